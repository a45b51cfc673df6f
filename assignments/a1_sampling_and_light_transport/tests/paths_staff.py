"""Tests of all path tracers with random scenes, which have closed forms."""

from __future__ import annotations

import drawn_staff as drawn
import formulas
import numpy as np
import small_scenes as scenes

from tofrender.course.judge import expect

UP = np.array([0, 0, 1.0])
PLUGINS = {
    "PathTracerMats": "path_tracer_mats",
    "PathTracerNEE": "path_tracer_nee",
    "PathTracerMIS": "path_tracer_mis",
}
MIRROR = {"type": "conductor", "material": "none"}


def ask(submission, integrator, parameters, scene, o, d, *, seeds=16, spp=1024, shift=0):
    """All that a path tracer answers along rays."""
    came = submission.ask(
        "answer",
        integrator=integrator,
        name=PLUGINS[integrator],
        parameters=parameters,
        scene=scene,
        o=np.atleast_2d(o),
        d=np.atleast_2d(d),
        seeds=seeds,
        spp=spp,
        seed=submission.seed + shift,
    )
    return came | {"spp": spp}


def color(random, low, high):
    """Three numbers that differ."""
    return low + (high - low) * (random.permutation(3) + random.uniform(0, 1, 3)) / 3


def matte(reflectance):
    """A colored diffuse material."""
    return {"type": "diffuse", "reflectance": scenes.rgb(*reflectance)}


def lamp(radiance):
    """A colored light."""
    return {"type": "area", "radiance": scenes.rgb(*radiance)}


def compare(came, wanted, names, *, noise, hint=""):
    """Estimates along rays in all channels, and how much one sample scatters.

    `noise` is the largest standard deviation as a part of the mean, along all but the last ray.
    """
    for k, name in enumerate(names):
        what = f"radiance of {name}, R, G and B"
        expect.estimate(came["radiance"][:, k], wanted[k], what, rounding=4e-3, hint=hint)
    for k, name in enumerate(names[:-1]):
        mean = wanted[k].mean()
        if mean > 0:
            samples = came["radiance"][:, k] * np.sqrt(came["spp"]) / mean
            what = f"one sample as a part of its mean, {name}"
            hint = "is each sample divided by the density it has?"
            expect.noise(samples, noise, what, hint=hint)


# ----------------------------------------------------------------------------- long paths


def check_furnace(submission, integrator, noise):
    """Inside a sphere around a ball that emits and reflects, bounce by bounce."""
    random = submission.random
    radius = float(random.uniform(0.32, 0.42))
    wall = color(random, 0.4, 0.9)
    ball = color(random, 0.1, 0.3)
    wall[np.argmax(wall)] = random.uniform(0.98, 1)  # Long paths bring a good part
    emission = color(random, 0.5, 3)
    scene = scenes.scene(
        wall=scenes.sphere([0, 0, 0], 1.0, matte(wall), flip_normals=True),
        ball=scenes.sphere([0, 0, 0], radius, matte(ball), emitter=lamp(emission)),
    )
    o = 0.5 * (1 + radius) * drawn.directions(random, 2)
    d = drawn.directions(random, 2)
    d *= np.sign(np.sum(o * d, axis=1, keepdims=True))
    o, d = np.concatenate([o, o[:1]]), np.concatenate([d, -o[:1] / np.linalg.norm(o[0])])
    names = ["the wall of a sphere"] * 2 + ["a ball in it, which emits and reflects"]

    def wanted(bounces):
        seen = formulas.ball_in_a_sphere(radius, emission, ball, wall, bounces)
        return np.array([seen[1], seen[1], seen[0]])

    for bounces in (int(random.integers(2, 5)), int(random.integers(8, 17))):
        came = ask(submission, integrator, {"max_bounces": bounces}, scene, o, d)
        hint = f"max_bounces = {bounces}: so many reflections are added to what is seen directly"
        compare(came, wanted(bounces), names, noise=noise, hint=hint)
    expect.close(came["met"], 1.0, "lanes whose camera ray met a surface")
    hint = "without max_bounces there is no limit; the roulette must be without bias, however long"
    came = ask(submission, integrator, {}, scene, o, d, spp=2048)
    compare(came, wanted(2000), names, noise=4 * noise, hint=hint)
    first, again, other = (
        ask(submission, integrator, {}, scene, o, d, spp=64, shift=k) for k in (0, 0, 1)
    )
    what = "radiance with the same seed again"
    hint = "random numbers come from the sampler"
    expect.close(again["radiance"], first["radiance"], what, rtol=1e-2, hint=hint)
    different = np.abs(again["radiance"] - other["radiance"]).max() > 0
    expect.true(different, "other seeds must give other estimates", hint=hint)
    scene["camera"] = scenes.photo(12, 5, o[0], d[0], 0.01)
    image = submission.ask(
        "image",
        integrator=integrator,
        parameters={"max_bounces": -1},
        scene=scene,
        spp=256,
        seed=submission.seed,
    )
    expect.shape(image, (5, 12, 3), "picture")
    what = "pixels of the wall of a sphere around a ball that emits"
    expect.estimate(image.reshape(60, 3), wanted(2000)[0], what, rounding=4e-3)


