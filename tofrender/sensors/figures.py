"""Figure of the errors of depth estimators against their bound."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..runtime import checks
from ..runtime.canvas import figure_width, in_style, new_figure, palette
from .bounds import depth_bound
from .estimators import METHODS, estimate_depth
from .rates import generator
from .response import Response

BINS = 200


@in_style()
def error_figure(
    response: Any, bin_width_opl: float, background: float = 0.1, seed: int = 0, pixels: int = 400
) -> Any:
    """Draw the RMS error of each method of `estimate_depth` over the signal, and `depth_bound`.

    Args:
        response: As for `estimate_depth`.
        bin_width_opl: Width of the bins [m]; 200 of them hold the response.
        background: Expected counts per bin, at least 0.
        seed: Seed of the random numbers.
        pixels: Histograms that are simulated for each signal from 3 to 1000 counts.

    Returns:
        A Matplotlib figure; errors far above the bound at few counts are returns not found.

    Raises:
        ValueError: A value out of range.

    Example:
        >>> figure = error_figure(Response(sigma_s=2e-10), 0.02, pixels=20)
        >>> [line.get_label() for line in figure.axes[0].lines][-1]
        'Cramér-Rao bound'
    """
    response, width = (
        Response.of("response", response),
        checks.width("bin_width_opl", bin_width_opl),
    )
    background = checks.number("background", background, low=0, high=1e6)
    rng, levels = generator(seed), np.array([3, 10, 30, 100, 300, 1000])
    position = (BINS // 2 + rng.random(checks.integer("pixels", pixels, 1, 1 << 20))) * width
    masses = np.diff(response.cdf(np.arange(BINS + 1) * width - position[:, None]))
    counts = rng.poisson(levels[:, None, None] * masses + background)
    figure = new_figure(figure_width(5.0), 0.7 * figure_width(5.0))
    axes = figure.add_subplot(xscale="log", yscale="log")
    for method in METHODS:
        depth = estimate_depth(counts, response, method, bin_width_opl=width)["depth"].values
        error = np.sqrt(np.nanmean((depth - position / 2) ** 2, axis=1))
        axes.plot(levels, error, "o-", markersize=3, label=method)
    bound = depth_bound(levels, background, response, width)
    axes.plot(levels, bound, "--", color=palette().ink, label="Cramér-Rao bound")
    axes.set(xlabel="signal [counts]", ylabel="RMS error of depth [m]")
    axes.legend()
    return figure
