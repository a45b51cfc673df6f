"""Cases that all path tracers are judged by: scenes with their closed forms."""

from __future__ import annotations

import formulas
import numpy as np
import small_scenes as scenes

from tofrender.course.judge import expect

UP = np.array([0, 0, 1.0])
ALBEDO = 0.8
SEEDS = 32
SPP = 256

LIGHTS_DIRECTION = "bsdf.eval wants a local direction: si.to_local(ds.d)"
FRAMES = {  # hints for directions in the wrong frame
    "PathTracerMats": "bs.wo is a local direction: si.to_world(bs.wo)",
    "PathTracerNEE": LIGHTS_DIRECTION,
    "PathTracerMIS": f"{LIGHTS_DIRECTION}; so does bsdf.pdf",
}

BALL = {"center": np.array([1.2, 0.0, 1.0]), "radius": 0.5, "radiance": 4.0}


def ball():
    """A sphere light."""
    return scenes.sphere(
        BALL["center"], BALL["radius"], scenes.BLACK, emitter=scenes.lamp(BALL["radiance"])
    )


def panel(radius=1.5, radiance=2.0, height=1.0):
    """A disk light that faces the ground."""
    emitter = scenes.lamp(radiance)
    return scenes.disk([0, 0, height], -UP, radius, scenes.BLACK, emitter=emitter)


def reflected(irradiance):
    """Radiance of the diffuse floor."""
    return ALBEDO / np.pi * irradiance


def ball_on_floor():
    """Radiance of the floor below the sphere light's side, at the origin."""
    return reflected(formulas.sphere_irradiance(**BALL, o=np.zeros(3), normal=UP))


def trace(submission, integrator, scene, o, d, bounces, *, seeds=SEEDS, spp=SPP, shift=0):
    """Estimates along one ray, shape (seeds,)."""
    d = np.array(d, float)
    return submission.ask(
        "radiance",
        integrator=integrator,
        parameters={"max_bounces": bounces},
        scene=scene,
        o=np.array([o], float),
        d=d[None] / np.linalg.norm(d),
        seeds=seeds,
        spp=spp,
        seed=submission.seed + shift,
    )[:, 0, 1]


def check_direct_light(submission, integrator):
    """A disk and a sphere over a diffuse floor, and the disk with its floor turned over."""
    hint = (
        "f cos over the density, once each; the BSDF's eval and weight have the cosine in them; "
        "twice too bright: is the light that the path runs into counted, too?"
    )
    disk = scenes.scene(floor=scenes.floor(ALBEDO), light=panel())
    came = trace(submission, integrator, disk, [0, 0, 0.5], -UP, 1)
    wanted = reflected(formulas.disk_irradiance(1.5, 1.0, 2.0))
    expect.estimate(came, wanted, "radiance under a disk light", rounding=2e-3, hint=hint)
    sphere = scenes.scene(floor=scenes.floor(ALBEDO), light=ball())
    came = trace(submission, integrator, sphere, [0, 0, 0.5], -UP, 1, spp=4 * SPP, shift=1)
    what = "radiance under a sphere light"
    expect.estimate(came, ball_on_floor(), what, rounding=2e-3, hint=hint)
    n = np.array([0.6, 0.0, -0.8])
    turned = scenes.scene(
        floor=scenes.rectangle([0, 0, 0], n, 50.0, scenes.diffuse(ALBEDO)),
        light=scenes.disk(n, -n, 1.5, scenes.BLACK, emitter=scenes.lamp(2.0)),
    )
    came = trace(submission, integrator, turned, 0.5 * n, -n, 1, shift=2)
    what = "radiance under a disk light, floor and light tilted and turned over"
    expect.estimate(came, wanted, what, rounding=2e-3, hint=FRAMES[integrator])


def check_seen_light(submission, integrator):
    """Lights that the camera sees, at any limit of bounces; and nothing."""
    scene = scenes.scene(floor=scenes.floor(ALBEDO), light=panel())
    for bounces in (0, 2):
        came = trace(submission, integrator, scene, [0, 0, 0.5], UP, bounces, seeds=8, spp=16)
        what = f"radiance of a light that the camera sees, max_bounces = {bounces}"
        expect.close(came, 2.0, what, hint="what the camera sees counts once")
    came = trace(submission, integrator, scene, [0, 0, 0.5], -UP, 0, seeds=8, spp=16)
    hint = "max_bounces = 0 shows lights only: make no connection then, and no bounce"
    expect.close(came, 0.0, "radiance of the floor with max_bounces = 0", hint=hint)
    came = trace(submission, integrator, scene, [0, 0, 2.5], UP, 2, seeds=8, spp=16)
    expect.close(came, 0.0, "radiance where there is nothing")


