# pyright: reportArgumentType=false, reportCallIssue=false
"""`fit`: parameters of a scene whose light is closest to a measurement."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Annotated, Any

import drjit as dr
import mitsuba as mi
import numpy as np
import xarray as xr

from ..films.image import time_bins
from ..integrators.differentiable import VisibilityWarning
from ..labels import TRANSIENT, Kind, bins_of, read, require_whole_stokes
from ..rendering.dataset import pixels_and_channels
from ..runtime import checks, variants
from ..runtime.progress import ProgressBar, deferred_stop
from ..scenes.loading import require_sensor
from .losses import OF_TWO_RENDERS, WITH_FREQUENCIES, loss_of, require_same_shape
from .variables import Variables

MAX_STEPS = 1 << 20

OPTIMIZERS = ("adam", "sgd")
SHOWN_NUMBERS = 4  # most numbers of a value in the representation of a `Fit`


@dataclass(frozen=True, repr=False)
class Fit:
    """Result of a fit.

    Attributes:
        values: The best values by name: numbers, or arrays of the variables' shapes. The scene has
            them. They are the last of the `patience` steps in a row whose mean loss is the lowest,
            or, of fewer than twice as many steps, those of the lowest loss.
        loss: That loss.
        losses: The loss of each step, before its change, shape (steps,).
        history: The values of each step, by name, shape (steps, ...).
        steps: Number of steps.
        converged: Whether it ended because the loss no longer fell.
        why: Reason of its end.
    """

    values: dict[str, Any]
    loss: float
    losses: np.ndarray
    history: dict[str, np.ndarray]
    steps: int
    converged: bool
    why: str

    def __repr__(self) -> str:
        values = ", ".join(f"{name} = {_summary(value)}" for name, value in self.values.items())
        plural = "" if self.steps == 1 else "s"
        falls = f"loss {self.losses[0]:.3g} to {self.loss:.3g}"
        return f"Fit({self.steps} step{plural}, {falls}, {values}; {self.why})"


def fit(
    scene: mi.Scene,
    params: Mapping[str, Any],
    target: Annotated[Any, TRANSIENT],
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
    """Fit parameters of a scene to measured light, by gradient descent.

    Each step renders with `mi.render` and new random numbers, compares with the target, and moves
    against the gradient of the loss. Since single steps are noisy, the mean loss of the last
    `patience` steps is compared with that of as many before; where it is not lower, all learning
    rates are halved. The fit ends when they are below `tolerance` of what they were, after `steps`
    steps, or on Ctrl-C, SIGTERM or SIGHUP after the step under way.

    Gradients leave out silhouettes and shadow edges that move: fit what moves in full sight. The
    first step warns of it.

    The derivative of `mi.render` uses other random numbers than its light. Therefore noise does not
    bias losses whose derivative by the light is linear in the light, as "l2" and "phasor". Noise
    biases other losses, such as "wasserstein" and functions with phases, ratios or absolute values,
    and the bias falls only with `spp`. "phase" and "scale_free" render twice per step with
    independent random numbers, so that products of noise vanish on average.

    Args:
        scene: A loaded scene. It has the best values at the end, also after an error.
        params: Names and start values, a number for all components or an array. Without `apply`,
            names are those of `mi.traverse(scene)`, and its parameters themselves
            (`params.keep([...])`) do as well.
        target: Measured light: a result of `mi.render` (of several the last, with the time bins),
            an array of the film's shape, (height, width, bins, channels), or a Dataset of `render`
            with the film's pixels, bins and channels, in any order.
            For loss="phasor" and "phase" also a pair (I, Q), or all that `transient_to_phasor` and
            `render_amcw_phasor` return, for loss="phase" also a picture of phases [rad]. Their
            shape is (height, width, channels), with several frequencies before it.
        apply: With it, names are free, and values numbers, 2 to 4 numbers, or arrays of Dr.Jit's.
            `apply(params, values)` writes what follows from the values into the scene's parameters.
        integrator: One with derivatives; by default the scene's.
        sensor: Number of the sensor.
        loss: "l2", "phasor", "phase", "scale_free" or "wasserstein", see `l2_loss` and the others,
            or a function of the rendered light and the target, both tensors, that returns a number
            with derivatives.
        frequency_hz: The frequencies of the losses "phasor" and "phase" [Hz].
        optimizer: "adam", "sgd" or an optimiser of Mitsuba's without variables, whose settings are
            copied, but for the learning rate.
        learning_rate: About how far Adam moves a value in a step, in the value's own units, above
            0; a dict has one for each name.
        bounds: (low, high) by name; None is no bound. Values are clipped.
        steps: Most steps, from 1.
        spp: Samples per pixel, for light and for derivatives; by default the scene's.
        seed: Seed of all random numbers.
        tolerance: Fraction of the first learning rates at which the fit ends, from 0 to 1; 0 goes
            on for all steps, 1 ends where the loss is not lower for the first time.
        patience: Number of steps whose losses are averaged, from 1.
        callback: Called after each step with its number from 0, its loss and its values; the fit
            ends if it returns True.
        progress: Whether to show a bar for work that takes long.

    Returns:
        The values and the course of the fit, see `Fit`.

    Raises:
        ValueError: An argument is wrong, or the light does not depend on any variable; one line.
        BackendError: The active variant cannot render in time.

    Warns:
        UserWarning: The loss does not depend on one of the variables; it or a gradient is not
            finite, which ends the fit; a variable moves things, see above; a value ends at a bound;
            or no light is left in the end.

    Example:
        >>> film = {"type": "hdrfilm", "width": 4, "height": 4}
        >>> look = mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0])
        >>> camera = {"type": "perspective", "fov": 20, "to_world": look, "film": film}
        >>> wall = {"type": "rectangle", "bsdf": {"type": "diffuse"}}  # reflectance 0.5
        >>> parts = {
        ...     "wall": wall,
        ...     "lamp": {"type": "point", "position": [0, 0, 2]},
        ...     "camera": camera,
        ... }
        >>> scene = mi.load_dict({"type": "scene", "integrator": {"type": "prb"}, **parts})
        >>> target, name = mi.render(scene, spp=64), "wall.bsdf.reflectance.value"
        >>> found = fit(scene, {name: 0.2}, target, learning_rate=0.05, spp=16, steps=40)
        >>> round(found.values[name], 1)
        0.5
    """
    variants.require_vectorised()
    checks.instance("scene", scene, mi.Scene, "a loaded scene, as mi.load_dict and load_scene give")
    film = require_sensor(scene, sensor).film()
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
    measure = loss_of(loss, frequency_hz, film)
    variables = Variables(scene, params, apply, bounds)
    rates = variables.rates(learning_rate)
    engine = _make_optimizer(optimizer)
    is_phase = isinstance(loss, str) and loss in WITH_FREQUENCIES
    measured = _phasor_target(target, film, loss, frequency_hz) if is_phase else None
    if measured is None:
        tracer = scene.integrator() if integrator is None else integrator
        camera_unwarp = bool(getattr(tracer, "camera_unwarp", False))  # Mitsuba's have none
        measured = _target_tensor(target, film, camera_unwarp)
    of_two = isinstance(loss, str) and loss in OF_TWO_RENDERS

    engine.update(variables.start)
    plateau = _Plateau(tolerance, patience)
    losses: list[float] = []
    history: list[dict[str, Any]] = []
    why, converged, light = "all steps are taken", False, None

    def render(random_numbers: int) -> Any:
        """Render with random numbers of a step; of several results, the last one has time."""
        try:
            rendered = mi.render(
                scene,
                params=variables.params,
                sensor=sensor,
                integrator=integrator,
                seed=random_numbers,
                spp=samples,
            )
        except RuntimeError as error:
            reason = error.__cause__  # Dr.Jit only reports that there is one
            if not isinstance(reason, ValueError | TypeError):
                raise
        else:
            return rendered[-1] if isinstance(rendered, tuple) else rendered
        raise reason  # Outside the block, so that the traceback has no circular context

    with (
        ProgressBar("Fitting", count, unit="step", enabled=progress) as bar,
        deferred_stop() as stop,
        warnings.catch_warnings(),
        variables.write_at_exit(lambda: history[_best(losses, patience)[0]] if history else None),
    ):
        for step in range(count):
            if step == 1:
                warnings.simplefilter("ignore", VisibilityWarning)

            # Render with the current values, and compare with the target
            engine.set_learning_rate({name: rate * plateau.rate for name, rate in rates.items()})
            values = {name: engine[name] for name in rates}
            variables.write(values)
            first_seed, second_seed = mi.sample_tea_32(seed, step)
            light = render(first_seed)
            other = render(second_seed) if of_two else None
            error = _evaluate(measure, light, measured, other)
            losses.append(float(np.array(dr.detach(error)).item()))
            history.append(variables.plain(values))

            # Propagate derivatives to the values
            wrong = None if math.isfinite(losses[-1]) else f"the loss is {losses[-1]:g}"
            if wrong is None:
                if dr.grad_enabled(error):
                    dr.backward(error)
                for name, value in values.items():
                    if not dr.all(dr.isfinite(dr.grad(value)), axis=None):
                        wrong = f"the gradient of {name} is not finite"
                        break
            if wrong is not None:
                why = wrong
                warnings.warn(f"fit: {why} in step {step}", stacklevel=2)
                break
            if step == 0 and losses[0] != 0:
                _check_dependence(values)

            # Change the values
            engine.step()
            for name, value in variables.bounded(engine).items():
                engine[name] = value
            bar.update()
            said = None if callback is None else callback(step, losses[-1], history[-1])
            ended = isinstance(said, bool | np.bool_) and bool(said)
            converged = plateau.add(losses[-1])
            if stop.requested:
                why = "stopped"
            elif converged:
                why = "the loss no longer falls"
            elif ended:
                why = "the callback ended it"
            if stop.requested or converged or ended:
                break
    best, lowest = _best(losses, patience)
    if reached := variables.at_bounds(history[best]):
        warnings.warn(
            f"fit: {', '.join(reached)}, which is a bound. Widen the bound, or use "
            "loss='scale_free' or 'phase' if the gain of the target is unknown",
            stacklevel=2,
        )
    if not dr.any(dr.detach(light) != 0, axis=None):
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


def _make_optimizer(given: Any) -> Any:
    """Make an optimiser without variables from a name or another optimiser."""
    if isinstance(given, mi.ad.Optimizer):
        if len(given):
            raise ValueError(
                f"optimizer = {type(given).__name__} of {', '.join(given)}: must have no "
                "variables; params has them"
            )
        own = copy(given)
        own.state = {}
        return own
    allowed = f"one of {', '.join(OPTIMIZERS)}, or an optimiser of Mitsuba's"
    checks.instance("optimizer", given, str, allowed)
    kind = checks.one_of("optimizer", given, OPTIMIZERS)
    return mi.ad.Adam(lr=0.0) if kind == "adam" else mi.ad.SGD(lr=0.0)


def _phasor_target(
    given: Any, film: Any, loss: str, frequency_hz: Any
) -> tuple[mi.TensorXf, mi.TensorXf] | None:
    """Convert I and Q, or phases with the loss "phase", to a pair of tensors.

    None for light, which `_target_tensor` converts. The loss checks the shapes.
    """
    width, height = (int(n) for n in film.crop_size())
    is_tuple = isinstance(given, tuple)
    parts = given if is_tuple else (given,)
    if not parts or isinstance(parts[-1], xr.Dataset):
        return None
    parts = [_phasor_by_labels(part, film, frequency_hz) for part in parts]
    shapes = [np.shape(part) for part in parts]
    of_light = shapes[-1][:3] == (height, width, film.temporal_bins)
    if of_light or (is_tuple and (len(parts) < 2 or shapes[0] != shapes[1])):
        return None
    if not is_tuple and loss != "phase":
        return None

    arrays = []
    for name, part in zip(("I", "Q") if is_tuple else ("phase",), parts, strict=False):
        part = np.array(dr.detach(part)) if isinstance(part, dr.ArrayBase) else part
        array = checks.real_array(f"target: {name}", part, np.float32)
        pixels = array.shape[-3:-1] == (height, width)
        allowed = f"(..., {height}, {width}, channels), or the film's with time bins"
        checks.shape(f"target: {name}", array, pixels and array.size > 0, allowed)
        arrays.append(checks.finite(f"target: {name}", array))
    if not is_tuple:
        arrays = [np.cos(arrays[0]), np.sin(arrays[0])]
    return mi.TensorXf(arrays[0]), mi.TensorXf(arrays[1])


def _phasor_by_labels(values: Any, film: Any, frequency_hz: Any) -> Any:
    """Return the values of labeled phasors in the order of the film; others as they are."""
    if not isinstance(values, xr.DataArray) or "opl" in values.dims:
        return values
    axes = ("y", "x", "channel")
    if "frequency" in values.dims:
        axes = ("frequency", *axes)
        found = values["frequency"].values
        if not np.array_equal(found, np.atleast_1d(frequency_hz)):
            raise ValueError(
                f"target has the frequencies {found.tolist()} Hz. Pass them as frequency_hz"
            )
    kind = Kind("phasors of the film's pixels", {"phasor": axes})
    phasors = read(xr.Dataset({"phasor": values}), kind, "target")
    _require_same_pixels(phasors, film)
    return phasors["phasor"].values


def _target_tensor(given: Any, film: Any, camera_unwarp: bool) -> mi.TensorXf:
    """Convert a target to a tensor of the film's shape."""
    if isinstance(given, tuple) and given:
        given = given[-1]
    if isinstance(given, xr.Dataset | xr.DataArray):
        given = _labeled_bins(given, film, camera_unwarp)
    if isinstance(given, dr.ArrayBase):
        given = np.array(dr.detach(given))
    array = checks.real_array("target", given, np.float32)
    width, height = (int(n) for n in film.crop_size())
    shape = (height, width)
    axis = time_bins(film)
    if axis is not None:
        shape += axis[:1]
    valid = array.shape[: len(shape)] == shape and array.size > 0
    allowed = ", ".join(map(str, (*shape, "...")))
    checks.shape("target", array, valid, f"({allowed}), as what the film holds")
    return mi.TensorXf(checks.finite("target", array))


