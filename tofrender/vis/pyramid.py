"""The strategies of bidirectional path tracing as a pyramid of pictures."""

from typing import Annotated, Any

import xarray as xr
from matplotlib.figure import Figure

from ..labels import PYRAMID, bins_of, read
from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure
from ..runtime.plots import wrap_text
from .tone import auto_exposure, tonemap
from .transient_figures import picture_aspect

_WIDTH = 1.2  # Usual width of a picture [inches]
_LEAST = 0.42  # Least width of a picture [inches]
_WITH_TITLE = 0.8  # Least width of a picture with a full title [inches]
_GAP = 0.07  # Horizontal gap between pictures [inches]
_ABOVE = 0.2  # Space for the title above a picture [inches]


@in_style()
def pyramid_figure(
    pyramid: Annotated[xr.Dataset, PYRAMID],
    *,
    weighting: str = "mis",
    opl: float | None = None,
    stops_per_row: float = 1.0,
    title: str | None = None,
) -> Figure:
    """Draw the light of each strategy: a row for each number of segments, s grows to the right.

    White in the first row is the 98th percentile of the light of all strategies. Pictures are at
    least 0.42 inches wide, also if the chosen width of figures is smaller.

    Args:
        pyramid: The result of `strategy_pyramid`.
        weighting: "mis" for light with MIS weights, "none" for the unweighted light.
        opl: Path length [m]. The time bin at this path length is drawn. By default the light of all
            times is drawn.
        stops_per_row: Additional exposure of each row, since long paths contain little light. With
            0, rows are comparable.
        title: Title of the figure. By default the title describes the contents. Narrow pictures
            have the numbers s and t as their titles.

    Raises:
        ValueError: Not a result of `strategy_pyramid`, or a path length outside its bins.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=8, height=8, temporal_bins=50, bin_width_opl=0.3)
        >>> pyramid = tofrender.strategy_pyramid(scene, max_depth=2, spp=4)
        >>> [axes.get_title() for axes in pyramid_figure(pyramid).axes]
        ['s = 0, t = 2', 's = 1, t = 1', 's = 0, t = 3', 's = 1, t = 2', 's = 2, t = 1']
    """
    # Choose the light and the exposure
    pyramid = read(pyramid, PYRAMID, "pyramid")
    checks.text("title", title)
    weighting = checks.one_of("weighting", weighting, ("mis", "none"))
    stops = checks.number("stops_per_row", stops_per_row, low=0, high=100)
    chosen = pyramid["steady"]
    label = "light of all time"
    if opl is not None:
        index = _bin_of(pyramid, opl)
        chosen = pyramid["transient"].isel(opl=index)
        label = f"bin at {float(pyramid['opl'][index]):.4g} m"
    exposure = auto_exposure(chosen.sel(weighting="mis").sum("strategy").values, percentile=98)

    # Compute the size of the pictures and of the figure [inches]
    rows = int((pyramid["s"] + pyramid["t"]).max()) - 1
    wide = max(figure_width(max(3.4, min(7.0, _WIDTH * (rows + 1)))), _LEAST * (rows + 1))
    each = wide / (rows + 1)
    high = (each - _GAP) * picture_aspect(pyramid.sizes["y"], pyramid.sizes["x"], 0.3, 3.0)
    if title is None:
        title = f"{'weighted' if weighting == 'mis' else 'unweighted'}, {label}"
        title += f", {stops:+g} stops a row" if stops else ""
    named = wrap_text(title if each > _WITH_TITLE else f"{title}\nnumbers are s, t", wide - 0.1)
    top = 0.1 + 0.155 * len(named.splitlines())
    tall = top + rows * (high + _ABOVE) + 0.07
    figure = new_figure(wide, tall, layout=None)
    figure.suptitle(named, y=1 - 0.07 / tall, va="top")

    # Draw the strategies
    for picture in chosen.sel(weighting=weighting):
        s = int(picture["s"])
        t = int(picture["t"])
        segments = s + t - 1
        left = (rows - segments + 2 * s) / 2 * each + _GAP / 2
        bottom = tall - top - segments * (high + _ABOVE)
        box = (left / wide, bottom / tall, (each - _GAP) / wide, high / tall)
        axes = figure.add_axes(box, xticks=[], yticks=[])
        gain = exposure * 2 ** (stops * (segments - 1))
        axes.imshow(tonemap(picture.values, exposure=gain))
        label = f"s = {s}, t = {t}" if each > _WITH_TITLE else f"{s}, {t}"
        axes.set_title(label, fontsize=7, pad=2)
    return figure


def _bin_of(pyramid: xr.Dataset, opl: Any) -> int:
    """Return the index of the bin with a path length."""
    bins = bins_of(pyramid, "pyramid")
    start = bins.start_opl
    stop = bins.stop_opl
    opl = checks.meters("opl", opl)
    if not start <= opl < stop:
        raise ValueError(f"opl = {opl:g} m: must be in the bins, {start:g} m to {stop:g} m")
    return min(int((opl - start) / bins.bin_width_opl), bins.count - 1)
