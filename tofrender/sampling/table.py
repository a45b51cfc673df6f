"""Table of all warps, for the chi-square test, the command line and the figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from .hierarchical import HierarchicalWarp
from .warps import (
    MAX_ALPHA,
    MIN_ALPHA,
    in_range,
    square_to_beckmann,
    square_to_beckmann_pdf,
    square_to_cosine_hemisphere,
    square_to_cosine_hemisphere_pdf,
    square_to_tent,
    square_to_tent_pdf,
    square_to_uniform_disk,
    square_to_uniform_disk_pdf,
    square_to_uniform_hemisphere,
    square_to_uniform_hemisphere_pdf,
    square_to_uniform_sphere,
    square_to_uniform_sphere_pdf,
)

# A warp and its density
Pair = tuple[Callable[..., Any], Callable[..., Any]]


@dataclass(frozen=True)
class Warp:
    """Factory of a warp and its density.

    Attributes:
        make: Function of the parameter's value, or of no argument without a parameter. It returns
            the functions `sample(Point2f) -> points` and `pdf(points) -> Float`.
        domain: Domain of the points, as in `chi_square_test`.
        parameter: Name of the parameter, "" without a parameter.
    """

    make: Callable[..., Pair]
    domain: str
    parameter: str = ""


def _beckmann(alpha: float) -> Pair:
    """Return the Beckmann warp of a roughness, and its density."""
    alpha = in_range("alpha", alpha, MIN_ALPHA, MAX_ALPHA)
    return partial(square_to_beckmann, alpha=alpha), partial(square_to_beckmann_pdf, alpha=alpha)


def _hierarchical(image: Any) -> Pair:
    """Return the hierarchical warp of an image, and its density."""
    warp = HierarchicalWarp(image)
    return warp.sample, warp.pdf


WARPS: dict[str, Warp] = {
    "tent": Warp(lambda: (square_to_tent, square_to_tent_pdf), "plane"),
    "uniform_disk": Warp(lambda: (square_to_uniform_disk, square_to_uniform_disk_pdf), "disk"),
    "uniform_sphere": Warp(
        lambda: (square_to_uniform_sphere, square_to_uniform_sphere_pdf), "sphere"
    ),
    "uniform_hemisphere": Warp(
        lambda: (square_to_uniform_hemisphere, square_to_uniform_hemisphere_pdf), "hemisphere"
    ),
    "cosine_hemisphere": Warp(
        lambda: (square_to_cosine_hemisphere, square_to_cosine_hemisphere_pdf), "hemisphere"
    ),
    "beckmann": Warp(_beckmann, "hemisphere", "alpha"),
    "hierarchical": Warp(_hierarchical, "image", "image"),
}
"""Warps by name."""
