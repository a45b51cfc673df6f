"""The explorer in notebooks, as an anywidget."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

from ...labels import CAPTURE, EXPLORED, PATHS, TRANSIENT
from ...runtime import checks
from ..ui.bundle import text_of
from .module import javascript, style
from .page_contents import contents_of
from .paths import path_tracer

if TYPE_CHECKING:
    import xarray as xr
    from anywidget import AnyWidget


def explore(
    data: Annotated[xr.Dataset, EXPLORED],
    *,
    capture: Annotated[xr.Dataset, CAPTURE] | None = None,
    orders: Mapping[str, Annotated[xr.Dataset, TRANSIENT]] | None = None,
    distance_m: Any = None,
    title: str | None = None,
    scene: Any = None,
    paths: Sequence[Annotated[xr.Dataset, PATHS]] | None = None,
    megabytes: float = 80,
) -> AnyWidget:
    """Explore a transient in a notebook: light in time, pixels' responses, gates, phasors.

    The widget works in Jupyter, VS Code and Colab. A step in time needs a few milliseconds in the
    browser, even if the kernel is busy. Values are stored as one byte on a logarithmic scale. If
    they are larger than `megabytes`, blocks of pixels and bins are joined. The widget states the
    precision of values and the sizes of joined blocks. See also `report`, `visualize_transient`.

    Args:
        data: Result of `render`, `render_frames`, `capture`, `range_rate`, `strategy_pyramid`,
            `reconstruct` or `sensors.sense`. Error bars are shown if a render has standard errors.
            A pyramid shows the light by bounces.
        capture: Capture that was the input of the volume `data`. Then the wall, the laser
            spots and chosen points of the wall are shown. The view in 3D also shows the ellipsoid
            of possible points for the light of the chosen bin.
        orders: Parts of a render's light by name, Datasets of the same pixels and bins. They are
            drawn next to the response, for example `{"1 bounce": render(..., max_depth=2)}`.
        distance_m: Distance (height, width) [m] from the camera's position to the surface in each
            pixel of a render, as for `unwarp_camera`. With distances, time can be shown without the
            camera segment.
        title: Title. By default the name of the scene.
        scene: The scene of a render, loaded or as for `load_scene`. With a scene, the paths of the
            shown bin and the chosen pixel are listed and drawn into the picture.
        paths: Results of `paths_of` for some pixels, to show paths without a scene.
        megabytes: Largest size of the codes [1e6 bytes], above 0. All codes are sent to the browser
            at once.

    Returns:
        A widget, shown by a notebook if it is the last line of a cell. Its trait `header`
        describes the contents.

    Raises:
        ValueError: `data` is another Dataset, or another argument does not fit.
        MemoryError: The codes do not fit into memory.
        ImportError: anywidget is missing.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=20)
        >>> dataset = tofrender.render(scene, spp=16, window="auto")
        >>> widget = explore(dataset, title="Sixteen pixels")
        >>> widget.header["title"], widget.header["axis"]["count"]
        ('Sixteen pixels', 20)
    """
    # Prepare the data
    most = int(1e6 * checks.number("megabytes", megabytes, positive=True, high=1e6))
    parts: dict[str, Any] = {"capture": capture, "orders": orders, "distance_m": distance_m}
    contents = contents_of(data, **parts, title=title, paths=paths, most_bytes=most)

    # Show them, and answer questions about paths
    trace = None if scene is None else path_tracer(scene, data, contents.header["kind"])
    widget = _widget()(header=contents.header, data=contents.data, traces=trace is not None)
    if trace is not None:
        widget.on_msg(lambda _, asked, __: widget.send(trace(asked["pixel"], asked["range"])))
    return widget


def _widget() -> type[AnyWidget]:
    try:
        import anywidget
        import traitlets
    except ImportError:
        raise ImportError("anywidget is missing; run: pip install 'tofrender[explore]'") from None

    class Explorer(anywidget.AnyWidget):
        """An explorer of transients."""

        _esm = javascript() + text_of("explorer/notebook.js")
        _css = style()
        header = traitlets.Dict().tag(sync=True)
        data = traitlets.Bytes().tag(sync=True)
        traces = traitlets.Bool().tag(sync=True)

    return Explorer
