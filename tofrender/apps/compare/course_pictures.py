"""Pictures of the course's scenes by each technique, and their references."""

import math
from functools import lru_cache
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ...runtime import backend, checks
from ...scenes import BUILT_IN
from .picture_set import Picture

SIDE = 192  # Longest side of a rendered picture [pixels]
REFERENCE_SPP = 1024
REFERENCES = Path(__file__).with_name("references.npz")  # `python -m` this module makes it

# Path tracers of the course: plugin and label
TECHNIQUES = {
    "mats": ("path_tracer_mats", "material sampling"),
    "nee": ("path_tracer_nee", "light sampling"),
    "mis": ("path_tracer_mis", "both (MIS)"),
}
LIGHT_SCENES = (
    "veach",
    "small_box",
    "sphere_light_small",
    "sphere_light_medium",
    "sphere_light_large",
    "rectangle_light_quad",
    "rectangle_light_triangles",
)
OWN_SCENES = ("bust_simple", "bust_ao")  # Scenes with an own integrator
SCENES = (*LIGHT_SCENES, "cornell_box_steady_state", *OWN_SCENES)


def techniques(scene: str) -> dict[str, str]:
    """Return the labels of the techniques that can render a scene, and of its reference."""
    if checks.one_of("scene", scene, SCENES) in OWN_SCENES:
        return {"own": "its own integrator", "reference": f"reference, {REFERENCE_SPP} samples"}
    labels = {name: f"{name}: {label}" for name, (_, label) in TECHNIQUES.items()}
    return labels | {"reference": f"reference: Mitsuba's path, {REFERENCE_SPP} samples"}


@lru_cache(maxsize=64)
def render_technique(scene: str, technique: str, spp: int, seed: int = 0) -> Picture:
    """Render one of `SCENES` with one of its `techniques`.

    The technique "reference" ignores `spp`: its image is stored, with `REFERENCE_SPP` samples per
    pixel.
    """
    checks.one_of("technique", technique, techniques(scene))
    if technique == "reference":
        with np.load(REFERENCES) as references:
            pixels = references[scene].astype(np.float32)
        return Picture(f"reference, {REFERENCE_SPP} samples", pixels)
    pixels = _render(scene, technique, checks.integer("spp", spp, 1, 1 << 16), seed)
    return Picture(f"{technique}, {spp} samples", pixels)


def _render(scene: str, technique: str, spp: int, seed: int) -> np.ndarray:
    # Build the scene at the size of the page
    build: Any = BUILT_IN[scene]
    film = build()["sensor"]["film"]
    shrink = SIDE / max(film["width"], film["height"])
    size = {side: max(1, math.floor(shrink * film[side])) for side in ("width", "height")}
    kind = TECHNIQUES[technique][0] if technique in TECHNIQUES else "path"
    if scene in LIGHT_SCENES:
        description = build(**size, integrator=kind)
    else:
        description = build(**size)
        if technique in TECHNIQUES:
            description["integrator"] = description["integrator"] | {"type": kind}

    # The page renders in a thread
    with backend.tracing_lock():
        loaded: Any = mi.load_dict(description)
        backend.keep_alive(loaded)
        return np.array(mi.render(loaded, spp=spp, seed=mi.UInt32(seed)), np.float32)[..., :3]


if __name__ == "__main__":  # Render the references, in some minutes
    backend.activate()
    references = {}
    for scene in SCENES:
        parts = [_render(scene, "reference", REFERENCE_SPP // 8, 100 + part) for part in range(8)]
        references[scene] = np.mean(parts, axis=0, dtype=np.float64).astype(np.float16)
    np.savez_compressed(REFERENCES, **references)