# ------------------------------------------------------------------------------- lights


def check_lights(submission, integrator, noise):
    """A floor under lights of all kinds, in the dark, and lights from both sides."""
    random = submission.random
    meets_points = integrator != "PathTracerMats"
    albedo = color(random, 0.2, 0.9)
    phi = random.uniform(0, 2 * np.pi) + np.array([0, 2, 4]) * np.pi / 3
    out = np.stack([np.cos(phi), np.sin(phi), 0 * phi], axis=1)
    ball = 2.6 * out[0] + random.uniform(1.2, 2) * UP
    radius = random.uniform(0.5, 0.9)
    panel = 2.8 * out[1] + random.uniform(1.8, 2.4) * UP
    facing = -panel + random.uniform(-0.4, 0.4, 3)
    size = random.uniform(0.6, 1.0, 2)
    corners = scenes.frame(panel, facing, [*size, 1.0])[:3] @ CORNERS
    point = np.append(random.uniform(-0.3, 0.3, 2), 2.5)
    second = np.array([0.5, 0.3, -3.0])
    sun = -out[2] - random.uniform(0.7, 2) * UP
    sun /= np.linalg.norm(sun)
    strength = [color(random, 1, 5) for _ in range(6)]
    plate = color(random, 0.3, 1)
    alpha = float(random.uniform(0.3, 0.6))
    rough = {
        "type": "roughconductor",
        "material": "none",
        "alpha": alpha,
        "distribution": "ggx",
        "specular_reflectance": scenes.rgb(*plate),
    }
    parts = {
        "floor": scenes.rectangle([0, 0, 0], UP, 12.0, matte(albedo)),
        "ball": scenes.sphere(ball, radius, scenes.BLACK, emitter=lamp(strength[0])),
        "panel": scenes.rectangle(panel, facing, size, scenes.BLACK, emitter=lamp(strength[1])),
        "away": scenes.rectangle(1.2 * panel, panel, 0.5, scenes.BLACK, emitter=lamp(strength[2])),
        "screen": scenes.disk([7.0, 7, 0.05], UP, 4.0, scenes.BLACK),
        "plate": scenes.rectangle([0, 0, -5.0], UP, 0.5, rough),
        "point": {"type": "point", "position": point, "intensity": scenes.rgb(*strength[3])},
        "second": {"type": "point", "position": second, "intensity": scenes.rgb(*strength[4])},
        "sun": {"type": "directional", "direction": sun, "irradiance": scenes.rgb(*strength[5])},
    }
    for name in ("point", "second"):
        parts[name]["position"] = parts[name]["position"].tolist()
    parts["sun"]["direction"] = sun.tolist()
    x = np.append(random.uniform(-0.6, 0.6, (3, 2)), np.zeros((3, 1)), axis=1)
    wanted = np.zeros((8, 3))
    for k in range(3):
        irradiance = strength[0] * formulas.sphere_irradiance(ball, radius, x[k], UP, 1.0)
        irradiance += strength[1] * formulas.polygon_irradiance(corners.T, x[k], UP, 1.0)
        if meets_points:
            to = point - x[k]
            irradiance += strength[3] * to[2] / np.linalg.norm(to) ** 3 - strength[5] * sun[2]
        wanted[k] = albedo / np.pi * irradiance
    wanted[4] = strength[1]
    y = np.array([random.uniform(-0.3, 0.3), random.uniform(-0.3, 0.3), -5.0])
    down = random.uniform(-0.4, 0.4, (4, 3)) - UP
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    to = second - y
    if meets_points:
        arriving = to / np.linalg.norm(to)
        lobe = rough_mirror(-down[3][None], arriving[None], alpha)[0]
        wanted[6] = plate * lobe * strength[4] / (to @ to)
    front = facing / np.linalg.norm(facing)
    o = [
        *(x - 0.01 * down[:3]),
        [7, 7, 0.02],
        panel + 0.1 * front,
        panel - 0.1 * front,
        y - 0.01 * down[3],
    ]
    d = [*down[:3], -UP, -front, front, down[3]]
    o = np.array([*o, [0, 0, 30.0]])
    d = np.array([*d, UP])
    one = {"max_bounces": 1}
    scene = scenes.scene(**parts)
    came = ask(submission, integrator, one, scene, o, d, seeds=64, spp=2048)
    where = "a floor under lights of all kinds"
    names = [where] * 3 + [
        "a floor in the dark below a screen",
        "a light from its front",
        "a light from its back",
        "a rough plate under a point light",
        "nothing",
    ]
    hint = "all lights count, each once and with its own color, and only where they are seen; " + (
        "point lights and the sun are never met" if not meets_points else "a chance for each"
    )
    compare(came, wanted, names, noise=noise, hint=hint)
    hint = "the second of what sample returns says which lanes' camera ray met a surface"
    expect.close(came["met"], [1.0] * 7 + [0.0], "lanes that met a surface", hint=hint)
    expect.true(came["empty"], "the third of what sample returns must be []")
    hidden = np.append(random.uniform(-0.5, 0.5, 2), random.uniform(1.0, 1.5))
    scene = scenes.scene(
        floor=scenes.floor(0.9),
        ceiling=scenes.rectangle([0, 0, 3.0], -UP, 9.0, matte(plate)),
        shell=scenes.sphere(hidden, 0.5, scenes.BLACK),
        lamp=scenes.disk(hidden, -UP, 0.3, scenes.BLACK, emitter=lamp(strength[0])),
        point={"type": "point", "position": hidden.tolist(), "intensity": scenes.rgb(9.0)},
    )
    came = ask(submission, integrator, {"max_bounces": 4}, scene, o[:1], d[:1], spp=64)
    what = "radiance of a room whose only lights are in a closed black ball"
    expect.close(came["radiance"], 0.0, what, hint="a shadow ray at every bounce")


