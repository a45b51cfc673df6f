"""Moving scenes for tests, and the light in them by its rate of change of path length."""

import warnings
from typing import Any

import mitsuba as mi
import numpy as np

import tofrender
from helpers.support import camera, film, scene

REST = (0.0, 0.0, 0.0)


def pinhole(origin, target, **more: Any) -> dict:
    """A camera of one pixel that sees a spot of a tenth of a millimeter from a meter away."""
    more = {"fov": 0.006, "near_clip": 1e-3} | more
    return camera(origin, target, film(bins=1, start=0.0, bin_width=1e3), **more)


def seen_by(origin, target, parts: dict, max_depth: int = 2, sensor=None, **integrator) -> dict:
    """A scene that a pinhole camera looks at."""
    view = pinhole(origin, target, **(sensor or {}))
    return scene(parts, view, max_depth=max_depth, **integrator)


def rates_of(described: Any, rates, rate_bins: int = 1, spp: int = 64, **more: Any) -> np.ndarray:
    """Light of each bin of the rate over all light, a mean over pixels and lengths."""
    more = {"bins": 1, "window": (0.0, 1e3), "seed": 0} | more
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # Energy outside the bins
        light = tofrender.range_rate(
            described, rates=rates, rate_bins=rate_bins, spp=spp, progress=False, **more
        )
    steady = float(light["steady"].mean("channel").sum())
    assert steady > 0, "the scene is dark"
    return light["radiance"].mean("channel").sum(("y", "x", "opl")).values.astype(float) / steady


def share_at(described: Any, rate: float, within: float = 2e-3, **more: Any) -> float:
    """Share of the light whose rate is within so many m/s of the given one."""
    return float(rates_of(described, (rate - within, rate + within), **more)[0])


def with_motions(described: dict, motions: dict) -> mi.Scene:
    """The scene, loaded, with motions by `tofrender.moving`."""
    return tofrender.moving(tofrender.load_scene(described, optimize=False), motions)
