"""A scene with a parameter θ, what a closed form says of it, and its derivatives by renders."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from oracles.gradients import Arrived, Bins, Gate, Phasor, derived

import tofrender
from helpers.support import camera, film, scene
from tofrender.runtime.plugins import qualified_name

PULSE_KEY = "pulse_width_opl"  # The width of the pulse among the parameters of an integrator


@dataclass(frozen=True)
class Case:
    """A scene with a parameter θ."""

    row: str  # the parameter, as the table calls it
    scene: str  # what is seen, in words
    describe: Callable[[], dict]  # makes the scene, for `tofrender.load_scene`
    key: str  # the parameter of the scene that θ moves, as `mi.traverse` calls it
    value: Callable[[Any], Any]  # θ (a number, or a Dr.Jit float with a gradient) -> that parameter
    theta: float  # where the derivative is taken
    step: float  # half the distance of the renders that differences are taken of
    # the closed form: complex θ -> light and lengths of paths
    form: Callable[[Any], tuple[Any, Any]]
    seen: Any  # what the scene measures of them
    spp: int = 1 << 12  # samples of each pixel for half a percent
    of_pulse: bool = False  # whether θ is the pulse's width, which no path depends on
    # how directions are differentiated, the integrator's `gradient_sampling`
    sampling: str = "detached"
    until: float = math.inf  # length of the last light that counts in sum and moment [m]

    @property
    def name(self) -> str:
        return f"{self.row}: {self.scene}"

    def arrived(self) -> Arrived:
        return derived(self.form, self.theta)

    def expected(self) -> tuple[np.ndarray, np.ndarray]:
        """What is seen, and its derivative by θ."""
        light, seen = self.arrived(), self.at(self.theta).seen
        change = seen.by_width(light) if self.of_pulse else seen.derivative(light)
        return seen.value(light), change

    def at(self, theta: float) -> Case:
        """The case with the pulse of another θ, if θ is that; else itself."""
        return replace(self, seen=replace(self.seen, sigma=theta)) if self.of_pulse else self

    def weights(self) -> dict[str, np.ndarray]:
        """Names of numbers for the table -> their weights of what is seen.

        A pulse's width changes no sum and no mean, but the second moment, by 2 σ. The phase of a
        phasor P changes by Im(P* dP) / |P|².
        """
        if isinstance(self.seen, Bins):
            if self.of_pulse:
                light = self.arrived()
                mean = (light.light @ light.opl) / light.light.sum()
                return {"square": (self.seen.centers - mean) ** 2}
            counted = np.where(self.seen.centers < self.until, 1.0, 0.0)
            return {"sum": counted, "moment": counted * self.seen.centers}
        if isinstance(self.seen, Phasor):
            re, im = self.expected()[0]
            return {"phase": np.array([-im, re]) / (re * re + im * im)}
        return {"gate" if isinstance(self.seen, Gate) else "correlation": np.ones(1)}

    def load(self, **integrator: Any) -> mi.Scene:
        described = self.describe()
        described["integrator"] = described["integrator"] | integrator
        return tofrender.load_scene(own(described), optimize=False)

    def parameters(self, loaded: mi.Scene) -> mi.SceneParameters:
        """Those of the scene, or of the integrator for a pulse."""
        return mi.traverse(loaded.integrator() if self.of_pulse else loaded)

    def set(self, parameters: mi.SceneParameters, theta: Any) -> None:
        parameters[self.key] = self.value(theta)
        parameters.update()

    def output(self, rendered: Any) -> Any:
        """The tensor that holds what is seen."""
        return rendered[-1] if isinstance(rendered, tuple) else rendered

    def tensor_weights(self, weights: np.ndarray, shape: tuple[int, ...]) -> mi.Float:
        """Weights of what is seen for each entry of the tensor: a mean over pixels and colors.

        Shapes are (y, x, bins, channels), (y, x, frequencies, 2[, channels]) and (y, x, channels).
        """
        spread = np.ones(shape)
        if isinstance(self.seen, Bins):
            spread = spread * weights[:, None]
        elif isinstance(self.seen, Phasor):
            parts = (2, 1) if len(shape) == 5 else (2,)
            spread = spread * weights.reshape(parts)
        else:
            spread = spread * weights
        count = spread.size // (weights.size if weights.size > 1 else 1)
        return mi.Float((spread / count).ravel().astype(np.float32))

    def mean(self, tensor: Any) -> np.ndarray:
        """What is seen, a mean over pixels and colors, of a tensor."""
        values = np.array(tensor, dtype=np.float64)
        if isinstance(self.seen, Bins):
            return values.mean(axis=(0, 1, 3))
        if isinstance(self.seen, Phasor):
            return values.mean(axis=(0, 1, 2) if values.ndim == 4 else (0, 1, 2, 4))
        return np.array([values.mean()])


def own(described: dict) -> dict:
    """The same with the names of plugins that are this package's, whatever others have loaded."""
    return {
        key: own(value)
        if isinstance(value, dict)
        else (qualified_name(value) if key == "type" else value)
        for key, value in described.items()
    }