def _labeled_bins(given: xr.Dataset | xr.DataArray, film: Any, camera_unwarp: bool) -> np.ndarray:
    """Return the light of a Dataset that has the pixels, bins and channels of the film."""
    if time_bins(film) is None:
        raise ValueError("target = Dataset: must be an array for a film without time bins")
    if isinstance(given, xr.DataArray):  # The widths of its bins are checked against the film's
        given = given.to_dataset(name="transient").assign_attrs(bin_width_opl=film.bin_width_opl)
    target = read(given, TRANSIENT, "target")
    require_whole_stokes(target, "target")
    _require_same_pixels(target, film)

    # The light must have the time axis of the renders
    bins = bins_of(target, "target")
    start, width = film.start_opl, film.bin_width_opl
    found = (bins.start_opl, bins.bin_width_opl)
    if not np.allclose(found, (start, width), rtol=1e-4, atol=1e-3 * width):
        raise ValueError(
            f"target with bins of {found[1]:g} m from {found[0]:g} m on: must be {width:g} m from "
            f"{start:g} m on, as the film's"
        )
    if bool(target.attrs.get("camera_unwarp", camera_unwarp)) != camera_unwarp:
        raise ValueError(
            f"target: its path lengths {'include' if camera_unwarp else 'lack'} the segment to the "
            f"camera, the integrator has camera_unwarp = {camera_unwarp}. Pass the render before "
            "unwarp_camera, or an integrator with the same camera_unwarp"
        )
    quantity = target.attrs.get("quantity", "radiance per bin")
    checks.require("target: quantity", quantity, quantity == "radiance per bin", "radiance per bin")
    values = target["transient"].values
    return values.reshape(*values.shape[:3], -1)


