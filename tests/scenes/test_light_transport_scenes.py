"""The lights of the steady scenes of sampling and path tracing."""

from math import pi

import mitsuba as mi
import numpy as np
import pytest
from helpers.scenes import load, pixel_rays

import tofrender
from tofrender.scenes import BUILT_IN
from tofrender.scenes.light_transport import (
    SPHERE_LIGHT_CENTER,
    SPHERE_LIGHT_POWER,
    SPHERE_LIGHT_RADII,
    VEACH_LIGHTS,
    VEACH_PLATES,
    VEACH_POWER,
)
from tofrender.scenes.meshes import HALVES

SPHERE_LIGHTS = [f"sphere_light_{size}" for size in SPHERE_LIGHT_RADII]
RECTANGLES = ["rectangle_light_quad", "rectangle_light_triangles"]


def traced(name: str, **options) -> mi.Scene:
    """A scene for Mitsuba's `path`, its lights in the order of the dict."""
    return load(BUILT_IN[name](integrator="path", **options))


def picture(scene: mi.Scene, spp: int, seed: int = 0) -> np.ndarray:
    return np.array(mi.render(scene, spp=spp, seed=seed), dtype=np.float64)


def test_lights_of_veach_have_equal_power_and_distinct_colors():
    scene = BUILT_IN["veach"]()
    lights = [scene[f"{name}-light"] for name in VEACH_LIGHTS]
    radii = [light["radius"] for light in lights]
    # Of a sphere [W]: its area times pi times its radiance
    radiances = [np.array(light["emitter"]["radiance"]["value"]) for light in lights]
    powers = [4 * pi * r**2 * pi * radiance for r, radiance in zip(radii, radiances, strict=True)]
    np.testing.assert_allclose([each.mean() for each in powers], VEACH_POWER)
    assert len({tuple(each.round(6)) for each in powers}) == len(VEACH_LIGHTS)
    assert radii == sorted(radii)
    assert radii[-1] / radii[0] >= 20


def test_camera_of_veach_sees_every_light():
    scene = BUILT_IN["veach"]()
    image = picture(traced("veach", max_bounces=0), spp=16)
    for name in VEACH_LIGHTS:
        radiance = scene[f"{name}-light"]["emitter"]["radiance"]["value"]
        whole = np.isclose(image, radiance, rtol=1e-3).all(axis=2)  # pixels that see nothing else
        assert whole.any(), name
        assert not whole[0].any(), name  # not cut by the frame
        assert not whole[:, [0, -1]].any(), name
    assert (image.max(axis=2) > 0).mean() < 0.1


def test_every_plate_of_veach_mirrors_the_lights_into_the_camera():
    for name, (_, y, z, tilt) in VEACH_PLATES.items():
        angle = np.deg2rad(tilt)
        normal = np.array([-np.sin(angle), np.cos(angle)])  # y and z
        to_camera, to_lights = np.array([4 - y, 14 - z]), np.array([4.2 - y, -1 - z])
        mirrored = 2 * normal * (normal @ to_camera) - to_camera
        cosine = mirrored @ to_lights / np.linalg.norm(mirrored) / np.linalg.norm(to_lights)
        assert cosine > np.cos(np.deg2rad(2)), name


def reflection(scene: mi.Scene, plate: str, light: str) -> np.ndarray:
    """Whether each pixel of 192 x 128 sees the mirror image of `light` in `plate` of `veach`."""
    hit = scene.ray_intersect(pixel_rays(scene, 192, 128))
    shapes = {shape.id(): mi.ShapePtr(shape) for shape in scene.shapes()}
    mirrored = hit.spawn_ray(hit.to_world(mi.reflect(hit.wi)))
    reached = scene.ray_intersect(mirrored).shape
    seen = (hit.shape == shapes[f"{plate}-plate"]) & (reached == shapes[f"{light}-light"])
    return np.array(seen).reshape(128, 192)


@pytest.mark.statistical
def test_veach_separates_the_ways_to_sample():
    """Noise of Mitsuba's `direct` with either or both ways, where mirror and light are extremes.

    Light sampling was 217 times better for the small light on the rough plate, material sampling
    206 times for the large light on the smooth plate. Both together took one sample each and had
    1.7 and 0.6 times the noise of the better one alone.
    """
    noise = {}
    for way, (lights, materials) in {"nee": (1, 0), "mats": (0, 1), "mis": (1, 1)}.items():
        scene = BUILT_IN["veach"](width=192, height=128)
        samples = {"emitter_samples": lights, "bsdf_samples": materials}
        loaded = load(scene | {"integrator": {"type": "direct", **samples}})
        noise[way] = np.std([picture(loaded, 16, seed) for seed in range(8)], axis=0, ddof=1)
    for plate, light, pixels, good, bad in (
        ("roughest", "green", 10, "nee", "mats"),  # a small light on a rough plate
        ("smooth", "red", 200, "mats", "nee"),  # a large light on a smooth plate
    ):
        there = reflection(loaded, plate, light)
        assert there.sum() > pixels
        of = {way: noise[way][there].mean() for way in noise}
        assert of[bad] > 30 * of[good]
        assert of["mis"] < 2 * of[good]


