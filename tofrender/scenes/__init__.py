"""Built-in scenes: builder functions that return dicts for `mi.load_dict`, and a table of them."""

from collections.abc import Callable

from ..runtime import checks
from .boxes import (
    START_OPL,
    cornell_box,
    cornell_box_flash,
    cornell_box_glass,
    cornell_box_mirror,
    cornell_box_steady_state,
    small_box,
)
from .caustics import caustic, lamp_in_fixture, light_through_hole, mirror_and_glass
from .confocal import (
    ourbox_confocal,
    wall_box_behind,
    wall_box_hi_nlos,
    wall_box_sphere_nlos,
    wall_box_spheres_nlos,
)
from .fog import cornell_box_fog, headlight_in_fog, lamp_in_milk, smoke_corridor
from .light_transport import (
    bust_ao,
    bust_simple,
    rectangle_light_quad,
    rectangle_light_triangles,
    sphere_light_large,
    sphere_light_medium,
    sphere_light_small,
    veach,
)
from .moving import corridor, fan, moving_mirror
from .nlos import nlos_behind_fog, nlos_bunny, nlos_patch, nlos_plane, nlos_z
from .parts import Dict
from .polarized import brewster_window, strained_mirror_corridor
from .views import SAMPLER

BUILT_IN: dict[str, Callable[..., Dict]] = {
    builder.__name__: builder
    for builder in (
        # Cornell boxes
        cornell_box,
        cornell_box_mirror,
        cornell_box_glass,
        cornell_box_flash,
        cornell_box_steady_state,
        # Steady scenes
        bust_simple,
        bust_ao,
        veach,
        sphere_light_small,
        sphere_light_medium,
        sphere_light_large,
        rectangle_light_quad,
        rectangle_light_triangles,
        small_box,
        # Caustics and hidden light sources
        caustic,
        mirror_and_glass,
        lamp_in_fixture,
        light_through_hole,
        # Participating media
        cornell_box_fog,
        lamp_in_milk,
        smoke_corridor,
        headlight_in_fog,
        # Polarized light
        brewster_window,
        strained_mirror_corridor,
        # Moving parts
        fan,
        corridor,
        moving_mirror,
        # Non-line-of-sight captures
        nlos_z,
        nlos_bunny,
        nlos_patch,
        nlos_plane,
        nlos_behind_fog,
        # Confocal captures
        wall_box_sphere_nlos,
        wall_box_spheres_nlos,
        wall_box_hi_nlos,
        wall_box_behind,
        ourbox_confocal,
    )
}
"""The built-in scenes by name. The first line of a builder's docstring describes its scene."""

__all__ = [*BUILT_IN, "BUILT_IN", "SAMPLER", "START_OPL", "describe"]


def describe(name: str) -> str:
    """Return the first line of a built-in scene's docstring.

    Example:
        >>> describe("cornell_box")
        'The Cornell box with two white boxes, lit from the ceiling.'
    """
    return (BUILT_IN[checks.one_of("name", name, BUILT_IN)].__doc__ or "").partition("\n")[0]
