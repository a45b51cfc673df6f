"""Errors of reconstructions of the hidden scene, over the light that a sensor receives."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import mitsuba as mi
import numpy as np
import xarray as xr

from ..labels import CAPTURE
from ..nlos.captures import as_capture, read_capture
from ..nlos.device.relay_wall import find_shapes
from ..nlos.reconstruction.depths import depth_error
from ..nlos.reconstruction.methods import METHODS, reconstruct
from ..nlos.truth import hidden_depth
from ..runtime import checks
from ..scenes.loading import load_scene
from .sensor_config import read_sensor, sense

MAX_SEEDS = 1000


def reconstruction_errors(
    capture: Annotated[xr.Dataset, CAPTURE],
    scene: mi.Scene | Mapping[str, Any] | str | os.PathLike[str],
    *,
    sensor: Any,
    photons_per_cycle: Sequence[float],
    methods: Sequence[str] = METHODS,
    seeds: int = 3,
    hidden_shapes: Any = None,
) -> xr.Dataset:
    """Measure a capture at several signal levels, and compare each reconstruction with the scene.

    For each level and seed, `sense` draws photon counts, each method reconstructs the hidden scene
    from the same counts, and `depth_error` compares the depth map with `hidden_depth`. Draw the
    result with `reconstruction_errors_figure`.

    Args:
        capture: Result of `capture` or `make_capture`, single or confocal, without noise.
        scene: The scene of the capture, as for `hidden_depth`.
        sensor: Sensor with a SPAD, as for `sense`. Its signal level is replaced.
        photons_per_cycle: Signal levels: the mean of the expected photons of a pixel per cycle, see
            `expected_photons`. One level or more, above 0.
        methods: Methods of `reconstruct` that support the capture.
        seeds: Number of noise realizations per level, from 1 to 1000.
        hidden_shapes: As for `hidden_depth`.

    Returns:
        `error (reconstruction, photons_per_cycle, seed)`: median of the absolute depth error [m],
        NaN if no depth was found. `found`, with the same axes: fraction of the pixels with a true
        depth in which a depth was found, from 0 to 1.

    Raises:
        ValueError: The capture, the sensor, a level or a method is not supported; one line.

    Example:
        >>> from tofrender import capture
        >>> wall = capture("nlos_plane", grid=(8, 8), spp=64, progress=False)
        >>> spad = {"cycles": 1000, "photons": {"photons_per_cycle": 1}, "spad": {}}
        >>> levels = {"sensor": spad, "photons_per_cycle": [0.3], "methods": ["lct"], "seeds": 1}
        >>> reconstruction_errors(wall, "nlos_plane", **levels)["error"].shape
        (1, 1, 1)
    """
    # Check the arguments
    capture = read_capture(as_capture(capture), "capture")
    given = read_sensor(sensor)["given"]
    levels = checks.real_array("photons_per_cycle", photons_per_cycle, np.float64)
    valid = levels.ndim == 1 and levels.size > 0 and bool((levels > 0).all())
    checks.require("photons_per_cycle", photons_per_cycle, valid, "one or more levels above 0")
    checks.instance("methods", methods, list | tuple, f"a list of {', '.join(METHODS)}")
    names = [checks.one_of("methods", name, METHODS) for name in methods]
    checks.require("methods", methods, bool(names), "one or more methods of reconstruct")
    count = checks.integer("seeds", seeds, 1, MAX_SEEDS)
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, optimize=False)
    if hidden_shapes is not None:
        hidden_shapes = find_shapes(scene, hidden_shapes, "hidden_shapes")

    # Measure, reconstruct and compare
    errors = np.full((len(names), levels.size, count), np.nan)
    found = np.zeros(errors.shape)
    for j, level in enumerate(levels):
        photons = dict(given["photons"]) | {"photons_per_cycle": float(level)}
        for seed in range(count):
            counts = sense(capture, dict(given) | {"photons": photons}, seed)
            for i, name in enumerate(names):
                volume = reconstruct(counts, name, progress=False)
                truth = hidden_depth(scene, volume, hidden_shapes=hidden_shapes)
                compared = depth_error(volume, truth)
                errors[i, j, seed] = compared.median
                found[i, j, seed] = compared.found

    # Label the result
    axes = ("reconstruction", "photons_per_cycle", "seed")
    units = {"units": "m", "long_name": "median absolute depth error"}
    return xr.Dataset(
        {
            "error": (axes, errors, units),
            "found": (axes, found, {"units": "1", "long_name": "fraction of depths found"}),
        },
        {"reconstruction": names, "photons_per_cycle": levels, "seed": np.arange(count)},
    )
