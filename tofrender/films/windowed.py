"""Create films with time bins and the pixels of another film."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mitsuba as mi

from ..runtime import plugins
from .image import pixels_of, temporal_filter_of

if TYPE_CHECKING:
    from .transient import TransientHDRFilm


def transient_film(
    film: mi.Film, temporal_bins: int, start_opl: float, bin_width_opl: float, **pixels: int
) -> TransientHDRFilm:
    """Return a new `transient_hdr_film` with the pixels and filters of another film.

    Args:
        film: The other film.
        temporal_bins: Number of bins.
        start_opl: Start of the first bin [m].
        bin_width_opl: Width of a bin [m].
        **pixels: Values that replace parameters of `pixels_of`.
    """
    bins = {
        "temporal_bins": temporal_bins,
        "start_opl": start_opl,
        "bin_width_opl": bin_width_opl,
        "temporal_filter": temporal_filter_of(film),
    }
    plugin = plugins.qualified_name("transient_hdr_film")
    return mi.load_dict({"type": plugin} | pixels_of(film) | pixels | bins)
