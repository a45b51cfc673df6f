"""a1.path_tracer_mis: drawn scenes."""

import paths_staff as paths
import pytest

pytestmark = pytest.mark.a1_path_tracer_mis
NAME = "PathTracerMIS"


def test_long_paths(submission):
    """Many bounces, and no limit, where every surface emits and reflects."""
    paths.check_furnace(submission, NAME, noise=4.5)


def test_lights_of_all_kinds(submission):
    """Several lights over a colored floor."""
    paths.check_lights(submission, NAME, noise=7)


def test_materials_under_a_sky(submission):
    """Diffuse, rough, mirrored, mixed, of glass, from the back."""
    paths.check_sky(submission, NAME, noise=3)


def test_light_by_way_of_a_mirror(submission):
    """A floor that only a mirror lights."""
    paths.check_light_by_a_mirror(submission, NAME)
