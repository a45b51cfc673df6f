"""Probes of a submission's path tracers for single rays, in the submission's process."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import worlds

FAR = 1000.0
"""All light of these scenes is shorter [m]."""


def along_rays(
    theirs,
    name,
    parts,
    rays,
    seed,
    seeds=16,
    lanes=1024,
    after=0.0,
    **options,
):
    """Estimate the light along rays, as the mean of many lanes for each ray.

    Args:
        theirs: The submission.
        name: Its integrator.
        parts: The scene, for `worlds.described`.
        rays: Arrays `origin`, `towards` of shape (n, 3); optionally `start` (n, 3), where lengths
            start, and `active` (n,).
        seed: Seed of the first of the estimates.
        seeds: Number of estimates.
        lanes: Lanes for each ray.
        after: A length [m]; unless it is 0, gates and modulations measure only `late`.
        options: Parameters of the integrator.

    Returns:
        Some of `light` (seeds, n, 3), summed over all lengths; `moment`, light times length
        [m]; `late` (seeds, n), share of lanes with light that is longer than `after`; `valid`
        (seeds, n), share of lanes with a hit by the returned mask; and `extra`, the number of
        AOVs. For a film also `steady` (seeds, n, 3), the light that `sample` returns.
    """
    scene = worlds.described(None, parts)
    kind = getattr(theirs, name)
    package = kind.__module__.startswith("tofrender.")
    if package:
        options = {"max_depth": 8} | options  # its TransientPath has another default
    integrator = kind(_properties(options))
    asks = {"TimeGatedTransientPath": _gated, "AMCWTransientPath": _modulated}
    ask = asks.get(name, _package if package else _deposited)
    origin = np.asarray(rays["origin"], float)
    number = len(origin)

    def spread(array):
        return np.repeat(np.asarray(array), lanes, axis=0).T

    towards = np.asarray(rays["towards"], float) - origin
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    start = np.asarray(rays.get("start", origin), float)
    active = np.asarray(rays.get("active", np.ones(number)), bool)
    found = {}
    for k in range(seeds):
        ray = mi.Ray3f(mi.Point3f(spread(origin)), mi.Vector3f(spread(towards)))
        given = (mi.Point3f(spread(start)), mi.Bool(spread(active)))
        answer = ask(integrator, scene, ray, given, seed + k, after)
        for key, value in answer.items():
            if key != "extra":
                array = np.array(value, np.float64)
                array = array.reshape(-1, array.shape[-1]).T
                array = np.broadcast_to(array, (number * lanes, array.shape[1]))
                array = (array != 0).any(axis=1, keepdims=True) if key == "late" else array
                array = array.reshape(number, lanes, -1).mean(axis=1)
                found.setdefault(key, []).append(array[:, 0] if array.shape[1] == 1 else array)
    return {key: np.stack(values) for key, values in found.items()} | {"extra": answer["extra"]}


def _properties(options):
    props = mi.Properties()
    for name, value in options.items():
        props[name] = value
    return props


# Arguments: integrator, scene, rays, (start of lengths, active lanes), seed, length


def _gated(integrator, scene, ray, given, seed, after):
    """Measure with pulses that weight all light equally, by its length, or only late light."""
    weights = {"light": (("box", -FAR, 0.0), FAR), "moment": (("slope", -FAR, 0.0), FAR**2 / 2)}
    if after:
        weights = {"late": (("box", -FAR, -after), FAR - after)}
    answer = {}
    for name, (pulse, scale) in weights.items():
        integrator.pulse = worlds.pulse(*pulse)
        origin, active = given
        value, valid, aovs = integrator.sample(
            scene, _sampler(ray, seed), ray, 0.0, active=active, origin=origin
        )
        answer[name] = mi.Color3f(value) * scale
    return answer | {"valid": _mask(valid), "extra": len(aovs)}


def _modulated(integrator, scene, ray, given, seed, after):
    weights = {"light": worlds.Ramp(1.0, 0.0), "moment": worlds.Ramp(0.0, 1.0)}
    if after:
        weights = {"late": worlds.Step(after)}
    answer = {}
    for name, modulation in weights.items():
        integrator.set_modulation(modulation)
        origin, active = given
        value, valid, aovs = integrator.sample(
            scene, _sampler(ray, seed), ray, active=active, origin=origin
        )
        answer[name] = mi.Color3f(value)
    return answer | {"valid": _mask(valid), "extra": len(aovs)}


def _deposited(integrator, scene, ray, given, seed, after):
    """Collect the contributions that `sample` passes to `deposit`."""
    number = dr.width(ray)
    lane = dr.arange(mi.UInt32, number)
    sums = [dr.zeros(mi.Float, number) for _ in range(7)]
    dr.eval(lane, sums)

    def deposit(spectrum, opl, active):
        spectrum = mi.Color3f(spectrum)
        opl = mi.Float(opl)
        active = mi.Bool(active)
        late = dr.select(opl > after, dr.max(spectrum), 0)
        for total, value in zip(sums, [*spectrum, *(spectrum * opl), late], strict=True):
            dr.scatter_add(total, value, lane, active)

    origin, active = given
    steady, valid = integrator.sample(
        scene, _sampler(ray, seed), ray, deposit, origin, active=active
    )
    steady = mi.Color3f(steady)
    dr.eval(steady, valid, sums)
    return {
        "light": mi.Color3f(*sums[:3]),
        "moment": mi.Color3f(*sums[3:6]),
        "late": mi.Color3f(sums[6]),
        "steady": steady,
        "valid": _mask(valid),
        "extra": 0,
    }


def _package(integrator, scene, ray, given, seed, after):
    """Measure the package's integrator, which does not call `deposit`."""
    from tofrender.films.sums import Weighted

    answer = {}
    weights = {"light": lambda opl: 1.0, "moment": lambda opl: opl}
    if after:
        weights = {"light": worlds.Step(after).eval}
    for name, weight in weights.items():
        total, path = integrator.plan(scene).trace(
            _sampler(ray, seed), ray, given[0], Weighted.zero(weight), given[1]
        )
        answer[name] = mi.Color3f(total.total)
    answer["steady"] = answer["light"]
    answer["late"] = answer["light"]
    return answer | {"valid": _mask(path.valid_ray), "extra": 0}


def _sampler(ray, seed):
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(seed, dr.width(ray))
    return sampler


def _mask(valid):
    return mi.Float(dr.select(mi.Bool(valid), 1.0, 0.0))
