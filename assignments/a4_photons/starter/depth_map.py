"""Problem a4.depth_map: depth from histograms of photons."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

from typing import Any

import numpy as np

from tofrender.sensors.response import distribution


def estimate_depth(
    counts: np.ndarray,
    response: Any,
    method: str = "ml",
    *,
    start_opl: float,
    bin_width_opl: float,
) -> dict[str, np.ndarray]:
    """Estimate the depth of the strongest return in each pixel.

    Args:
        counts: Counts per bin, at least 0, shape (y, x, bin). They need not be integers, for
            example after the correction by `coates`.
        response: Pulse and jitter together, as for `depth_bound`. The distance of each return from
            the first and the last bin is greater than the length of the response.
        method: "matched", the maximum of the matched filter, refined by a parabola, or "ml", the
            maximum of the likelihood.
        start_opl: Path length where the first bin starts [m].
        bin_width_opl: Width of the bins [m of path].

    Returns:
        Arrays of shape (y, x): `depth` [m], half the path length of the light itself, without the
        mean delay of the response; `depth_std` [m], `depth_bound` for the estimated signal and
        background. Without counts they are NaN and infinite.
    """
    raise NotImplementedError("a4.depth_map: estimate_depth")
