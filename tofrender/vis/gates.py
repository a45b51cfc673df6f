"""A picture of one instant, with its time and a scale."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure
from ..runtime.plots import colour_bar, fit_height, wrap_text
from ..signals.units import opl_to_ns
from .figures import explain_hatch, picture_aspect, pixel_axes
from .tone import auto_exposure, tonemap

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@in_style
def gate_figure(
    image: Any,
    opl: float,
    pulse_width_opl: float,
    *,
    exposure: float | None = None,
    title: str | None = None,
) -> Figure:
    """Draw what a Gaussian gate saw: the picture, when and for how long, and how bright it is.

    Args:
        image: What `render_at_time` returns, radiance per metre [W m^-3 sr^-1]: (height, width) or
            (height, width, channels) with 1 or 3 channels.
        opl: Path length at the middle of the gate [m].
        pulse_width_opl: Standard deviation of the gate [m], above 0.
        exposure: Gain; `1` is shown as white after it. None shows the 99.5th percentile of the
            light as white.
        title: Above the line that says the time; None for nothing.

    Returns:
        A `matplotlib.figure.Figure`, made outside of pyplot. The colour bar says how bright white
        and greys are; of colours it goes for each channel.

    Raises:
        ValueError: Another shape, or a number out of range.

    Example:
        >>> figure = gate_figure(np.ones((4, 6, 3)), opl=5.9, pulse_width_opl=0.03)
        >>> figure.axes[0].get_title()
        't = 19.68 ± 0.10 ns, OPL = 5.900 ± 0.030 m'
    """
    opl = checks.metres("opl", opl)
    width = checks.metres("pulse_width_opl", pulse_width_opl, positive=True)
    checks.text("title", title)
    image = checks.real_array("image", image)
    if exposure is None:
        exposure = auto_exposure(image)
    exposure = checks.number("exposure", exposure, positive=True)
    try:
        picture = tonemap(image, exposure=exposure)
    except ValueError as error:
        raise ValueError(str(error).replace("values", "image", 1)) from None

    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    wide = figure_width(4.6)
    rows, columns = picture.shape[:2]
    high = wide * picture_aspect(rows, columns, 0.4, 2.0) + 1.0
    figure = new_figure(wide, high, "compressed")
    axes = figure.add_subplot()
    axes.imshow(picture, interpolation="nearest")
    pixel_axes(axes)
    axes.set_title(_when(opl, width))
    greys = tonemap(np.linspace(0, 1, 256)[None], exposure=1)[0] / 255
    scale = ScalarMappable(Normalize(0, 1 / exposure), ListedColormap(greys.tolist()))
    brighter = bool((image * exposure > 1.0001).any())
    label = "radiance per metre [W m⁻³ sr⁻¹]"
    colour_bar(scale, axes, label, extend="max" if brighter else "neither")
    if title is not None:
        figure.suptitle(wrap_text(title, wide))
    explain_hatch(figure, np.isnan(image), dark=True)
    fit_height(figure)
    return figure


def _when(opl: float, width: float) -> str:
    """Time and path length with digits for a tenth of the gate's width."""
    parts = []
    for middle, around, unit in (
        (opl_to_ns(opl), opl_to_ns(width), "ns"),
        (opl, width, "m"),
    ):
        digits = min(12, max(1, 1 - math.floor(math.log10(around))))
        parts.append(f"{middle:.{digits}f} ± {around:.{digits}f} {unit}")
    return f"t = {parts[0]}, OPL = {parts[1]}"
