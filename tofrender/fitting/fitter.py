# pyright: reportArgumentType=false, reportCallIssue=false
"""`fit`: change a scene until its light is what was measured."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..integrators.differentiable import VisibilityWarning
from ..runtime import backend, checks
from ..runtime.progress import deferred_stop, progress_bar
from ..scenes.loading import require_sensor
from .given import loss_of, optimizer_of, target_of
from .variables import Variables

MAX_STEPS = 1 << 20
"""Most steps of a fit."""

SHOWN_NUMBERS = 4
"""Values of more numbers than these are told by their shape."""


@dataclass(frozen=True, repr=False)
class Fit:
    """What a fit has found.

    Attributes:
        values: The best values by name: numbers, or arrays of the shape of what was fitted. The
            scene has them. They are the last of the `patience` steps in a row whose mean loss is
            the lowest, or, where fewer than twice as many were taken, those of the lowest loss.
        loss: That loss.
        losses: The loss of each step, before its change, shape (steps,).
        history: The values of each step, by name, shape (steps, ...).
        steps: How many steps were taken.
        converged: Whether it ended because the loss no longer fell.
        why: Why it ended.
    """

    values: dict[str, Any]
    loss: float
    losses: np.ndarray
    history: dict[str, np.ndarray]
    steps: int
    converged: bool
    why: str

    def __repr__(self) -> str:
        told = ", ".join(f"{name} = {_told(value)}" for name, value in self.values.items())
        plural = "" if self.steps == 1 else "s"
        falls = f"loss {self.losses[0]:.3g} to {self.loss:.3g}"
        return f"Fit({self.steps} step{plural}, {falls}, {told}; {self.why})"


def fit(
    scene: mi.Scene,
    params: Mapping[str, Any],
    target: Any,
    *,
    apply: Callable[[mi.SceneParameters, dict[str, Any]], Any] | None = None,
    integrator: mi.Integrator | None = None,
    sensor: int = 0,
    loss: str | Callable[[Any, Any], Any] = "l2",
    frequency_hz: float | Sequence[float] | None = None,
    optimizer: str | mi.ad.Optimizer = "adam",
    learning_rate: float | Mapping[str, float] = 0.01,
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None,
    steps: int = 200,
    spp: int | None = None,
    seed: int = 0,
    tolerance: float = 0.05,
    patience: int = 10,
    callback: Callable[[int, float, dict[str, Any]], Any] | None = None,
    progress: bool = True,
) -> Fit:
    """Fit parameters of a scene to light that was measured, by gradients.

    Each step renders with `mi.render` and new random numbers, compares with the target, and goes
    against the gradient of the loss. Single steps go up and down with the noise; so the mean loss
    of the last `patience` steps is compared with that of as many before. Where it is not lower, all
    learning rates are halved. The fit ends when they are below `tolerance` of what they were, after
    `steps` steps, or on Ctrl-C, SIGTERM or SIGHUP after the step under way.

    Gradients know nothing of edges that move over what they hide or light (silhouettes, shadows):
    fit what moves in full sight. The first step warns of it.

    Args:
        scene: A loaded scene. It is changed, and has the best values at the end, also where an
            error ended the fit.
        params: Names and start values of what is fitted. Without `apply`, names are those of
            `mi.traverse(scene)`; parameters of it (`params.keep([...])`) do as well, and start as
            they are. A start is a number for all components, or an array.
        target: What was measured: what `mi.render` returns (of several things the last, with the
            time bins), an array of the film's shape, (height, width, bins, channels), or a Dataset
            of `render`.
        apply: With it, names are free, and values numbers, 2 to 4 numbers, or arrays of Dr.Jit's.
            `apply(params, values)` writes what follows from the values into the scene's parameters.
        integrator: One with derivatives; by default the scene's.
        sensor: Number of the sensor.
        loss: "l2", "phasor" or "wasserstein", see `l2_loss` and the others, or a function of the
            rendered light and the target, both tensors, that returns a number with derivatives.
        frequency_hz: The frequencies of the phasor loss [Hz].
        optimizer: "adam", "sgd" or an optimiser of Mitsuba's without variables, of which the
            settings are taken, but for the learning rate; it stays as it is.
        learning_rate: About how far Adam moves a value in a step, in the value's own units, above
            0; a dict has one for each name.
        bounds: (low, high) of what has any, by name; None is no bound. Values stay within.
        steps: Most steps, from 1.
        spp: Samples per pixel, for light and for derivatives; by default the scene's.
        seed: Seed of all random numbers.
        tolerance: Where learning rates end, as a part of what they are at first, from 0 to 1; 0
            goes on for all steps, 1 ends where the loss is not lower for the first time.
        patience: Over how many steps losses are averaged, from 1.
        callback: Called after each step with its number from 0, its loss and its values; the fit
            ends if it returns True.
        progress: Whether to show a bar for work that takes long.

    Returns:
        The values and how they were found, see `Fit`.

    Raises:
        ValueError: An argument is wrong, or the light does not depend on what is fitted; one line.
        BackendError: The active variant cannot render in time.

    Warns:
        UserWarning: The loss does not depend on one of the values, or it or a gradient is no
            number, which ends the fit; or what is fitted moves things, see above; or no light is
            left in the end.

    Example:
        >>> wall = {"type": "rectangle", "bsdf": {"type": "diffuse"}}
        >>> lamp = {"type": "point", "position": [0, 0, 2]}
        >>> film = {"type": "hdrfilm", "width": 4, "height": 4}
        >>> look = mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0])
        >>> camera = {"type": "perspective", "fov": 20, "to_world": look, "film": film}
        >>> parts = {"integrator": {"type": "prb"}, "wall": wall, "lamp": lamp, "camera": camera}
        >>> scene = mi.load_dict({"type": "scene", **parts})
        >>> target = mi.render(scene, spp=64)
        >>> name = "wall.bsdf.reflectance.value"  # 0.5 in the scene
        >>> found = fit(scene, {name: 0.2}, target, learning_rate=0.05, spp=16, steps=40)
        >>> round(found.values[name], 1)
        0.5
    """
    backend.require_vectorised()
    checks.instance("scene", scene, mi.Scene, "a loaded scene, as mi.load_dict and load_scene give")
    require_sensor(scene)
    checks.integer("sensor", sensor, 0, len(scene.sensors()) - 1)
    if integrator is not None:
        checks.instance("integrator", integrator, mi.Integrator, "an integrator or None")
    for name, value in (("apply", apply), ("callback", callback)):
        if value is not None:
            checks.function(name, value)
    count = checks.integer("steps", steps, 1, MAX_STEPS)
    samples = 0 if spp is None else checks.integer("spp", spp, 1, checks.MAX_SPP)
    seed = checks.integer("seed", seed, 0, checks.MAX_SEED)
    tolerance = checks.number("tolerance", tolerance, low=0, high=1)
    patience = checks.integer("patience", patience, 1, MAX_STEPS)
    checks.boolean("progress", progress)
    film = scene.sensors()[sensor].film()
    measure = loss_of(loss, frequency_hz, film)
    variables = Variables(scene, params, apply, bounds)
    rates = variables.rates(learning_rate)
    engine = optimizer_of(optimizer)
    measured = target_of(target, film)

    engine.update(variables.start)
    plateau = _Plateau(tolerance, patience)
    losses: list[float] = []
    history: list[dict[str, Any]] = []
    why, converged, light = "all steps are taken", False, True
    with (
        progress_bar("Fitting", count, unit="step", enabled=progress) as bar,
        deferred_stop() as stop,
        ExitStack() as told,
        variables.settled(lambda: history[_best(losses, patience)[0]] if history else None),
    ):
        for step in range(count):
            if step == 1:
                told.enter_context(warnings.catch_warnings())
                warnings.simplefilter("ignore", VisibilityWarning)
            engine.set_learning_rate({name: rate * plateau.rate for name, rate in rates.items()})
            values = {name: engine[name] for name in rates}
            variables.write(values)
            rendered = mi.render(
                scene,
                params=variables.params,
                sensor=sensor,
                integrator=integrator,
                seed=mi.sample_tea_32(seed, step)[0],
                spp=samples,
            )
            light = _any_light(rendered)
            apart = _apart(measure, rendered, measured)
            losses.append(float(np.array(dr.detach(apart)).item()))
            history.append(variables.plain(values))
            if not math.isfinite(losses[-1]):
                why = f"the loss is {losses[-1]:g}"
                warnings.warn(f"fit: {why} in step {step}", stacklevel=2)
                break
            if dr.grad_enabled(apart):
                dr.backward(apart)
            wrong = _not_finite(values)
            if wrong:
                why = f"the gradient of {wrong} is not finite"
                warnings.warn(f"fit: {why} in step {step}", stacklevel=2)
                break
            if step == 0 and losses[0] != 0:
                _tell_of_no_effect(values)
            engine.step()
            for name, value in variables.bounded(engine).items():
                engine[name] = value
            bar.update()
            ended = callback is not None and callback(step, losses[-1], history[-1]) is True
            converged = plateau.add(losses[-1])
            if stop.requested or ended or converged:
                ends = (stop.requested, "stopped"), (converged, "the loss no longer falls")
                why = next((text for holds, text in ends if holds), "the callback ended it")
                break
    best, lowest = _best(losses, patience)
    if not light:
        warnings.warn(
            "fit: no light is left in the film; start nearer, or with loss='wasserstein' or a low "
            "frequency_hz",
            stacklevel=2,
        )
    return Fit(
        values=history[best],
        loss=lowest,
        losses=np.array(losses),
        history={name: np.array([each[name] for each in history]) for name in rates},
        steps=len(losses),
        converged=converged,
        why=why,
    )


# ------------------------------------------------------------------------------- when it ends


class _Plateau:
    """Halves rates where losses no longer fall."""

    def __init__(self, tolerance: float, patience: int) -> None:
        self.rate, self._tolerance, self._patience = 1.0, tolerance, patience
        self._since: list[float] = []

    def add(self, loss: float) -> bool:
        """Take a step's loss; gives whether the fit ends."""
        self._since.append(loss)
        n = self._patience
        if len(self._since) < 2 * n:
            return False
        before, now = self._since[-2 * n : -n], self._since[-n:]
        if math.fsum(now) < math.fsum(before):
            return False
        self._since.clear()
        self.rate /= 2
        return self.rate < self._tolerance


