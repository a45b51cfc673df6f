"""Cramér-Rao bound of a depth from counts in bins."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..runtime import checks
from .jitter import kernel
from .rates import at_least_0
from .response import distribution


def depth_bound(signal: Any, background: Any, response: Any, bin_width_opl: float) -> np.ndarray:
    """Least standard deviation of a depth [m] from counts in bins, of a known response.

        1 / (2 sqrt(I)),    I = sum over bins of (S dP_k/dt)^2 / (S P_k + b)

    P_k(t) is the part of the signal in bin k, for light at the path length t, a bin's centre. A
    Gaussian without background has sigma / (2 sqrt(S)), to which bins of width w add about w^2 /
    (24 sigma^2) of it; with much background b per metre, I = S^2 / (4 sqrt(pi) sigma^3 b).

    Args:
        signal: Expected counts S of the signal, at least 0, any shape.
        background: Expected counts b per bin, at least 0, of a shape that broadcasts to that.
        response: Of pulse and detector together, as for `estimate_depth`.
        bin_width_opl: Width of the bins [m].

    Example:
        >>> from tofrender import GaussianPulse
        >>> depth_bound(100, 0, GaussianPulse(0.3), 0.03).round(4).item()  # 0.3 / 20
        0.015
    """
    signal, background = at_least_0("signal", signal), at_least_0("background", background)
    shape, width = distribution("response", response), checks.width("bin_width_opl", bin_width_opl)
    reach = kernel(shape, width).size // 2
    edges = (np.arange(-reach, reach + 2) - 0.5) * width
    masses, slopes = (np.diff(each(edges)) for each in (shape.cdf, shape.pdf))
    information: Any = 0.0
    for mass, slope in zip(masses, slopes, strict=True):
        mean = signal * mass + background
        information = information + (signal * slope) ** 2 / np.where(mean > 0, mean, 1)
    with np.errstate(divide="ignore"):
        return 0.5 / np.sqrt(information)
