# pyright: reportArgumentType=false, reportCallIssue=false
"""`fit`: find parameters of a scene for which its light is closest to a measurement."""

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
from ..labels import (
    TRANSIENT,
    Kind,
    bins_of,
    read,
    require_same_labels,
    require_whole_stokes,
)
from ..rendering.dataset import pixels_and_channels
from ..runtime import checks, variants
from ..runtime.parameters import filled, takes
from ..runtime.progress import ProgressBar, deferred_stop
from ..scenes.loading import require_sensor
from .losses import OF_TWO_RENDERS, WITH_FREQUENCIES, loss_of, require_same_shape
from .variables import Variables

# Largest number of steps
MAX_STEPS = 1 << 20

OPTIMIZERS = ("adam", "sgd")
# Largest number of components of a value that the representation of a `Fit` shows
SHOWN_NUMBERS = 4


@dataclass(frozen=True, repr=False)
class Fit:
    """Result of a fit.

    Attributes:
        values: The best values by name: numbers, or arrays of the variables' shapes. The scene
            contains these values. They are the last values of the `patience` consecutive steps with
            the lowest mean loss. With fewer than twice as many steps, they are the values with the
            lowest loss.
        loss: The loss of these values.
        losses: The loss of each step, before its change, shape (steps,).
        history: The values of each step, by name, shape (steps, ...).
        steps: Number of steps.
        converged: Whether the fit ended because the loss no longer decreased.
        why: Reason why the fit ended.
    """

    values: dict[str, Any]
    loss: float
    losses: np.ndarray
    history: dict[str, np.ndarray]
    steps: int
    converged: bool
    why: str

    def __repr__(self) -> str:
        """Return steps, losses and values as text."""
        values = ", ".join(f"{name} = {_summary(value)}" for name, value in self.values.items())
        plural = "" if self.steps == 1 else "s"
        change = f"loss {self.losses[0]:.3g} to {self.loss:.3g}"
        return f"Fit({self.steps} step{plural}, {change}, {values}; {self.why})"


@dataclass(frozen=True, kw_only=True, eq=False)
class FitArguments:
    """All parameters of `fit`: the light, the variables, and the descent."""

    scene: mi.Scene = field(kw_only=False)
    params: Mapping[str, Any] = field(kw_only=False)
    target: Annotated[Any, TRANSIENT] = field(kw_only=False)
    apply: Callable[[mi.SceneParameters, dict[str, Any]], Any] | None = None
    integrator: mi.Integrator | None = None
    sensor: int = 0
    loss: str | Callable[[Any, Any], Any] = "l2"
    frequency_hz: float | Sequence[float] | None = None
    optimizer: str | mi.ad.Optimizer = "adam"
    learning_rate: float | Mapping[str, float] = 0.01
    bounds: Mapping[str, tuple[float | None, float | None]] | None = None
    steps: int = 200
    spp: int | None = None
    seed: int = 0
    tolerance: float = 0.05
    patience: int = 10
    callback: Callable[[int, float, dict[str, Any]], Any] | None = None
    progress: bool = True


