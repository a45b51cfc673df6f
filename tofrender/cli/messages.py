"""Messages of the package with the names of the command's options in them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from inspect import signature
from typing import Any, get_type_hints

import typer

from ..rendering.settings import SCENE_NAMES

OPTION_NAMES = {scene_name: name for name, scene_name in SCENE_NAMES.items()}
OPTION_NAMES |= {"width": "size", "height": "size"}
"""Parameters of commands by the names of the same settings in scenes and films."""

_options: dict[str, tuple[str, bool]] = {}
"""Options of the running command by parameter, with whether each is given."""


def set_command(command: Callable[..., Any] | None, given: Mapping[str, Any]) -> None:
    """Set the command that messages are about, and the values it is called with."""
    _options.clear()
    if command is None:
        return
    kinds = get_type_hints(command, include_extras=True)
    for name, parameter in signature(command).parameters.items():
        about = [each for each in getattr(kinds[name], "__metadata__", ()) if each is not None]
        if any(isinstance(each, typer.models.ArgumentInfo) for each in about):
            continue
        declared = [name for each in about for name in getattr(each, "param_decls", None) or ()]
        option = declared[0] if declared else f"--{name.replace('_', '-')}"
        _options[name] = option, given.get(name) != parameter.default


def with_option_names(message: str) -> str:
    """Replace names of parameters in a message by options of the running command.

    The first word is replaced if that option was given, a word in backticks wherever the command
    has the option.
    """

    def first(found: re.Match[str]) -> str:
        option, given = _option(found[1])
        return f"{option if given else found[1]}{found[2]}"

    def quoted(found: re.Match[str]) -> str:
        option, _ = _option(found[1])
        return found[0] if not option else f"{option} {found[3]}" if found[3] else option

    message = re.sub(r"\A(\w+)( = |:)", first, message)
    if "variant" in _options:
        message = re.sub(r"call mi\.set_variant\('(\w+)'\) first", r"give --variant \1", message)
    return re.sub(r"`(\w+)(='?([^`']*)'?)?`", quoted, message)


def _option(word: str) -> tuple[str, bool]:
    return _options.get(OPTION_NAMES.get(word, word), ("", False))
