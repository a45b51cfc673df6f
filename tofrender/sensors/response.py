"""Temporal response of a detector or a whole system: a Gaussian with an exponential tail."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from ..runtime import checks
from ..signals.pulses import GaussianPulse, SampledPulse
from ..signals.units import SPEED_OF_LIGHT

# Number of bins of a convolution per standard deviation of the Gaussian
FINE = 8


@dataclass(frozen=True)
class Response:
    """Distribution of the delay of a time stamp: a Gaussian convolved with an exponential tail.

        f(t) = exp(s^2 / 2 a^2 - t / a) erfc(s / (sqrt(2) a) - t / (sqrt(2) s)) / (2 a)

    The mean is a, and the variance is s^2 + a^2. A `GaussianPulse` can be used instead. A
    `SampledPulse`, which can be read from a file, represents a measured response.

    Args:
        sigma_s: Standard deviation s of the Gaussian [s], above 0.
        tail_s: Time constant a of the tail towards later stamps [s], 0 without a tail.

    Example:
        >>> delays = distribution("jitter", Response(40e-12, tail_s=60e-12))
        >>> round(delays.mean() / 299792458 * 1e12)  # ps
        60
    """

    sigma_s: float
    tail_s: float = 0.0

    def __post_init__(self) -> None:
        checks.number("sigma_s", self.sigma_s, unit="seconds", positive=True, high=1)
        checks.number("tail_s", self.tail_s, unit="seconds", low=0, high=1)


def distribution(name: str, response: Any) -> Any:
    """Return the SciPy distribution of a response over path lengths [m].

    Args:
        name: Name of the parameter, for messages.
        response: A `Response`, a `GaussianPulse` or a `SampledPulse`.
    """
    if isinstance(response, SampledPulse):
        edges = response.start_opl + response.bin_width_opl * np.arange(response.density.size + 1)
        return stats.rv_histogram((response.density, edges), density=True)
    if isinstance(response, GaussianPulse):
        return stats.norm(0, response.width_opl)
    checks.instance(name, response, Response, "a Response, GaussianPulse or SampledPulse")

    # A very short tail is replaced by its mean. The variance differs by less than 1e-6, and the
    # exponential would overflow
    sigma = response.sigma_s * SPEED_OF_LIGHT
    tail = response.tail_s * SPEED_OF_LIGHT
    if tail < 1e-3 * sigma:
        return stats.norm(tail, sigma)
    return stats.exponnorm(tail / sigma, 0, sigma)


def blurred(response: Any, width_opl: float) -> Response | GaussianPulse | SampledPulse:
    """Convolve a response with a Gaussian pulse.

    The convolution of a `SampledPulse` has bins of at most an eighth of the width.

    Args:
        response: A `Response`, a `GaussianPulse` or a `SampledPulse`.
        width_opl: Standard deviation of the pulse [m], above 0.

    Example:
        >>> blurred(GaussianPulse(0.03), 0.04)
        GaussianPulse(width_opl=0.05)
    """
    if isinstance(response, GaussianPulse):
        return GaussianPulse(math.hypot(response.width_opl, width_opl))
    if isinstance(response, Response):
        sigma = math.hypot(response.sigma_s, width_opl / SPEED_OF_LIGHT)
        return Response(sigma, response.tail_s)

    # Students write `jitter`, but get this module
    from .jitter import kernel

    # Divide the bins of a measured response, and move each part by the Gaussian
    parts = math.ceil(FINE * response.bin_width_opl / width_opl)
    step = response.bin_width_opl / parts
    masses = kernel(stats.norm(0, width_opl), step)
    values = np.convolve(np.repeat(response.density, parts), masses)
    start = response.start_opl - step * (masses.size // 2)
    return SampledPulse(values, start, step)
