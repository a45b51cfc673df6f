"""What a fit changes: numbers with names, and how they are written into a scene."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks

Apply = Callable[[mi.SceneParameters, dict[str, Any]], Any]


class Variables:
    """The values of a fit.

    Args:
        scene: The scene.
        params: Names and start values.
        apply: Writes into the scene's parameters what follows from the values; None writes them
            under their own names.
        bounds: (low, high) by name.

    Attributes:
        params: The scene's parameters.
        start: Start values by name, as differentiable arrays of Dr.Jit's.

    Raises:
        ValueError: A name, a value or a bound is wrong; one line.
    """

    def __init__(
        self, scene: mi.Scene, params: Any, apply: Apply | None, bounds: Any = None
    ) -> None:
        given = _named(params)
        own = isinstance(params, mi.SceneParameters)
        self.params = params if own and apply is None else mi.traverse(scene)
        self._apply = apply
        make = self._latent if apply is not None else self._of_scene
        self.start = {name: make(name, value) for name, value in given.items()}
        kept = self.start if apply is not None else {name: self.params[name] for name in given}
        self._before = {name: _plain(value) for name, value in kept.items()}
        self._bounds = self._limits(bounds)

    # ------------------------------------------------------------------------- while it runs

    def write(self, values: dict[str, Any]) -> None:
        """Write values into the scene."""
        with _quiet():
            if self._apply is None:
                for name, value in values.items():
                    self.params[name] = value
            else:
                self._apply(self.params, dict(values))
            self.params.update()

    @contextmanager
    def settled(self, found: Callable[[], Mapping[str, Any] | None]) -> Iterator[None]:
        """Write plain values that were found into the scene at the end, after an error too.

        Where none were found, it has again what it had before, or with `apply` what fits started
        with. Nothing of it tracks gradients then.
        """

        def settle() -> None:
            values = found()
            made = self._before if values is None else values
            self.write({name: self.made(name, each) for name, each in made.items()})

        try:
            yield
        except BaseException:
            with suppress(Exception):  # `apply` may be what has failed
                settle()
            raise
        settle()

    def bounded(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Those that have bounds, within them."""
        found = {}
        for name, (low, high) in self._bounds.items():
            value = dr.detach(values[name])
            value = value if low is None else dr.maximum(value, low)
            found[name] = value if high is None else dr.minimum(value, high)
        return found

    def plain(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Values as numbers and NumPy arrays."""
        return {name: _plain(value) for name, value in values.items()}

    def made(self, name: str, value: Any) -> Any:
        """A plain value as what the fit started with."""
        return _like(self.start[name], np.asarray(value, np.float32))

    # -------------------------------------------------------------------------- what is given

    def rates(self, given: Any) -> dict[str, float]:
        """The learning rate of each."""
        if not isinstance(given, Mapping):
            return dict.fromkeys(self.start, checks.number("learning_rate", given, positive=True))
        rates = self._by_name("learning_rate", given)
        missing = [name for name in self.start if name not in rates]
        if missing:
            raise ValueError(
                f"learning_rate = {checks.quote(dict(given))}: must have {missing[0]!r}, too"
            )
        return {
            name: checks.number(f"learning_rate[{name!r}]", rates[name], positive=True)
            for name in self.start
        }

    def _by_name(self, what: str, given: Any) -> dict[str, Any]:
        """A dict whose names are those of the values."""
        found = checks.mapping(what, given)
        for name, value in found.items():
            if name not in self.start:
                raise ValueError(
                    f"{what}[{name!r}] = {checks.quote(value)}: must be of {', '.join(self.start)}"
                )
        return found

    def _limits(self, bounds: Any) -> dict[str, tuple[float | None, float | None]]:
        found = {}
        for name, pair in self._by_name("bounds", bounds).items():
            said = f"bounds[{name!r}]"
            wrong = f"{said} = {checks.quote(pair)}: must be (low, high), low below high"
            if isinstance(pair, str | bytes | Mapping):
                raise ValueError(wrong)
            try:
                low, high = pair
            except (TypeError, ValueError):
                raise ValueError(wrong) from None
            low, high = (
                None if each is None else checks.number(said, each) for each in (low, high)
            )
            if low is not None and high is not None and not low < high:
                raise ValueError(wrong)
            start = np.asarray(_plain(self.start[name]))
            below = low is not None and start.min() < low
            if below or (high is not None and start.max() > high):
                raise ValueError(
                    f"params[{name!r}] = {checks.quote(start.tolist())}: must be within bounds = "
                    f"{checks.quote(pair)}"
                )
            found[name] = low, high
        return found

    def _of_scene(self, name: str, value: Any) -> Any:
        """The start of a parameter of the scene."""
        said = f"params[{name!r}]"
        if name not in self.params:
            near = difflib.get_close_matches(name, list(self.params.keys()), 1)
            hint = f"did you mean {near[0]!r}? Must" if near else "must"
            raise ValueError(
                f"{said} = {checks.quote(value)}: {hint} be a parameter of the scene, as "
                "mi.traverse(scene) lists them, or come with `apply`"
            )
        its = self.params[name]
        if not (dr.is_diff_v(its) and dr.is_float_v(its)) or dr.is_matrix_v(its):
            raise ValueError(
                f"{said} = {checks.quote(value)}: is of type {type(its).__name__}, must be a "
                "parameter of floats with derivatives; `apply` can write others"
            )
        return _like(its, _numbers(said, value), said)

    def _latent(self, name: str, value: Any) -> Any:
        """The start of a value that `apply` knows."""
        said = f"params[{name!r}]"
        if isinstance(value, dr.ArrayBase):
            kind = type(value)
            if not (dr.is_diff_v(value) and dr.is_float_v(value)) or dr.is_matrix_v(value):
                raise ValueError(
                    f"{said} = {kind.__name__}: must be of floats with derivatives, as mi.Float"
                )
            _numbers(said, value)
            return dr.detach(value)
        array = _numbers(said, value)
        if array.ndim == 0:
            return mi.Float(float(array))
        kinds = {2: mi.Vector2f, 3: mi.Vector3f, 4: mi.Vector4f}
        if array.ndim != 1 or len(array) not in kinds:
            raise ValueError(
                f"{said} with shape {array.shape}: must be a number, 2 to 4 numbers, or an array "
                "of Dr.Jit's"
            )
        return kinds[len(array)](*array.tolist())


@contextmanager
def _quiet() -> Iterator[None]:
    """Without Mitsuba's warning at each step of parameters that its own integrators leave out."""
    level = mi.log_level()
    mi.set_log_level(max(level, mi.LogLevel.Error, key=int))
    try:
        yield
    finally:
        mi.set_log_level(level)


def _named(params: Any) -> dict[str, Any]:
    """Names and values of what is fitted, one or more."""
    if isinstance(params, mi.SceneParameters):
        params = dict(params)
    given = checks.mapping("params", params)
    if not given:
        raise ValueError(
            f"params = {checks.quote(params)}: must have a name and start value or more"
        )
    return given


def _numbers(said: str, value: Any) -> np.ndarray:
    """Finite numbers of a start value."""
    array = np.array(dr.detach(value)) if isinstance(value, dr.ArrayBase) else value
    try:
        array = checks.real_array(said, array, np.float32)
        checks.finite(said, np.atleast_1d(array))
    except ValueError:
        raise ValueError(
            f"{said} = {checks.quote(value)}: must be a finite number or an array of such"
        ) from None
    if not array.size:
        raise ValueError(f"{said} = {checks.quote(value)}: must hold a number or more")
    return array


def _like(its: Any, array: np.ndarray, said: str = "") -> Any:
    """Numbers as an array of the same type and shape."""
    shape = tuple(its.shape)
    if array.ndim == 0:
        array = np.full(shape, array)
    own = np.shape(_plain(its))
    if array.size != np.prod(shape, dtype=int) or (
        array.ndim > 1 and array.shape not in (own, shape)
    ):
        raise ValueError(
            f"{said} with shape {array.shape}: must be a number or an array of shape {own}"
        )
    return type(its)(np.ascontiguousarray(array.reshape(shape), np.float32))


def _plain(value: Any) -> Any:
    """A number or a NumPy array of a Dr.Jit array."""
    array = np.array(dr.detach(value), np.float32)
    if array.size == 1:
        return float(array.item())
    dynamic = not dr.is_tensor_v(value) and array.ndim > 1 and array.shape[-1] == 1
    return array[..., 0] if dynamic else array
