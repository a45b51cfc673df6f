"""Other renderers: load a described scene for each of them, and render its bins."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import mitsuba as mi
import numpy as np

import tofrender

Draw = Callable[[int], np.ndarray]

SAMPLERS = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")
"""Samplers of Mitsuba, which mitransient supports. The first is the default of mitransient."""


def has(package: str) -> bool:
    """Whether another renderer is installed."""
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True


def ours(described: Mapping[str, Any], **integrator: Any) -> mi.Scene:
    """Load a scene for tofrender, with the default sampler of `tofrender.render`."""
    changed = {**described, "integrator": described["integrator"] | integrator}
    return tofrender.load_scene(changed, optimize=False, sampler="padded_sobol")


def mitransient(described: Mapping[str, Any], sampler: str = SAMPLERS[0]) -> mi.Scene:
    """Load a scene for mitransient's `transient_path` and film."""
    import mitransient  # noqa: F401 (registers its plugins)

    return mi.load_dict({**described, "sensor": _sampled(described, sampler)}, optimize=False)


def path(described: Mapping[str, Any], sampler: str = SAMPLERS[0]) -> mi.Scene:
    """Load a scene with the same pixels for Mitsuba's steady `path`."""
    # Keep the size of the film
    sensor = _sampled(described, sampler)
    film = {k: v for k, v in sensor["film"].items() if re.match("width|height|crop", k)}
    sensor["film"] = film | {"type": "hdrfilm", "rfilter": {"type": "box"}, "pixel_format": "rgb"}

    # Keep the depth of the integrator
    names = "max_depth", "hide_emitters"
    kept = {k: v for k, v in described["integrator"].items() if k in names}
    return mi.load_dict({**described, "sensor": sensor, "integrator": {"type": "path"} | kept})


def bins(scene: mi.Scene, spp: int) -> Draw:
    """Return a function that renders bins as users do: with `tofrender.render` or `mi.render`."""
    if hasattr(scene.integrator(), "fills_bins"):
        options = {"spp": spp, "progress": False}
        return lambda seed: tofrender.render(scene, seed=seed, **options)["transient"].values
    return lambda seed: np.array(mi.render(scene, spp=spp, seed=mi.UInt32(seed + 1))[1])


def _sampled(described: Mapping[str, Any], sampler: str) -> dict[str, Any]:
    """Return the sensor of a scene with another sampler."""
    return described["sensor"] | {"sampler": {"type": sampler}}
