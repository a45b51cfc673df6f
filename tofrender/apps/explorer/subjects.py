"""What Datasets say that an explorer shows: renders, captures, strategies, reconstructions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ...nlos.captures import ON_WALL, check_capture
from ...nlos.reconstruction.depths import check_volume, depth_map
from ...rendering.cubes import Cube
from ...rendering.dataset import QUANTITIES, time_axis
from ...runtime import checks
from ...signals.colour import LUMINANCE
from ...signals.units import ns_to_opl
from ...vis.transient import Transient, typeset
from .reducing import How

if TYPE_CHECKING:
    import xarray as xr

CAMERA = "optical path length, way to the camera included"
UNWARPED = "optical path length, way to the camera left out"
WALL = "optical path length, laser to wall and wall to sensor included"
HIDDEN = "optical path length, from the wall to the wall"

SPOTS = {"transient": "pixels", "capture": "points", "volume": "columns"}

FACTS = {
    "mode": "Mode",
    "method": "Method",
    "spp": "Samples per pixel",
    "integrator": "Integrator",
    "pulse": "Pulse",
    "max_depth": "Longest path [segments]",
    "sampler": "Sampler",
    "seed": "Seed",
    "variant": "Variant",
    "render_seconds": "Rendered in [s]",
    "energy_outside_window": "Light outside of the bins [part]",
    "versions": "Versions",
}
"""Attributes that are told, by what they are called."""


@dataclass
class Subject:
    """A cube and what belongs to it.

    Attributes:
        kind: "transient", "capture" or "volume".
        light: (..., y, x, bins, channels); leading axes are the lasers'.
        start: Where bins start [m].
        width: Of a bin [m].
        what: What bins count.
        how: What becomes of bins that are joined.
        quantity: Of a value, with its unit.
        peaks: (lasers, y, x) where along the bins each pixel is brightest [m], NaN if nowhere.
        first: Column and row of the first pixel.
        steady: (y, x, 1, channels), all light.
        errors: Standard errors of `light`.
        orders: Parts of the light by name, like it in shape.
        distance: (y, x) from the camera to what each pixel sees [m].
        hatch: (y, x) where nothing is known.
        depth: What has to hold for half the path length to be a depth; "" where it never is one.
        geometry: More for the header.
        points: (y, x, 3) of a wall [m].
        notes: What the page has to say.
    """

    kind: str
    light: Cube
    start: float
    width: float
    what: str
    how: How
    quantity: str
    peaks: np.ndarray
    first: tuple[int, int] = (0, 0)
    steady: Cube | None = None
    errors: Cube | None = None
    orders: dict[str, Cube] = field(default_factory=dict)
    distance: np.ndarray | None = None
    hatch: np.ndarray | None = None
    depth: str = ""
    geometry: dict[str, Any] = field(default_factory=dict)
    points: np.ndarray | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def weights(self) -> list[float]:
        """Of channels in the luminance."""
        return LUMINANCE.tolist() if self.light.shape[-1] == 3 else [1.0]


def subject_of(data: Any, orders: Any = None, distance_m: Any = None) -> Subject:
    """What a Dataset of `render`, `capture`, `strategy_pyramid` or `reconstruct` shows.

    Raises:
        ValueError: It is none of these, or what is given with it does not fit; one line.
    """
    import xarray as xr

    given = {"orders": orders, "distance_m": distance_m}
    if not isinstance(data, xr.Dataset):
        raise ValueError(f"data = {checks.quote(data)}: must be an xarray.Dataset")
    kind = "volume" if "intensity" in data else "capture" if "sensor_grid" in data else "transient"
    for name, value in given.items():
        if value is not None and kind != "transient":
            raise ValueError(f"{name}: must be None, as data is a {kind}")
    if kind == "volume":
        return _volume(data)
    if kind == "capture":
        return _capture(data)
    if "strategy" in data.dims:
        data, own = _strategies(data)
        orders = own if orders is None else orders
    return _transient(data, _orders(orders, data), distance_m)


def facts(data: xr.Dataset, subject: Subject) -> list[tuple[str, str]]:
    """What the attributes tell, as text; the first one is the size."""
    *pictures, height, width, bins, _ = subject.light.shape
    what = "voxels" if subject.kind == "volume" else "bins"
    size = (
        f"{width} × {height} {SPOTS[subject.kind]}, {bins} {what} of {1000 * subject.width:.4g} mm"
    )
    if pictures:
        size += f", {math.prod(pictures)} lit points"
    told = [("Size", size)]
    for name, label in FACTS.items():
        if name in data.attrs:
            value = data.attrs[name]
            told.append((label, f"{value:.4g}" if isinstance(value, float) else str(value)))
    return told


def _quantity(attrs: Mapping[str, Any]) -> str:
    """With its unit, powers raised."""
    return f"{attrs['quantity']} [{typeset(str(attrs['units']))}]"


# ---------------------------------------------------------------------------------------- kinds


def _transient(data: xr.Dataset, orders: dict[str, Cube], distance_m: Any) -> Subject:
    seen = Transient.of(data)
    unwarped = bool(data.attrs.get("camera_unwarp"))
    peaks = ns_to_opl(seen.brightest()[1])[None]
    subject = Subject(
        "transient",
        seen.values,
        seen.start_opl,
        seen.bin_width_opl,
        what=UNWARPED if unwarped else CAMERA,
        how="mean" if data.attrs["quantity"] == "radiance per metre" else "sum",
        quantity=_quantity(data.attrs),
        peaks=peaks,
        first=(seen.x0, seen.y0),
        orders=orders,
        hatch=_unknown(seen.values),
        depth="" if unwarped else "a flash at the camera, and light that comes straight back",
    )
    if "steady" in data:
        steady = Cube.of("data: steady", data["steady"])
        if steady.shape != (*seen.size, seen.values.shape[3]):
            raise ValueError(f"data: steady with shape {steady.shape}: must be as transient has it")
        subject.steady = steady.view(np.s_[:, :, None, :])
    if "transient_error" in data:
        subject.errors = Cube.of("data: transient_error", data["transient_error"])
    if distance_m is not None:
        if unwarped:
            raise ValueError("distance_m: must be None, as data is unwarped already")
        subject.distance = _distances(distance_m, seen.size, subject.notes)
    return subject


def _capture(data: xr.Dataset) -> Subject:
    check_capture(data)
    light = Cube.of("data: transient", data["transient"])
    start, width = time_axis(data)
    grid = data["sensor_grid"].values.astype(np.float64)
    mode, legs = data.attrs["mode"], bool(data.attrs["counts_first_and_last_legs"])
    pictures = list(np.ndindex(*light.shape[:-4]))
    views = [Transient(light.view(place), start, width) for place in pictures]
    geometry: dict[str, Any] = {"mode": mode}
    if mode != "confocal":
        geometry["lasers"] = _in_grid(data["laser_grid"].values.reshape(-1, 3), grid)
    unseen = ~data[ON_WALL].values if ON_WALL in data else None
    is_sphere = mode == "confocal" and not legs
    return Subject(
        "capture",
        light,
        start,
        width,
        what=WALL if legs else HIDDEN,
        how="sum",
        quantity=_quantity(data.attrs),
        peaks=np.stack([ns_to_opl(view.brightest()[1]) for view in views]),
        first=(int(data["x"].values[0]), int(data["y"].values[0])),
        hatch=unseen,
        depth="a single bounce in the hidden scene, back to where it was lit" * is_sphere,
        geometry=geometry,
        points=grid,
    )


def _volume(data: xr.Dataset) -> Subject:
    values = check_volume(data)
    start, step = _axis(data, "z")
    sides = {axis: _axis(data, axis) for axis in "xy"}
    rows = slice(None)
    if not ("frame_axes" in data and float(data["frame_axes"].values[1, 1]) < 0):
        rows, (low, size) = (
            slice(None, None, -1),
            sides["y"],
        )  # The first row of a picture is on top
        sides["y"] = low + size * values.shape[1], -size
    return Subject(
        "volume",
        Cube(np.moveaxis(values, 0, -1)[rows, ..., None]),
        start,
        step,
        what="distance from the wall",
        how="mean",
        quantity=f"intensity [{data.attrs.get('units', 'arbitrary')}]",
        peaks=depth_map(data).values[None, rows],
        geometry=dict(sides),
    )


def _strategies(data: xr.Dataset) -> tuple[xr.Dataset, dict[str, xr.Dataset]]:
    """The light of all strategies of a pyramid, and that of each number of bounces."""
    if "weighting" not in data.dims or not {"s", "t"} <= set(data.coords):
        raise ValueError("data with strategies: must be a result of strategy_pyramid")
    weighted = data.sel(weighting="mis", drop=True).assign_attrs(quantity=QUANTITIES[0])
    length = (data["s"] + data["t"]).values
    orders = {}
    for vertices in sorted({int(n) for n in length}):
        bounces = vertices - 2
        part = weighted.isel(strategy=np.flatnonzero(length == vertices)).sum("strategy")
        name = "lamp, seen directly" if not bounces else f"{bounces} bounce{'s' * (bounces > 1)}"
        orders[name] = part
    return weighted.sum("strategy", keep_attrs=True), orders


# ------------------------------------------------------------------------------------------ parts


def _orders(orders: Any, data: xr.Dataset) -> dict[str, Cube]:
    found = {}
    for name, each in checks.mapping("orders", orders).items():
        if "transient" not in getattr(each, "data_vars", ()):
            raise ValueError(
                f"orders[{name!r}] = {checks.quote(each)}: must be a Dataset of render"
            )
        cube = Cube.of(f"orders[{name!r}]", each["transient"])
        if cube.shape != data["transient"].shape or not np.array_equal(each["opl"], data["opl"]):
            raise ValueError(f"orders[{name!r}]: must have the pixels and the bins of data")
        found[name] = cube
    return found


def _distances(distance_m: Any, size: tuple[int, int], notes: list[str]) -> np.ndarray:
    distances = checks.real_array("distance_m", distance_m, np.float64)
    if distances.shape != size:
        raise ValueError(f"distance_m with shape {distances.shape}: must be {size}, one a pixel")
    seen = np.isfinite(distances)
    known = distances[seen]
    if not known.size or known.min() < 0 or known.max() > checks.MAX_OPL:
        raise ValueError("distance_m: must be from 0 to 1e12 metres, or NaN, not everywhere")
    if not seen.all():
        notes.append(
            f"{int((~seen).sum())} pixels see no surface; without the way to the camera they are "
            "shown as if it were as far as on average."
        )
    return np.where(seen, distances, known.mean())


def _unknown(cube: Cube) -> np.ndarray | None:
    """Where values are NaN or infinite."""
    unknown = np.zeros(cube.shape[:2], bool)
    for (rows, columns, *_), values in cube.pieces():
        if not np.isfinite(values.sum()):
            unknown[rows, columns] |= ~np.isfinite(values).all(axis=(2, 3))
    return unknown if unknown.any() else None


def _axis(data: xr.Dataset, axis: str) -> tuple[float, float]:
    """Where the voxels of an axis begin, and their size [m]."""
    if axis not in data.coords:
        raise ValueError(f"data: coordinate {axis} is missing; must be as reconstruct has it")
    centres = np.asarray(data[axis].values, np.float64)
    step = float(centres[-1] - centres[0]) / (len(centres) - 1) if len(centres) > 1 else 1.0
    if not math.isfinite(step) or step <= 0:
        raise ValueError(f"data: coordinate {axis}: must be finite and grow")
    return float(centres[0]) - step / 2, step


def _in_grid(points: np.ndarray, grid: np.ndarray) -> list[list[float]]:
    """Columns and rows of points among those of a wall's grid."""
    rows, columns = np.indices(grid.shape[:2])
    known = np.column_stack([grid.reshape(-1, 3), np.ones(rows.size)])
    places = np.column_stack([columns.ravel(), rows.ravel()])
    solution = np.linalg.lstsq(known, places, rcond=None)[0]
    return (np.column_stack([points, np.ones(len(points))]) @ solution).round(3).tolist()
