"""Create films with the pixels of another film, and read properties of films."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from ..runtime import checks
from ..signals.polarization import STOKES


def image_film(film: mi.Film) -> mi.Film:
    """Return a new `hdrfilm` in float32 with the size, crop and filter of another film."""
    pixel_format = "luminance" if mi.is_monochromatic else "rgb"
    stored = {"pixel_format": pixel_format, "component_format": "float32"}
    return mi.load_dict({"type": "hdrfilm"} | pixels_of(film) | stored)


def stokes_channels() -> list[str]:
    """Return the names of a picture's channels for S1, S2 and S3, none if unpolarized."""
    colors = "L" if mi.is_monochromatic else "RGB"
    return [f"{each}.{c}" for each in STOKES[1:] for c in colors] if mi.is_polarized else []


def temporal_filter_of(film: mi.Film) -> str:
    """Return the temporal filter of a film: "box", or "" if the `rfilter` is used in time too.

    The filter of a film without time bins reconstructs the picture only, so its temporal filter is
    "box".
    """
    if time_bins(film) is None:
        return "box"

    # mitransient's film does not have this attribute
    return getattr(film, "temporal_filter", "")


def pixels_of(film: mi.Film) -> dict[str, Any]:
    """Return the parameters of a film that define its pixels: size, crop, border and filter."""
    size = film.size()
    crop = film.crop_size()
    offset = film.crop_offset()
    return {
        "width": size.x,
        "height": size.y,
        "crop_width": crop.x,
        "crop_height": crop.y,
        "crop_offset_x": offset.x,
        "crop_offset_y": offset.y,
        "sample_border": film.sample_border(),
        "rfilter": film.rfilter(),
    }


def box_by_default(props: mi.Properties) -> None:
    """Add a box filter to a film's parameters without filter. A wrong `rfilter` raises an error."""
    kind = mi.ReconstructionFilter
    if "rfilter" in props:
        checks.instance("rfilter", props["rfilter"], kind, "a filter, like {'type': 'tent'}")
    if not any(isinstance(value, kind) for _, value in props.objects()):
        props["rfilter"] = mi.load_dict({"type": "box"})


def time_bins(film: mi.Film) -> tuple[int, float, float] | None:
    """Return number, start [m] and width [m] of a film's time bins, None for other films."""
    if not hasattr(film, "temporal_bins") or not hasattr(film, "add_transient_data"):
        return None
    return int(film.temporal_bins), float(film.start_opl), float(film.bin_width_opl)


def require_resolved(film: mi.Film) -> None:
    """Raise a ValueError if single precision cannot resolve time bins, see `checks.resolved`."""
    axis = time_bins(film)
    if axis is not None:
        bins, start, width = axis
        checks.resolved("bin_width_opl", width, start, start + bins * width)
