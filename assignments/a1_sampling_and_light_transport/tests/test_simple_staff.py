"""a1.simple: drawn lights over surfaces of all kinds."""

import drawn_staff as drawn
import formulas
import numpy as np
import pytest
import small_scenes as scenes

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_simple

UP = np.array([0, 0, 1.0])
MIRROR = {"type": "conductor", "material": "none"}
GLASS = {"type": "dielectric"}


def ask(submission, scene, position, energy, x, d):
    """All that is answered for points x that are seen along d from close by."""
    came = submission.ask(
        "answer",
        integrator="Simple",
        name="simple",
        parameters={"position": list(position), "energy": energy},
        scene=scene,
        o=x - 0.01 * d,
        d=d,
        seeds=1,
        spp=1,
        seed=submission.seed,
    )
    return came["radiance"][0], came["met"], came["empty"]


def wanted_of(position, energy, x, n):
    """Radiance in each channel."""
    white = formulas.point_light(np.asarray(position), 1.0, x, n)
    return white[:, None] * np.broadcast_to(energy, 3)


def downwards(random, count):
    """Directions that look down on a floor."""
    d = drawn.directions(random, count)
    d[:, 2] = -np.abs(d[:, 2]) - 0.3
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def test_drawn_scene(submission):
    """A floor, a ball, a lamp and tilted shading normals; the scene's lights are ignored."""
    random = submission.random
    light = np.append(random.uniform(-1, 1, 2), random.uniform(1, 3))
    energy = random.permutation([7.0, 30.0, 100.0]) * random.uniform(0.5, 1.5)
    normal = drawn.near(random, UP, random.uniform(0.3, 0.7))
    lamp_normal = drawn.near(random, UP, 0.5)
    parts = {
        "floor": scenes.rectangle([0, 0, 0], UP, 4.0, MIRROR),
        "ball": scenes.sphere([8.0, 0, 0], 1.0, GLASS),
        "lamp": scenes.rectangle(
            [0, 9.0, 0], lamp_normal, 0.5, scenes.BLACK, emitter=scenes.lamp(3.0)
        ),
        "tilted": drawn.tilted_normals(np.array([-8.0, 0, 0]), UP, normal, 0.5, scenes.BLACK),
        "sky": {"type": "constant", "radiance": scenes.rgb(2.0)},
        "point": {"type": "point", "position": [0, 0, 5.0], "intensity": scenes.rgb(9.0)},
    }
    floor = np.append(random.uniform(-3, 3, (30, 2)), np.zeros((30, 1)), axis=1)
    to_ball = drawn.directions(random, 30)
    to_ball[:, 2] = np.abs(to_ball[:, 2]) + 0.2
    to_ball /= np.linalg.norm(to_ball, axis=1, keepdims=True)
    ball = to_ball + np.array([8.0, 0, 0])
    lamp = np.array([[0, 9.0, 0]])
    tilted = np.array([[-8.0, 0, 0]])
    air = np.append(random.uniform(-3, 3, (5, 2)), np.ones((5, 1)) * 20, axis=1)
    x = np.concatenate([floor, ball, lamp, tilted, air])
    d = [downwards(random, 30), -to_ball, -lamp_normal[None], -UP[None], np.tile(UP, (5, 1))]
    n = np.concatenate([np.tile(UP, (30, 1)), to_ball, lamp_normal[None], normal[None]])
    came, met, _ = ask(
        submission, scenes.scene(**parts), light, energy.tolist(), x, np.concatenate(d)
    )
    wanted = wanted_of(light, energy, x[:-5], n)
    hint = "each channel has its own energy; materials, lights and sky of the scene do not matter"
    places = {"the floor": slice(30), "a glass ball": slice(30, 60), "a lamp": slice(60, 61)}
    for name, part in places.items():
        what = f"radiance of {name}"
        scale = 1e-3 * wanted[part].max() + 1e-3
        expect.close(came[part], wanted[part], what, rtol=3e-3, atol=scale, hint=hint)
    hint = "the cosine is that of the shading normal, si.sh_frame.n"
    expect.close(
        came[61], wanted[61], "radiance where shading normals are tilted", rtol=3e-3, hint=hint
    )
    expect.close(
        came[-5:], 0.0, "radiance where there is no surface", hint="the sky does not count"
    )
    expect.close(met[:62], 1.0, "lanes that met a surface")


