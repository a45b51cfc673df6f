"""Pictures to compare: the course's scenes by each technique, references, and files."""

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

SIDE = 192
"""Longest side of a rendered picture [pixels]."""

REFERENCE_SPP = 1024
REFERENCES = Path(__file__).with_name("references.npz")
"""Pictures of all scenes by `REFERENCE_SPP` samples; `python -m` this module makes them."""

TECHNIQUES = {
    "mats": ("path_tracer_mats", "material sampling"),
    "nee": ("path_tracer_nee", "light sampling"),
    "mis": ("path_tracer_mis", "both (MIS)"),
}
"""The course's path tracers: plugin, and what it is."""

LIGHT_SCENES = (
    "veach",
    "small_box",
    "sphere_light_small",
    "sphere_light_medium",
    "sphere_light_large",
    "rectangle_light_quad",
    "rectangle_light_triangles",
)
PATH_SCENES = (*LIGHT_SCENES, "cornell_box_steady_state")
OWN_SCENES = ("bust_simple", "bust_ao")
"""Scenes of an integrator of their own."""

SCENES = (*PATH_SCENES, *OWN_SCENES)


@dataclass(frozen=True)
class Picture:
    """A picture.

    Attributes:
        name: What it is.
        pixels: Linear values, float32 of shape (height, width, 3).
    """

    name: str
    pixels: np.ndarray


def techniques(scene: str) -> dict[str, str]:
    """What a scene can be rendered by, and its reference: names with what they are.

    Example:
        >>> list(techniques("veach")), list(techniques("bust_ao"))
        (['mats', 'nee', 'mis', 'reference'], ['own', 'reference'])
    """
    if checks.one_of("scene", scene, SCENES) in OWN_SCENES:
        return {"own": "its own integrator", "reference": f"reference, {REFERENCE_SPP} samples"}
    ways = {name: f"{name}: {what}" for name, (_, what) in TECHNIQUES.items()}
    return ways | {"reference": f"reference: Mitsuba's path, {REFERENCE_SPP} samples"}


@lru_cache(maxsize=64)
def rendered(scene: str, technique: str, spp: int, seed: int = 0) -> Picture:
    """A scene of the course by one of its techniques; rendered once.

    Args:
        scene: A name in `SCENES`.
        technique: A name in `techniques(scene)`.
        spp: Samples per pixel, which a reference has of its own.
        seed: Seed of the random numbers.

    Raises:
        ValueError: There is no such scene or technique.
    """
    checks.one_of("technique", technique, techniques(scene))
    if technique == "reference":
        with np.load(REFERENCES) as kept:
            return Picture(f"reference, {REFERENCE_SPP} samples", kept[scene].astype(np.float32))
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
    loaded: Any = mi.load_dict(description)
    return _three(np.array(mi.render(loaded, spp=spp, seed=mi.UInt32(seed)), np.float32))


def opened(path: Any) -> Picture:
    """The picture of a file: exr, png, jpg, or what `tofrender render` has written.

    Raises:
        ValueError: It is none; one line.
    """
    from ...io import load_exr_stack, load_npz

    path = checks.path("picture", path)
    if path.is_dir():
        inside = path / "transient.npz"
        data = load_npz(inside) if inside.is_file() else load_exr_stack(path)
        return Picture(path.name, _three(data["steady"].values))
    if path.suffix.lower() == ".npz":
        return Picture(path.name, _three(load_npz(path)["steady"].values))
    from ...sampling.images import read_image

    try:
        return Picture(path.name, _three(read_image(path)))
    except (ValueError, FileNotFoundError) as error:
        raise ValueError(str(error).replace("image =", "picture =", 1)) from None


def difference(one: Picture, reference: Picture) -> float:
    """Root mean square of the difference, relative to the reference's mean.

    Raises:
        ValueError: They are of different sizes; one line.

    Example:
        >>> grey = Picture("grey", np.ones((2, 2, 3), np.float32))
        >>> difference(grey, grey)
        0.0
    """
    same_size(one, reference)
    apart = float(np.sqrt(np.mean((one.pixels - reference.pixels).astype(np.float64) ** 2)))
    return apart / max(float(np.mean(reference.pixels)), 1e-30)


def same_size(one: Picture, other: Picture) -> None:
    """Refuse pictures of different sizes.

    Raises:
        ValueError: One line.
    """
    sizes = [f"{each.pixels.shape[1]} x {each.pixels.shape[0]}" for each in (one, other)]
    if sizes[0] != sizes[1]:
        raise ValueError(f"{other.name}: {sizes[1]} pixels; must be {sizes[0]}, as {one.name}")


def _three(pixels: np.ndarray) -> np.ndarray:
    """Three channels of finite values."""
    values = np.nan_to_num(np.asarray(pixels, np.float32), posinf=0.0, neginf=0.0)
    return np.ascontiguousarray(
        np.repeat(values[..., :1], 3, axis=-1) if values.shape[-1] < 3 else values[..., :3]
    )


def _make_references() -> None:
    """Render the references, in some minutes."""
    backend.activate()
    made = {}
    for scene in SCENES:
        parts = [_render(scene, "reference", REFERENCE_SPP // 8, 100 + part) for part in range(8)]
        made[scene] = np.mean(parts, axis=0, dtype=np.float64).astype(np.float16)
    np.savez_compressed(REFERENCES, **made)


if __name__ == "__main__":
    _make_references()
