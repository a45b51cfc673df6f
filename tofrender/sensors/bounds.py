"""Cramér-Rao bounds of depths and echoes that are estimated from counts in bins."""

from typing import Any

import numpy as np

from ..runtime import checks
from .jitter import kernel
from .photon_rates import at_least_0
from .response import distribution


def depth_bound(signal: Any, background: Any, response: Any, bin_width_opl: float) -> np.ndarray:
    """Return the smallest standard deviation of a depth [m], for counts in bins and a response.

        1 / (2 sqrt(I)),    I = sum over bins of (S dP_k/dt)^2 / (S P_k + b)

    P_k(t) is the fraction of the signal in bin k, for light with the path length t at the center of
    a bin. For a Gaussian without background, the bound is sigma / (2 sqrt(S)), and bins of width w
    increase it by the fraction w^2 / (24 sigma^2). For a large background of b counts per meter,
    I = S^2 / (4 sqrt(pi) sigma^3 b).

    Args:
        signal: Expected counts S of the signal, at least 0, any shape.
        background: Expected counts b per bin, at least 0, with a shape that broadcasts to `signal`.
        response: Response of pulse and detector together, as for `estimate_depth`.
        bin_width_opl: Width of the bins [m].

    Example:
        >>> from tofrender import GaussianPulse
        >>> depth_bound(100, 0, GaussianPulse(0.3), 0.03).round(4).item()  # 0.3 / 20
        0.015
    """
    # Check the arguments
    signal = at_least_0("signal", signal)
    background = at_least_0("background", background)
    shape = distribution("response", response)
    width = checks.width("bin_width_opl", bin_width_opl)

    # Sum the Fisher information over bins
    edges = _edges(shape, width)
    masses = np.diff(shape.cdf(edges))
    slopes = np.diff(shape.pdf(edges))
    information: Any = 0.0
    for mass, slope in zip(masses, slopes, strict=True):
        mean = signal * mass + background
        information = information + (signal * slope) ** 2 / np.where(mean > 0, mean, 1)
    with np.errstate(divide="ignore"):
        return 0.5 / np.sqrt(information)


def echo_bounds(
    signal: Any, background: Any, response: Any, bin_width_opl: float
) -> dict[str, np.ndarray]:
    """Return the smallest standard deviations of depth, intensity and width of an echo.

    All three are unknown. The bounds are the roots of the diagonal of the inverse Fisher matrix

        I_ij = sum over bins of (dm_k/di) (dm_k/dj) / m_k,    m_k = S P_k(t, a) + b

    for the path length t, the signal S, and the factor a that widens the response about its mean.
    For a Gaussian without background, the bounds are sigma / (2 sqrt(S)), sqrt(S) and
    sigma / sqrt(2 S).

    The arguments are as for `depth_bound`.

    Returns:
        Arrays by name, as in `echoes`: "depth" [m], "intensity" (counts) and "width" [m], the
        standard deviation of the echo along the path. They are infinite if the bins cannot
        distinguish the three quantities.

    Example:
        >>> from tofrender import GaussianPulse
        >>> found = echo_bounds(200, 0, GaussianPulse(0.3), 0.01)
        >>> {name: round(bound.item(), 4) for name, bound in found.items()}
        {'depth': 0.0106, 'intensity': 14.1421, 'width': 0.015}
    """
    # Check the arguments
    signal = at_least_0("signal", signal)
    background = at_least_0("background", background)
    shape = distribution("response", response)
    width = checks.width("bin_width_opl", bin_width_opl)
    signal, background = np.broadcast_arrays(signal, background)
    edges = _edges(shape, width)

    # Derivatives of each bin by position, signal and width
    density = shape.pdf(edges)
    lit = signal > 0
    changes = (
        np.diff(each) for each in (-density, shape.cdf(edges), (shape.mean() - edges) * density)
    )

    # Sum the Fisher information over bins
    information = np.zeros((*signal.shape, 3, 3))
    for slope, mass, spread in zip(*changes, strict=True):
        mean = signal * mass + background
        change = np.stack([signal * slope, np.full_like(mean, mass), signal * spread], axis=-1)
        change = change / np.sqrt(np.where(mean > 0, mean, 1))[..., None]
        information += change[..., :, None] * change[..., None, :]

    # Find the pixels with a regular matrix
    size = np.sqrt(np.diagonal(information, axis1=-2, axis2=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = information / (size[..., :, None] * size[..., None, :])
        lit = lit & (size > 0).all(axis=-1) & (np.linalg.det(relative) > 1e-12)

    # Invert the matrix
    least = np.linalg.inv(np.where(lit[..., None, None], information, np.eye(3)))
    std = np.where(lit[..., None], np.sqrt(np.diagonal(least, axis1=-2, axis2=-1)), np.inf)
    return {"depth": std[..., 0] / 2, "intensity": std[..., 1], "width": std[..., 2] * shape.std()}


def _edges(shape: Any, width: float) -> np.ndarray:
    """Return the edges [m] of the bins that a response reaches, from the center of a bin."""
    reach = kernel(shape, width).size // 2
    return (np.arange(-reach, reach + 2) - 0.5) * width