@pytest.mark.parametrize(("width", "height"), [(32, 24), (24, 32), (64, 16)])
def test_camera_does_not_see_the_sphere_lights(width, height):
    for name in SPHERE_LIGHTS:
        image = picture(traced(name, width=width, height=height, max_bounces=0), spp=64)
        assert image.max() == 0


@pytest.mark.statistical
def test_sphere_lights_light_floor_and_wall_as_a_point_of_their_power_would():
    """L = ρ/π · Φ cosθ / (4π d²) at each pixel's center, for each radius.

    The standard error of a pixel is at most 0.5 % of it, and its mean and its center's value differ
    by less than 0.3 %, but for the two rows that see the edge of floor and wall. 4 % is seven
    standard errors.
    """
    size = {"width": 32, "height": 24}
    scene = traced("sphere_light_small", **size)
    hit = scene.ray_intersect(pixel_rays(scene, 32, 24))
    to_light = np.array(SPHERE_LIGHT_CENTER)[:, None] - np.array(hit.p)
    distance = np.linalg.norm(to_light, axis=0)
    cosine = (np.array(hit.n) * to_light).sum(axis=0) / distance
    albedo = np.where(np.array(hit.n)[1] > 0.5, [[0.75], [0.65], [0.5]], [[0.2], [0.5], [0.55]])
    expected = albedo / pi * SPHERE_LIGHT_POWER * cosine / (4 * pi * distance**2)
    expected = expected.T.reshape(24, 32, 3)
    floor = np.array(hit.n)[1].reshape(24, 32) > 0.5
    edge = floor.any(axis=1) & ~np.roll(floor, 1, axis=0).all(axis=1)
    inside = ~(edge | np.roll(edge, -1))
    assert inside.sum() == 22
    means = []
    for name in SPHERE_LIGHTS:
        image = picture(traced(name, **size), spp=64)
        np.testing.assert_allclose(image[inside], expected[inside], rtol=0.04)
        means.append(image.mean())
    np.testing.assert_allclose(means, means[0], rtol=1e-3)


@pytest.mark.statistical
def test_quad_and_two_triangles_give_the_same_picture():
    """Means over 4 x 4 pixels of 8 seeds: no block may be off by 6 of its standard errors.

    With 7 + 7 degrees of freedom, |t| > 6 has probability 3e-5; 36 blocks and 3 channels that
    move together make a false alarm about once in a thousand runs, and the seeds are fixed.
    """
    pictures = []
    for name in RECTANGLES:
        scene = traced(name, width=24, height=24)
        seeds = np.stack([picture(scene, spp=64, seed=seed) for seed in range(8)])
        pictures.append(seeds.reshape(8, 6, 4, 6, 4, 3).mean(axis=(2, 4)))
    a, b = pictures
    error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / 8) + 1e-4
    assert (abs(a.mean(axis=0) - b.mean(axis=0)) / error).max() < 6
    assert a.mean() == pytest.approx(b.mean(), rel=5e-3)


@pytest.mark.parametrize("optimize", [True, False])
def test_triangles_are_two_lights(optimize):
    quad, triangles = (
        tofrender.load_scene(BUILT_IN[name](integrator="path"), optimize=optimize)
        for name in RECTANGLES
    )
    assert len(quad.emitters()) == 1
    assert len(triangles.emitters()) == len(HALVES) == 2
    panel = quad.emitters()[0].get_shape()
    halves = [light.get_shape() for light in triangles.emitters()]
    area = float(panel.surface_area()[0])
    np.testing.assert_allclose([float(h.surface_area()[0]) for h in halves], area / 2, rtol=1e-5)
    at = mi.Point2f(0.3)
    for half in halves:
        normals = [np.array(s.sample_position(0, at).n).ravel() for s in (half, panel)]
        np.testing.assert_allclose(*normals, atol=1e-5)


@pytest.mark.statistical
def test_light_of_the_small_box_is_partly_indirect():
    direct, all_of_it = (
        picture(traced("small_box", width=16, height=16, max_bounces=bounces), spp=64)
        for bounces in (1, 8)
    )
    share = 1 - np.median(direct) / np.median(all_of_it)
    assert 0.3 < share < 0.8
