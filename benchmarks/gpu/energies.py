"""Compare the light that a backend renders with LLVM and with closed forms."""

from __future__ import annotations

import os
from typing import Any

import mitsuba as mi
import numpy as np
from scipy.stats import norm, t as student

import tofrender
from tofrender.runtime import backend, gpu, llvm

from ..six_scenes import SCENES as SIX
from ..tofbench.adapters import tofrender as adapter
from ..tofbench.table import all_cases
from ..tofbench.verdicts import judge, readings_of, threshold
from .part import Part

REFERENCE = "llvm_ad_rgb"

SCENES = (
    *SIX,
    "cornell_box_fog",
    "caustic",
    "mirror_and_glass",
    "light_through_hole",
    "smoke_corridor",
    "lamp_in_milk",
)
"""Six scenes of the table of performance, and six built-in scenes."""

MOST_Z = 4.0
ROUNDING = 1e-4  # Standard error of rounding, relative to the number
CASE_SAMPLES = 1 / 16  # Factor of the samples of tofbench's cases
FIRST_REFERENCE_SEED = 1000  # Seeds of both backends differ, so that their renders are independent


def energies(part: Part) -> None:
    """Compare scenes with LLVM, and tofbench's cases with their closed forms."""
    if llvm.choose() is None:
        part.skipped.append("scenes: LLVM is missing")
    else:
        for name in part.each(SCENES[: part.sizes.compared_scenes]):
            _compare_scene(part, name)
    _compare_cases(part)


def z_of(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Return the distance of two means in standard deviations of a normal distribution.

    This is the normal quantile of the p-value of Welch's t-test, so that few runs do not make a
    large value more likely.
    """
    noise_ours = ours.var(ddof=1) / len(ours)
    noise_theirs = theirs.var(ddof=1) / len(theirs)
    rounding = (ROUNDING * ours.mean()) ** 2
    distance = (ours.mean() - theirs.mean()) / np.sqrt(noise_ours + noise_theirs + rounding)
    square_sum = noise_ours**2 / (len(ours) - 1) + noise_theirs**2 / (len(theirs) - 1)
    if square_sum == 0:
        return float(distance)
    degrees = (noise_ours + noise_theirs) ** 2 / square_sum
    p = student.sf(abs(distance), degrees)
    return float(np.copysign(norm.isf(p), distance))


def _compare_scene(part: Part, name: str) -> None:
    """Compare all light of a scene, and its mean path length, with LLVM."""
    ours = _readings(part, name, part.variant, first_seed=0)
    theirs = _readings(part, name, REFERENCE, first_seed=FIRST_REFERENCE_SEED)
    backend.activate(part.variant)
    row: dict[str, Any] = {}
    for number, reading in enumerate(("energy", "mean length")):
        z = z_of(ours[:, number], theirs[:, number])
        ratio = float(ours[:, number].mean() / theirs[:, number].mean())
        row[reading] = {"over LLVM": ratio, "z": z}
        part.require(abs(z) < MOST_Z, f"{name}: {reading} {z:+.1f} sigma from LLVM")
    part.results[name] = row


def _readings(part: Part, name: str, variant: str, first_seed: int) -> np.ndarray:
    """Render a scene with several seeds; returns energy and mean path length of each render."""
    backend.activate(variant)
    width, height, _ = part.sizes.compared_film
    if name in SIX:
        scene = SIX[name]()
        scene["sensor"]["film"] |= {"width": width, "height": height}
        scene = tofrender.load_scene(scene)
    else:
        scene = tofrender.load_scene(name, width=width, height=height)
    rows = []
    for seed in range(first_seed, first_seed + part.sizes.seeds):
        data = tofrender.render(scene, spp=part.sizes.compared_spp, seed=seed, progress=False)
        light = data["transient"].sum(["y", "x", "channel"])
        energy = float(light.sum())
        rows.append((energy, float((light * light["opl"]).sum()) / energy))
    return np.array(rows)


def _compare_cases(part: Part) -> None:
    """Compare tofbench's cases with their closed forms."""
    cases = all_cases()
    allowed = threshold(sum(len(readings_of(case)) for case in cases))
    abilities = frozenset(adapter.ABILITIES)
    forms = [case.form_for(abilities) for case in cases]
    supported = [form for form in forms if form is not None]
    os.environ["TOFBENCH_BACKEND"] = gpu.backend_of(part.variant) or "llvm"
    by_name = {case.name: case for case in supported[: part.sizes.compared_cases]}
    for name in part.each(list(by_name)):
        case = by_name[name]
        samples = max(16, int(case.samples * CASE_SAMPLES))
        runs = [
            np.asarray(adapter.render(case.scene, case.bins, samples, seed), np.float64)
            for seed in range(part.sizes.seeds)
        ]
        verdict = judge(case, np.array(runs), 0.0, allowed)
        used = gpu.backend_of(mi.variant()) or "llvm"
        part.results[f"tofbench {name}"] = {"sigma": verdict.bias, "backend": used}
        note = f"{verdict.bias:+.1f} sigma" if verdict.bias is not None else verdict.note
        part.require(verdict.status == "passed", f"tofbench {name}: {note}")
    backend.activate(part.variant)