def _best(losses: Sequence[float], patience: int) -> tuple[int, float]:
    """The step with the best values, and the loss that says so."""
    finite = [each for each in losses if math.isfinite(each)]
    if not finite:
        return 0, losses[0]
    n = patience if len(finite) >= 2 * patience else 1
    means = np.convolve(finite, np.full(n, 1 / n), "valid")
    best = int(np.argmin(means))
    return best + n - 1, float(means[best])


def _not_finite(values: Mapping[str, Any]) -> str:
    """The name of a value whose gradient is not finite, "" if all are."""
    for name, value in values.items():
        if not dr.all(dr.isfinite(dr.grad(value)), axis=None):
            return name
    return ""


def _tell_of_no_effect(values: Mapping[str, Any]) -> None:
    """Warn of values that change nothing, and refuse if none changes anything."""
    none = [name for name, value in values.items() if dr.all(dr.grad(value) == 0, axis=None)]
    if len(none) == len(values):
        raise ValueError(
            f"params = {', '.join(none)}: the loss does not depend on them where the fit starts; "
            "must be of what the sensor sees, and the integrator one with their derivatives"
        )
    for name in none:
        warnings.warn(
            f"params[{name!r}]: the loss does not depend on it where the fit starts", stacklevel=3
        )


def _apart(measure: Callable[[Any, Any], Any], rendered: Any, target: Any) -> Any:
    """The loss of what was rendered."""
    light = rendered[-1] if isinstance(rendered, tuple) else rendered
    if light.shape != target.shape:
        raise ValueError(
            f"target with shape {target.shape}: must be {light.shape}, as what is rendered"
        )
    apart = measure(light, target)
    number = isinstance(apart, dr.ArrayBase) and dr.is_float_v(apart)
    if not number or math.prod(apart.shape) != 1:
        what = checks.quote(type(apart).__name__)
        raise ValueError(f"loss: returned {what}; must return a number of Dr.Jit's")
    return apart


def _any_light(rendered: Any) -> bool:
    """Whether something was seen."""
    light = rendered[-1] if isinstance(rendered, tuple) else rendered
    return bool(dr.any(dr.detach(light) != 0, axis=None))


def _told(value: Any) -> str:
    """A value in a line."""
    size = np.size(value)
    if size > SHOWN_NUMBERS:
        return f"array {np.shape(value)}"
    text = ", ".join(f"{number:.4g}" for number in np.ravel(value))
    return text if size == 1 else f"({text})"
