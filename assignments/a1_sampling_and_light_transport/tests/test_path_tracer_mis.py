"""a1.path_tracer_mis."""

import direct_light
import formulas
import pytest
import small_scenes as scenes

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_path_tracer_mis
NAME = "PathTracerMIS"


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


def test_what_one_technique_finds(submission):
    """Point lights, and what mirrors show."""
    direct_light.check_point_light(submission, NAME)
    direct_light.check_mirror(submission, NAME)


def noise(submission, scene, o, d):
    """Mean of single samples, and their standard deviation as a part of it."""
    came = submission.ask(
        "moments",
        integrator=NAME,
        parameters={"max_bounces": 1},
        scene=scene,
        o=o,
        d=d,
        spp=16384,
        seed=submission.seed,
    )
    return came["mean"], came["deviation"] / max(came["mean"], 1e-9)


def test_both_techniques_help(submission):
    """A small light on a diffuse floor, and a large light in a plate that is nearly a mirror."""
    scene = scenes.scene(floor=scenes.floor(), light=direct_light.panel(0.001, 1e6))
    mean, relative = noise(submission, scene, [0.0, 0.0, 0.5], [0.0, 0.0, -1.0])
    hint = "the lights' sampling is not used, or its weight is not pdf_light / (sum of both)"
    wanted = direct_light.reflected(formulas.disk_irradiance(0.001, 1.0, 1e6))
    expect.close(mean, wanted, "radiance under a small light", rtol=0.1, hint=hint)
    expect.true(
        relative < 2,
        "under a small light the standard deviation of a sample must be below twice its mean; "
        f"it is {relative:.3g} times that",
        hint=hint,
    )
    plate = {"type": "roughconductor", "material": "none", "alpha": 0.01, "distribution": "ggx"}
    light = scenes.disk([2.0, 0, 0], [-1, 0, 0], 1.0, scenes.BLACK, emitter=scenes.lamp(2.0))
    scene = scenes.scene(plate=scenes.rectangle([0, 0, 0], [1, 0, 1], 0.2, plate), light=light)
    mean, relative = noise(submission, scene, [0.0, 0.0, 1.0], [0.0, 0.0, -1.0])
    hint = "the material's sampling is not used, or its weight is not pdf_material / (sum of both)"
    expect.close(mean, 2.0, "radiance of a large light in a glossy plate", rtol=0.1, hint=hint)
    expect.true(
        relative < 2,
        "in a glossy plate the standard deviation of a sample must be below twice its mean; "
        f"it is {relative:.3g} times that",
        hint=hint,
    )
