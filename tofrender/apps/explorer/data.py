"""Data of an explorer from Datasets: renders, captures, strategies, reconstructions."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from ...labels import (
    FRAMES,
    PHASORS,
    PYRAMID,
    RANGE_RATES,
    TRANSIENT,
    VOLUME,
    bins_of,
    by_pixel,
    even_axis,
    intensity,
    read,
    require_same_labels,
    with_energy,
)
from ...motion.fmcw import checked_film
from ...nlos.captures import ON_WALL, read_capture
from ...nlos.reconstruction.depths import check_volume, depth_map
from ...nlos.reconstruction.wall_capture import WallFrame
from ...rendering.cubes import Cube
from ...rendering.dataset import DIMS, QUANTITIES
from ...runtime import checks
from ...signals.color import luminance
from ...signals.polarization import STOKES
from ...signals.units import ns_to_opl
from ...vis.transient_figures import Transient, typeset
from ...vis.unwarp import checked_distances
from .compression import Mode
from .measurements import film_of, is_film, phasors_of

PIXELS = {"transient": "pixels", "capture": "points", "volume": "columns", "phasors": "pixels"}

DOWNWARDS = slice(None)
UPWARDS = slice(None, None, -1)
"""Orders of the rows of a wall, with the highest row first."""

FACTS = {
    "capture_mode": "Mode",
    "method": "Method",
    "spp": "Samples per pixel",
    "cycles": "Laser cycles",
    "integrator": "Integrator",
    "pulse": "Pulse",
    "max_depth": "Longest path [segments]",
    "sampler": "Sampler",
    "seed": "Seed",
    "variant": "Variant",
    "render_seconds": "Rendered in [s]",
    "energy_outside_window": "Light outside of the bins [fraction]",
    "versions": "Versions",
}
"""Labels of attributes that are shown."""


@dataclass
class ExplorerData:
    """A cube of light with everything that an explorer shows of it."""

    header: dict[str, Any]  # "kind", "quantity", "depth" (when half a length is one), "geometry"
    light: Cube  # Light (..., y, x, bins, channels). Leading axes are laser spots
    mode: Mode  # How bins are joined
    axis: dict[str, Any]  # "start" and "width" of bins [m], label ("what")
    arrays: dict[str, np.ndarray]  # "peaks" of each pixel [m]; "distance", "points", "hatch"
    layers: dict[str, tuple[Cube, Mode]] = field(default_factory=dict)  # Other cubes
    first: tuple[int, int] = (0, 0)  # Column and row of the first pixel
    down: int = 1  # Step of row numbers from the top of the picture downwards, 1 or -1
    hatched: str = ""  # Meaning of the pixels of "hatch"
    notes: list[str] = field(default_factory=list)  # Sentences for the reader
    warnings: list[str] = field(default_factory=list)  # Sentences above the picture


def explorer_data(data: Any, orders: Any = None, distance_m: Any = None) -> ExplorerData:
    """Check a Dataset that `explore` supports, and prepare the data that an explorer shows."""
    checks.require("data", data, isinstance(data, xr.Dataset), "an xarray.Dataset")
    if distance_m is not None:
        distance_m = by_pixel(distance_m, data, "distance_m")

    # Convert films of rates and taps to light
    rates = None
    if "rate" in data.dims:
        distances = "None, as data is of range_rate"
        checks.require("distance_m", distance_m, distance_m is None, distances)
        data, rates = _range_rate(data)
    if "taps" in data:
        data = phasors_of(data)

    # Which kind of Dataset is it?
    kinds = {"intensity": "volume", "sensor_grid": "capture", "I": "phasors"}
    kind = next((kinds[name] for name in kinds if name in data), "transient")
    for name, value in (("orders", orders), ("distance_m", distance_m)):
        valid = value is None or kind == "transient"
        checks.require(name, value, valid, f"None for a {kind}")
        valid = value is None or "frame" not in data.dims
        checks.require(name, value, valid, "None for frames")

    # Prepare volumes, captures and phasors, or light in time
    if kind != "transient":
        found = {"volume": _volume, "capture": _capture, "phasors": _phasors}[kind](data)
    else:
        own = None
        measured = None
        if is_film(data):
            measured = film_of(data)
            data = measured.film
            if measured.expectation is not None:
                own = {"expectation": measured.expectation}
        elif "strategy" in data.dims:
            data, own = _strategies(read(data, PYRAMID, "data"))
        data = read(data, (TRANSIENT, FRAMES), "data")
        orders = own if orders is None else orders
        light = intensity(data, "data")
        found = _transient(light, _orders(orders, light), distance_m)
        for name in STOKES[1:]:
            if "stokes" in data.dims and name in data["stokes"].values:
                component = data["transient"].sel(stokes=name)
                found.layers[f"stokes {name}"] = Cube(component), found.mode
        if rates is not None:
            found.layers["rates"], found.header["rateAxis"] = rates
        if measured is not None:
            found.header |= {"quantity": measured.quantity}
            found.header["counts"] = measured.quantity == "counts"
            found.axis["what"] = measured.label or found.axis["what"]
    _find_flaws(found)
    return found


def _find_flaws(found: ExplorerData) -> None:
    """Hatch pixels with values that are not finite, and warn of them and of negative values."""
    *_, height, width, _, _ = found.light.shape
    unknown = np.zeros((height, width), bool)
    negative = 0
    least = 0.0
    for (*_, rows, columns, _, _), values in found.light.pieces():
        if not np.isfinite(values.sum()):
            bad = ~np.isfinite(values).all(axis=(-2, -1))
            unknown[rows, columns] |= bad.reshape(-1, *bad.shape[-2:]).any(axis=0)
        below = values < 0
        if below.any():
            negative += int(below.sum())
            least = min(least, float(values[below].min()))

    # Hatch and warn
    if unknown.any():
        found.arrays["hatch"] = unknown | found.arrays.get("hatch", False)
        if found.arrays["peaks"].size:
            found.arrays["peaks"] = np.where(unknown, np.nan, found.arrays["peaks"])
        found.hatched = ", or ".join(filter(None, [found.hatched, "values that are not finite"]))
        found.warnings.append(
            f"{unknown.sum()} of {unknown.size} pixels have values that are NaN or infinite; they "
            "are hatched."
        )
    if negative:
        found.warnings.append(f"{negative} values below 0, down to {least:.3g}, are shown as 0.")


def facts(data: xr.Dataset, found: ExplorerData) -> list[tuple[str, str]]:
    """Return size and attributes as labels and texts."""
    # The energy of a part differs from the energy of the whole
    kind = found.header["kind"]
    if "transient" in data and kind == "transient" and "energy_outside_window" in data.attrs:
        data = with_energy(read(data, (TRANSIENT, FRAMES), "data"), "data")

    # Describe the size
    *spots, height, width, bins, _ = found.light.shape
    unit = f"{'voxel' if kind == 'volume' else 'bin'}{'s' * (bins > 1)}"
    unit = "MHz" if kind == "phasors" else f"{unit} of {1000 * found.axis['width']:.4g} mm"
    count = ", ".join(f"{f / 1e6:.4g}" for f in found.header.get("frequencies", ())) or bins
    size = f"{width} × {height} {PIXELS[kind]}, {count} {unit}"
    if spots:
        size += f", {math.prod(spots)} {'frames' if 'frames' in found.header else 'laser spots'}"
    shown = ((label, data.attrs[name]) for name, label in FACTS.items() if name in data.attrs)
    return [
        ("Size", size),
        *((k, f"{v:.4g}" if isinstance(v, float) else str(v)) for k, v in shown),
    ]


def _quantity(attrs: Mapping[str, Any]) -> str:
    return f"{attrs['quantity']} [{typeset(str(attrs['units']))}]"


def _transient(data: xr.Dataset, orders: dict[str, Cube], distance_m: Any) -> ExplorerData:
    frames = "frame" in data.dims
    count = data.sizes["frame"] if frames else 0
    views = [Transient.of(data.isel(frame=k, drop=True)) for k in range(count)]
    views = views or [Transient.of(data)]
    seen = views[0]

    def cube(name: str) -> Cube:
        return Cube.of(f"data: {name}", data[name])

    # Label the axis of time
    unwarped = bool(data.attrs.get("camera_unwarp"))
    per_meter = data.attrs["quantity"] == "radiance per meter"
    mode: Mode = "mean" if per_meter else "sum"
    label = f"optical path length, camera segment {'left out' if unwarped else 'included'}"
    header = {"kind": "transient", "quantity": _quantity(data.attrs), "perMeter": per_meter}
    header["depth"] = "" if unwarped else "a flash at the camera, and a single bounce"
    if frames:
        header["frames"] = [float(time) for time in data["frame"].values]
    axis = {"start": seen.start_opl, "width": seen.bin_width_opl, "what": label}

    # Add light, errors, orders and the steady image
    arrays = {"peaks": np.stack([ns_to_opl(view.brightest()[1]) for view in views])}
    light = cube("transient") if frames else seen.values
    found = ExplorerData(header, light, mode, axis, arrays, first=(seen.x0, seen.y0))
    if "transient_error" in data:
        found.layers["errors"] = cube("transient_error"), "mean error" if per_meter else "error"
    found.layers |= {f"orders {name}": (each, mode) for name, each in orders.items()}
    if "steady" in data:
        steady = cube("steady")
        found.layers["steady"] = steady.view(np.s_[..., None, :]), "mean"
    if distance_m is not None:
        allowed = "None, as data is unwarped already"
        checks.require("distance_m", distance_m, not unwarped, allowed)
        found.arrays["distance"] = _distances(distance_m, seen.size, found.notes)
    return found


def _capture(data: xr.Dataset) -> ExplorerData:
    data = read_capture(data, "data")
    rows = _rows_from_top(_wall_frame(data).axes)
    light = Cube.of("data: transient", data["transient"]).view((..., rows, *[slice(None)] * 3))
    width = bins_of(data, "data").bin_width_opl
    start = float(data["opl"].values[0] - width / 2)
    grid = data["sensor_grid"].values.astype(np.float64)[rows]

    # Geometry of the wall and the laser
    mode = data.attrs["capture_mode"]
    legs = bool(data.attrs["counts_first_and_last_legs"])
    views = [Transient(light.view(spot), start, width) for spot in np.ndindex(*light.shape[:-4])]
    geometry: dict[str, Any] = {"mode": mode}
    if mode != "confocal":
        geometry["lasers"] = _in_grid(data["laser_grid"].values.reshape(-1, 3), grid)
    peaks = np.stack([ns_to_opl(view.brightest()[1]) for view in views])
    arrays = {"peaks": peaks, "points": grid}
    if ON_WALL in data:
        arrays["hatch"] = ~data[ON_WALL].values[rows]

    # Labels
    is_confocal = mode == "confocal" and not legs
    header = {"kind": "capture", "quantity": _quantity(data.attrs), "geometry": geometry}
    header["depth"] = "a single bounce in the hidden scene, back to the laser spot" * is_confocal
    ends = "laser to wall and wall to sensor included" if legs else "from the wall to the wall"
    axis = {"start": start, "width": width, "what": f"optical path length, {ends}"}
    first = int(data["x"].values[0]), int(data["y"].values[rows][0])
    down = 1 if rows == DOWNWARDS else -1
    found = ExplorerData(header, light, "sum", axis, arrays, first=first, down=down)
    found.hatched = "points off the relay wall" if ON_WALL in data else ""
    return found


def _wall_frame(capture: xr.Dataset) -> WallFrame:
    grid, normals = (
        capture[f"sensor_{name}"].values.astype(np.float64) for name in ("grid", "normals")
    )
    return WallFrame.of(grid, normals)


def _rows_from_top(frame_axes: np.ndarray) -> slice:
    """Return the order of rows in which the first row of a wall is the highest one.

    Pictures of a capture, slices of its volume and the 3-D view must agree.
    """
    return DOWNWARDS if float(frame_axes[1, 1]) < 0 else UPWARDS


def _phasors(data: xr.Dataset) -> ExplorerData:
    """Return phasors I + iQ (frequency, y, x, channel) of a phasor film or an iToF camera."""
    data = read(data, PHASORS, "data")
    re, im = (luminance(data[name].values).astype(np.float64) for name in "IQ")
    frequencies = [float(each) for each in data["frequency"].values]
    amplitude = Cube(np.moveaxis(np.hypot(re, im), 0, -1)[..., None])
    units = data.attrs.get("units")
    quantity = f"amplitude [{units}]" if units else "amplitude"
    header = {"kind": "phasors", "quantity": quantity, "frequencies": frequencies}
    axis = {"start": 0.0, "width": 1.0, "what": ""}
    arrays = {"peaks": np.zeros((1, 0, 0)), "I": re, "Q": im}
    first = int(data["x"][0]), int(data["y"][0])
    return ExplorerData(header, amplitude, "mean", axis, arrays, first=first)


def _volume(data: xr.Dataset) -> ExplorerData:
    data = read(data, VOLUME, "data")
    values = check_volume(data)
    start, step = even_axis(data, "z", "data", width=1.0)
    sides = {axis: even_axis(data, axis, "data", width=1.0) for axis in "xy"}
    rows = _rows_from_top(data["frame_axes"].values) if "frame_axes" in data else UPWARDS
    if rows == UPWARDS:
        low, size = sides["y"]
        sides["y"] = low + size * values.shape[1], -size
    quantity = f"intensity [{data.attrs.get('units', 'arbitrary')}]"
    # Orientation of the axes x, upwards and away from the wall
    handed = -math.copysign(1, sides["y"][1])
    if "frame_axes" in data:
        handed *= math.copysign(1, np.linalg.det(data["frame_axes"].values))
    header = {"kind": "volume", "quantity": quantity, "geometry": {**sides, "handed": handed}}
    axis = {"start": start, "width": step, "what": "distance from the wall"}
    peaks = depth_map(data).values[None, rows]
    light = Cube(np.moveaxis(values, 0, -1)[rows, ..., None])
    return ExplorerData(header, light, "mean", axis, {"peaks": peaks})


def wall_of(volume: xr.Dataset, capture: Any) -> dict[str, np.ndarray]:
    """Return wall points, laser spots and segment origins of a capture, in the volume's frame."""
    capture = read_capture(capture, "capture")
    if not {"frame_origin", "frame_axes"} <= set(volume.data_vars):
        raise ValueError(
            "data: frame_origin or frame_axes is missing; it must be a result of reconstruct"
        )
    frame = WallFrame(
        *(volume[f"frame_{name}"].values.astype(float) for name in ("origin", "axes"))
    )
    own = _wall_frame(capture)
    grid = capture["sensor_grid"].values.astype(float)[_rows_from_top(own.axes)]
    size = 1e-3 * max(1.0, np.ptp(grid.reshape(-1, 3), axis=0).max())
    same = np.allclose(own.origin, frame.origin, atol=size)
    if not (same and np.allclose(own.axes, frame.axes, atol=1e-3)):
        there, here = (np.round(each.origin, 3).tolist() for each in (own, frame))
        rule = f"must be the wall of data, at {here} with its axes"
        raise ValueError(f"capture with a wall at {there} m: {rule}")
    found = {"wall": frame(grid)}
    if capture.attrs["capture_mode"] != "confocal":
        found["spots"] = frame(capture["laser_grid"].values.astype(float))
    if capture.attrs["counts_first_and_last_legs"]:
        ends = [capture[f"{name}_origin"].values for name in ("laser", "sensor")]
        found["origins"] = frame(np.array(ends, float))
    return found


