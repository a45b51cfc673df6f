"""Degrees and angles of polarization of Stokes vectors."""

from typing import Annotated, Any

import numpy as np

from ..labels import STOKES, STOKES_VECTORS
from ..runtime import checks
from ..signals.phasors import wrap

# Default axis of Stokes components, before the channels
AXIS = -2


def degree_of_polarization(stokes: Annotated[Any, STOKES_VECTORS], axis: int = AXIS) -> Any:
    """Return the degree of polarization, sqrt(S1² + S2² + S3²) / S0.

    Args:
        stokes: Stokes vectors: a DataArray with a dimension `stokes`, as `render` returns in
            polarized variants, or an array of any shape.
        axis: Axis of an array that contains the four components, by default before the channels.

    Returns:
        Degree from 0 to 1, float64, without this axis. A DataArray results in a DataArray, an array
        in an array. NaN without light.

    Raises:
        ValueError: The number of components is not four.

    Example:
        >>> degree_of_polarization([2.0, 0.0, 1.2, 1.6], axis=0).round(6)
        np.float64(1.0)
    """
    return _apply(stokes, axis, lambda s0, s1, s2, s3: _over(np.sqrt(s1**2 + s2**2 + s3**2), s0))


def degree_of_linear_polarization(stokes: Annotated[Any, STOKES_VECTORS], axis: int = AXIS) -> Any:
    """Return the degree of linear polarization, sqrt(S1² + S2²) / S0.

    Arguments, result and errors are as for `degree_of_polarization`.

    Example:
        >>> degree_of_linear_polarization([2.0, 0.0, 1.2, 1.6], axis=0).round(6)
        np.float64(0.6)
    """
    return _apply(stokes, axis, lambda s0, s1, s2, s3: _over(np.hypot(s1, s2), s0))


def degree_of_circular_polarization(
    stokes: Annotated[Any, STOKES_VECTORS], axis: int = AXIS
) -> Any:
    """Return the signed degree of circular polarization, S3 / S0, from -1 to 1.

    Arguments, result and errors are as for `degree_of_polarization`.

    Example:
        >>> degree_of_circular_polarization([2.0, 0.0, 1.2, -1.6], axis=0).round(6)
        np.float64(-0.8)
    """
    return _apply(stokes, axis, lambda s0, s1, s2, s3: _over(s3, s0))


def angle_of_linear_polarization(stokes: Annotated[Any, STOKES_VECTORS], axis: int = AXIS) -> Any:
    """Return the angle of linear polarization, atan2(S2, S1) / 2, in [0, pi).

    The angle is measured from the right of the picture towards its top: 0 across the sensor's `up`,
    pi/2 along `up`. NaN for light without linear polarization. Arguments and errors are as for
    `degree_of_polarization`.

    Example:
        >>> np.degrees(angle_of_linear_polarization([1.0, 0.0, -1.0, 0.0], axis=0)).round(3)
        np.float64(135.0)
    """

    def angle(s0, s1, s2, s3):
        found = np.where(np.hypot(s1, s2) > 0, np.arctan2(s2, s1) / 2, np.nan)
        return wrap(found, np.pi)[()]

    return _apply(stokes, axis, angle)


def _apply(stokes: Any, axis: int, formula: Any) -> Any:
    """Evaluate a formula of the four components, and keep the labels of a DataArray."""
    import xarray as xr

    # A DataArray
    if isinstance(stokes, xr.DataArray):
        names = [str(n) for n in stokes["stokes"].values] if "stokes" in stokes.indexes else STOKES
        if stokes.sizes.get("stokes") != 4 or {*names} != {*STOKES}:
            found = dict(stokes.sizes)
            raise ValueError(f"stokes = DataArray with {found}: must have 4 components stokes")
        parts = [stokes.isel(stokes=names.index(name), drop=True) for name in STOKES]
        values = formula(*(np.asarray(each.values, np.float64) for each in parts))
        return xr.DataArray(values, parts[0].coords, parts[0].dims)

    # An array
    array = checks.real_array("stokes", stokes, np.float64)
    axis = checks.integer("axis", axis, min(-array.ndim, AXIS), max(array.ndim, 1) - 1)
    if array.shape[axis : axis + 1 or None] != (4,):
        raise ValueError(f"stokes with shape {array.shape}: must have 4 components on axis {axis}")
    return formula(*np.moveaxis(array, axis, 0))


def _over(part: Any, s0: Any) -> Any:
    """Divide by S0. The result is NaN if S0 is 0 or less."""
    return np.where(s0 > 0, part / np.where(s0 > 0, s0, 1), np.nan)[()]
