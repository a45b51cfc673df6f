"""a1.path_tracer_mats."""

import direct_light
import pytest
import small_scenes as scenes

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_path_tracer_mats
NAME = "PathTracerMats"


def test_seen_light(submission):
    """Lights that the camera sees."""
    direct_light.check_seen_light(submission, NAME)


def test_direct_light(submission):
    """A disk and a sphere over a diffuse floor."""
    direct_light.check_direct_light(submission, NAME)


def test_many_bounces(submission):
    """Light after one and after four bounces."""
    direct_light.check_many_bounces(submission, NAME)


def test_unlimited(submission):
    """Russian roulette, in a picture."""
    direct_light.check_unlimited(submission, NAME)


def test_mirror(submission):
    """A light, and a lit floor, in a mirror."""
    direct_light.check_mirror(submission, NAME)


def test_open_sky(submission):
    """A floor under a sky of one brightness, and the sky itself."""
    sky = {"type": "constant", "radiance": scenes.rgb(3.0)}
    scene = scenes.scene(floor=scenes.floor(0.5), sky=sky)
    up = direct_light.UP
    came = direct_light.trace(submission, NAME, scene, [0, 0, 1], -up, 1, seeds=8)
    hint = "paths that leave the scene see the environment: si.emitter(scene)"
    expect.estimate(came, 1.5, "radiance of a floor under the sky", rounding=1e-3, hint=hint)
    came = direct_light.trace(submission, NAME, scene, [0, 0, 1], up, 1, seeds=8)
    expect.estimate(came, 3.0, "radiance of the sky", rounding=1e-3, hint=hint)
