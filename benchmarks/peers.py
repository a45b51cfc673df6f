"""Who else renders in time: a described scene for each, and what renders it."""

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
"""Mitsuba's, all of which mitransient takes; the first is its default."""


def has(package: str) -> bool:
    """Whether a peer is installed."""
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True


def ours(described: Mapping[str, Any], **integrator: Any) -> mi.Scene:
    """Our scene, with the sampler that `tofrender.render` takes by default."""
    changed = {**described, "integrator": described["integrator"] | integrator}
    return tofrender.load_scene(changed, optimize=False, sampler="padded_sobol")


def mitransient(described: Mapping[str, Any], sampler: str = SAMPLERS[0]) -> mi.Scene:
    """The same with mitransient's `transient_path` and film."""
    import mitransient  # noqa: F401 (registers its plugins)

    return mi.load_dict({**described, "sensor": _sampled(described, sampler)}, optimize=False)


def path(described: Mapping[str, Any], sampler: str = SAMPLERS[0]) -> mi.Scene:
    """The same pixels for Mitsuba's steady `path`."""
    sensor = _sampled(described, sampler)
    film = {k: v for k, v in sensor["film"].items() if re.match("width|height|crop", k)}
    sensor["film"] = film | {"type": "hdrfilm", "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    names = "max_depth", "hide_emitters"
    kept = {k: v for k, v in described["integrator"].items() if k in names}
    return mi.load_dict({**described, "sensor": sensor, "integrator": {"type": "path"} | kept})


def bins(scene: mi.Scene, spp: int) -> Draw:
    """A scene's bins, as its users render them: ours by `tofrender.render`, else `mi.render`."""
    if hasattr(scene.integrator(), "fills_bins"):
        options = {"spp": spp, "progress": False}
        return lambda seed: tofrender.render(scene, seed=seed, **options)["transient"].values
    return lambda seed: np.array(mi.render(scene, spp=spp, seed=mi.UInt32(seed + 1))[1])


def _sampled(described: Mapping[str, Any], sampler: str) -> dict[str, Any]:
    return described["sensor"] | {"sampler": {"type": sampler}}
