"""Problem a4.bound: the smallest error of a depth from photons."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

from typing import Any

import numpy as np

from tofrender.sensors.response import distribution


def depth_bound(signal: Any, background: Any, response: Any, bin_width_opl: float) -> np.ndarray:
    """Smallest standard deviation [m] of an unbiased depth from Poisson counts in bins.

    The light arrives in the center of a bin, far from both ends of the histogram.

    Args:
        signal: Expected counts S of the signal, at least 0, any shape.
        background: Expected counts b per bin, at least 0, of a shape that broadcasts to `signal`.
        response: Pulse and jitter together: `distribution("response", response)` has the methods
            `cdf` and `pdf` [1/m] of the path length.
        bin_width_opl: Width of the bins [m of path].

    Returns:
        Standard deviations of depth (half of the path length); infinite without signal.
    """
    raise NotImplementedError("a4.bound: depth_bound")
