"""Measurements of sensors as films and phasors, which explorers and comparisons show."""

import json
from typing import NamedTuple

import numpy as np
import xarray as xr

from ...rendering.dataset import QUANTITIES
from ...runtime import checks
from ...sensors.config import read_sensor
from ...sensors.itof import Itof

LABELS = {
    "bin": "",  # Photons have the path lengths of light
    "delay_opl": "path length at which the gate opens",
    "sweep": "optical path length along the sweep",
}
"""Labels of the time axes of measurements; a film's own one if empty."""


class Measured(NamedTuple):
    """A measurement as a film of one channel."""

    film: xr.Dataset
    expectation: xr.Dataset | None
    quantity: str
    label: str


def is_film(data: xr.Dataset) -> bool:
    """Whether a Dataset is a measurement with a time axis: photon counts, or images of a camera."""
    return "counts" in data or "images" in data


def film_of(data: xr.Dataset) -> Measured:
    """Convert photon counts of a SPAD, or images of a gated or a streak camera, to a film.

    Images of overlapping gates are densities, which are averaged where bins are joined. Counts, and
    electrons along a sweep, are summed.
    """
    name = "counts" if "counts" in data else "images"
    axes = [axis for axis in LABELS if axis in data[name].dims]
    whole = len(axes) == 1 and set(data[name].dims) == {"y", "x", *axes}
    checks.require("data", data, whole, f"a result of sense with {name}")
    (axis,) = axes
    start, step, centers = _time_axis(data, axis)
    attrs = data.attrs | {"start_opl": start, "bin_width_opl": step}
    attrs["quantity"] = QUANTITIES[1] if axis == "delay_opl" else QUANTITIES[0]
    coords = {side: _pixels(data, side) for side in "yx"} | {"opl": centers, "channel": ["L"]}
    films = {}
    for variable in (name, "expected"):
        if variable in data:
            values = data[variable].transpose("y", "x", axis).values.astype(np.float32)
            light = (("y", "x", "opl", "channel"), values[..., None])
            films[variable] = xr.Dataset({"transient": light}, coords, attrs)
    quantity = "counts" if name == "counts" else f"images [{data.attrs.get('units', 'electrons')}]"
    return Measured(films[name], films.get("expected"), quantity, LABELS[axis])


def phasors_of(data: xr.Dataset) -> xr.Dataset:
    """Compute the phasors of the taps of an iToF camera; saturated pixels are NaN."""
    described = data.attrs.get("sensor")
    checks.require(
        "data", list(data.attrs), isinstance(described, str), "a result of sense with taps"
    )
    try:
        camera = read_sensor(json.loads(str(described)))["model"]
    except ValueError as error:
        raise ValueError(f"data: attribute sensor: {error}") from None
    checks.instance("data: attribute sensor", camera, Itof, "an iToF camera")
    found = camera.depth(data)
    dims = ("frequency", "y", "x", "channel")
    phasor = (found["amplitude"] * np.exp(1j * found["phase"])).transpose(*dims[:3]).values
    parts = {"I": (dims, phasor.real[..., None]), "Q": (dims, phasor.imag[..., None])}
    return xr.Dataset(parts, {"frequency": data["frequency"].values}, data.attrs)


def picture_of_taps(data: xr.Dataset) -> np.ndarray:
    """Return the mean of all taps, (height, width, 1) [electrons]."""
    mean = data["taps"].mean(("frequency", "tap")).transpose("y", "x")
    return mean.values[..., None].astype(np.float32)


def _time_axis(data: xr.Dataset, axis: str) -> tuple[float, float, np.ndarray]:
    """Return start and width of bins [m], and their centers."""
    name = "opl" if axis == "bin" else axis
    checks.require("data", list(data.coords), name in data.coords, f"with the coordinate {name}")
    centers = np.asarray(data[name].values, float)
    steps = np.diff(centers)
    step = float(steps.mean()) if steps.size else float(data.attrs.get("bin_width_opl", 1.0))
    even = step > 0 and np.allclose(steps, step, rtol=1e-3, atol=0)
    checks.require(f"data: {name}", centers, even, "at equal steps that grow")
    return float(centers[0]) - step / 2, step, centers


def _pixels(data: xr.Dataset, side: str) -> np.ndarray:
    """Return the numbers of rows or columns; sensors with larger pixels count their own."""
    count = data.sizes[side]
    if side in data.coords:
        numbers = data[side].values
        if numbers.dtype.kind in "iu" and (np.diff(numbers) == 1).all():
            return numbers
    return np.arange(count)
