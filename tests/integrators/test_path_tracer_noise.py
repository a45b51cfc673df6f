"""How noisy the course's path tracers are: each where the theory says, both together nowhere."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.support import (
    agree,
    load,
)
from helpers.tracers import (
    COURSE,
    TRACERS,
    course,
    paths,
    through_pixels,
)
from oracles import films as oracles

from tofrender.scenes.light_transport import VEACH_LIGHTS, VEACH_PLATES


@pytest.mark.statistical
@pytest.mark.parametrize("name", COURSE)
def test_both_together_are_never_much_worse_than_the_better(name):
    """At most twice the variance of a path; with one sample, twice the second moment.

    The latter is exact for direct light: F² / ((p1 + p2) / 2) is at most 2 F² / p1. One sample of
    two, where the other finds nothing, has a variance of mean² even if the first is perfect.
    """
    loaded = load(course(name, width=24, height=18))
    limits = {"max_bounces": 8 if "box" in name else 1, "hide_emitters": True}
    found = [through_pixels(loaded, TRACERS[tracer] | limits, 256, 5) for tracer in TRACERS]
    mats, nee, reuse, _ = (values.var(axis=0).mean() for values in found)
    assert reuse <= 2 * min(mats, nee)
    mats, nee, _, mixed = ((values**2).mean() for values in found)
    if "box" not in name:
        assert mixed <= 2.1 * min(mats, nee)  # a twentieth for noise


@pytest.mark.statistical
def test_so_on_each_surface_of_veach():
    loaded = load(course("veach", width=48, height=32))
    limits = {"max_bounces": 1, "hide_emitters": True}
    mats, nee, reuse = (
        through_pixels(loaded, TRACERS[tracer] | limits, 512, 6).var(axis=0)
        for tracer in ("mats", "nee", "reuse")
    )
    pixel = dr.arange(mi.UInt32, 48 * 32)
    at = (mi.Point2f(pixel % 48, pixel // 48) + 0.5) / mi.Point2f(48, 32)
    ray, _ = loaded.sensors()[0].sample_ray(0, 0.5, at, mi.Point2f(0.5))
    seen = loaded.ray_intersect(ray).shape
    surfaces = {each.id(): np.array(seen == mi.ShapePtr(each)) for each in loaded.shapes()}
    for name in ("floor", "back", *(f"{plate}-plate" for plate in VEACH_PLATES)):
        here = surfaces[name].reshape(32, 48)
        assert here.sum() > 30
        assert reuse[here].mean() <= 2 * min(mats[here].mean(), nee[here].mean()), name


def mirrored_lights(integrator: dict, seed: int, count: int = 1 << 15) -> np.ndarray:
    """Paths to where each plate of `veach` mirrors each light's centre, (plates, lights, paths)."""
    loaded = load(course("veach"))
    eye, points = np.array([0.0, 4.0, 14.0]), []
    for _, y, z, tilt in VEACH_PLATES.values():
        plate = np.array([0, y, z])
        normal = np.array([0.0, -math.sin(math.radians(tilt)), math.cos(math.radians(tilt))])
        image = oracles.mirrored(eye, plate, normal)
        for _, x, _ in VEACH_LIGHTS.values():
            way = np.array([x, 4.2, -1.0]) - image
            points.append(image + way * (normal @ (plate - image)) / (normal @ way))
    way = np.repeat(np.array(points) - eye, count, axis=0)
    ray = mi.Ray3f(mi.Point3f(eye), dr.normalize(mi.Vector3f(way.T)))
    found = paths(loaded, integrator | {"max_depth": 2}, ray, seed).mean(axis=1)
    return found.reshape(len(VEACH_PLATES), len(VEACH_LIGHTS), count)


@pytest.mark.statistical
def test_veach_shows_what_each_is_good_at():
    found = {tracer: mirrored_lights(TRACERS[tracer], 7) for tracer in TRACERS}
    mats, nee = (found[tracer].var(axis=2) for tracer in ("mats", "nee"))
    small_on_rough, large_on_smooth = (3, 0), (0, 3)
    assert mats[small_on_rough] > 50 * nee[small_on_rough]
    assert nee[large_on_smooth] > 50 * mats[large_on_smooth]
    *alone, _, mixed = ((values**2).mean(axis=2) for values in found.values())
    assert (mixed <= 2.1 * np.minimum(*alone)).all()


@pytest.mark.statistical
def test_reflections_of_veach_in_expectation():
    """Where a tracer is not hopeless: `mats` with large lights, `nee` on rough plates."""
    good = {"mats": np.s_[:, 2:], "nee": np.s_[2:], "one_sample": np.s_[:]}

    def batches(integrator, seed):
        values = mirrored_lights(integrator, seed)
        return np.moveaxis(values.reshape(*values.shape[:2], 32, -1).mean(axis=3), 2, 0)

    reference = batches({"type": "path"}, 8)
    for tracer, where in good.items():
        found = batches(TRACERS[tracer], 9)
        where = (np.s_[:], *(where if isinstance(where, tuple) else (where,)))
        assert agree(found[where], reference[where])
        assert not agree(1.1 * found[where], reference[where])
