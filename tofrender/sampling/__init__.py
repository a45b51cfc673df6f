"""Random numbers, point sets, warps of the unit square, and the tests of all of them."""

from __future__ import annotations

from ..lazy import names_of

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
__all__ = sorted({*_HOMES, *(name for names in _HOMES.values() for name in names)})  # pyright: ignore[reportUnsupportedDunderAll]

__getattr__, __dir__ = names_of(__name__, _HOMES)
