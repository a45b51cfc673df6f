"""Debian's Chromium, driven by Playwright, for tests that look at pages as a reader does."""

import fcntl
import io
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from helpers.processes import GUARD_S
from helpers.served import is_free, served

NAMES = ("chromium", "chromium-browser", "google-chrome")
INSTALL = "apt-get install -y --no-install-recommends chromium"


@cache
def chromium() -> str:
    """Where Chromium is; root on Debian gets it installed, others skip the test with a reason."""
    with (Path(tempfile.gettempdir()) / f"tofrender-chromium-{os.getuid()}").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # Several pytest workers ask at once
        found = next(filter(None, map(shutil.which, NAMES)), None)
        if found is None and os.getuid() == 0 and shutil.which("apt-get"):
            command = f"{INSTALL} || (apt-get update && {INSTALL})"
            subprocess.run(["sh", "-c", command], capture_output=True, check=False)
            found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip(f"no Chromium; run: sudo {INSTALL}")
    return found


def elsewhere(page: Any, *own: str) -> list[str]:
    """What a page asked for that is not its own."""
    return [url for url in page.asked if not url.startswith((*own, "data:", "blob:"))]


@contextmanager
def page_of(*arguments: object, size: tuple[int, int] = (1280, 800), dark=False) -> Iterator[Any]:
    """The page of a command, which is `page.command`; it asks no other host for anything."""
    with served(*arguments, "--no-browser") as command:
        viewport = {"width": size[0], "height": size[1]}
        with page(dark=dark, viewport=viewport, accept_downloads=True) as there:
            there.goto(command.url)
            there.command = command
            yield there
            assert there.errors == []
            assert elsewhere(there, command.site) == []
        assert command.stop() == 0
        assert "Traceback" not in command.errors
        assert is_free(command.port)


def drag(page: Any, start: tuple[float, float], stop: tuple[float, float]) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*stop, steps=5)
    page.mouse.up()


def shades(page: Any) -> np.ndarray:
    return np.array(Image.open(io.BytesIO(page.screenshot())).convert("L"))


def found(condition: str, value: str) -> str:
    """JavaScript: the `value` of the first `each` of all elements, in shadows too, that is so."""
    return f"""(function find(root) {{
      for (const each of root.querySelectorAll('*')) {{
        if ({condition}) return {value};
        const inner = each.shadowRoot && find(each.shadowRoot);
        if (inner) return inner;
      }}
    }})(document)"""


@contextmanager
def page(*, dark: bool = False, offline: bool = False, **options: Any) -> Iterator[Any]:
    """A page of a browser without a window; `page.errors` and `page.asked` are lists of texts.

    Args:
        dark: Whether the reader prefers dark pages.
        offline: Whether there is no network at all.
        options: More of Playwright's `new_context`, like `viewport`.
    """
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        colors = "dark" if dark else "light"
        context = browser.new_context(color_scheme=colors, offline=offline, **options)
        context.set_default_timeout(1000 * GUARD_S)
        page = context.new_page()
        page.errors, page.asked = [], []
        page.on("request", lambda request: page.asked.append(request.url))
        page.on("pageerror", lambda error: page.errors.append(str(error)))
        page.on("console", lambda e: page.errors.append(e.text) if e.type == "error" else None)
        try:
            yield page
        finally:
            browser.close()
