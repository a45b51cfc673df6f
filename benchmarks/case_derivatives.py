"""The case `derivatives`: time of derivatives over the time of the same render."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

import tofrender

from .timing import Row, in_turn

DEPTHS = (4, 16, 64)


def derivatives(runs: int, quick: bool) -> list[Row]:
    """Differentiate the transient Cornell box with a pulse.

    Reverse mode differentiates by all reflectances, and forward mode by one reflectance.
    """
    size, spp = (32, 16) if quick else (128, 64)
    what = f"Cornell box, {size}x{size} x 300 bins, {spp} spp"
    rows: list[Row] = []
    for depth in DEPTHS[:1] if quick else DEPTHS:
        # Load the scene, and attach gradients to the reflectances
        described = tofrender.cornell_box(width=size, height=size)
        described["sensor"]["film"]["type"] = "tofrender_transient_hdr_film"
        scene = mi.load_dict(described)
        plugin = {"type": "tofrender_transient_path", "max_depth": depth, "pulse_width_opl": 0.03}
        integrator = mi.load_dict(plugin)
        params = mi.traverse(scene)
        names = [name for name in params.keys() if name.endswith("reflectance.value")]  # noqa: SIM118
        for name in names:
            dr.enable_grad(params[name])
        params.update()

        # Measure the times
        functions = {
            "render": _render(scene, integrator, spp),
            "reverse": _reverse(scene, integrator, params, spp),
            "forward": _forward(scene, integrator, params, names[0], spp),
        }
        times = in_turn(functions, runs)
        for mode, target in (("reverse", 3.0), ("forward", 2.0)):
            row = f"{what}, depth {depth}: {mode} over render"
            rows += times[mode].rows(times["render"], row, wall=target)
    return rows


def _render(scene: mi.Scene, integrator: Any, spp: int) -> Callable[[], None]:
    """Return a function that renders without derivatives."""

    def run() -> None:
        dr.eval(integrator.render(scene, spp=spp))
        dr.sync_thread()

    return run


def _reverse(scene: mi.Scene, integrator: Any, params: Any, spp: int) -> Callable[[], None]:
    """Return a function that differentiates the sum of all bins in reverse mode."""
    steady, transient = integrator.render(scene, spp=1)
    asked = dr.zeros(mi.TensorXf, steady.shape), dr.ones(mi.TensorXf, transient.shape)

    def run() -> None:
        integrator.render_backward(scene, params, asked, spp=spp)
        dr.eval(dr.grad(dict(params)))
        dr.sync_thread()

    return run


def _forward(
    scene: mi.Scene, integrator: Any, params: Any, name: str, spp: int
) -> Callable[[], None]:
    """Return a function that differentiates by one parameter in forward mode."""

    def run() -> None:
        dr.set_grad(params[name], 1.0)
        dr.eval(integrator.render_forward(scene, params, spp=spp))
        dr.sync_thread()

    return run