def test_from_the_other_side(submission):
    """The side that is seen is lit, whichever it is; and an energy that is an integer."""
    random = submission.random
    light = np.append(random.uniform(-1, 1, 2), -random.uniform(1, 3))
    energy = int(random.integers(10, 100))
    n = drawn.near(random, UP, random.uniform(0, 0.3))
    plate = scenes.scene(plate=scenes.rectangle([0, 0, 0], n, 2.0, scenes.diffuse(0.3)))
    inside = scenes.frame([0, 0, 0], n)[:3, :2]
    x = random.uniform(-1, 1, (20, 2)) @ inside.T
    below = -downwards(random, 20)
    d = np.concatenate([below, -below, -below])
    aside = x + np.array([9.0, 0, 0])
    came, met, empty = ask(submission, plate, light, energy, np.concatenate([x, x, aside]), d)
    wanted = wanted_of(light, float(energy), x, -n)
    hint = "turn the shading normal to the side that the camera ray comes from"
    expect.close(
        came[:20],
        wanted,
        "radiance of a plate that is lit and seen from below",
        rtol=3e-3,
        hint=hint,
    )
    what = "radiance of a plate that is lit from below and seen from above"
    expect.close(came[20:40], 0.0, what, hint=hint)
    expect.close(came[40:], 0.0, "radiance where there is no surface")
    hint = "the second of what sample returns says which lanes met a surface: si.is_valid()"
    expect.close(met, np.repeat([1.0, 0.0], [40, 20]), "lanes that met a surface", hint=hint)
    expect.true(empty, "the third of what sample returns must be []")


def test_drawn_shadows(submission):
    """Whatever lies between makes a shadow, close to the surface or close to the light."""
    check_shadows(submission, 1.0)
    check_shadows(submission, submission.random.uniform(20, 200))


def check_shadows(submission, scale):
    """Screens in a scene of some size [m]."""
    random = submission.random
    light = np.append(random.uniform(-0.5, 0.5, 2), random.uniform(1.5, 3)) * scale
    grid = np.stack([each.ravel() for each in np.mgrid[-2:3, -2:3]], axis=1)
    x = np.append(0.8 * grid[random.permutation(25)[:16]], np.zeros((16, 1)), axis=1) * scale
    share = np.concatenate([random.uniform(0.02, 0.1, 3), random.uniform(0.1, 0.96, 4)])
    share = np.append(share, random.uniform(0.97, 0.985))
    share = np.append(share, random.uniform(1.05, 1.3, 8))  # Behind the light
    materials = [scenes.BLACK, GLASS, MIRROR, {"type": "null"}]
    parts = {"floor": scenes.floor(0.5, 3.0 * scale)}
    for k in range(16):
        middle = x[k] + share[k] * (light - x[k])
        size = 0.05 * scale * abs(1 - share[k])
        emitter = {"emitter": scenes.lamp(1.0)} if k == 1 else {}
        material = scenes.BLACK if k == 1 else materials[k % 4]
        side = light - x[k] if random.random() < 0.5 else x[k] - light
        parts[f"screen{k}"] = scenes.rectangle(middle, side, size, material, **emitter)
    d = np.tile(-UP, (16, 1))
    energy = 30.0 * scale**2
    came, met, _ = ask(submission, scenes.scene(**parts), light, energy, x, d)
    hint = "one shadow ray from the point to the light; all surfaces stop it, glass and lamps too"
    expect.close(came[:8], 0.0, "radiance behind screens between point and light", hint=hint)
    wanted = wanted_of(light, energy, x[8:], np.tile(UP, (8, 1)))
    hint = "what is behind the light makes no shadow: the shadow ray ends at the light"
    expect.close(came[8:], wanted, "radiance with screens behind the light", rtol=3e-3, hint=hint)
    expect.close(met, 1.0, "lanes that met a surface, those in shadow included")
