"""Variables of a fit: start values, bounds, and parameters of the scene."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..runtime.interface import readable

Apply = Callable[[mi.SceneParameters, dict[str, Any]], Any]


class Variables:
    """Named values of a fit. The arguments are as for `fit`.

    Attributes:
        params: The parameters of the scene.
        start: Start values by name, as differentiable Dr.Jit arrays.
    """

    def __init__(
        self, scene: mi.Scene, params: Any, apply: Apply | None, bounds: Any = None
    ) -> None:
        # Read names and start values
        own = isinstance(params, mi.SceneParameters)
        start = dict(readable(params)) if own else params
        given = checks.mapping("params", start)
        if not given:
            raise ValueError(
                f"params = {checks.quote(start)}: must contain at least one name with a start value"
            )
        self.params = params if own and apply is None else mi.traverse(scene)
        self._apply = apply

        # Convert the start values
        convert = self._scene_parameter if apply is None else self._free_variable
        self.start = {name: convert(name, value) for name, value in given.items()}
        before = self.start if apply is not None else {name: self.params[name] for name in given}
        self._before = self.plain(before)
        self._bounds = self._check_bounds(bounds)

    # ------------------------------------------------------------------------ during the fit

    def write(self, values: dict[str, Any]) -> None:
        """Write values to the scene."""
        # Mitsuba would warn in each step of parameters that its integrators ignore
        level = mi.log_level()
        mi.set_log_level(max(level, mi.LogLevel.Error, key=int))
        try:
            if self._apply is None:
                for name, value in values.items():
                    self.params[name] = value
            else:
                self._apply(self.params, dict(values))
            self.params.update()
        finally:
            mi.set_log_level(level)

    @contextmanager
    def write_at_exit(self, best: Callable[[], Mapping[str, Any] | None]) -> Iterator[None]:
        """Write the best values to the scene after the block, also after an error.

        Args:
            best: Function that returns the best values without gradients, by name. If it returns
                None, the values before the fit are restored. A fit with a function `apply` restores
                the start values.
        """

        def write_best() -> None:
            values = best() or self._before
            arrays = {name: np.asarray(value, np.float32) for name, value in values.items()}
            self.write({name: _like(self.start[name], array) for name, array in arrays.items()})

        try:
            yield
        except BaseException:
            # `apply` may have caused the error
            with suppress(Exception):
                write_best()
            raise
        write_best()

    def bounded(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Clip the values with bounds."""
        clipped = {}
        for name, (low, high) in self._bounds.items():
            value = dr.detach(values[name])
            value = value if low is None else dr.maximum(value, low)
            clipped[name] = value if high is None else dr.minimum(value, high)
        return clipped

    def at_bounds(self, values: Mapping[str, Any]) -> list[str]:
        """Describe the variables that have a component at a bound."""
        found = []
        for name, (low, high) in self._bounds.items():
            value = np.asarray(values[name], np.float32)
            for bound in (low, high):
                if bound is not None and np.any(value == np.float32(bound)):
                    found.append(f"{name} at {bound:g}")
        return found

    def plain(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Convert values to numbers and NumPy arrays."""
        return {name: _plain(value) for name, value in values.items()}

    # ------------------------------------------------------------------------------ arguments

    def rates(self, given: Any) -> dict[str, float]:
        """Return the learning rate of each variable."""
        # One learning rate for all variables
        if not isinstance(given, Mapping):
            return dict.fromkeys(self.start, checks.number("learning_rate", given, positive=True))

        # A learning rate by name
        rates = self._by_name("learning_rate", given)
        for name in self.start:
            if name not in rates:
                shown = checks.quote(dict(given))
                raise ValueError(f"learning_rate = {shown}: must have {name!r}, too")
            checks.number(f"learning_rate[{name!r}]", rates[name], positive=True)
        return {name: float(rates[name]) for name in self.start}

    def _by_name(self, argument: str, given: Any) -> dict[str, Any]:
        """Check that the names of a dict are variables."""
        found = checks.mapping(argument, given)
        for name, value in found.items():
            allowed = f"of {', '.join(self.start)}"
            checks.require(f"{argument}[{name!r}]", value, name in self.start, allowed)
        return found

    def _check_bounds(self, bounds: Any) -> dict[str, tuple[float | None, float | None]]:
        """Check the bounds, and that start values are within them."""
        checked = {}
        for name, pair in self._by_name("bounds", bounds).items():
            label = f"bounds[{name!r}]"
            allowed = "(low, high), low below high"
            checks.require(label, pair, not isinstance(pair, str | bytes | Mapping), allowed)
            ends = checks.items(label, pair, 2, allowed)
            low, high = (None if x is None else checks.number(label, x) for x in ends)
            rising = low is None or high is None or low < high
            checks.require(label, pair, rising, allowed)
            start = np.asarray(_plain(self.start[name]))
            within = (low is None or start.min() >= low) and (high is None or start.max() <= high)
            allowed = f"within bounds = {checks.quote(pair)}"
            checks.require(f"params[{name!r}]", start.tolist(), within, allowed)
            checked[name] = low, high
        return checked

    def _scene_parameter(self, name: str, value: Any) -> Any:
        """Convert the start value of a scene parameter to the type and shape in the scene.

        Raises:
            ValueError: The parameter is unknown or not differentiable, or the value does not fit.
        """
        label = f"params[{name!r}]"
        if name not in self.params:
            near = difflib.get_close_matches(name, list(self.params.keys()), 1)

            # A similar name may be the same parameter of several merged shapes
            if near and near[0].partition(".")[2] == name.partition(".")[2] != "":
                raise ValueError(
                    f"{label}: the scene does not have this parameter. {near[0]!r} may belong to "
                    "several shapes: equal shapes and materials are merged unless the scene is "
                    "loaded with optimize=False"
                )
            hint = f"did you mean {near[0]!r}? Must" if near else "must"
            raise ValueError(
                f"{label} = {checks.quote(value)}: {hint} be a parameter of the scene, as "
                "mi.traverse(scene) lists them, or come with `apply`"
            )
        parameter = self.params[name]
        if not _is_differentiable(parameter):
            raise ValueError(
                f"{label} = {checks.quote(value)}: is of type {type(parameter).__name__}, must be "
                "a parameter of floats with derivatives; `apply` can write others"
            )
        return _like(parameter, _numbers(label, value), label)

    def _free_variable(self, name: str, value: Any) -> Any:
        """Convert the start value of a variable that only `apply` knows."""
        label = f"params[{name!r}]"
        # Dr.Jit arrays
        is_drjit = isinstance(value, dr.ArrayBase)
        if is_drjit and not _is_differentiable(value):
            kind = type(value).__name__
            raise ValueError(f"{label} = {kind}: must be of floats with derivatives, as mi.Float")
        array = _numbers(label, value)
        if is_drjit:
            return dr.detach(value)

        # Numbers
        if array.ndim == 0:
            return mi.Float(float(array))
        vectors = {(2,): mi.Vector2f, (3,): mi.Vector3f, (4,): mi.Vector4f}
        allowed = "a number, 2 to 4 numbers, or a Dr.Jit array"
        checks.shape(label, array, array.shape in vectors, allowed)
        return vectors[array.shape](*array.tolist())


def _is_differentiable(value: Any) -> bool:
    """Return whether a parameter consists of floats with derivatives."""
    return dr.is_diff_v(value) and dr.is_float_v(value) and not dr.is_matrix_v(value)


def _numbers(label: str, value: Any) -> np.ndarray:
    """Convert a start value to finite numbers."""
    array = np.array(dr.detach(value)) if isinstance(value, dr.ArrayBase) else value
    try:
        array = checks.real_array(label, array, np.float32)
        checks.finite(label, np.atleast_1d(array))
    except ValueError:
        raise ValueError(
            f"{label} = {checks.quote(value)}: must be a finite number or an array of these"
        ) from None
    if not array.size:
        raise ValueError(f"{label} = {checks.quote(value)}: must contain at least one number")
    return array


def _like(template: Any, array: np.ndarray, label: str = "") -> Any:
    """Convert numbers to an array of the same type and shape as the template."""
    shape = tuple(template.shape)
    if array.ndim == 0:
        array = np.full(shape, array)
    own = np.shape(_plain(template))
    fits = array.size == np.prod(shape, dtype=int)
    fits = fits and (array.ndim <= 1 or array.shape in (own, shape))
    checks.shape(label, array, fits, f"a number or an array of shape {own}")
    return type(template)(np.ascontiguousarray(array.reshape(shape), np.float32))


def _plain(value: Any) -> Any:
    """Convert a Dr.Jit array to a number or a NumPy array."""
    array = np.array(dr.detach(value), np.float32)
    if array.size == 1:
        return float(array.item())
    dynamic = not dr.is_tensor_v(value) and array.ndim > 1 and array.shape[-1] == 1
    return array[..., 0] if dynamic else array
