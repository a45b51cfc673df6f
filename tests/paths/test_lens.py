"""The lens as what light arrives at: it sees what its rays meet, with their density."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import unit
from helpers.scenes import numbers
from helpers.support import camera, film, load

from tofrender.bidirectional.lens import Lens
from tofrender.paths.camera import pixel_corner, ray_origin, sampled_size

ORIGIN, TARGET = (0.3, -0.5, 1.2), (1.0, 2.0, 0.4)
AXIS = unit(np.subtract(TARGET, ORIGIN))
NEAR, FAR = 0.2, 50.0
OFFSET = {"principal_point_offset_x": 0.3, "principal_point_offset_y": -0.15}
THIN = {"kind": "thinlens", "aperture_radius": 0.2, "focus_distance": 1.7}
CROP = {"crop_width": 5, "crop_height": 3, "crop_offset_x": 6, "crop_offset_y": 1}
WIDE_FILTER = {"rfilter": {"type": "gaussian"}, "sample_border": True}

CAMERAS = {
    "plain": ({}, {}),
    "offset": (OFFSET, {}),
    "crop": ({}, CROP),
    "border": ({}, WIDE_FILTER),
    "offset, crop and border": (OFFSET, CROP | WIDE_FILTER),
    "mirrored": ({"mirrored": True} | OFFSET, {}),
    "lens": (THIN, {}),
    "lens, crop and border": (THIN, CROP | WIDE_FILTER),
}
EACH = pytest.mark.parametrize("name", CAMERAS)


def eye(name: str) -> mi.Sensor:
    options, window = dict(CAMERAS[name][0]), CAMERAS[name][1]
    turned = mi.ScalarTransform4f().scale([-1 if options.pop("mirrored", False) else 1, 1, 1])
    clips = {"near_clip": NEAR, "far_clip": FAR, "fov": 70.0}
    the_film = film(12, 8, bins=1, **window)
    described = camera(ORIGIN, TARGET, the_film, up=(0, 0, 1), **clips | options)
    return load(described | {"to_world": described["to_world"] @ turned})


def film_rays(sensor: mi.Sensor, u: np.ndarray, aperture=(0.5, 0.5)) -> tuple[mi.Ray3f, np.ndarray]:
    """Rays through points of the sampled area, its corners (0, 0) and (1, 1); and their pixels."""
    the_film = sensor.film()
    first = np.array(pixel_corner(the_film, mi.UInt32(0)), float).ravel()
    position = first[:, None] + u * np.array(sampled_size(the_film), float)[:, None]
    sample = mi.Point2f((position.T - the_film.crop_offset()).T / np.c_[the_film.crop_size()])
    aperture = mi.Point2f(*aperture) + dr.zeros(mi.Float, u.shape[1])
    ray, _ = sensor.sample_ray(mi.Float(0), mi.Float(0.5), sample, aperture)
    return ray, position


def points(count: int = 4096, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.01, 0.99, (2, count))


BOTH_POINTS = pytest.mark.parametrize("aperture", [(0.5, 0.5), (0.1, 0.8)])
"""Random numbers of two points on the lens."""


@BOTH_POINTS
@EACH
def test_density_is_that_of_rays_through_an_even_film(name, aperture):
    """One over the solid angle of a piece of film, whose edges are central differences.

    So its integral over the film is 1. Its importance is that over the cosine and the lens's area.
    """
    sensor, u, step = eye(name), points(), 5e-3
    moved = {}
    for sign in (-1, 1):
        for axis in (0, 1):
            to = u + sign * step * np.eye(2)[axis][:, None]
            ray, _ = film_rays(sensor, to, aperture)
            moved[sign, axis] = np.array(ray.d, float)
    across, down = ((moved[1, axis] - moved[-1, axis]) / (2 * step) for axis in (0, 1))
    solid_angle = np.linalg.norm(np.cross(across.T, down.T), axis=1)
    ray, _ = film_rays(sensor, u, aperture)
    lens = Lens(sensor)
    found = np.array(lens.density(ray.d), float)
    assert found == pytest.approx(1 / solid_angle, rel=1e-3)
    cos = np.abs(np.array(dr.dot(ray.d, lens.axis)))
    area = np.pi * THIN["aperture_radius"] ** 2 if "lens" in name else 1.0
    np.testing.assert_allclose(np.array(lens.importance(ray.d)), found / (cos * area), rtol=1e-5)


@BOTH_POINTS
@EACH
def test_points_land_where_their_ray_comes_from(name, aperture):
    sensor, u = eye(name), points()
    lens = Lens(sensor)
    ray, position = film_rays(sensor, u, aperture)
    origin = ray_origin(sensor, ray)
    distance = np.random.default_rng(1).uniform(0.5, 20, u.shape[1])
    arrival = lens.arrive(origin + ray.d * mi.Float(distance), origin)
    assert dr.all(arrival.seen)
    assert np.array(arrival.position) == pytest.approx(position, abs=1e-4)
    assert np.array(arrival.distance) == pytest.approx(distance, rel=1e-5)
    assert np.array(arrival.direction) == pytest.approx(-np.array(ray.d), abs=1e-5)
    assert np.array(arrival.density) == pytest.approx(np.array(lens.density(ray.d)), rel=1e-4)
    assert np.array(arrival.near) == pytest.approx(np.array(ray.o), abs=1e-5)


@EACH
def test_nothing_beyond_the_window_is_seen(name):
    sensor, u = eye(name), points()
    side = np.array([[-0.01, 0.5], [1.01, 0.5], [0.5, -0.01], [0.5, 1.01]]).T
    for place, seen in ((u, True), (side, False)):
        ray, _ = film_rays(sensor, place)
        arrival = Lens(sensor).arrive(ray(1.0), ray_origin(sensor, ray))
        assert dr.all(arrival.seen == seen)
        assert dr.all((arrival.density > 0) == seen)


@EACH
def test_clips_and_what_is_behind(name):
    """Depths count along the axis; what is infinitely far away is behind no clip."""
    sensor = eye(name)
    lens, (ray, _) = Lens(sensor), film_rays(sensor, np.full((2, 1), 0.5))
    origin = ray_origin(sensor, ray)
    cos = dr.dot(ray.d, mi.Vector3f(*AXIS.tolist()))
    for depth, seen in ((0.99 * NEAR, 0), (1.01 * NEAR, 1), (0.99 * FAR, 1), (1.01 * FAR, 0)):
        p = origin + ray.d * (depth / cos)
        assert dr.all(lens.arrive(p, origin).seen == bool(seen))
        assert dr.all(lens.arrive(p, origin, True).seen)
    for distant in (False, True):
        arrival = lens.arrive(origin - ray.d, origin, distant)
        assert not dr.any(arrival.seen)
        assert dr.all(arrival.density == 0)


def test_points_on_the_lens():
    """Even on a disk: r² is even up to R², and all is in the plane across the axis; or a point."""
    sampler, other = (numbers(0, 1 << 16) for _ in range(2))
    pinhole = np.array(Lens(eye("plain")).sample(sampler)).T
    assert pinhole == pytest.approx(np.broadcast_to(ORIGIN, pinhole.shape))
    assert dr.all(sampler.next_1d() == other.next_1d())  # None was drawn
    offset = np.array(Lens(eye("lens")).sample(sampler)).T - ORIGIN
    assert np.abs(offset @ AXIS).max() < 1e-6
    inside = np.sort((offset**2).sum(axis=1)) / THIN["aperture_radius"] ** 2
    assert inside == pytest.approx((np.arange(inside.size) + 0.5) / inside.size, abs=0.01)
    assert offset.mean(axis=0) == pytest.approx(np.zeros(3), abs=2e-3)