def _strategies(data: xr.Dataset) -> tuple[xr.Dataset, dict[str, xr.Dataset]]:
    """Return the light of all strategies of a pyramid, and of each number of bounces."""
    if "weighting" not in data.dims or not {"s", "t"} <= set(data.coords):
        raise ValueError("data with strategies: must be a result of strategy_pyramid")
    weighted = data.sel(weighting="mis", drop=True).assign_attrs(quantity=QUANTITIES[0])
    length = (data["s"] + data["t"]).values
    orders = {}
    for vertices in sorted({int(n) for n in length}):
        bounces = vertices - 2
        name = "lamp, seen directly" if not bounces else f"{bounces} bounce{'s' * (bounces > 1)}"
        strategies = np.flatnonzero(length == vertices)
        orders[name] = weighted.isel(strategy=strategies).sum("strategy")
    return weighted.sum("strategy", keep_attrs=True), orders


def _range_rate(data: xr.Dataset) -> tuple[xr.Dataset, Any]:
    """Return the light of all rates as a film, and a layer (rate, y, x, bins, 1) with its axis."""
    data = read(data, RANGE_RATES, "data")
    light, opl, rate = checked_film(data, "data")
    kept = [name for name in ("radiance", "steady") if name in data]
    film = data[kept].rename(radiance="transient")
    film = film.assign(transient=film["transient"].sum("rate", dtype=np.float32)).drop_vars("rate")
    about = {"quantity": QUANTITIES[0], "units": "W m^-2 sr^-1", "bin_width_opl": opl.width}
    layer = Cube(np.moveaxis(light, 3, 0)[..., None]), "sum"
    axis = {"start": rate.start, "width": rate.width, "count": rate.count}
    return film.assign_attrs(about), (layer, axis)


