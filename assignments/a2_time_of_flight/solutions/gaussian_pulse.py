"""A Gaussian pulse by bisection: the quantile is where the cdf crosses ξ."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi


class GaussianPulse:
    """Normalized Gaussian p(t) = exp(-t² / (2 σ²)) / (σ √(2π))."""

    def __init__(self, width_opl: float) -> None:
        self.width_opl = width_opl
        self.support = (-5.0 * width_opl, 5.0 * width_opl)
        self.normalization = 1.0 / (width_opl * math.sqrt(2.0 * math.pi))

    def eval(self, t: mi.Float) -> mi.Float:
        """Density [1/m]."""
        z = t / self.width_opl
        return self.normalization * dr.exp(-z * z / 2)

    def cdf(self, t: mi.Float) -> mi.Float:
        """Fraction of the energy up to t."""
        z = mi.Float(t) / self.width_opl / math.sqrt(2.0)
        return 0.5 * (1.0 + dr.erf(z))

    def sample(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Find t with cdf(t) = ξ between -6 σ and 6 σ, by bisection below the mean and symmetry."""
        xi = mi.Float(xi)
        below = dr.minimum(xi, 1.0 - xi)
        low = mi.Float(-6.0 * self.width_opl)
        high = mi.Float(0.0)
        for _ in range(24):
            middle = 0.5 * (low + high)
            beyond = self.cdf(middle) > below
            low = dr.select(beyond, low, middle)
            high = dr.select(beyond, middle, high)
        t = 0.5 * (low + high)
        return dr.select(xi < 0.5, t, -t), dr.ones(mi.Float, dr.width(t))