@takes(FitArguments)
def fit(*args: Any, **options: Any) -> Fit:  # noqa: D417, the record has them
    """Fit parameters of a scene to measured light, by gradient descent.

    Each step renders with `mi.render` and new random numbers, compares the light with the target,
    and changes the values against the gradient of the loss. Single steps are noisy. Therefore the
    mean loss of the last `patience` steps is compared with the mean of as many steps before. If it
    is not lower, all learning rates are halved. The fit ends when the learning rates are below
    `tolerance` times their first values, or after `steps` steps. Ctrl-C, SIGTERM and SIGHUP end it
    after the current step.

    Gradients do not include moving silhouettes and moving shadow edges. Fit objects that move in
    full sight. The first step warns of moving objects.

    The derivative of `mi.render` uses other random numbers than its light. If the derivative of the
    loss is linear in the light, as for "l2" and "phasor", noise does not bias the fit. Noise biases
    other losses, such as "wasserstein" and functions with phases, ratios or absolute values, and
    only a larger `spp` reduces this bias. "phase" and "scale_free" render twice per step with
    independent random numbers, so that products of noise vanish on average.

    Args:
        scene: A loaded scene. It contains the best values at the end, also after an error.
        params: Names and start values. A value is a number for all components, or an array. Without
            `apply`, names are parameters as listed by `mi.traverse(scene)`. These parameters
            themselves (`params.keep([...])`) are accepted as well.
        target: Measured light: a result of `mi.render` (the last of several results, with time
            bins), an array of the film's shape (height, width, bins, channels), or a Dataset of
            `render` with the film's pixels, bins and channels, in any order.
            For loss="phasor" and "phase", also a pair (I, Q), or the whole result of
            `transient_to_phasor` and `render_amcw_phasor`. For loss="phase", also phases [rad].
            Their shape is (height, width, channels), after the axis of several frequencies.
        apply: Function `apply(params, values)` that computes parameters of the scene from the
            values. With it, names are arbitrary, and a value is a number, 2 to 4 numbers, or a
            Dr.Jit array.
        integrator: An integrator with derivatives, by default the scene's integrator.
        sensor: Index of the sensor.
        loss: "l2", "phasor", "phase", "scale_free" or "wasserstein", see `l2_loss` and the others,
            or a function of rendered light and target (two tensors) that returns a number with
            derivatives.
        frequency_hz: Frequencies of the losses "phasor" and "phase" [Hz].
        optimizer: "adam", "sgd", or a Mitsuba optimizer without variables. Its settings are copied,
            except for the learning rate.
        learning_rate: Approximate change of a value by Adam in a step, in the unit of the value,
            above 0, or a dict with a learning rate for each name.
        bounds: (low, high) by name, None without a bound. Values are clipped.
        steps: Largest number of steps, from 1.
        spp: Samples per pixel, for light and for derivatives, by default the scene's.
        seed: Seed of all random numbers.
        tolerance: Fraction of the first learning rates at which the fit ends, from 0 to 1. 0 runs
            all steps. 1 ends the fit the first time that the loss is not lower.
        patience: Number of steps over which losses are averaged, from 1.
        callback: Function that is called after each step with the index of the step from 0, its
            loss and its values. If it returns True, the fit ends.
        progress: Whether to show a progress bar.

    Returns:
        The values and the history of the fit, see `Fit`.

    Raises:
        ValueError: An argument is invalid, or the light does not depend on any variable.
        BackendError: The active variant does not support time-resolved rendering.

    Warns:
        UserWarning: The loss does not depend on a variable; a loss or a gradient is not finite,
            which ends the fit; a variable moves objects, see above; a value ends at a bound; or the
            final film is black.

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
    # Check the arguments
    variants.require_vectorized()
    given = filled(FitArguments, fit, args, options)
    scene = given.scene
    integrator = given.integrator
    loss = given.loss
    frequency_hz = given.frequency_hz
    callback = given.callback
    checks.instance("scene", scene, mi.Scene, "a loaded scene, as mi.load_dict and load_scene give")
    film = require_sensor(scene, given.sensor).film()
    if integrator is not None:
        checks.instance("integrator", integrator, mi.Integrator, "an integrator or None")
    for name, value in (("apply", given.apply), ("callback", callback)):
        if value is not None:
            checks.function(name, value)
    count = checks.integer("steps", given.steps, 1, MAX_STEPS)
    samples = 0 if given.spp is None else checks.integer("spp", given.spp, 1, checks.MAX_SPP)
    seed = checks.integer("seed", given.seed, 0, checks.MAX_SEED)
    tolerance = checks.number("tolerance", given.tolerance, low=0, high=1)
    patience = checks.integer("patience", given.patience, 1, MAX_STEPS)
    checks.boolean("progress", given.progress)

    # Prepare loss, variables and target. Integrators of Mitsuba do not have camera_unwarp
    measure = loss_of(loss, frequency_hz, film)
    variables = Variables(scene, given.params, given.apply, given.bounds)
    rates = variables.rates(given.learning_rate)
    engine = _make_optimizer(given.optimizer)
    is_phase = isinstance(loss, str) and loss in WITH_FREQUENCIES
    measured = _phasor_target(given.target, film, loss, frequency_hz) if is_phase else None
    if measured is None:
        tracer = scene.integrator() if integrator is None else integrator
        camera_unwarp = bool(getattr(tracer, "camera_unwarp", False))
        measured = _target_tensor(given.target, film, camera_unwarp)
    of_two = isinstance(loss, str) and loss in OF_TWO_RENDERS

    # Prepare the loop
    engine.update(variables.start)
    plateau = _Plateau(tolerance, patience)
    losses: list[float] = []
    history: list[dict[str, Any]] = []
    why = "all steps are taken"
    converged = False
    light = None

    def render(random_numbers: int) -> Any:
        """Render with random numbers of a step. The last of several results has time bins."""
        try:
            rendered = mi.render(
                scene,
                params=variables.params,
                sensor=given.sensor,
                integrator=integrator,
                seed=random_numbers,
                spp=samples,
            )
        except RuntimeError as error:
            # Dr.Jit only reports that there is a cause
            reason = error.__cause__
            if not isinstance(reason, ValueError | TypeError):
                raise
        else:
            return rendered[-1] if isinstance(rendered, tuple) else rendered

        # Raise outside the `except` block, so that the traceback has no circular context
        raise reason

    with (
        ProgressBar("Fitting", count, unit="step", enabled=given.progress) as bar,
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
            answer = None if callback is None else callback(step, losses[-1], history[-1])
            ended = isinstance(answer, bool | np.bool_) and bool(answer)

            # Does the fit end?
            converged = plateau.add(losses[-1])
            if stop.requested:
                why = "stopped"
            elif converged:
                why = "the loss no longer falls"
            elif ended:
                why = "the callback ended it"
            if stop.requested or converged or ended:
                break
    # Report values at bounds, and a black film
    best, lowest = _best(losses, patience)
    if reached := variables.at_bounds(history[best]):
        warnings.warn(
            f"fit: {', '.join(reached)}, which is a bound. Widen the bound, or use "
            "loss='scale_free' or 'phase' if the gain of the target is unknown",
            stacklevel=2,
        )
    if not dr.any(dr.detach(light) != 0, axis=None):
        warnings.warn(
            "fit: the final film is black. Choose start values nearer to the target, "
            "loss='wasserstein', or a low frequency_hz",
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
    """Create an optimizer without variables from a name or another optimizer."""
    if isinstance(given, mi.ad.Optimizer):
        if len(given):
            raise ValueError(
                f"optimizer = {type(given).__name__}: it has the variables {', '.join(given)}. "
                "Pass an optimizer without variables, and set params instead"
            )
        own = copy(given)
        own.state = {}
        return own
    allowed = f"one of {', '.join(OPTIMIZERS)}, or an optimizer of Mitsuba's"
    checks.instance("optimizer", given, str, allowed)
    kind = checks.one_of("optimizer", given, OPTIMIZERS)
    return mi.ad.Adam(lr=0.0) if kind == "adam" else mi.ad.SGD(lr=0.0)


def _phasor_target(
    given: Any, film: Any, loss: str, frequency_hz: Any
) -> tuple[mi.TensorXf, mi.TensorXf] | None:
    """Convert I and Q, or phases with the loss "phase", to a pair of tensors.

    Return None for light, which `_target_tensor` converts. The loss checks the shapes.
    """
    # Is the target light?
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

    # Check the arrays
    arrays = []
    for name, part in zip(("I", "Q") if is_tuple else ("phase",), parts, strict=False):
        part = np.array(dr.detach(part)) if isinstance(part, dr.ArrayBase) else part
        array = checks.real_array(f"target: {name}", part, np.float32)
        pixels = array.shape[-3:-1] == (height, width)
        allowed = f"(..., {height}, {width}, channels), or the film's with time bins"
        checks.shape(f"target: {name}", array, pixels and array.size > 0, allowed)
        arrays.append(checks.finite(f"target: {name}", array))

    # Phases become phasors of amplitude 1
    if not is_tuple:
        arrays = [np.cos(arrays[0]), np.sin(arrays[0])]
    return mi.TensorXf(arrays[0]), mi.TensorXf(arrays[1])


def _phasor_by_labels(values: Any, film: Any, frequency_hz: Any) -> Any:
    """Return the values of labeled phasors in the order of the film; others are unchanged."""
    if not isinstance(values, xr.DataArray) or "opl" in values.dims:
        return values

    # The frequencies must equal the loss's frequencies
    axes = ("y", "x", "channel")
    if "frequency" in values.dims:
        axes = ("frequency", *axes)
        found = values["frequency"].values
        if not np.array_equal(found, np.atleast_1d(frequency_hz)):
            raise ValueError(
                f"target has the frequencies {found.tolist()} Hz. Pass them as frequency_hz"
            )

    # Read the pixels
    kind = Kind("phasors of the film's pixels", {"phasor": axes})
    phasors = read(xr.Dataset({"phasor": values}), kind, "target")
    _require_same_pixels(phasors, film)
    return phasors["phasor"].values


def _target_tensor(given: Any, film: Any, camera_unwarp: bool) -> mi.TensorXf:
    """Convert a target to a tensor of the film's shape."""
    # Convert to an array
    if isinstance(given, tuple) and given:
        given = given[-1]
    if isinstance(given, xr.Dataset | xr.DataArray):
        given = _labeled_bins(given, film, camera_unwarp)
    if isinstance(given, dr.ArrayBase):
        given = np.array(dr.detach(given))
    array = checks.real_array("target", given, np.float32)

    # Check the shape
    width, height = (int(n) for n in film.crop_size())
    shape = (height, width)
    axis = time_bins(film)
    if axis is not None:
        shape += axis[:1]
    valid = array.shape[: len(shape)] == shape and array.size > 0
    allowed = ", ".join(map(str, (*shape, "...")))
    checks.shape("target", array, valid, f"({allowed}), the shape of the film")
    return mi.TensorXf(checks.finite("target", array))