def _require_same_pixels(target: xr.Dataset, film: Any) -> None:
    """Refuse other pixels or channels than those of the film."""
    wanted = pixels_and_channels(film, target.sizes["channel"])
    for axis in ("y", "x", "channel"):
        found = target[axis].values
        if not np.array_equal(found, wanted[axis]):
            raise ValueError(
                f"target: the axis {axis} has the labels {checks.quote(found.tolist())}, the film "
                f"has {checks.quote(wanted[axis].tolist())}. Pass the pixels and channels of the "
                "film"
            )


@dataclass
class _Plateau:
    """Schedule that halves the learning rates where losses no longer fall."""

    tolerance: float
    patience: int
    rate: float = 1.0  # factor of all learning rates
    losses: list[float] = field(default_factory=list)  # since the last change

    def add(self, loss: float) -> bool:
        """Add a step's loss, and return whether the fit ends."""
        self.losses.append(loss)
        before = self.losses[-2 * self.patience : -self.patience]
        now = self.losses[-self.patience :]
        if len(before) < self.patience or math.fsum(now) < math.fsum(before):
            return False
        self.losses.clear()
        self.rate /= 2
        return self.rate < self.tolerance


def _best(losses: Sequence[float], patience: int) -> tuple[int, float]:
    """Return the step with the best values, and their mean loss."""
    finite = [each for each in losses if math.isfinite(each)]
    if not finite:
        return 0, losses[0]
    n = patience if len(finite) >= 2 * patience else 1
    means = np.convolve(finite, np.full(n, 1 / n), "valid")
    best = int(np.argmin(means))
    return best + n - 1, float(means[best])


def _check_dependence(values: Mapping[str, Any]) -> None:
    """Warn of values without an effect on the loss, and refuse if none has any."""
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


def _evaluate(loss: Callable[..., Any], light: Any, target: Any, other: Any) -> Any:
    """Evaluate the loss, which must return one number; `other` is a second render or None."""
    if not isinstance(target, tuple):
        require_same_shape(light, target)
    error = loss(light, target) if other is None else loss(light, target, other=other)
    number = isinstance(error, dr.ArrayBase) and dr.is_float_v(error)
    if not number or math.prod(error.shape) != 1:
        kind = checks.quote(type(error).__name__)
        raise ValueError(f"loss: returned {kind}; must return a number of Dr.Jit's")
    return error


def _summary(value: Any) -> str:
    """Format a value in a line."""
    if np.size(value) > SHOWN_NUMBERS:
        return f"array {np.shape(value)}"
    text = ", ".join(f"{number:.4g}" for number in np.ravel(value))
    return text if np.size(value) == 1 else f"({text})"
