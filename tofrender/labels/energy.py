"""The part of the light that no time bin of a film contains."""

from typing import Any

import numpy as np
import xarray as xr

from .reading import intensity

NAME = "energy_outside_window"
AGREES = 1e-3  # Difference of a stored number that rounding and filters explain


def energy_outside_window(film: xr.Dataset, parameter: str) -> float | None:
    """Return the part of the energy of a film that no bin contains, from 0 to 1.

    The part is 1 - light / steady, with the sums of both over all pixels and channels. Polarized
    films are summed over S0. For frames, the largest part of all frames is returned. The stored
    attribute is returned if it agrees. After a choice of pixels or bins, the attribute is stale.

    Args:
        film: A Dataset in the order of `read`, with or without `steady`.
        parameter: Name of the function's parameter, for messages.

    Returns:
        The part, or None if there is neither `steady` nor an attribute.

    Raises:
        ValueError: The attribute is not a number, or S0 is missing.

    Example:
        >>> light = (("y", "x", "opl", "channel"), np.ones((1, 1, 3, 1)))
        >>> film = xr.Dataset({"transient": light}, attrs={"energy_outside_window": 0.0})
        >>> film["steady"] = (("y", "x", "channel"), np.full((1, 1, 1), 4.0))
        >>> energy_outside_window(film, "film")
        0.25
    """
    # Is the attribute a number?
    stored: Any = film.attrs.get(NAME)
    is_number = isinstance(stored, float | int | np.number) and bool(np.isfinite(stored))
    if stored is not None and not is_number:
        raise ValueError(f"{parameter}: the attribute {NAME} = {stored!r} is not a finite number")
    known = None if stored is None else float(stored)
    if "steady" not in film:
        return known

    # Compare the light in the bins with the light of all times
    if "frame" in film.dims:
        frames = (film.isel(frame=number) for number in range(film.sizes["frame"]))
        parts = [energy_outside_window(frame, parameter) for frame in frames]
        return max((part for part in parts if part is not None), default=None)
    name = "transient" if "transient" in film else "radiance"
    light = _sum(intensity(film[name], parameter))
    steady = _sum(intensity(film["steady"], parameter))
    if film.attrs.get("quantity") == "radiance per meter":
        light *= film.attrs["bin_width_opl"]
    if not (steady > 0 and np.isfinite(light)):
        return known

    # Keep the stored number if only rounding differs, so that unchanged films stay equal
    found = min(max(1 - light / steady, 0.0), 1.0)
    if known is not None and abs(found - known) <= AGREES:
        return known
    return found


def _sum(values: xr.DataArray) -> float:
    """Return the sum of the values without NaN; the usual sum is faster, and enough without NaN."""
    total = float(values.sum(dtype=np.float64, skipna=False))
    return total if np.isfinite(total) else float(values.sum(dtype=np.float64))


def with_energy(film: xr.Dataset, parameter: str) -> xr.Dataset:
    """Return a film, with `energy_outside_window` computed from its pixels and bins."""
    outside = energy_outside_window(film, parameter)
    return film if outside is None else film.assign_attrs({NAME: outside})