def _orders(orders: Any, data: xr.Dataset) -> dict[str, Cube]:
    found = {}
    for name, each in checks.mapping("orders", orders).items():
        parameter = f"orders[{name!r}]"
        part = intensity(read(each, TRANSIENT, parameter), parameter)
        labels = {axis: data[axis].values for axis in DIMS["transient"]}
        require_same_labels(part, labels, parameter, "data")
        found[name] = Cube.of(parameter, part["transient"])
    return found


def _distances(distance_m: Any, size: tuple[int, int], notes: list[str]) -> np.ndarray:
    """Return the distances of all pixels. Pixels without a surface get the mean distance."""
    distances = checked_distances(distance_m, size)
    seen = np.isfinite(distances)
    if not seen.any():
        raise ValueError("distance_m: must not be NaN or infinite everywhere")
    if not seen.all():
        notes.append(
            f"{int((~seen).sum())} pixels see no surface; without the camera segment they are "
            "shown at the mean distance of the others."
        )
    return np.where(seen, distances, distances[seen].mean())


def _in_grid(points: np.ndarray, grid: np.ndarray) -> list[list[float]]:
    """Return columns and rows of points in the grid of a relay wall."""
    rows, columns = np.indices(grid.shape[:2])
    known = np.column_stack([grid.reshape(-1, 3), np.ones(rows.size)])
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    solution = np.linalg.lstsq(known, pixels, rcond=None)[0]
    return (np.column_stack([points, np.ones(len(points))]) @ solution).round(3).tolist()
