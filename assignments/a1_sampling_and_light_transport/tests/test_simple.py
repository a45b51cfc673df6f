"""a1.simple."""

import formulas
import numpy as np
import pytest
import small_scenes as scenes

from tofrender.course.judge import expect
from tofrender.course.judge.factors import Ratio

pytestmark = pytest.mark.a1_simple

LIGHT = np.array([1.0, 0.3, formulas.inputs.number("height of the light", 2.0, low=1.8, high=2.4)])
GROUND = np.array([[0.0, 0, 0], [1.0, 0.3, 0], [-2, 1, 0], [3, -3, 0], [0.5, 4, 0]])
DOWN = np.array([0.0, 0.6, -0.8])


def look(submission, scene, points, energy=40.0, position=LIGHT, d=DOWN):
    """Radiance of points that are seen along `d` from one meter away, shape (n, 3)."""
    d = np.broadcast_to(d, points.shape)
    return submission.ask(
        "radiance",
        integrator="Simple",
        parameters={"position": list(position), "energy": energy},
        scene=scene,
        o=points - d,
        d=d,
        seeds=1,
        spp=1,
        seed=submission.seed,
    )[0]


def test_plane(submission):
    """Points of a plane; its material is ignored."""
    came = look(submission, scenes.scene(floor=scenes.floor(0.1)), GROUND)
    wanted = formulas.point_light(LIGHT, 40.0, GROUND, np.array([0, 0, 1.0]))
    to_light = LIGHT - GROUND
    distance = np.linalg.norm(to_light, axis=1)
    once = "Phi / (4 pi^2) cos / distance^2"
    ratios = {
        "4π": f"{once}: a point light of the power Phi has the intensity Phi / 4 pi",
        "π": f"{once}: a white surface reflects 1 / pi of the irradiance",
        "1/cos": Ratio(distance / to_light[:, 2], f"{once}: the cosine is missing"),
        "cos": Ratio(to_light[:, 2] / distance, f"{once}, with the cosine once"),
        "distance": Ratio(distance, f"{once}, the distance squared"),
    }
    expect.close(
        came[:, 1],
        wanted,
        "radiance of a plane",
        rtol=1e-3,
        ratios=ratios,
        hint="Phi / (4 pi^2) cos / distance^2, with the cosine once and the distance squared",
    )


def test_curved_surface(submission):
    """Points of a sphere: the cosine to the surface's normal, clamped at 0."""
    n = formulas.direction(np.linspace(0, 1.5, 7), 0.7)
    scene = scenes.scene(ball=scenes.sphere([0, 0, 0], 1.0, scenes.diffuse(0.5)))
    came = look(submission, scene, n, d=np.array([0.0, 0.0, -1.0]), position=[0, 0, 3])[:, 1]
    wanted = formulas.point_light(np.array([0, 0, 3.0]), 40.0, n, n)
    hint = "the shading normal at the point, and max(0, cos): light from below does not count"
    expect.close(came, wanted, "radiance of a sphere", rtol=2e-3, atol=2e-3, hint=hint)


def test_color_of_the_energy(submission):
    """Energy as three numbers, and a ray that meets nothing."""
    came = look(submission, scenes.scene(floor=scenes.floor()), GROUND[:2], [10.0, 20.0, 40.0])
    expect.close(came[:, 0], came[:, 2] / 4, "red of an energy (10, 20, 40)", rtol=1e-3)
    expect.close(came[:, 1], came[:, 2] / 2, "green of an energy (10, 20, 40)", rtol=1e-3)
    normal = np.array([0, 0, 1.0])
    blue = formulas.point_light(LIGHT, 40.0, GROUND[:2], normal)
    expect.close(came[:, 2], blue, "blue of an energy (10, 20, 40)", rtol=1e-3)
    small = scenes.scene(floor=scenes.rectangle([0, 0, 0], [0, 0, 1], 0.5, scenes.BLACK))
    nothing = look(submission, small, GROUND[3:])
    expect.close(nothing, 0.0, "radiance where there is no surface", hint="mask with si.is_valid()")


def test_shadow(submission):
    """A screen between point and light makes a shadow; a ceiling above the light does not."""
    normal = np.array([0, 0, 1.0])
    middle = 0.5 * (LIGHT + GROUND)
    screen = scenes.rectangle(middle[0], normal, 0.1, scenes.BLACK)
    ceiling = scenes.rectangle([0, 0, 3.0], -normal, 20.0, scenes.BLACK)
    scene = scenes.scene(floor=scenes.floor(), screen=screen, ceiling=ceiling)
    came = look(submission, scene, GROUND, d=np.array([0.6, 0.0, -0.8]))[:, 1]
    hint = "is there a shadow ray from the surface point to the light?"
    expect.close(came[:1], 0.0, "radiance in the shadow of the screen", hint=hint)
    wanted = formulas.point_light(LIGHT, 40.0, GROUND[1:], normal)
    hint = "the shadow ray must end at the light (spawn_ray_to), and not start in the surface"
    expect.close(
        came[1:], wanted, "radiance under a ceiling that is above the light", rtol=1e-3, hint=hint
    )


def test_picture(submission):
    """A picture by `mi.render`."""
    camera = scenes.photo(8, 8, [0, 0, 1.0], [0, 0, -1.0], 0.02)
    scene = scenes.scene(floor=scenes.floor(), camera=camera)
    parameters = {"position": [0.5, 0.0, 2.0], "energy": 40.0}
    came = submission.ask(
        "image",
        integrator="Simple",
        parameters=parameters,
        scene=scene,
        spp=4,
        seed=submission.seed,
    )
    origin = np.zeros((1, 3))
    normal = np.array([0, 0, 1.0])
    wanted = formulas.point_light(np.array([0.5, 0, 2.0]), 40.0, origin, normal)[0]
    expect.shape(came, (8, 8, 3), "picture")
    expect.close(came.mean(axis=(0, 1)), wanted, "mean color of a picture of the plane", rtol=1e-2)