CORNERS = np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [0, 0, 0, 0], [1, 1, 1, 1.0]])
"""Those of a rectangle, as columns."""


def rough_mirror(wi, wo, alpha):
    """Reflectance times cosine of GGX normals without color, at +z (Walter et al. 2007)."""
    h = wi + wo
    h = h / np.linalg.norm(h, axis=1, keepdims=True)
    tan2 = (1 - h[:, 2] ** 2) / h[:, 2] ** 2
    density = 1 / (np.pi * alpha**2 * h[:, 2] ** 4 * (1 + tan2 / alpha**2) ** 2)

    def seen(w):
        return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / w[:, 2] ** 2 - 1)))

    return density * seen(wi) * seen(wo) / (4 * wi[:, 2])


# -------------------------------------------------------------------------------- a sky


def check_sky(submission, integrator, noise):
    """Materials of all kinds, each alone under a sky; and the sky."""
    random = submission.random
    sky = color(random, 0.5, 3)
    albedo = color(random, 0.2, 0.9)
    alpha = float(random.uniform(0.3, 0.6))
    ior = float(random.uniform(1.3, 1.9))
    rough = {"type": "roughconductor", "material": "none", "alpha": alpha, "distribution": "ggx"}
    plastic = {"type": "plastic", "diffuse_reflectance": scenes.rgb(*albedo), "int_ior": ior}
    plastic["ext_ior"] = 1.0
    both_sides = {"type": "twosided", "bsdf": matte(albedo)}
    materials = [matte(albedo), both_sides, matte(albedo), MIRROR, plastic, rough]
    n = drawn.directions(random, 6)
    x = 30.0 * np.array([[-1, -1, 0], [-1, 1, 0], [0, -1, 0], [0, 1, 0], [1, -1, 0], [1, 1, 0]])
    tilt = random.uniform(0.2, 0.9, 6)
    to_camera = np.array([drawn.near(random, n[k], tilt[k]) for k in range(6)])
    to_camera[1:3] *= -1  # The back
    parts = {
        f"plate{k}": scenes.rectangle(x[k], n[k], 0.2, materials[k], id=f"plate{k}")
        for k in range(6)
    }
    parts["ball"] = scenes.sphere(
        [0, 0, 0], 0.5, {"type": "dielectric", "int_ior": ior, "ext_ior": 1.0}
    )
    parts["sky"] = {"type": "constant", "radiance": scenes.rgb(*sky)}
    incidence = random.uniform(0.1, 1.2)
    outwards = drawn.directions(random, 1)[0]
    back = drawn.near(random, outwards, incidence)
    o = np.concatenate([x + 0.1 * to_camera, [[0, 0, 50.0], 0.5 * outwards + back]])
    d = np.concatenate([-to_camera, [UP, -back]])
    bounces = int(random.choice([1, 2, -1]))
    wi = np.array([[np.sin(tilt[5]), 0, np.cos(tilt[5])]])
    w, solid_angle = formulas.sphere_grid(600, 400)
    above = w[:, 2] > 0
    lobe = rough_mirror(wi, w[above], alpha)
    mirrored = fresnel(incidence, ior)
    shown = {1: mirrored, 2: mirrored + (1 - mirrored) ** 2, -1: 1.0}[bounces]
    wanted = np.ones((8, 3)) * sky
    wanted[:2] *= albedo
    wanted[2] = 0
    coat = fresnel(tilt[4], ior)
    # Light that enters the coat is reflected by the body, or comes back
    wanted[4] *= coat + (1 - coat) * albedo
    wanted[5] *= np.sum(lobe * solid_angle[above])
    wanted[7] *= shown
    came = ask(
        submission, integrator, {"max_bounces": bounces}, scenes.scene(**parts), o, d, spp=2048
    )
    names = [
        "a diffuse plate under a sky",
        "the back of a two-sided plate under a sky",
        "the back of a one-sided plate under a sky",
        "a mirror under a sky",
        "plastic, partly a mirror and partly diffuse, under a sky",
        "a rough plate under a sky",
        "the sky",
        f"a glass ball under a sky, max_bounces = {bounces}",
    ]
    hint = (
        "the sky counts once: by a connection, or where a path leaves the scene "
        "(after mirrors and glass, bs.sampled_type says so, always)"
    )
    compare(came, wanted, names, noise=noise, hint=hint)
    expect.close(came["met"][:6], 1.0, "lanes whose camera ray met a surface")


