"""Checks of where something is: paths of files, addresses of schedulers."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from .messages import shown

MAX_NAME, MAX_PATH = 255, 4096
"""Bytes of a file's name, and of a path, that file systems take."""


def path(name: str, value: Any) -> Path:
    """Return `value`, text or an `os.PathLike`, as a `Path`.

    A number is refused, which `open` would take for an open file, and close.

    Raises:
        ValueError: One line with name and value.

    Example:
        >>> path("path", 3)
        Traceback (most recent call last):
        ValueError: path = 3: must be text or an os.PathLike, the name of a file or folder
    """
    allowed = "must be text or an os.PathLike, the name of a file or folder"
    if isinstance(value, str | os.PathLike):
        text = os.fspath(value)
        if isinstance(text, str) and text.splitlines() == [text] and "\0" not in text:
            longest = max(len(os.fsencode(part)) for part in (*Path(text).parts, ""))
            if longest > MAX_NAME or len(text) > MAX_PATH:
                allowed = f"must have names of at most {MAX_NAME} bytes, {MAX_PATH} in all"
                raise ValueError(f"{name} = {shown(text)}: {allowed}")
            return Path(text)
        if text:
            value, allowed = text, "must be a name in one line, without NUL"
    raise ValueError(f"{name} = {shown(value)}: {allowed}")


def address(name: str, value: Any) -> str:
    """Return the address of a scheduler.

    Raises:
        ValueError: One line with name, value and what is allowed.

    Example:
        >>> address("scheduler", "10.0.0.1")
        Traceback (most recent call last):
        ValueError: scheduler = '10.0.0.1': must be an address like tcp://10.0.0.1:8786
    """
    found = re.fullmatch(r"((tcp|tls|ws|wss|ucx)://)?(\[[\w:%.]+\]|[^\s/:]+):(\d{1,5})", str(value))
    if not isinstance(value, str) or not found or not 0 < int(found[4]) < 1 << 16:
        raise ValueError(f"{name} = {shown(value)}: must be an address like tcp://10.0.0.1:8786")
    return found[0]
