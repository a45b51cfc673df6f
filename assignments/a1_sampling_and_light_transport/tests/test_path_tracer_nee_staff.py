"""a1.path_tracer_nee: drawn scenes."""

import paths_staff as paths
import pytest
import small_scenes as scenes

pytestmark = pytest.mark.a1_path_tracer_nee
NAME = "PathTracerNEE"


def test_long_paths(submission):
    """Many bounces, and no limit, where every surface emits and reflects."""
    paths.check_furnace(submission, NAME, noise=2.5)


def test_lights_of_all_kinds(submission):
    """Several lights over a colored floor."""
    paths.check_lights(submission, NAME, noise=5)


def test_materials_under_a_sky(submission):
    """Diffuse, rough, mirrored, mixed, of glass, from the back."""
    paths.check_sky(submission, NAME, noise=4)


def test_light_by_way_of_a_mirror(submission):
    """A floor that only a mirror lights."""
    paths.check_light_by_a_mirror(submission, NAME)


def test_lights_alone(submission):
    """A large light in a plate that is nearly a mirror, which a light's sample finds rarely."""
    alpha = float(submission.random.uniform(0.01, 0.02))
    plate = {"type": "roughconductor", "material": "none", "alpha": alpha, "distribution": "ggx"}
    light = scenes.disk([2.0, 0, 0], [-1, 0, 0], 1.0, scenes.BLACK, emitter=scenes.lamp(2.0))
    scene = scenes.scene(plate=scenes.rectangle([0, 0, 0], [1, 0, 1], 0.2, plate), light=light)
    hint = "a light that the path runs into after a rough surface does not count"
    paths.check_alone(submission, NAME, scene, paths.UP, -paths.UP, hint)
