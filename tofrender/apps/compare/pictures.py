"""Pictures to compare: scenes of the course by each technique, references, and files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ...runtime import backend, checks
from ...scenes import BUILT_IN

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
OWN_SCENES = ("bust_simple", "bust_ao")  # With an integrator of their own
SCENES = (*LIGHT_SCENES, "cornell_box_steady_state", *OWN_SCENES)


@dataclass(frozen=True)
class Picture:
    """A picture and its label."""

    name: str
    pixels: np.ndarray  # Linear values, float32 (height, width, 3)


def techniques(scene: str) -> dict[str, str]:
    """Labels of the techniques that can render a scene, and of its reference."""
    if checks.one_of("scene", scene, SCENES) in OWN_SCENES:
        return {"own": "its own integrator", "reference": f"reference, {REFERENCE_SPP} samples"}
    labels = {name: f"{name}: {label}" for name, (_, label) in TECHNIQUES.items()}
    return labels | {"reference": f"reference: Mitsuba's path, {REFERENCE_SPP} samples"}


@lru_cache(maxsize=64)
def render_technique(scene: str, technique: str, spp: int, seed: int = 0) -> Picture:
    """Render one of `SCENES` by one of its `techniques`; a reference has its own `spp`."""
    checks.one_of("technique", technique, techniques(scene))
    if technique == "reference":
        with np.load(REFERENCES) as references:
            pixels = references[scene].astype(np.float32)
        return Picture(f"reference, {REFERENCE_SPP} samples", pixels)
    pixels = _render(scene, technique, checks.integer("spp", spp, 1, 1 << 16), seed)
    return Picture(f"{technique}, {spp} samples", pixels)


def _render(scene: str, technique: str, spp: int, seed: int) -> np.ndarray:
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
    with backend.tracing_lock():  # The page renders in a thread
        loaded: Any = mi.load_dict(description)
        backend.keep_alive(loaded)
        picture = np.array(mi.render(loaded, spp=spp, seed=mi.UInt32(seed)), np.float32)
    return _three_channels(picture)


def load_picture(path: Any) -> Picture:
    """Load the picture of an exr, png or jpg file, or of a result of `tofrender render`."""
    from ...io import load_exr_stack, load_npz
    from ...sampling.images import read_image

    path = checks.path("picture", path)
    archive = path / "transient.npz" if path.is_dir() else path
    if archive.is_file() and archive.suffix.lower() == ".npz":
        pixels = load_npz(archive)["steady"].values
    elif path.is_dir():
        pixels = load_exr_stack(path)["steady"].values
    else:
        try:
            pixels = read_image(path)
        except (ValueError, FileNotFoundError) as error:
            raise ValueError(str(error).replace("image =", "picture =", 1)) from None
    return Picture(path.name, _three_channels(pixels))


def difference(one: Picture, reference: Picture) -> float:
    """Root mean square of the difference, relative to the reference's mean."""
    same_size(one, reference)
    rms = float(np.sqrt(np.mean((one.pixels - reference.pixels).astype(np.float64) ** 2)))
    return rms / max(float(np.mean(reference.pixels)), 1e-30)


def same_size(one: Picture, other: Picture) -> None:
    """Refuse pictures of different sizes with a ValueError."""
    sizes = [f"{each.pixels.shape[1]} x {each.pixels.shape[0]}" for each in (one, other)]
    if sizes[0] != sizes[1]:
        raise ValueError(f"{other.name}: {sizes[1]} pixels; must be {sizes[0]}, as {one.name}")


def _three_channels(pixels: np.ndarray) -> np.ndarray:
    """Finite values in three channels."""
    values = np.nan_to_num(np.asarray(pixels, np.float32), posinf=0.0, neginf=0.0)
    return np.ascontiguousarray(
        np.repeat(values[..., :1], 3, axis=-1) if values.shape[-1] < 3 else values[..., :3]
    )


if __name__ == "__main__":  # Render the references, in some minutes
    backend.activate()
    references = {}
    for scene in SCENES:
        parts = [_render(scene, "reference", REFERENCE_SPP // 8, 100 + part) for part in range(8)]
        references[scene] = np.mean(parts, axis=0, dtype=np.float64).astype(np.float16)
    np.savez_compressed(REFERENCES, **references)
