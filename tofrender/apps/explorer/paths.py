"""Paths of pixels in an explorer: results of `paths_of` as JSON."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

from ...labels import PATHS, read
from ...rendering.path_list import paths_of
from ...runtime import checks
from ...scenes.loading import load_scene
from ...signals.pulses import GaussianPulse

COUNT = 200  # Number of paths of a pixel and bin in a live explorer
SAMPLES = 1 << 13  # Number of camera rays before the choice of paths
ALLOWED = "a list of results of paths_of"


def path_lists(paths: Any, kind: str) -> list[dict[str, Any]]:
    """Convert results of `paths_of` for some pixels with `plain_paths`.

    Other values raise an error.
    """
    _require_render("paths", paths, kind)
    given = checks.instance("paths", [] if paths is None else paths, list | tuple, ALLOWED)
    lists = [read(each, PATHS, "paths").transpose("path", "vertex", ...) for each in given]
    return [plain_paths(each) for each in lists]


def plain_paths(found: Any, fraction: Any = 1.0) -> dict[str, Any]:
    """Return lengths, light, shapes and film positions of a pixel's paths.

    Vertices are ordered from the sensor. If `paths_of` has chosen some of the paths, all chosen
    paths get the same part of the total light. The light is multiplied by `fraction`.
    """
    # Light of each path
    light = found["radiance"].mean("channel").values.astype(float)
    if found.attrs["found"] > light.size:
        light = np.full(light.size, float(found["total"].mean()) / light.size)
    light = light * fraction

    # Vertices of each path
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

    The scene is a loaded scene or an argument of `load_scene`. Its film must have the pixels of the
    data. The light of a path is multiplied by the part of the pulse in the range.
    """
    # Does the film of the scene have the pixels of the data?
    _require_render("scene", scene, kind)
    sensor = int(data.attrs.get("sensor", 0))
    size = data.sizes["x"], data.sizes["y"]
    if not isinstance(scene, mi.Scene):
        scene = load_scene(scene, width=size[0], height=size[1], optimize=False)
    film = scene.sensors()[sensor].film()
    own = *map(int, film.crop_size()), *map(int, film.crop_offset())
    wanted = *size, int(data["x"].min()), int(data["y"].min())
    allowed = f"{wanted} (width, height, first column and row), as in data"
    checks.require("film of the scene", own, own == wanted, allowed)
    pulse = _pulse(data, scene)

    def trace(pixel: Any, opl: Any) -> dict[str, Any]:
        try:
            # Find paths with a part of their pulse in the range
            start, stop = opl
            fraction = 1.0
            low, high = (0.0, 0.0) if pulse is None else pulse.support
            options = {"count": COUNT, "spp": SAMPLES, "sensor": sensor}
            found = paths_of(scene, pixel, opl=(max(0.0, start - high), stop - low), **options)

            # How much of the pulse is in the range?
            if pulse is not None:
                ends = (mi.Float(end - found["opl"].values) for end in (start, stop))
                before, after = (np.array(pulse.cdf(end)) for end in ends)
                fraction = after - before
            return plain_paths(found, fraction) | {"opl": opl, "traced": True}
        except (ValueError, RuntimeError) as error:
            return {"pixel": pixel, "opl": opl, "traced": True, "error": str(error)}

    return trace


def _pulse(data: Any, scene: mi.Scene) -> Any:
    """Return the pulse of a render by its attribute.

    None means an instantaneous pulse, or a pulse that differs from the pulse of the scene.
    """
    text = str(data.attrs.get("pulse", "none"))
    if found := re.fullmatch(r"GaussianPulse\(width_opl=(.+)\)", text):
        return GaussianPulse(float(found[1]))
    own = getattr(scene.integrator(), "pulse", None)
    return own if str(own) == text else None


def _require_render(name: str, value: Any, kind: str) -> None:
    valid = value is None or kind == "transient"
    checks.require(name, value, valid, f"None for a {kind}")
