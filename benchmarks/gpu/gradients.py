"""Derivatives of long paths: forward mode and reverse mode must agree."""

from __future__ import annotations

import time

import drjit as dr
import mitsuba as mi

import tofrender
from tofrender.runtime import gpu, memory

from .part import LIGHT_LENGTH_M, Part

NAME = "red.reflectance.value"
MOST_APART = 1e-3  # Relative difference of both modes, which use the same paths


def gradients(part: Part) -> None:
    """Differentiate the Cornell box by an albedo, with longer and longer paths."""
    for depth in part.each(part.sizes.depths):
        free = memory.available()
        forward, forward_s = _derivative(part, depth, reverse=False)
        reverse, reverse_s = _derivative(part, depth, reverse=True)
        row = {
            "forward": forward,
            "reverse": reverse,
            "forward_s": forward_s,
            "reverse_s": reverse_s,
        }
        if gpu.backend_of(mi.variant()) == gpu.CUDA:
            row["memory_mib"] = (free - memory.available()) / 2**20
        part.results[f"max_depth {depth}"] = row
        part.require(forward > 0, f"max_depth {depth}: more albedo gives {forward} more light")
        agree = abs(forward - reverse) <= MOST_APART * abs(forward)
        part.require(agree, f"max_depth {depth}: {forward} forward, {reverse} in reverse")


def _derivative(part: Part, depth: int, reverse: bool) -> tuple[float, float]:
    """Derivative of all light by the albedo of the red wall, and its time [s] without compiling."""
    width, height, bins = part.sizes.compared_film
    window = {"temporal_bins": bins, "bin_width_opl": LIGHT_LENGTH_M / bins}
    described = tofrender.cornell_box(width=width, height=height, **window)
    described["integrator"] |= {"max_depth": depth, "rr_depth": depth}
    scene = tofrender.load_scene(described)
    for _ in range(2):  # The first time compiles
        start = time.perf_counter()
        parameters = mi.traverse(scene)
        shift = mi.Float(0)
        dr.enable_grad(shift)
        parameters[NAME] = mi.Color3f(parameters[NAME]) + mi.Color3f(shift)
        parameters.update()
        film = mi.render(scene, parameters, spp=part.sizes.compared_spp)[1]
        if reverse:
            dr.backward(dr.sum(film.array))
            value = dr.grad(shift)
        else:
            dr.forward(shift)
            value = dr.sum(dr.grad(film).array)
        found = float(value[0])
        seconds = time.perf_counter() - start
    return found, seconds
