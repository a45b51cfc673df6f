"""`python -m benchmarks.denoising`: gain and cost of `denoise`, scene by scene.

Errors are mean squared differences from a render of 4096 samples, which is stored in --cache. The
denoised film is compared with a plain render of equally many samples, and with a plain render of
equal CPU time. The worst region is the region of 8 x 8 pixels where the error grows most. Phasors
have a frequency of 50 MHz, and gates are ten equal parts of the window.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

import tofrender

from .case_lights import plain_pixels
from .six_scenes import SCENES as TABLE, SIZE, box

SPP = 64  # Samples per pixel
MANY = 1024  # Samples per pixel of a part of the reference
PARTS = 4  # Number of parts of the reference
FREQUENCY_HZ = 50e6
LENS = {"type": "thinlens", "aperture_radius": 0.12, "focus_distance": 3.4}
LEAST = 1e-6  # Regions with a smaller error, relative to the worst region, are free of noise


def textured() -> Any:
    """Describe a box with random tiles on floor and back."""
    tiles = np.random.default_rng(5).uniform(0.1, 0.9, (64, 64, 3)).astype(np.float32)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(tiles), "raw": True, "filter_type": "nearest"}
    return _with_walls({"type": "diffuse", "reflectance": texture})


def _with_walls(bsdf: dict[str, Any]) -> Any:
    """Describe a box with another material on floor and back."""
    found = box()
    for name in ("floor", "back"):
        found[name]["bsdf"] = bsdf
    return found


SCENES: dict[str, Callable[[], Any] | str] = {
    **TABLE,
    "fog": "cornell_box_fog",
    "veach": "veach",
    "caustic": "caustic",
    "textured": textured,
    "out of focus": lambda: box() | {"sensor": box()["sensor"] | LENS},
    "glossy": lambda: _with_walls({"type": "roughconductor", "alpha": 0.15, "material": "Al"}),
    "fine mesh": "bust_simple",
    **{
        name.replace("_", " "): name
        for name in (
            "mirror_and_glass",
            "light_through_hole",
            "small_box",
            "headlight_in_fog",
            "smoke_corridor",
            "lamp_in_milk",
            "wall_box_hi_nlos",
            "brewster_window",
        )
    },
}
"""The constants of `denoise` were tuned on the first nine scenes and "mirror and glass"."""


def load(name: str) -> tuple[Any, dict[str, Any]]:
    """Return a scene and the options of its render."""
    mi.set_variant("llvm_ad_spectral_polarized" if name == "brewster window" else "llvm_ad_rgb")
    described = SCENES[name]
    if not isinstance(described, str):
        return tofrender.load_scene(described()), {}
    if described in ("veach", "small_box", "bust_simple"):  # Steady scenes
        return described, {"size": (SIZE, SIZE), "window": "auto", "bins": 300}
    return tofrender.load_scene(described, width=SIZE, height=SIZE), {}


def film(dataset: Any) -> np.ndarray:
    """Return the film as (height, width, bins, channels)."""
    values = dataset["transient"].values
    return values.reshape(*values.shape[:3], -1).astype(np.float64)


def timed(scene: Any, **options: Any) -> tuple[Any, float]:
    """Render, and return the result and the CPU time [s]."""
    start = time.process_time()
    found = tofrender.render(scene, progress=False, **options)
    dr.sync_thread()
    return found, time.process_time() - start


def measure(name: str, seeds: int, cache: Path) -> dict[str, float]:
    """Measure gain and cost of `denoise` in a scene."""
    # Load or render the reference
    scene, options = load(name)
    file = cache / f"{name.replace(' ', '_')}.npy"
    if not file.exists():
        films = (timed(scene, spp=MANY, seed=1000 + k, **options)[0] for k in range(PARTS))
        np.save(file, sum(film(each) for each in films) / PARTS)
    truth = np.load(file)

    # Exclude pixels with lamps
    plain = np.ones(truth.shape[:2], bool)
    if isinstance(scene, mi.Scene):
        plain = plain_pixels(scene, lamps_alone=True)

    # Compile both kinds of renders
    for kind in ({}, {"denoise": True}):
        timed(scene, spp=SPP, **kind, **options)

    # Render with and without `denoise`
    raws = []
    founds = []
    phasors = []
    gates = []
    own = []
    denoised = []
    for seed in range(seeds):
        raw, seconds = timed(scene, spp=SPP, seed=seed, **options)
        own.append(seconds)
        found, seconds = timed(scene, spp=SPP, seed=seed, denoise=True, **options)
        denoised.append(seconds)

        # Errors of phasors, gates and bins
        wave = np.exp(2j * np.pi * FREQUENCY_HZ * raw["time"].values * 1e-9)
        off = [film(each) - truth for each in (raw, found)]
        phasors.append([(abs(np.einsum("ptc,t->pc", e[plain], wave)) ** 2).sum() for e in off])
        parts = ([part.sum(axis=1) for part in np.array_split(e[plain], 10, axis=1)] for e in off)
        gates.append([(np.array(part) ** 2).sum() for part in parts])
        raws.append(off[0] ** 2)
        founds.append(off[1] ** 2)
    raw = np.mean(raws, axis=0)
    found = np.mean(founds, axis=0)

    # Render longer, so that the time is equal. The minimum is robust to other processes
    cost = min(denoised) / min(own)
    more = (timed(scene, spp=round(SPP * cost), seed=k, **options)[0] for k in range(seeds))
    longer = [(film(each) - truth) ** 2 for each in more]

    # Errors of regions
    regions = [
        e.sum(axis=(2, 3)).reshape(8, SIZE // 8, 8, -1).sum(axis=(1, 3)) for e in (raw, found)
    ]
    noisy = regions[0] > LEAST * regions[0].max()
    return {
        "all": raw.sum() / found.sum(),
        "without lamps": raw[plain].sum() / found[plain].sum(),
        "all at equal time": np.mean(longer, axis=0).sum() / found.sum(),
        "at equal time": np.mean(longer, axis=0)[plain].sum() / found[plain].sum(),
        "worst region": (regions[1][noisy] / regions[0][noisy]).max(),
        "phasors": np.divide(*np.sum(phasors, axis=0)),
        "gates": np.divide(*np.sum(gates, axis=0)),
        "cost": cost - 1,
    }


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.denoising", description=__doc__)
    parser.add_argument("scenes", nargs="*", default=list(SCENES), help="by default all")
    parser.add_argument("--seeds", type=int, default=4, help="renders of each (4)")
    parser.add_argument("--cache", type=Path, required=True, help="folder for reference films")
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore")  # Light outside of the window
    heads = "all", "without lamps", "at equal time", "worst region", "phasors", "gates", "cost"
    print("| scene | " + " | ".join(heads) + " |")
    print("| --- " * (len(heads) + 1) + "|")
    for name in options.scenes:
        found = measure(name, options.seeds, options.cache)
        cells = [f"{found[head]:.2f}" for head in heads]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
