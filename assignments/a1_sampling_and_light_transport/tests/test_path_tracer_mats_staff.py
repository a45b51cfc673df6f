"""a1.path_tracer_mats: drawn scenes."""

import paths_staff as paths
import pytest
import small_scenes as scenes

pytestmark = pytest.mark.a1_path_tracer_mats
NAME = "PathTracerMats"


def test_long_paths(submission):
    """Many bounces, and no limit, where every surface emits and reflects."""
    paths.check_furnace(submission, NAME, noise=5)


def test_lights_of_all_kinds(submission):
    """Several lights over a colored floor."""
    paths.check_lights(submission, NAME, noise=8.5)


def test_materials_under_a_sky(submission):
    """Diffuse, rough, mirrored, mixed, of glass, from the back."""
    paths.check_sky(submission, NAME, noise=2)


def test_light_by_way_of_a_mirror(submission):
    """A floor that only a mirror lights."""
    paths.check_light_by_a_mirror(submission, NAME)


def test_materials_alone(submission):
    """A small light, which a sample of the material finds rarely."""
    radius = submission.random.uniform(0.04, 0.08)
    light = scenes.disk([0, 0, 1.0], -paths.UP, radius, scenes.BLACK, emitter=scenes.lamp(90.0))
    scene = scenes.scene(floor=scenes.floor(), light=light)
    hint = "here light counts when the path runs into it, and no light is asked"
    paths.check_alone(submission, NAME, scene, 0.5 * paths.UP, -paths.UP, hint)
