"""a1.ao."""

import formulas
import numpy as np
import pytest
import small_scenes as scenes

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_ao

UP = np.array([0, 0, 1.0])


def look(submission, scene, o, d, spp=1024):
    """Estimates of the openness along rays, shape (seeds, n)."""
    o = np.atleast_2d(o)
    d = np.atleast_2d(d)
    return submission.ask(
        "radiance",
        integrator="AmbientOcclusion",
        parameters={},
        scene=scene,
        o=o,
        d=d / np.linalg.norm(d, axis=1, keepdims=True),
        seeds=32,
        spp=spp,
        seed=submission.seed,
    )[..., 1]


def test_open_plane(submission):
    """Nothing hides the sky from a plane; without a surface the value is 0."""
    tilted = np.array([0.3, -0.8, 0.5])
    scene = scenes.scene(
        floor=scenes.rectangle([0, 0, 0], tilted, 1.0, scenes.diffuse(0.2)),
        ground=scenes.rectangle(-0.1 * tilted, tilted, 50.0, scenes.BLACK),
    )
    came = look(submission, scene, [tilted, [1, 1, 1]], [-tilted, tilted])
    hint = (
        "is the direction turned into the surface's frame? "
        "divide by the density that it was drawn with"
    )
    expect.estimate(came[:, :1], 1.0, "openness of a plane", rounding=1e-4, hint=hint)
    expect.close(came[:, 1], 0.0, "value where there is no surface", hint="mask with is_valid()")


def test_beside_a_wall(submission):
    """Beside a wall of the height H at the distances d: (1 + cos(atan(H / d))) / 2."""
    distance = np.array([0.1, 0.5, 1.0, 3.0])
    wall = scenes.rectangle([0, 0, 0.5], [1, 0, 0], [0.5, 300.0], scenes.BLACK)
    scene = scenes.scene(floor=scenes.floor(), wall=wall)
    o = np.stack([distance, 0 * distance, 0 * distance + 0.05], axis=1)
    came = look(submission, scene, o, np.broadcast_to(-UP, o.shape))
    expect.estimate(
        came,
        formulas.wall_openness(1.0, distance),
        "openness beside a wall",
        rounding=2e-3,
        x=distance,
        x_label="distance [m]",
        hint="directions with the density cos / pi, or a weight that makes up for another density",
    )


def test_closed_box(submission):
    """From inside of a closed box no sky is seen, far walls included."""
    box = {
        "type": "cube",
        "bsdf": scenes.BLACK,
        "flip_normals": True,
        "to_world": np.diag([40.0, 30.0, 20.0, 1.0]),
    }
    o = np.zeros((3, 3))
    d = np.array([[1, 0.2, 0.1], [0.1, -1, 0.3], [0.2, 0.3, 1]])
    came = look(submission, scenes.scene(box=box), o, d, spp=64)
    hint = (
        "the shadow ray has no end, and starts just off the surface (si.spawn_ray); "
        "is the direction turned into the surface's frame?"
    )
    expect.close(came, 0.0, "openness inside of a box", atol=2e-3, hint=hint)


def test_seen_from_the_back(submission):
    """The hemisphere is on the side that the camera sees."""
    lid = scenes.disk([0, 0, 2.0], -UP, 2.0, scenes.BLACK)
    scene = scenes.scene(floor=scenes.rectangle([0, 0, 0], -UP, 2.0, scenes.BLACK), lid=lid)
    back = look(submission, scene, [[0, 0, 1.0], [0, 0, -1.0]], [-UP, UP])
    hint = (
        "is the direction turned into the surface's frame? "
        "turn the normal to the side that the ray comes from"
    )
    expect.estimate(
        back,
        [0.5, 1.0],
        "openness of a plate's two sides, one under a disk",
        rounding=1e-3,
        hint=hint,
    )
