"""Completions for shells: names that are known without importing what has them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

SCENES = (
    *("cornell_box", "cornell_box_mirror", "cornell_box_glass", "cornell_box_flash"),
    *("cornell_box_steady_state", "bust_simple", "bust_ao", "veach", "sphere_light_small"),
    *("sphere_light_medium", "sphere_light_large", "rectangle_light_quad"),
    *("rectangle_light_triangles", "small_box", "caustic", "mirror_and_glass", "lamp_in_fixture"),
    *("light_through_hole", "cornell_box_fog", "lamp_in_milk", "smoke_corridor"),
    *("headlight_in_fog", "brewster_window", "strained_mirror_corridor", "nlos_z", "nlos_bunny"),
    *("nlos_patch", "nlos_plane", "nlos_behind_fog"),
    *("wall_box_sphere_nlos", "wall_box_spheres_nlos", "wall_box_hi_nlos", "wall_box_behind"),
    "ourbox_confocal",
)
VARIANTS = tuple(
    f"{backend}_{kind}"
    for backend in ("llvm", "cuda")
    for kind in (
        *("ad_rgb", "ad_mono", "ad_spectral", "ad_mono_polarized", "ad_spectral_polarized"),
        *("mono", "rgb", "spectral"),
    )
)


def among(names: Iterable[str]) -> Callable[[str], list[str]]:
    """A function that completes text to one of some names."""
    known = tuple(names)
    return lambda incomplete: [name for name in known if name.startswith(incomplete)]


def scene(incomplete: str) -> list[str]:
    """Completions to a built-in scene, an XML file, or a folder on the way to one."""
    names = [name.replace("_", "-") for name in SCENES] if "-" in incomplete else SCENES
    return among(names)(incomplete) + paths(incomplete, ".xml")


def paths(incomplete: str, *suffixes: str) -> list[str]:
    """Completions to files that end in one of these, and folders."""
    folder, _, start = incomplete.rpartition("/")
    root = f"{folder}/" if "/" in incomplete else ""
    try:
        found = sorted(Path(root or ".").expanduser().iterdir())
    except OSError:
        return []
    return [
        f"{root}{each.name}" + "/" * each.is_dir()
        for each in found
        if each.name.startswith(start)
        and (start.startswith(".") or not each.name.startswith("."))
        and (each.is_dir() or each.suffix in suffixes)
    ]
