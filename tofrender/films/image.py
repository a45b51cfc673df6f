"""Films for the pixels of another one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mitsuba as mi

from ..runtime import checks, plugins
from ..signals.polarisation import STOKES

if TYPE_CHECKING:
    from .transient import TransientHDRFilm


def image_film(film: mi.Film) -> mi.Film:
    """Return a new `hdrfilm` of the same size, crop and filter, in float32."""
    pixel_format = "luminance" if mi.is_monochromatic else "rgb"
    stored = {"pixel_format": pixel_format, "component_format": "float32"}
    return mi.load_dict({"type": "hdrfilm"} | pixels_of(film) | stored)


def stokes_channels() -> list[str]:
    """Return names of channels for the Stokes components that a picture has beside its colours."""
    colours = "L" if mi.is_monochromatic else "RGB"
    return [f"{each}.{c}" for each in STOKES[1:] for c in colours] if mi.is_polarized else []


def transient_film(
    film: mi.Film, temporal_bins: int, start_opl: float, bin_width_opl: float, **pixels: int
) -> TransientHDRFilm:
    """Return a new `transient_hdr_film` of the same pixels and filters, with the given bins [m].

    `pixels` replaces some parameters of `pixels_of`.
    """
    bins = {
        "temporal_bins": temporal_bins,
        "start_opl": start_opl,
        "bin_width_opl": bin_width_opl,
        "temporal_filter": temporal_filter_of(film),
    }
    plugin = plugins.qualified_name("transient_hdr_film")
    return mi.load_dict({"type": plugin} | pixels_of(film) | pixels | bins)


def temporal_filter_of(film: mi.Film) -> str:
    """Return the filter in time of a film: "box", or "" for its `rfilter` in time as well.

    The filter of a film without time bins reconstructs the picture and has no meaning in time.
    """
    if time_bins(film) is None:
        return "box"
    return getattr(film, "temporal_filter", "")  # The film of mitransient lacks it


def pixels_of(film: mi.Film) -> dict[str, Any]:
    """Return the parameters of a film that say which pixels it has."""
    size, crop, offset = film.size(), film.crop_size(), film.crop_offset()
    return {
        **{"width": size.x, "height": size.y},
        **{"crop_width": crop.x, "crop_height": crop.y},
        **{"crop_offset_x": offset.x, "crop_offset_y": offset.y},
        **{"sample_border": film.sample_border(), "rfilter": film.rfilter()},
    }


def box_by_default(props: mi.Properties) -> None:
    """Give a film the box filter if its parameters have none; refuse an `rfilter` that is none."""
    kind = mi.ReconstructionFilter
    if "rfilter" in props:
        checks.instance("rfilter", props["rfilter"], kind, "a filter, like {'type': 'tent'}")
    if not any(isinstance(value, kind) for _, value in props.objects()):
        props["rfilter"] = mi.load_dict({"type": "box"})


def time_bins(film: mi.Film) -> tuple[int, float, float] | None:
    """Return the number of a film's time bins, start and width [m]; None without bins."""
    if not hasattr(film, "temporal_bins") or not hasattr(film, "add_transient_data"):
        return None
    return int(film.temporal_bins), float(film.start_opl), float(film.bin_width_opl)


def require_resolved(film: mi.Film) -> None:
    """Refuse time bins too narrow for the lengths in them, see `checks.resolved`."""
    axis = time_bins(film)
    if axis is not None:
        bins, start, width = axis
        checks.resolved("bin_width_opl", width, start, start + bins * width)
