"""Sensors described by TOML files or tables, and what they measure of a render."""

import inspect
import json
import os
import warnings
from collections.abc import Mapping
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
from .radiometry import expected_photons
from .response import Response
from .spad import Spad

FOLDER = Path(__file__).parent / "presets"
CAPTURE_ATTRIBUTES = ("capture_mode", "counts_first_and_last_legs")
MODELS = {"spad": Spad, "itof": Itof, "gated": GatedCamera, "streak": StreakCamera}


def sense(dataset: Annotated[xr.Dataset, TRANSIENT], sensor: Any, seed: int = 0) -> xr.Dataset:
    """Measure a render with a sensor that a preset, a TOML file or a mapping describes.

    Args:
        dataset: A Dataset of `render`, or a single or confocal capture, "radiance per bin".
        sensor: "flash_dtof", "scanning_dtof", "itof", "iccd_gate", "streak", the path of a .toml
            file, or a mapping with its keys; docs/sensors.md lists them.
        seed: Seed of the noise.

    Returns:
        A Dataset: `counts` of a SPAD, `taps` of an iToF, `images` of a gated or streak camera, as
        their methods return them; `expected`, their expectation, of the same shape, where it has a
        closed form; `depth` [m] of an iToF; the description as JSON in the attribute `sensor`.
        Of a capture also its geometry, so that `reconstruct` and `save_capture` accept the counts.

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
    model, cycles = config["model"], config["cycles"]
    of_wall = isinstance(dataset, xr.Dataset) and "sensor_grid" in dataset
    if of_wall:
        dataset = _capture(dataset, config)
    if "pixels" in config:
        dataset = read(dataset, TRANSIENT, "dataset")
        light = intensity(dataset[["transient"]], "dataset")
        dataset = with_pixels(light, config["pixels"], "sensor.pixels")
    rates = expected_photons(dataset, **config["photons"])
    is_spad = isinstance(model, Spad)
    found = (model.histogram if is_spad else model.frames)(rates, cycles, seed)
    if not (is_spad and model.interactions()):
        with warnings.catch_warnings():  # It has warned already
            warnings.simplefilter("ignore", UserWarning)
            found["expected"] = model.expected(rates, cycles)[found.attrs["quantity"]]
    if isinstance(model, Itof):
        found["depth"] = model.depth(found)["depth"].assign_attrs(units="m")
    if of_wall:
        found = found.assign(
            {name: dataset[name] for name in dataset.data_vars if name != "transient"}
        )
        found = found.assign_attrs({name: dataset.attrs[name] for name in CAPTURE_ATTRIBUTES})
    plain = json.dumps(config["given"], default=lambda value: value.tolist())  # Of NumPy's
    return found.assign_attrs(sensor=plain)


def _capture(capture: xr.Dataset, config: dict[str, Any]) -> xr.Dataset:
    """Read a capture. Refuse captures and sensors whose counts would not fit its points."""
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
    """Read and check the argument of `sense`: its keys, the `model`, and the whole as `given`."""
    if not isinstance(sensor, Mapping):
        path = os.fspath(sensor) if isinstance(sensor, os.PathLike) else sensor
        if not str(path).endswith(".toml"):
            path = FOLDER / f"{checks.one_of('sensor', path, (*PRESETS, 'FILE.toml'))}.toml"
        sensor = read_toml("sensor", path)[0]
    given = table("sensor", sensor)
    known_keys("sensor", given, CHECKS)
    kinds = [kind for kind in MODELS if kind in given]
    checks.require("sensor", given, len(kinds) == 1, f"a table with one of {', '.join(MODELS)}")
    for key in ("cycles", "photons"):
        if key not in given:
            raise ValueError(f"sensor.{key}: must be given")
    found = checked("sensor", given, CHECKS)
    return found | {"model": found.pop(kinds[0]), "given": given}


def _pixels(name: str, value: Any) -> list[int]:
    sides = checks.items(name, value, 2, "[width, height]")
    return [checks.integer(name, side, 1, checks.MAX_SIZE) for side in sides]


def _photons(name: str, value: Any) -> dict[str, Any]:
    known_keys(name, table(name, value), inspect.getfullargspec(expected_photons).kwonlyargs)
    return value


def _model(kind: Any, name: str, value: Any) -> Any:
    """Instance of a class from a table of its parameters."""
    given, parameters = table(name, value), inspect.signature(kind).parameters
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
    **{"pixels": _pixels, "photons": _photons},
    **{name: partial(_model, kind) for name, kind in MODELS.items()},
}
