"""A live page: one component of Panel, with controls in JavaScript."""

import asyncio
from abc import abstractmethod
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any

import panel as pn
import param
from panel.io.document import schedule_write_events

WRITTEN_S = 0.1  # Longest time from a change until it is written [s]


class App(pn.custom.JSComponent):
    """The page of one reader, with a thread for long tasks. `ui/app.js` shows the page.

    Subclasses define `_esm`, `draw`, and a method `do_name` for each message {"do": "name", ...}.

    Example:
        >>> class Counting(App):
        ...     _esm, drawn = "export function render() {}", 0
        ...
        ...     async def draw(self):
        ...         self.drawn += 1
        ...         await asyncio.sleep(0.01)
        >>> async def redraw():
        ...     page = Counting(None)
        ...     await asyncio.gather(*(page.do_redraw() for _ in range(5)))
        ...     return page.drawn
        >>> asyncio.run(redraw())  # The first, and the four others together
        2
    """

    state = param.Dict(default={}, doc="Numbers and texts to show.")
    data = param.Dict(default={}, doc="Arrays as bytes, and their descriptions.")
    chosen = param.Dict(default={}, doc="Choices of the reader.")
    __abstract = True
    PERIOD_MS = 0

    def __init__(self, executor: Executor | None, chosen: Any = None, **state: Any) -> None:
        super().__init__(sizing_mode="stretch_width", chosen=chosen or {}, state=state)
        self._executor = executor
        self._drawing = self._outdated = self._is_open = False
        self._document: Any = None  # Remains None in a notebook
        self.param.watch(self.do_redraw, "chosen")

    @abstractmethod
    async def draw(self) -> None:
        """Compute and show the reader's choice."""

    async def refresh(self) -> None:
        """Look for changes, each `PERIOD_MS` while the page is open."""
        await self.do_redraw()

    async def do_open(self) -> None:
        """Start when the page is open. Earlier changes may not reach the page."""
        if self.PERIOD_MS and not self._is_open:
            refresh: Any = self.refresh
            pn.state.add_periodic_callback(refresh, period=self.PERIOD_MS)
        self._is_open = True
        self._document = pn.state.curdoc
        await self.do_redraw()

    async def do_redraw(self, *_: Any) -> None:
        """Draw now, or once again after the current drawing."""
        # Only one drawing at a time
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

    def tell(self, **changes: Any) -> None:
        """Change the state that is shown."""
        if (state := self.state | changes) != self.state:
            self.send(self.param.update, state=state)

    def send(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> None:
        """Call a function that changes the page, and write the changes that Panel has kept.

        After two quick changes, Panel 1.9 may keep the second change until the third change.
        """
        function(*arguments, **options)
        if self._document is not None:
            loop = asyncio.get_running_loop()
            loop.call_later(WRITTEN_S, schedule_write_events, self._document, [], [])

    async def _handle_msg(self, data: dict[str, Any]) -> None:
        await getattr(self, f"do_{data.pop('do')}")(**data)


def failure(title: str, error: BaseException) -> dict[str, str]:
    """Describe an error as a message of the page.

    Returns:
        A dict. `kind` is "bad", `title` is the given title, `text` is the first line of the error,
        and `code` contains its other lines.
    """
    first, _, rest = str(error).partition("\n")
    return {"kind": "bad", "title": title, "text": first, "code": rest}
