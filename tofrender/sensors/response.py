"""Temporal response of a detector or of a whole system: Gaussian with an exponential tail."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from ..runtime import checks
from ..signals.pulses import GaussianPulse, SampledPulse
from ..signals.units import SPEED_OF_LIGHT

TAIL = 1e-6  # Probability beyond each end of a kernel


@dataclass(frozen=True)
class Response:
    """Distribution of the delay of a time stamp: a Gaussian convolved with an exponential tail.

        f(t) = exp(s^2 / 2 a^2 - t / a) erfc(s / (sqrt(2) a) - t / (sqrt(2) s)) / (2 a)

    with mean a, variance s^2 + a^2. The jitter of a SPAD or, with the laser pulse, of a system.

    Args:
        sigma_s: Standard deviation s of the Gaussian [s], above 0.
        tail_s: Time constant a of the tail, towards later stamps [s]; 0 for none.
        measured: A `SampledPulse` instead of the two: a measured response over metres of path.

    Example:
        >>> masses = Response(sigma_s=40e-12, tail_s=60e-12).kernel(bin_width_opl=0.015)
        >>> lags = np.arange(masses.size) - masses.size // 2
        >>> round(masses @ lags * 0.015 / 299792458 * 1e12)  # ps
        60
    """

    sigma_s: float | None = None
    tail_s: float = 0.0
    measured: SampledPulse | None = None

    def __post_init__(self) -> None:
        tail = checks.number("tail_s", self.tail_s, unit="seconds", low=0, high=1)
        if self.measured is None:
            checks.number("sigma_s", self.sigma_s, unit="seconds", low=1e-18, high=1)
        else:
            valid = isinstance(self.measured, SampledPulse) and self.sigma_s is None and tail == 0
            allowed = "a SampledPulse, without sigma_s and tail_s"
            checks.require("measured", self.measured, valid, allowed)

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> Response:
        """Read a measured response as `SampledPulse.from_file` does, with its errors."""
        return cls(measured=SampledPulse.from_file(path))

    @classmethod
    def of(cls, name: str, value: Any) -> Response:
        """Convert a `GaussianPulse` or `SampledPulse`; a `Response` stays as it is."""
        if isinstance(value, GaussianPulse):
            return cls(value.width_opl / SPEED_OF_LIGHT)
        value = cls(measured=value) if isinstance(value, SampledPulse) else value
        return checks.instance(name, value, cls, "a Response, GaussianPulse or SampledPulse")

    @property
    def distribution(self) -> Any:
        """Distribution of SciPy over path lengths [m], with `pdf`, `cdf` and so on."""
        if self.measured is not None:
            start, width = self.measured.start_opl, self.measured.bin_width_opl
            edges = start + width * np.arange(self.measured.density.size + 1)
            return stats.rv_histogram((self.measured.density, edges), density=True)
        sigma, tail = (self.sigma_s or 0) * SPEED_OF_LIGHT, self.tail_s * SPEED_OF_LIGHT
        if tail < 1e-3 * sigma:  # Differs by less than 1e-6 of the variance; avoids overflow
            return stats.norm(tail, sigma)
        return stats.exponnorm(tail / sigma, 0, sigma)

    def kernel(self, bin_width_opl: float, tail: float = TAIL) -> np.ndarray:
        """Probabilities that stamps move by k = -n to n bins of width w [m] from a bin's centre.

        They are cdf((k + 1/2) w) - cdf((k - 1/2) w), and sum to 1; `tail` is left out at each end.
        """
        width = checks.width("bin_width_opl", bin_width_opl)
        ends = self.distribution.ppf([tail, 1 - tail])
        reach = max(1, int(np.rint(np.abs(ends).max() / width)))
        masses = np.diff(self.distribution.cdf((np.arange(-reach, reach + 2) - 0.5) * width))
        return masses / masses.sum()
