"""a1.path_tracer_nee."""

import direct_light
import formulas
import pytest
import small_scenes as scenes

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_path_tracer_nee
NAME = "PathTracerNEE"


def test_seen_light(submission):
    """Lights that the camera sees."""
    direct_light.check_seen_light(submission, NAME)


def test_direct_light(submission):
    """A disk, a sphere and a point light over a diffuse floor."""
    direct_light.check_direct_light(submission, NAME)
    direct_light.check_point_light(submission, NAME)


def test_many_bounces(submission):
    """Light after one and after four bounces."""
    direct_light.check_many_bounces(submission, NAME)


def test_unlimited(submission):
    """Russian roulette, in a picture."""
    direct_light.check_unlimited(submission, NAME)


def test_mirror(submission):
    """A light, and a lit floor, in a mirror."""
    direct_light.check_mirror(submission, NAME)


def test_shadow(submission):
    """A screen between the floor and the light."""
    up = direct_light.UP
    screen = scenes.disk([0, 0, 0.8], up, 2.0, scenes.BLACK)
    scene = scenes.scene(floor=scenes.floor(), light=direct_light.panel(0.5), screen=screen)
    came = direct_light.trace(submission, NAME, scene, [0, 0, 0.5], -up, 1, seeds=8, spp=64)
    hint = "is there a shadow ray (test_visibility of sample_emitter_direction)?"
    expect.close(came, 0.0, "radiance in a shadow", atol=1e-6, hint=hint)


def test_small_light_has_little_noise(submission):
    """A small light, which one of a million BSDF samples would hit."""
    scene = scenes.scene(floor=scenes.floor(), light=direct_light.panel(0.001, 1e6))
    came = submission.ask(
        "moments",
        integrator=NAME,
        parameters={"max_bounces": 1},
        scene=scene,
        o=[0.0, 0.0, 0.5],
        d=[0.0, 0.0, -1.0],
        spp=4096,
        seed=submission.seed,
    )
    wanted = direct_light.reflected(formulas.disk_irradiance(0.001, 1.0, 1e6))
    hint = "directions come from the light here; the material alone finds it too rarely"
    expect.close(came["mean"], wanted, "radiance under a small light", rtol=0.1, hint=hint)
    relative = came["deviation"] / came["mean"]
    expect.true(
        relative < 1,
        "the standard deviation of a sample under a small light must be less than its mean; "
        f"it is {relative:.3g} times that",
        hint=hint,
    )
