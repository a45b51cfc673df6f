"""Probes: functions that the tests call with a submission, in the submission's process."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import worlds

SEEDS = 16


def properties(**options):
    """Parameters of an integrator."""
    props = mi.Properties()
    for name, value in options.items():
        props[name] = value
    return props


def world(name, view, **options):
    """A scene of `worlds` with a camera."""
    return getattr(worlds, name)(worlds.camera(**view), **options)


# -------------------------------------------------------------------------------------- lens


def _lens(theirs, view):
    scene = worlds.load({"sensor": worlds.camera(**view)})
    return theirs.Lens(scene.sensors()[0])


def lens_along(theirs, view, d):
    """Area, density and importance for unit vectors, shape (n, 3)."""
    lens = _lens(theirs, view)
    d = mi.Vector3f(*(mi.Float(column) for column in np.asarray(d, np.float32).T))
    zero = d.x * 0
    return {
        "area": mi.Float(lens.area),
        "density": lens.density(d) + zero,
        "importance": lens.importance(d) + zero,
    }


def lens_arrival(theirs, view, p):
    """Result of `arrive` for points, shape (n, 3); vectors have their axis first."""
    lens = _lens(theirs, view)
    sampler = mi.load_dict({"type": "independent"})
    p = np.asarray(p, np.float32)
    sampler.seed(0, len(p))
    points = mi.Point3f(*(mi.Float(column) for column in p.T))
    on_lens = lens.sample(sampler)
    came = lens.arrive(points, on_lens)
    zero = points.x * 0
    return {
        "points": mi.Point3f(points) + zero,
        "sampled": mi.Point3f(on_lens) + zero,
        "lens": mi.Point3f(came.lens) + zero,
        "near": came.near + zero,
        "direction": came.direction + zero,
        "distance": came.distance + zero,
        "density": came.density + zero,
        "position": came.position + zero,
        "seen": dr.select(mi.Bool(came.seen), mi.Float(1), mi.Float(0)) + zero,
    }


# -------------------------------------------------------------------------------- integrators


def render(theirs, name, scene, view, spp, seed, integrator=None, seeds=SEEDS, **options):
    """(steady, bins) of an integrator, seeds in front."""
    scene = world(scene, view, **options)
    tracer = getattr(theirs, name)(properties(**(integrator or {})))
    tracer.make_lens = worlds.MitsubasLens
    steady = []
    transient = []
    for k in range(seeds):
        image, cube = tracer.render(scene, scene.sensors()[0], seed=seed + k, spp=spp)
        steady.append(np.array(image, dtype=np.float64))
        transient.append(np.array(cube, dtype=np.float64))
    return np.stack(steady), np.stack(transient)
