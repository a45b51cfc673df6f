"""Paths of pixels in an explorer: results of `paths_of` as JSON."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from ...rendering.path_list import paths_of
from ...runtime import checks
from ...scenes.loading import load_scene
from ...signals.pulses import GaussianPulse

FIELDS = {"shape", "opl", "radiance", "on_film", "vertex_opl"}
COUNT = 200  # Paths of a pixel and bin that a live explorer shows
SAMPLES = 1 << 13  # Camera rays that they are chosen from
ALLOWED = "a list of results of paths_of"


def path_lists(paths: Any, kind: str) -> list[dict[str, Any]]:
    """Convert results of `paths_of` for some pixels by `plain_paths`; refuse anything else."""
    _require_render("paths", paths, kind)
    given = checks.instance("paths", [] if paths is None else paths, list | tuple, ALLOWED)
    for each in given:
        valid = set(getattr(each, "data_vars", ())) >= FIELDS
        checks.require("paths", each, valid, ALLOWED)
    return [plain_paths(each) for each in given]


def plain_paths(found: Any, fraction: Any = 1.0) -> dict[str, Any]:
    """Return lengths, light, shapes and film positions of a pixel's paths, from the sensor on.

    Where only some of the paths were chosen, all stand for the same light, here times a fraction.
    """
    light = found["radiance"].mean("channel").values.astype(float)
    if found.attrs["found"] > light.size:
        light = np.full(light.size, float(found["total"].mean()) / light.size)
    light = light * fraction
    paths = []
    for k, opl in enumerate(found["opl"].values):
        count = int(np.isfinite(found["vertex_opl"].values[k]).sum())
        film = found["on_film"].values[k, :count]
        points = [None if np.isnan(p).any() else np.round(p, 2).tolist() for p in film]
        shapes = found["shape"].values[k, :count].tolist()
        paths.append({"opl": float(opl), "light": light[k], "shapes": shapes, "film": points})
    return {"pixel": found.attrs["pixel"], "opl": found.attrs["range"], "paths": paths}


def path_tracer(scene: Any, data: Any, kind: str) -> Callable[[Any, Any], dict[str, Any]]:
    """Return a function that traces paths of a pixel with lengths in a range, as `plain_paths`.

    The scene, a loaded one or what `load_scene` loads, must have the film of the data. Paths count
    by the part of their pulse that is in the range.
    """
    _require_render("scene", scene, kind)
    sensor = int(data.attrs.get("sensor", 0))
    size = data.sizes["x"], data.sizes["y"]
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, width=size[0], height=size[1], optimize=False)
    film = scene.sensors()[sensor].film()
    own = *map(int, film.crop_size()), *map(int, film.crop_offset())
    wanted = *size, int(data["x"].min()), int(data["y"].min())
    allowed = f"{wanted} (width, height, first column and row), as the data have it"
    checks.require("film of the scene", own, own == wanted, allowed)
    pulse = _pulse(data, scene)

    def trace(pixel: Any, opl: Any) -> dict[str, Any]:
        try:
            (start, stop), fraction = opl, 1.0
            low, high = (0.0, 0.0) if pulse is None else pulse.support
            options = {"count": COUNT, "spp": SAMPLES, "sensor": sensor}
            found = paths_of(scene, pixel, opl=(max(0.0, start - high), stop - low), **options)
            if pulse is not None:
                ends = (mi.Float(end - found["opl"].values) for end in (start, stop))
                before, after = (np.array(pulse.cdf(end)) for end in ends)
                fraction = after - before
            return plain_paths(found, fraction) | {"opl": opl, "traced": True}
        except (ValueError, RuntimeError) as error:
            return {"pixel": pixel, "opl": opl, "traced": True, "error": str(error)}

    return trace


def _pulse(data: Any, scene: mi.Scene) -> Any:
    """Pulse of a render, by its attribute; None for an instant, or if the scene has another one."""
    text = str(data.attrs.get("pulse", "none"))
    if found := re.fullmatch(r"GaussianPulse\(width_opl=(.+)\)", text):
        return GaussianPulse(float(found[1]))
    own = getattr(scene.integrator(), "pulse", None)
    return own if str(own) == text else None


def _require_render(name: str, value: Any, kind: str) -> None:
    valid = value is None or kind == "transient"
    checks.require(name, value, valid, f"None, as data is a {kind}")
