"""Problem a2.gaussian_pulse: the temporal profile of a laser pulse."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import drjit as dr
import mitsuba as mi


class GaussianPulse:
    """Normalized Gaussian p(t) = exp(-t² / (2 σ²)) / (σ √(2π)), centered at t = 0.

    Time is measured as optical path length: t is in meters, the density in 1/m.

    Args:
        width_opl: Standard deviation σ [m], above 0.

    Attributes:
        width_opl: σ [m].
        normalization: 1 / (σ √(2π)) [1/m], a Python float.
        support: (first, last) offset [m] beyond which the pulse is negligible: ±5 σ.
    """

    def __init__(self, width_opl: float) -> None:
        self.width_opl = width_opl
        self.support = (-5.0 * width_opl, 5.0 * width_opl)
        raise NotImplementedError("a2.gaussian_pulse: set self.normalization")

    def eval(self, t: mi.Float) -> mi.Float:
        """Density [1/m] at the offset `t` [m] from the pulse's center."""
        raise NotImplementedError("a2.gaussian_pulse: GaussianPulse.eval")

    def cdf(self, t: mi.Float) -> mi.Float:
        """Fraction of the energy up to the offset `t` [m], from 0 to 1: the integral of `eval`."""
        raise NotImplementedError("a2.gaussian_pulse: GaussianPulse.cdf")

    def sample(self, xi: mi.Float) -> tuple[mi.Float, mi.Float]:
        """Draw an offset from the pulse.

        Args:
            xi: Uniform random numbers in [0, 1], **both ends included**.

        Returns:
            Offsets [m] with the density `eval`, within 9 σ for every `xi`, and their weights: 1,
            because offsets are drawn in exact proportion to the density.
        """
        raise NotImplementedError("a2.gaussian_pulse: GaussianPulse.sample")
