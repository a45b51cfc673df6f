"""Units and names of all variables and coordinates of Datasets, and the coordinate `time`.

`time` [ns] is a second coordinate along the axis `opl` [m]. It has an index, so `sel(time=...)`
works like `sel(opl=...)`. `time` is computed from `opl` and not stored in files.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..signals.units import opl_to_ns

if TYPE_CHECKING:
    import xarray as xr

# Name of the second coordinate along the axis `opl`
TIME = "time"

# Units and names of coordinates
AXES: dict[str, dict[str, str]] = {
    "x": {"units": "pixel", "long_name": "column"},
    "y": {"units": "pixel", "long_name": "row"},
    "laser_x": {"units": "point", "long_name": "column of the lit point"},
    "laser_y": {"units": "point", "long_name": "row of the lit point"},
    "opl": {"units": "m", "long_name": "optical path length"},
    "time": {"units": "ns", "long_name": "time"},
    "stokes": {"units": "1", "long_name": "component of the Stokes vector"},
    "channel": {"units": "1", "long_name": "channel"},
    "xyz": {"units": "1", "long_name": "axis of the world"},
    "axis": {"units": "1", "long_name": "axis of the volume"},
    "weighting": {"units": "1", "long_name": "weights"},
    "strategy": {"units": "1", "long_name": "strategy s,t"},
    "record": {"units": "1", "long_name": "record"},
    "frequency": {"units": "Hz", "long_name": "frequency"},
    "part": {"units": "1", "long_name": "part of the phasor"},
    "wall_x": {"units": "point", "long_name": "column of the wall"},
    "wall_y": {"units": "point", "long_name": "row of the wall"},
    "s": {"units": "1", "long_name": "vertices from a light"},
    "t": {"units": "1", "long_name": "vertices from the lens"},
}

# Units and names of variables. The attributes of the Dataset define them for light
VARIABLES: dict[str, dict[str, str]] = {
    "sensor_grid": {"units": "m", "long_name": "points looked at"},
    "sensor_normals": {"units": "1", "long_name": "normals of the wall where it is looked at"},
    "laser_grid": {"units": "m", "long_name": "points lit"},
    "laser_normals": {"units": "1", "long_name": "normals of the wall where it is lit"},
    "sensor_origin": {"units": "m", "long_name": "place of the sensor"},
    "laser_origin": {"units": "m", "long_name": "place of the laser"},
    "on_wall": {"units": "1", "long_name": "whether a pixel looks at the wall"},
    "intensity": {"units": "1", "long_name": "intensity"},
    "normals": {"units": "1", "long_name": "normals"},
    "features": {"units": "m or 1", "long_name": "position, normal, albedo, distance, kind"},
    "attempt": {"units": "1", "long_name": "draws that were tried"},
    "render_seed": {"units": "1", "long_name": "seed of the render"},
    "energy_outside_window": {"units": "1", "long_name": "energy outside the window"},
    "made_with": {"units": "1", "long_name": "all that made it"},
    "frame_origin": {"units": "m", "long_name": "origin of the volume"},
    "frame_axes": {"units": "1", "long_name": "axes of the volume"},
}


def labels_of(name: str, attrs: Mapping[str, Any]) -> dict[str, str]:
    """Return the units and the long name of a variable or coordinate.

    Args:
        name: Name of the variable.
        attrs: Attributes of the Dataset.
    """
    # Is the variable in a table?
    known = AXES.get(name) or VARIABLES.get(name)
    if known is not None:
        return known

    # Is the variable light, or its standard error?
    what, _, error = name.partition("_")
    if what not in ("transient", "steady") or error not in ("", "error"):
        return {}

    # Find the quantity and the units. A steady picture is integrated over the path length
    quantity = "radiance" if what == "steady" else str(attrs.get("quantity", "radiance per bin"))
    units = str(attrs.get("units", "W m^-2 sr^-1"))
    if what == "steady" and units == "W m^-3 sr^-1":
        units = "W m^-2 sr^-1"
    return {"units": units, "long_name": f"standard error of {quantity}" if error else quantity}


def labeled(dataset: xr.Dataset) -> xr.Dataset:
    """Add missing units and names to a Dataset, and the coordinate `time` along `opl`."""
    dataset = with_time(dataset)
    for name, variable in dataset.variables.items():
        for key, text in labels_of(str(name), dataset.attrs).items():
            variable.attrs.setdefault(key, text)
    return dataset


def with_time(dataset: xr.Dataset) -> xr.Dataset:
    """Compute the coordinate `time` of a Dataset again from the coordinate `opl`.

    If `opl` is not an axis, the function removes `time`.
    """
    if "opl" not in dataset.dims or "opl" not in dataset.coords:
        return dataset.drop_vars(TIME) if TIME in dataset.coords else dataset
    time = opl_to_ns(np.asarray(dataset["opl"].values, np.float64))
    if TIME in dataset.coords:
        dataset = dataset.drop_vars(TIME)
    return dataset.assign_coords({TIME: ("opl", time, dict(AXES[TIME]))}).set_xindex(TIME)