def fresnel(angle, ior):
    """Share of unpolarized light that is reflected where glass begins."""
    cos = np.cos(angle)
    inside = np.sqrt(1 - (np.sin(angle) / ior) ** 2)
    s = (cos - ior * inside) / (cos + ior * inside)
    p = (ior * cos - inside) / (ior * cos + inside)
    return 0.5 * (s**2 + p**2)


# ------------------------------------------------------------------------------ a mirror


def check_light_by_a_mirror(submission, integrator):
    """A light that faces a mirror, and a floor that it lights only by way of that."""
    random = submission.random
    albedo = color(random, 0.3, 0.9)
    emission = color(random, 1, 5)
    wall = random.uniform(1.7, 2.3)
    light = random.uniform(0.4, 0.6)
    size = random.uniform(0.5, 0.8, 2)
    height = random.uniform(1.4, 1.8)
    x = np.array([1.0, 0, 0])
    middle = np.array([light, random.uniform(-0.3, 0.3), height])
    parts = {
        "floor": scenes.rectangle([0, 0, 0], UP, 8.0, matte(albedo)),
        "mirror": scenes.rectangle([wall, 0, 0], -x, 8.0, MIRROR),
        "light": scenes.rectangle(middle, x, size, scenes.BLACK, emitter=lamp(emission)),
    }
    corners = (scenes.frame(middle, x, [*size, 1.0])[:3] @ CORNERS).T
    corners[:, 0] = 2 * wall - corners[:, 0]
    o = np.array([0, 0, 0.02])
    d = -UP
    wanted = albedo * emission / np.pi * formulas.polygon_irradiance(corners, np.zeros(3), UP, 1.0)
    came = ask(submission, integrator, {"max_bounces": 2}, scenes.scene(**parts), o, d, spp=16384)
    hint = (
        "after a floor and then a mirror no connection has counted the light: what is met by way "
        "of mirrors alone since the last other surface counts"
    )
    what = "radiance of a floor that is lit by way of a mirror, R, G and B"
    expect.estimate(came["radiance"][:, 0], wanted, what, rounding=4e-3, hint=hint)
    came = ask(submission, integrator, {"max_bounces": 1}, scenes.scene(**parts), o, d, spp=64)
    expect.close(came["radiance"], 0.0, "the same with max_bounces = 1", hint="mirrors count")


def check_alone(submission, integrator, scene, o, d, hint):
    """One technique alone is noisy where the other is good."""
    came = ask(submission, integrator, {"max_bounces": 1}, scene, o, d, spp=8192)
    relative = came["deviation"].mean() / max(came["radiance"].mean(), 1e-9)
    text = (
        f"one sample's standard deviation must be more than 3 times its mean here; it is "
        f"{relative:.3g} times that: does another technique help?"
    )
    expect.true(relative > 3, text, hint=hint)
