"""Random numbers, point sets, warps of the unit square, and the tests of all of them."""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "warps": (
        "WARPS",
        "Warp",
        "square_to_beckmann",
        "square_to_beckmann_pdf",
        "square_to_cosine_hemisphere",
        "square_to_cosine_hemisphere_pdf",
        "square_to_tent",
        "square_to_tent_pdf",
        "square_to_uniform_disk",
        "square_to_uniform_disk_pdf",
        "square_to_uniform_hemisphere",
        "square_to_uniform_hemisphere_pdf",
        "square_to_uniform_sphere",
        "square_to_uniform_sphere_pdf",
    ),
    "points": ("POINT_SETS", "grid", "independent", "point_set", "stratified"),
    "chi_square": ("chi_square_test",),
    "verdicts": ("Moment", "Verdict"),
    "cases": (
        "Case",
        "SuiteVerdict",
        "bsdf_case",
        "chi_square_suite",
        "light_case",
        "warp_case",
    ),
    "hierarchical": ("EnvironmentWarp", "HierarchicalWarp"),
    "shapes": (
        "EmitterRecord",
        "Quad",
        "Sphere",
        "SurfaceGroup",
        "Triangle",
        "sample_sphere_cap",
        "sample_sphere_cap_pdf",
        "sample_triangle",
        "sample_triangle_pdf",
        "visible",
    ),
    "scene_emitters": ("emitters_of",),
}
_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names}

__all__ = sorted({*_MODULE_OF, *_HOMES})  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for."""
    if name in _HOMES:
        return importlib.import_module(f".{name}", __name__)
    if name in _MODULE_OF:
        value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names, loaded or not."""
    return sorted({*globals(), *__all__})
