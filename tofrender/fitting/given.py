# pyright: reportArgumentType=false
"""What `fit` is given, in the form that its steps work with."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import partial
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering.dataset import time_axis
from ..runtime import checks
from .losses import LOSSES, check_below_limit

if TYPE_CHECKING:
    import xarray as xr

OPTIMIZERS = ("adam", "sgd")


def optimizer_of(given: Any) -> Any:
    """An optimiser without variables.

    Raises:
        ValueError: It is none, or has some; one line.
    """
    if isinstance(given, mi.ad.Optimizer):
        if len(given):
            raise ValueError(
                f"optimizer = {type(given).__name__} of {', '.join(given)}: must have no "
                "variables; params has them"
            )
        own = copy(given)
        own.state = {}
        return own
    if not isinstance(given, str):
        allowed = f"one of {', '.join(OPTIMIZERS)}, or an optimiser of Mitsuba's"
        raise ValueError(f"optimizer = {checks.quote(given)}: must be {allowed}")
    kind = checks.one_of("optimizer", given, OPTIMIZERS)
    return mi.ad.Adam(lr=0.0) if kind == "adam" else mi.ad.SGD(lr=0.0)


def loss_of(given: Any, frequency_hz: Any, film: Any) -> Callable[[Any, Any], Any]:
    """The loss as a function of rendered light and target.

    Raises:
        ValueError: It is none, or not for this film; one line.
    """
    name = given if isinstance(given, str) else None
    if name != "phasor" and frequency_hz is not None:
        raise ValueError(
            f"frequency_hz = {checks.quote(frequency_hz)}: must be left out; only "
            "loss='phasor' has frequencies"
        )
    if name is None and callable(given):
        return given
    if name is None:
        allowed = f"one of {', '.join(LOSSES)}, or a function"
        raise ValueError(f"loss = {checks.quote(given)}: must be {allowed}")
    chosen = LOSSES[checks.one_of("loss", name, tuple(LOSSES))]
    if name == "l2":
        return chosen
    if not hasattr(film, "temporal_bins"):
        raise ValueError(f"loss = {name!r}: must be 'l2' for a film without time bins")
    if name == "wasserstein":
        return chosen
    if frequency_hz is None:
        raise ValueError("frequency_hz = None: must be given with loss='phasor', in hertz")
    axis: dict[str, Any] = {each: getattr(film, each) for each in ("start_opl", "bin_width_opl")}
    check_below_limit(frequency_hz, axis["bin_width_opl"])
    return partial(chosen, frequency_hz=frequency_hz, **axis)


def target_of(given: Any, film: Any) -> mi.TensorXf:
    """What was measured, of the film's shape.

    Raises:
        ValueError: It is of another shape or has other bins; one line.
    """
    if isinstance(given, tuple) and given:
        given = given[-1]
    if hasattr(given, "data_vars"):
        given = _of_dataset(given, film)
    if isinstance(given, dr.ArrayBase):
        given = np.array(dr.detach(given))
    array = checks.real_array("target", given, np.float32)
    height, width = (int(n) for n in reversed(tuple(film.crop_size())))
    allowed: tuple[Any, ...] = (height, width, "...")
    if hasattr(film, "temporal_bins"):
        allowed = (height, width, film.temporal_bins, "...")
    known = tuple(n for n in allowed if n != "...")
    if array.ndim <= len(known) - 1 or array.shape[: len(known)] != known or array.size == 0:
        shape = ", ".join(map(str, allowed))
        raise ValueError(
            f"target with shape {array.shape}: must be ({shape}), as what the film holds"
        )
    checks.finite("target", array)
    return mi.TensorXf(array)


def _of_dataset(dataset: xr.Dataset, film: Any) -> np.ndarray:
    """The bins of a Dataset that has the film's time axis."""
    if "transient" not in dataset.data_vars or "opl" not in dataset.coords:
        raise ValueError("target = Dataset: must hold `transient` along `opl`, as of `render`")
    if not hasattr(film, "temporal_bins"):
        raise ValueError("target = Dataset: must be an array for a film without time bins")
    start, width = time_axis(dataset)
    own = film.start_opl, film.bin_width_opl
    if not np.allclose((start, width), own, rtol=1e-4, atol=1e-3 * own[1]):
        raise ValueError(
            f"target with bins of {width:g} m from {start:g} m on: must be {own[1]:g} m from "
            f"{own[0]:g} m on, as the film's"
        )
    values = dataset["transient"].values
    if "stokes" in dataset.dims:
        values = values.reshape(*values.shape[:-2], -1)
    return values
