"""Sensors described by TOML files or tables, and what they measure of a render."""

from __future__ import annotations

import inspect
import json
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from ..runtime import checks
from ..runtime.tables import known_keys, read_toml, table
from .cameras import GatedCamera, StreakCamera
from .itof import Itof
from .radiometry import expected_photons
from .response import Response
from .spad import Spad

FOLDER = Path(__file__).parent / "presets"
PRESETS = ("flash_dtof", "scanning_dtof", "itof", "iccd_gate", "streak")
MODELS = {"spad": Spad, "itof": Itof, "gated": GatedCamera, "streak": StreakCamera}
KEYS = ("cycles", "pixels", "photons", *MODELS)


@dataclass(frozen=True)
class SensorConfig:
    """A sensor, checked, with its exposure and the parameters of `expected_photons`."""

    model: Any  # Of `MODELS`
    cycles: int
    photons: dict[str, Any]
    pixels: tuple[int, int] | None  # Width and height; None for those of the film
    given: dict[str, Any]  # As it was read


def sense(dataset: xr.Dataset, sensor: Any, seed: int = 0) -> xr.Dataset:
    """Measure a render with a sensor that a preset, a TOML file or a mapping describes.

    Args:
        dataset: A Dataset of `render`, "radiance per bin".
        sensor: "flash_dtof", "scanning_dtof", "itof", "iccd_gate", "streak", the path of a .toml
            file, or a mapping with its keys; docs/sensors.md lists them.
        seed: Seed of the noise.

    Returns:
        A Dataset: `counts` of a SPAD, `taps` of an iToF, `images` of a gated or streak camera, as
        their methods return them; `expected`, their expectation, of the same shape, where it has a
        closed form; `depth` [m] of an iToF; the description as JSON in the attribute `sensor`.

    Raises:
        ValueError: A key is unknown, a value is not allowed or does not fit the render; one line.
        FileNotFoundError: There is no such file.

    Example:
        >>> from tofrender import render
        >>> box = render("cornell_box", spp=4, size=(8, 8), window="auto", progress=False)
        >>> photons = {"photons_per_cycle": 0.5}
        >>> found = sense(box, {"cycles": 1000, "photons": photons, "spad": {}}, seed=1)
        >>> bool(abs(found["counts"].sum() / found["expected"].sum() - 1) < 0.05)
        True
    """
    config = read_sensor(sensor)
    model, cycles = config.model, config.cycles
    if config.pixels is not None:
        dataset = _with_pixels(dataset, *config.pixels)
    rates = expected_photons(dataset, **config.photons)
    is_spad = isinstance(model, Spad)
    found = (model.histogram if is_spad else model.frames)(rates, cycles, seed)
    if not (is_spad and model.interactions()):
        with warnings.catch_warnings():  # It has warned already
            warnings.simplefilter("ignore", UserWarning)
            found["expected"] = model.expected(rates, cycles)[found.attrs["quantity"]]
    if isinstance(model, Itof):
        found["depth"] = model.depth(found)["depth"].assign_attrs(units="m")
    return found.assign_attrs(sensor=json.dumps(config.given))


def read_sensor(sensor: Any) -> SensorConfig:
    """Read and check a description of a sensor, with the arguments and errors of `sense`."""
    if isinstance(sensor, SensorConfig):
        return sensor
    if not isinstance(sensor, Mapping):
        path = os.fspath(sensor) if isinstance(sensor, os.PathLike) else sensor
        if not str(path).endswith(".toml"):
            path = FOLDER / f"{checks.one_of('sensor', path, (*PRESETS, 'FILE.toml'))}.toml"
        sensor = read_toml("sensor", path)[0]
    given = table("sensor", sensor)
    known_keys("sensor", given, KEYS)
    kinds = [kind for kind in MODELS if kind in given]
    checks.require("sensor", given, len(kinds) == 1, f"a table with one of {', '.join(MODELS)}")
    for key in ("cycles", "photons"):
        if key not in given:
            raise ValueError(f"sensor.{key}: must be given")
    photons, pixels = table("sensor.photons", given["photons"]), given.get("pixels")
    known_keys("sensor.photons", photons, inspect.getfullargspec(expected_photons).kwonlyargs)
    if pixels is not None:
        sides = checks.items("sensor.pixels", pixels, 2, "[width, height]")
        wide, high = (checks.integer("sensor.pixels", n, 1, checks.MAX_SIZE) for n in sides)
        pixels = wide, high
    cycles = checks.integer("sensor.cycles", given["cycles"], 1, (1 << 31) - 1)
    model = _model(f"sensor.{kinds[0]}", MODELS[kinds[0]], given[kinds[0]])
    return SensorConfig(model, cycles, photons, pixels, given)


def _model(where: str, kind: Any, given: Any) -> Any:
    """Instance of a class from a table of its parameters."""
    given = table(where, given)
    parameters = inspect.signature(kind).parameters
    known_keys(where, given, parameters)
    for name, parameter in parameters.items():
        if parameter.default is parameter.empty and name not in given:
            raise ValueError(f"{where}.{name}: must be given")
    if "jitter" in given:
        given["jitter"] = _model(f"{where}.jitter", Response, given["jitter"])
    try:
        return kind(**given)
    except ValueError as error:
        raise ValueError(f"{where}.{error}") from None


def _with_pixels(dataset: xr.Dataset, width: int, height: int) -> xr.Dataset:
    """A render of as many pixels, each the mean of some of the film's."""
    whole = isinstance(dataset, xr.Dataset) and {"y", "x"} <= set(dataset.dims)
    checks.require("dataset", dataset, whole and "transient" in dataset, "a Dataset of render")
    film, given = (dataset.sizes["x"], dataset.sizes["y"]), [width, height]
    fits = film[0] % width == film[1] % height == 0
    allowed = f"numbers that divide the film of {film[0]} x {film[1]} pixels"
    checks.require("sensor.pixels", given, fits, allowed)
    step = {"x": film[0] // width, "y": film[1] // height}
    blocks = dataset[["transient"]].coarsen(step, coord_func="min")  # type: ignore[arg-type]
    light: Any = blocks.mean(keep_attrs=True)
    axes = {axis: (axis, light[axis].values // n) for axis, n in step.items()}
    sizes = {"film_width": step["x"], "film_height": step["y"]}
    attrs = {name: dataset.attrs[name] / n for name, n in sizes.items() if name in dataset.attrs}
    return light.assign_coords(axes).assign_attrs(attrs)
