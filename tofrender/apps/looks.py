"""How all applications look: one style sheet for the page, one for what is in it."""

from __future__ import annotations

import html
from functools import cache
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


@cache
def page_style() -> str:
    """Colours and measures of the page."""
    return (HERE / "page.css").read_text(encoding="utf-8")


@cache
def controls_style() -> str:
    """Style of each control and pane."""
    return (HERE / "controls.css").read_text(encoding="utf-8")


def text(markup: str = "", **options: Any) -> Any:
    """A pane of HTML; what comes from elsewhere has to be escaped."""
    import panel as pn

    return pn.pane.HTML(markup, stylesheets=[controls_style()], **options)


def box(kind: str, title: str, body: str = "") -> str:
    """A message: "good", "bad" or "" (a note), with a title and more in HTML."""
    return (
        f'<div class="box {kind}" role="status"><strong>{html.escape(title)}</strong>{body}</div>'
    )


def trouble(title: str, error: BaseException) -> str:
    """What went wrong, as it was said: the first line, and the lines of code below it."""
    first, _, rest = str(error).partition("\n")
    body = html.escape(first) + (f"<pre>{html.escape(rest)}</pre>" if rest else "")
    return box("bad", title, body)
