"""Measurements of sensors as films and phasors, which explorers and comparisons show."""

import json
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from ...labels import COUNTS, GATES, STREAK, TAPS, even_axis, pixel_steps, read
from ...rendering.dataset import QUANTITIES
from ...runtime import checks
from ...sensors.itof import Itof
from ...sensors.sensor_config import read_sensor

LABELS = {
    "bin": "",  # Photons have the path lengths of light
    "delay_opl": "path length at which the gate opens",
    "sweep": "optical path length along the sweep",
}
"""Labels of the time axes of measurements. An empty label means the label of a film."""


class MeasuredFilm(NamedTuple):
    """A measurement as a film of one channel."""

    film: xr.Dataset
    expectation: xr.Dataset | None
    quantity: str
    label: str


def is_film(data: xr.Dataset) -> bool:
    """Return whether a Dataset has photon counts, or images of a gated or a streak camera."""
    return "counts" in data or "images" in data


def film_of(data: xr.Dataset) -> MeasuredFilm:
    """Convert photon counts of a SPAD, or images of a gated or a streak camera, to a film.

    Images of overlapping gates are densities. If bins are joined, densities are averaged, and
    counts and electrons along a sweep are summed.
    """
    # Find the axis of time
    name = "counts" if "counts" in data else "images"
    data = read(data, (COUNTS, GATES, STREAK), "data")
    axis = next(axis for axis in LABELS if axis in data[name].dims)
    name_of_centers = "opl" if axis == "bin" else axis
    start, step = even_axis(
        data,
        name_of_centers,
        "data",
        stated="bin_width_opl",
        overlap=axis == "delay_opl",
        width=1.0,
    )
    centers = np.asarray(data[name_of_centers].values, np.float64)
    attrs = data.attrs | {"start_opl": start, "bin_width_opl": step}
    attrs["quantity"] = QUANTITIES[1] if axis == "delay_opl" else QUANTITIES[0]

    # A larger pixel is labeled by its own index
    coords: dict[str, Any] = {"opl": centers, "channel": ["L"]}
    for side, distance in pixel_steps(data, "data").items():
        coords[side] = data[side].values[0] // distance + np.arange(data.sizes[side])

    # Make films of the measurement and of its expectation
    films = {}
    for variable in (name, "expected"):
        if variable in data:
            values = data[variable].transpose("y", "x", axis).values.astype(np.float32)
            light = (("y", "x", "opl", "channel"), values[..., None])
            films[variable] = xr.Dataset({"transient": light}, coords, attrs)
    quantity = "counts" if name == "counts" else f"images [{data.attrs.get('units', 'electrons')}]"
    return MeasuredFilm(films[name], films.get("expected"), quantity, LABELS[axis])


def phasors_of(data: xr.Dataset) -> xr.Dataset:
    """Compute the phasors of the taps of an iToF camera. Saturated pixels are NaN."""
    # Read the camera from the attribute
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
    phasor = (found["amplitude"] * np.exp(1j * found["phase"])).expand_dims(channel=["L"], axis=3)
    return xr.Dataset({"I": phasor.real, "Q": phasor.imag}, attrs=data.attrs)


def picture_of_taps(data: xr.Dataset) -> np.ndarray:
    """Return the mean of all taps, (height, width, 1) [electrons]."""
    mean = read(data, TAPS, "data")["taps"].mean(("frequency", "tap"))
    return mean.values[..., None].astype(np.float32)