def _labeled_bins(given: xr.Dataset | xr.DataArray, film: Any, camera_unwarp: bool) -> np.ndarray:
    """Return the light of a Dataset with the same pixels, bins and channels as the film."""
    # Read the light. A DataArray gets the film's bin width, which is checked below
    if time_bins(film) is None:
        raise ValueError("target = Dataset: must be an array for a film without time bins")
    if isinstance(given, xr.DataArray):
        given = given.to_dataset(name="transient").assign_attrs(bin_width_opl=film.bin_width_opl)
    target = read(given, TRANSIENT, "target")
    require_whole_stokes(target, "target")
    _require_same_pixels(target, film)

    # The light must have the time axis of the renders
    bins = bins_of(target, "target")
    start = film.start_opl
    width = film.bin_width_opl
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
    """Raise a ValueError if pixels or channels differ from the film's."""
    wanted = pixels_and_channels(film, target.sizes["channel"])
    require_same_labels(target, wanted, "target", "the film")


@dataclass
class _Plateau:
    """Schedule that halves the learning rates when losses no longer decrease."""

    # Factor of the learning rates at which the fit ends
    tolerance: float

    # Number of steps over which losses are averaged
    patience: int

    # Current factor of all learning rates
    rate: float = 1.0

    # Losses since the last change of the factor
    losses: list[float] = field(default_factory=list)

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
    """Warn of values without an effect on the loss. Raise an error if no value has an effect."""
    none = [name for name, value in values.items() if dr.all(dr.grad(value) == 0, axis=None)]
    if len(none) == len(values):
        raise ValueError(
            f"params = {', '.join(none)}: the loss does not depend on them at the start. Choose "
            "parameters of what the sensor sees, and an integrator with their derivatives"
        )
    for name in none:
        warnings.warn(
            f"params[{name!r}]: the loss does not depend on it at the start", stacklevel=3
        )


def _evaluate(loss: Callable[..., Any], light: Any, target: Any, other: Any) -> Any:
    """Evaluate the loss, which must return one number; `other` is a second render or None."""
    if not isinstance(target, tuple):
        require_same_shape(light, target)
    error = loss(light, target) if other is None else loss(light, target, other=other)
    number = isinstance(error, dr.ArrayBase) and dr.is_float_v(error)
    if not number or math.prod(error.shape) != 1:
        kind = checks.quote(type(error).__name__)
        raise ValueError(f"loss: returned {kind}; must return a Dr.Jit number")
    return error


def _summary(value: Any) -> str:
    """Format a value as one line."""
    if np.size(value) > SHOWN_NUMBERS:
        return f"array {np.shape(value)}"
    text = ", ".join(f"{number:.4g}" for number in np.ravel(value))
    return text if np.size(value) == 1 else f"({text})"
