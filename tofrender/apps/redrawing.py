"""Drawing anew what changes while it is drawn."""

from __future__ import annotations

from collections.abc import Awaitable, Callable


class Redrawing:
    """Draws once at a time: what is asked for meanwhile is drawn together, once, afterwards.

    Args:
        draw: Draws what is chosen when it is called.

    Example:
        >>> import asyncio
        >>> async def draw():
        ...     drawn.append(len(drawn))
        ...     await asyncio.sleep(0.01)
        >>> async def ask():
        ...     await asyncio.gather(*(redraw() for _ in range(5)))
        >>> redraw, drawn = Redrawing(draw), []
        >>> asyncio.run(ask())
        >>> drawn  # The first, and the four others
        [0, 1]
    """

    def __init__(self, draw: Callable[[], Awaitable[None]]) -> None:
        self._draw = draw
        self._busy = self._again = False

    async def __call__(self) -> None:
        """Draw, now or as soon as what is drawn is done."""
        self._again = True
        if self._busy:
            return
        self._busy = True
        try:
            while self._again:
                self._again = False
                await self._draw()
        finally:
            self._busy = False