def check_many_bounces(submission, integrator):
    """Inside a sphere around a light: each bounce adds a known fraction of the previous bounce."""
    hint = (
        "every bounce adds the same part again; too bright: is light counted twice, or a bounce "
        "too many? too dark: is the direction in the right frame?"
    )
    for bounces in (1, 4):
        scene = scenes.integrating_sphere(0.7, 2.0, 0.8)
        d = [0.3, 0.2, 1.0]
        came = trace(submission, integrator, scene, [0, 0, 0.8], d, bounces, shift=bounces)
        wanted = formulas.integrating_sphere(0.7, 2.0, 0.8, bounces)
        what = f"radiance inside a sphere around a light, max_bounces = {bounces}"
        expect.estimate(came, wanted, what, rounding=2e-3, hint=hint)


def check_unlimited(submission, integrator):
    """The whole series, by Russian roulette, in a picture."""
    scene = scenes.integrating_sphere(0.7, 2.0, 0.8)
    scene["camera"] = scenes.photo(8, 8, [0, 0, 0.8], [0, 0.2, 1.0], 0.1)
    came = submission.ask(
        "image",
        integrator=integrator,
        parameters={"max_bounces": -1},
        scene=scene,
        spp=256,
        seed=submission.seed,
    )
    expect.shape(came, (8, 8, 3), "picture")
    hint = (
        "what survives the roulette is divided by its chance to survive "
        "(if the tests with a limit pass)"
    )
    wanted = formulas.integrating_sphere(0.7, 2.0, 0.8, -1)
    samples = came.reshape(64, 3)[:, 1]
    what = "pixels inside a sphere around a light, without limit of bounces"
    expect.estimate(samples, wanted, what, rounding=2e-3, hint=hint)


def check_mirror(submission, integrator):
    """A light, and a lit floor, in a mirror."""
    mirror = {"type": "conductor", "material": "none"}
    tilted = scenes.scene(
        mirror=scenes.rectangle([0, 0, 0], [1, 0, 1], 0.2, mirror),
        light=scenes.disk([2.0, 0, 0], [-1, 0, 0], 1.0, scenes.BLACK, emitter=scenes.lamp(2.0)),
    )
    hint = (
        "no light's sample hits a mirror's direction: what it shows counts where the path meets it"
    )
    came = trace(submission, integrator, tilted, [0, 0, 1.0], -UP, 1, seeds=8, spp=32)
    expect.estimate(came, 2.0, "radiance of a light in a mirror", rounding=1e-3, hint=hint)
    over = scenes.scene(
        floor=scenes.floor(ALBEDO),
        light=ball(),
        mirror=scenes.rectangle([0, 0, 0.6], -UP, 0.05, mirror),
    )
    came = trace(submission, integrator, over, [0, 0, 0.3], UP, 2, spp=4 * SPP, shift=1)
    what = "radiance of a lit floor in a mirror"
    expect.estimate(came, ball_on_floor(), what, rounding=2e-3, hint=hint)
    came = trace(submission, integrator, over, [0, 0, 0.3], UP, 1, seeds=8, spp=32)
    hint = "mirror and floor are two bounces"
    expect.close(came, 0.0, "the same with max_bounces = 1", hint=hint)


def check_point_light(submission, integrator):
    """A light that no path can run into."""
    lamp = {"type": "point", "position": [1.0, 0.3, 2.0], "intensity": scenes.rgb(3.0)}
    scene = scenes.scene(floor=scenes.floor(0.5), light=lamp)
    came = trace(submission, integrator, scene, [0, 0, 0.5], -UP, 1)
    wanted = formulas.point_light(np.array([1, 0.3, 2]), 0.5 * 4 * np.pi * 3, np.zeros((1, 3)), UP)
    hint = "a point light has no density of hits: its weight is 1 (ds.delta)"
    expect.estimate(came, wanted[0], "radiance under a point light", rounding=1e-3, hint=hint)
