"""Figures that pyplot knows nothing of."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def new_figure(width: float, height: float, layout: Any = "constrained") -> Figure:
    """A figure [inches] outside of pyplot, that a notebook shows as the picture it is.

    The layout "compressed" keeps pictures close together, and their colour bars as high as them.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class Picture(Figure):
        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            self.savefig(stream, format="png")
            return stream.getvalue()

    class Canvas(FigureCanvasAgg):
        def draw_idle(self, *args: Any, **kwargs: Any) -> None:
            """There is no window to refresh; without this every frame is drawn twice."""

    figure = Picture(figsize=(width, height), layout=layout)
    Canvas(figure)
    return figure