def render(case: Case, theta: float | None = None, spp: int = 0, seed: int = 0) -> np.ndarray:
    """What is seen at θ, by default the case's own."""
    loaded = case.load(**({PULSE_KEY: theta} if case.of_pulse and theta is not None else {}))
    if not case.of_pulse:
        case.set(mi.traverse(loaded), case.theta if theta is None else theta)
    return case.mean(case.output(mi.render(loaded, spp=spp or case.spp, seed=seed)))


def differences(case: Case, spp: int = 0, seed: int = 0) -> np.ndarray:
    """Derivative of what is seen, by renders on both sides with the same random numbers."""
    right, left = (render(case, case.theta + sign * case.step, spp, seed) for sign in (1, -1))
    return (right - left) / (2 * case.step)


def tracked(value: float) -> mi.Float:
    """A number that tracks gradients."""
    theta = mi.Float(value)
    dr.enable_grad(theta)
    return theta


def from_above(
    height: float, fov: float, seen: Bins, parts: dict, *, size: int = 1, **integrator: Any
) -> dict:
    """A scene that is looked at along -z."""
    window = film(size, size, bins=seen.count, start=seen.start, bin_width=seen.width)
    view = camera((0, 0, height), (0, 0, 0), window, fov=fov)
    return own(scene(parts, view, **{"pulse_width_opl": seen.sigma} | integrator))


def fog_box(low: float, high: float, half: float, medium: dict) -> dict:
    """A box of a medium from z = low to high, whose boundary is none."""
    place = mi.ScalarTransform4f().translate([0, 0, (low + high) / 2])
    place = place.scale([half, half, (high - low) / 2])
    return {"type": "cube", "to_world": place, "bsdf": {"type": "null"}, "interior": medium}


def grid_of(values: np.ndarray, low: Any, side: Any, albedo: float) -> dict:
    """A medium whose extinction is a grid over a box with a corner at `low`."""
    place = mi.ScalarTransform4f().translate(low).scale(side)
    grid = mi.VolumeGrid(np.asarray(values, np.float32))
    volume = {"type": "gridvolume", "to_world": place, "grid": grid}
    return {"type": "heterogeneous", "albedo": albedo, "sigma_t": volume}


def moved_render(loaded: mi.Scene, key: str, value: Any, **options: Any) -> Any:
    """A render of the scene with another value of a parameter, whose gradients it tracks."""
    parameters = mi.traverse(loaded)
    parameters[key] = value
    parameters.update()
    return mi.render(loaded, parameters, **options)


def attached(
    case: Case, spp: int = 0, seed: int = 0, options: dict | None = None, **integrator: Any
) -> tuple[Any, Any]:
    """θ with its gradient enabled, and the tensor of what is seen; `options` are of the render."""
    sampling = {} if case.sampling == "detached" else {"gradient_sampling": case.sampling}
    loaded = case.load(**sampling | integrator)
    parameters = case.parameters(loaded)
    theta = tracked(case.theta)
    case.set(parameters, theta)
    options = {"spp": spp or case.spp, "seed": seed} | (options or {})
    rendered = mi.render(loaded, parameters, **options)
    return theta, case.output(rendered)


def forward(case: Case, spp: int = 0, seed: int = 0, **integrator: Any) -> np.ndarray:
    """Derivative of what is seen, in forward mode."""
    theta, tensor = attached(case, spp, seed, **integrator)
    dr.forward(theta)
    return case.mean(dr.grad(tensor))


def reverse(
    case: Case, weights: np.ndarray, spp: int = 0, seed: int = 0, **integrator: Any
) -> float:
    """Derivative of a weighted sum of what is seen, in reverse mode."""
    theta, tensor = attached(case, spp, seed, **integrator)
    dr.backward(dr.sum(tensor.array * case.tensor_weights(weights, tensor.shape)))
    return float(dr.grad(theta)[0])
