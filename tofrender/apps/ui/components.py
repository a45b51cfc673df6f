"""Components that all live applications share: page, messages, style sheets."""

from __future__ import annotations

import asyncio
import html
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any

import panel as pn
import param

from .bundle import text_of

CONTROLS_WIDTH = 264  # Width of a column of controls [px]


def control(kind: str, label: str, **options: Any) -> Any:
    """A widget of Panel, by default in a column of controls."""
    style = {"stylesheets": [text_of("ui/controls.css")], "margin": (4, 6), "width": CONTROLS_WIDTH}
    return getattr(pn.widgets, kind)(label=label, **(style | options))


def text(markup: str = "", **options: Any) -> Any:
    """A pane of HTML; data inside of it have to be escaped."""
    return pn.pane.HTML(markup, stylesheets=[text_of("ui/controls.css")], **options)


def box(kind: str, title: str, body: str = "") -> str:
    """HTML of a message: "good", "bad" or "" (a note), with a title and a body in HTML."""
    return (
        f'<div class="box {kind}" role="status"><strong>{html.escape(title)}</strong>{body}</div>'
    )


def table(rows: dict[str, str]) -> str:
    """HTML of a table with names and values."""
    items = (f"<dt>{html.escape(k)}</dt><dd>{html.escape(v)}</dd>" for k, v in rows.items())
    return f"<dl>{''.join(items)}</dl>"


def error_box(title: str, error: BaseException) -> str:
    """HTML of an error message: its first line, and the lines of code below it."""
    first, _, rest = str(error).partition("\n")
    body = html.escape(first) + (f"<pre>{html.escape(rest)}</pre>" if rest else "")
    return box("bad", title, body)


class Canvas(pn.custom.JSComponent):
    """A component in JavaScript that increments `ready` when it receives updates."""

    ready = param.Integer(default=0)
    __abstract = True


class Page(ABC):
    """The page of one reader, with a thread for long tasks; subclasses have `layout` and `draw`.

    Example:
        >>> class Counting(Page):
        ...     layout, drawn = None, 0
        ...
        ...     async def draw(self):
        ...         self.drawn += 1
        ...         await asyncio.sleep(0.01)
        >>> async def redraw():
        ...     page = Counting(None)
        ...     await asyncio.gather(*(page.redraw() for _ in range(5)))
        ...     return page.drawn
        >>> asyncio.run(redraw())  # The first, and the four others together
        2
    """

    def __init__(self, executor: Executor | None) -> None:
        self._executor = executor
        self._drawing = self._outdated = False

    @abstractmethod
    def layout(self) -> Any:
        """The layout, an object of Panel."""

    @abstractmethod
    async def draw(self) -> None:
        """Draw the current choice."""

    async def redraw(self, *_: Any) -> None:
        """Draw now, or once more after the drawing under way."""
        self._outdated = True
        if self._drawing:
            return
        self._drawing = True
        try:
            while self._outdated:
                self._outdated = False
                await self.draw()
        finally:
            self._drawing = False

    async def run(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function in the application's thread."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._executor, function, *arguments)


def application(page: Callable[[], Page]) -> Callable[[], Any]:
    """A function that makes the layout of a new reader's page, for `serving.serve`."""

    def make() -> Any:
        style = text_of("ui/page.css")
        if style not in pn.config.raw_css:
            pn.config.raw_css = [*pn.config.raw_css, style]
        return page().layout()

    return make
