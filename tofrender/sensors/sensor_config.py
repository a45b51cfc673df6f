"""Sensors that are described by TOML files or tables, and their measurement of a render."""

import inspect
import json
import os
import warnings
from collections.abc import Mapping
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import xarray as xr

from ..analysis.rebinning import with_pixels
from ..labels import TRANSIENT, intensity, read
from ..nlos.captures import read_capture
from ..runtime import checks
from ..runtime.tables import checked, known_keys, read_toml, table
from .cameras import GatedCamera, StreakCamera
from .itof import Itof
from .presets import PRESETS
from .radiometry import Optics, expected_photons
from .response import Response
from .spad import Spad

FOLDER = Path(__file__).parent / "presets"
CAPTURE_ATTRIBUTES = ("capture_mode", "counts_first_and_last_legs")
MODELS = {"spad": Spad, "itof": Itof, "gated": GatedCamera, "streak": StreakCamera}


def sense(dataset: Annotated[xr.Dataset, TRANSIENT], sensor: Any, seed: int = 0) -> xr.Dataset:
    """Measure a render with a sensor from a preset, a TOML file or a mapping.

    Args:
        dataset: A Dataset of `render`, or a single or confocal capture, "radiance per bin".
        sensor: "flash_dtof", "scanning_dtof", "itof", "iccd_gate", "streak", the path of a .toml
            file, or a mapping with the keys of such a file (see docs/sensors.md).
        seed: Seed of the noise.

    Returns:
        A Dataset with `counts` of a SPAD, `taps` of an iToF, or `images` of a gated or streak
        camera, as their methods return them. `expected` is their expectation with the same shape,
        if it has a closed form. An iToF also has `depth` [m]. The attribute `sensor` contains the
        description as JSON. The result for a capture contains its geometry, so that `reconstruct`
        and `save_capture` accept the counts.

    Raises:
        ValueError: A key is unknown, a value is not allowed or does not fit the render.
        FileNotFoundError: The file does not exist.

    Example:
        >>> from tofrender import render
        >>> box = render("cornell_box", spp=4, size=(8, 8), window="auto", progress=False)
        >>> photons = {"photons_per_cycle": 0.5}
        >>> found = sense(box, {"cycles": 1000, "photons": photons, "spad": {}}, seed=1)
        >>> bool(abs(found["counts"].sum() / found["expected"].sum() - 1) < 0.05)
        True
    """
    # Read the description
    config = read_sensor(sensor)
    model = config["model"]
    cycles = config["cycles"]

    # Convert the render to rates
    of_wall = isinstance(dataset, xr.Dataset) and "sensor_grid" in dataset
    if of_wall:
        dataset = _capture(dataset, config)
    if "pixels" in config:
        dataset = read(dataset, TRANSIENT, "dataset")
        light = intensity(dataset[["transient"]], "dataset")
        dataset = with_pixels(light, config["pixels"], "sensor.pixels")
    rates = expected_photons(dataset, **config["photons"])

    # Simulate the sensor. The simulation has already warned of high rates
    is_spad = isinstance(model, Spad)
    found = (model.histogram if is_spad else model.frames)(rates, cycles, seed)
    if not (is_spad and model.interactions()):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            found["expected"] = model.expected(rates, cycles)[found.attrs["quantity"]]
    if isinstance(model, Itof):
        found["depth"] = model.depth(found)["depth"].assign_attrs(units="m")

    # Add the geometry of a capture
    if of_wall:
        found = found.assign(
            {name: dataset[name] for name in dataset.data_vars if name != "transient"}
        )
        found = found.assign_attrs({name: dataset.attrs[name] for name in CAPTURE_ATTRIBUTES})
    # Describe the sensor. NumPy values are converted to plain numbers
    plain = json.dumps(config["given"], default=lambda value: value.tolist())
    return found.assign_attrs(sensor=plain)


def _capture(capture: xr.Dataset, config: dict[str, Any]) -> xr.Dataset:
    """Read a capture. Raise an error if the capture or the sensor is not supported."""
    capture = read_capture(capture, "dataset")
    if capture.attrs["capture_mode"] == "exhaustive":
        raise ValueError("dataset: exhaustive captures are not supported; use single or confocal")
    if not isinstance(config["model"], Spad):
        raise ValueError("sensor: only spad is supported for captures")
    if "pixels" in config:
        raise ValueError("sensor.pixels is not supported for captures; choose their grid instead")
    if config["model"].macro_pixel != (1, 1):
        raise ValueError("sensor.spad.macro_pixel is not supported for captures; remove it")
    return capture


def read_sensor(sensor: Any) -> dict[str, Any]:
    """Read and check the description of a sensor.

    Returns:
        Its keys, the sensor model as `model`, and the whole description as `given`.
    """
    # Load a preset or a file
    if not isinstance(sensor, Mapping):
        path = os.fspath(sensor) if isinstance(sensor, os.PathLike) else sensor
        if not str(path).endswith(".toml"):
            path = FOLDER / f"{checks.one_of('sensor', path, (*PRESETS, 'FILE.toml'))}.toml"
        sensor = read_toml("sensor", path)[0]

    # Check the keys
    given = table("sensor", sensor)
    known_keys("sensor", given, CHECKS)
    kinds = [kind for kind in MODELS if kind in given]
    checks.require("sensor", given, len(kinds) == 1, f"a table with one of {', '.join(MODELS)}")
    for key in ("cycles", "photons"):
        if key not in given:
            raise ValueError(f"sensor.{key}: must be given")
    found = checked("sensor", given, CHECKS)
    return found | {"model": found.pop(kinds[0]), "given": given}

    """Check the width and the height of a resampled image."""


def _pixels(name: str, value: Any) -> list[int]:
    sides = checks.items(name, value, 2, "[width, height]")
    return [checks.integer(name, side, 1, checks.MAX_SIZE) for side in sides]


def _photons(name: str, value: Any) -> dict[str, Any]:
    """Check a table with arguments of `expected_photons`."""
    known_keys(name, table(name, value), [each.name for each in fields(Optics)])
    return value


def _model(kind: Any, name: str, value: Any) -> Any:
    """Create an instance of a class from a table of its parameters."""
    given = table(name, value)
    parameters = inspect.signature(kind).parameters
    known_keys(name, given, parameters)
    for key, parameter in parameters.items():
        if parameter.default is parameter.empty and key not in given:
            raise ValueError(f"{name}.{key}: must be given")
    if "jitter" in given:
        given["jitter"] = _model(Response, f"{name}.jitter", given["jitter"])
    try:
        return kind(**given)
    except ValueError as error:
        raise ValueError(f"{name}.{error}") from None


CHECKS: dict[str, Any] = {
    "cycles": partial(checks.integer, low=1, high=(1 << 31) - 1),
    "pixels": _pixels,
    "photons": _photons,
    **{name: partial(_model, kind) for name, kind in MODELS.items()},
}
