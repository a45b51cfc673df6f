"""Probes: functions that the tests call with a submission, in the submission's process."""

from __future__ import annotations

from numbers import Real

import drjit as dr
import mitsuba as mi
import numpy as np
import pulses_to_check
import worlds
from rays import along_rays

from tofrender.course.judge import trials

__all__ = ["along_rays"]
SEEDS = 16


def properties(**options):
    """Parameters of an integrator."""
    props = mi.Properties()
    for name, value in options.items():
        props[name] = value
    return props


def over_seeds(render, seed):
    """Renders under seeds that follow each other, stacked in front."""
    return np.stack([np.array(render(seed + k), dtype=np.float64) for k in range(SEEDS)])


def world(name, view, **options):
    """A scene of `worlds` with a camera."""
    return getattr(worlds, name)(worlds.camera(**view), **options)


# ------------------------------------------------------------------------------------- pulses


def _of_drjit(name, values):
    """Refuse what no kernel can hold, as a product that begins with a number of NumPy."""
    if not dr.is_array_v(values):
        raise TypeError(
            f"{name} gave a {type(values).__name__} for a Dr.Jit float; is a NumPy number the "
            "first factor? float(...) makes it Python's"
        )
    return values


def pulse_normalization(theirs, width_opl):
    return theirs.GaussianPulse(width_opl=width_opl).normalization


def pulse_density(theirs, width_opl, t):
    return _of_drjit("eval", theirs.GaussianPulse(width_opl=width_opl).eval(mi.Float(t)))


def pulse_cdf(theirs, width_opl, t):
    return _of_drjit("cdf", theirs.GaussianPulse(width_opl=width_opl).cdf(mi.Float(t)))


def pulse_samples(theirs, width_opl, xi):
    t, weight = theirs.GaussianPulse(width_opl=width_opl).sample(mi.Float(xi))
    return {"t": mi.Float(t), "weight": mi.Float(weight) + dr.zeros(mi.Float, len(xi))}


def pulses_side_by_side(theirs, widths, t, xi):
    """Results of two pulses, which exist at the same time; t and xi in units of the widths."""
    pulses = [theirs.GaussianPulse(width_opl=width) for width in widths]
    return [_told(pulse, t * width, xi) for pulse, width in zip(pulses, widths, strict=True)]


def _told(pulse, t, xi):
    t, xi, one = mi.Float(t), mi.Float(xi), mi.Float(t[0])
    before = np.array(t), np.array(xi)
    offsets, weight = pulse.sample(xi)
    told = {
        "width_opl": pulse.width_opl,
        "support": [float(each) for each in pulse.support],
        "normalization": pulse.normalization,
        "is_number": isinstance(pulse.normalization, Real),
        "density": _of_drjit("eval", pulse.eval(t)),
        "cdf": _of_drjit("cdf", pulse.cdf(t)),
        "offsets": _of_drjit("sample", offsets),
        "again": pulse.sample(xi)[0],
        "weight": mi.Float(weight) + dr.zeros(mi.Float, dr.width(xi)),
        "one": [
            pulse.eval(one),
            pulse.cdf(one),
            *map(mi.Float, pulse.sample(mi.Float(xi[0]))),
        ],
    }
    same = [np.array_equal(np.array(a), b) for a, b in zip((t, xi), before, strict=True)]
    return told | {"kept": all(same)}


def defines(theirs, name):
    """Load a name of the submission; a failure contains the reason."""
    getattr(theirs, name)


def check_pulse(theirs, name, width_opl):
    """Result of the student's test for a pulse of `pulses_to_check`."""
    return trials.verdict(theirs.check_pulse, getattr(pulses_to_check, name)(width_opl))


def try_pulse(theirs, name, text):
    """Result of the student's test for a solution of a2.gaussian_pulse."""
    made = trials.load(name, text)
    return trials.verdict(theirs.check_pulse, made.GaussianPulse(width_opl=0.05))


def modulation(theirs, frequency_hz, phase_offset, opl):
    """Its values and numbers."""
    return _wave(theirs.AMCWPulse(frequency_hz=frequency_hz, phase_offset=phase_offset), opl)


def modulations(theirs, each, opl):
    """Modulations of several waves (frequency, offset or None), which exist at the same time."""
    waves = [
        theirs.AMCWPulse(frequency) if offset is None else theirs.AMCWPulse(frequency, offset)
        for frequency, offset in each
    ]
    return [_wave(wave, opl) for wave in waves]


def _wave(wave, opl):
    return {
        "frequency_hz": wave.frequency_hz,
        "phase_offset": wave.phase_offset,
        "values": _of_drjit("eval", wave.eval(mi.Float(opl))),
        "omega": wave.omega,
        "range": wave.get_unambiguous_range(),
    }


# ------------------------------------------------------------------------------------- gates


def _gated(theirs, pulse, **options):
    integrator = theirs.TimeGatedTransientPath(properties(**options))
    integrator.pulse = worlds.pulse(*pulse)
    return integrator


def gate_along_ray(theirs, scene, view, origin, target, times, pulse, max_depth):
    """Result of `sample` along one ray, for each target time: shape (times,)."""
    scene = world(scene, view)
    integrator = _gated(theirs, pulse, max_depth=max_depth)
    ray = _ray(origin, target)
    return [_mean(integrator.sample(scene, _sampler(), ray, float(time))[0]) for time in times]


def gate_image(theirs, scene, view, time, pulse, spp, seed, max_depth=2):
    """Images of `render_at_time`, shape (seeds, height, width, 3)."""
    scene = world(scene, view)
    integrator = _gated(theirs, pulse, max_depth=max_depth)
    sensor = scene.sensors()[0]
    return over_seeds(
        lambda s: theirs.render_at_time(scene, integrator, sensor, time, spp=spp, seed=s), seed
    )


def gates(theirs, scene, view, bins, pulse, spp, seed, max_depth, **options):
    """Cubes of `render_transient`, shape (seeds, height, width, bins, 3)."""
    scene = world(scene, view, **options)
    integrator = _gated(theirs, pulse, max_depth=max_depth)
    sensor = scene.sensors()[0]
    names = ("temporal_bins", "start_opl", "bin_width_opl")
    config = dict(zip(names, (int(bins[0]), float(bins[1]), float(bins[2])), strict=True))
    return over_seeds(
        lambda s: theirs.render_transient(scene, integrator, sensor, config, spp=spp, seed=s), seed
    )


def gate_pictures(theirs, view, colors, pulse, gates, time, spp, seed):
    """Pictures of `render_at_time` and cubes of `render_transient`, see `_pictures`."""
    scene = world("lamp", view, colors=colors)
    integrator = _gated(theirs, pulse, max_depth=2)
    sensor = scene.sensors()[0]
    names = ("temporal_bins", "start_opl", "bin_width_opl")
    config = dict(zip(names, (int(gates[0]), float(gates[1]), float(gates[2])), strict=True))

    def one(s, n):
        return theirs.render_at_time(scene, integrator, sensor, time, spp=n, seed=s)

    def many(s, n):
        return theirs.render_transient(scene, integrator, sensor, config, spp=n, seed=s)

    return {"one": _pictures(one, seed, spp), "many": _pictures(many, seed, spp)}


def gate_profile(theirs, view, times, pulse, options):
    """Result of `sample` along the camera's ray, with a given pulse or the pulse of the options."""
    integrator = theirs.TimeGatedTransientPath(properties(**options))
    if pulse is not None:
        integrator.pulse = worlds.pulse(*pulse)
    scene = world("lamp", view)
    ray = _ray(view["origin"], view["target"])
    return [_mean(integrator.sample(scene, _sampler(), ray, float(time))[0]) for time in times]


def _ray(origin, target):
    o = mi.Point3f(origin)
    d = dr.normalize(mi.Point3f(target) - mi.Point3f(origin))
    return mi.Ray3f(o + dr.zeros(mi.Float, 16), mi.Vector3f(d) + dr.zeros(mi.Float, 16))


def _sampler():
    sampler = mi.load_dict({"type": "independent", "sample_count": 16})
    sampler.seed(0, 16)
    return sampler


def _mean(spectrum):
    return float(np.mean(np.array(mi.Color3f(spectrum).x + dr.zeros(mi.Float, 16))))


def _pictures(render, seed, spp):
    """Pictures of several seeds, also of a 64th of the samples; the first one once more."""
    first = render(seed, spp)
    return {
        "values": over_seeds(lambda s: render(s, spp), seed),
        "few": over_seeds(lambda s: render(s, spp // 64), seed),
        "again": np.array(first, dtype=np.float64),
        "kind": f"{type(first).__name__} of {getattr(first, 'dtype', 'no dtype')}",
    }


# -------------------------------------------------------------------------------------- AMCW


def amcw_along_ray(theirs, scene, view, origin, target, ramps, max_depth):
    """Result of `sample` along one ray, for each modulation (at zero, slope [1/m])."""
    scene = world(scene, view)
    integrator = theirs.AMCWTransientPath(properties(max_depth=max_depth))
    values = []
    for ramp in ramps:
        integrator.set_modulation(worlds.Ramp(*ramp))
        values.append(_mean(integrator.sample(scene, _sampler(), _ray(origin, target))[0]))
    return values


def amcw_pictures(theirs, view, colors, ramp, spp, seed):
    """Pictures of `render_single_amcw`, see `_pictures`."""
    scene = world("lamp", view, colors=colors)
    integrator = theirs.AMCWTransientPath(properties(max_depth=2))
    integrator.set_modulation(worlds.Ramp(*ramp))

    def render(s, n):
        return theirs.render_single_amcw(scene, integrator, scene.sensors()[0], spp=n, seed=s)

    return _pictures(render, seed, spp)


def amcw_phasors(theirs, parts, view, frequency_hz, spp, seed, seeds=SEEDS):
    """I, Q, amplitude, phase and depth of any scene, each (seeds, height, width, 3)."""
    scene = world("described", view, parts=parts)
    sensor = scene.sensors()[0]
    found = [
        theirs.render_amcw_phasor(scene, sensor, frequency_hz, spp=spp, seed=seed + k)
        for k in range(seeds)
    ]
    return [np.stack([np.array(f[part], np.float64) for f in found]) for part in range(5)]


def amcw_image(theirs, scene, view, ramp, spp, seed, max_depth=2, **options):
    """Images of `render_single_amcw`, shape (seeds, height, width, 3)."""
    scene = world(scene, view, **options)
    integrator = theirs.AMCWTransientPath(properties(max_depth=max_depth))
    integrator.set_modulation(worlds.Ramp(*ramp))
    sensor = scene.sensors()[0]
    return over_seeds(
        lambda s: theirs.render_single_amcw(scene, integrator, sensor, spp=spp, seed=s), seed
    )


def amcw_phasor(theirs, scene, view, frequency_hz, spp, seed):
    """I, Q, amplitude, phase and depth of `render_amcw_phasor`."""
    scene = world(scene, view)
    result = theirs.render_amcw_phasor(scene, scene.sensors()[0], frequency_hz, spp=spp, seed=seed)
    return [np.array(each, dtype=np.float64) for each in result]


# -------------------------------------------------------------------------------------- film


def film(theirs, scene, view, pulse, spp, seed, seeds=SEEDS, max_depth=2, **options):
    """(steady, bins) of `TransientPath`, seeds in front.

    `pulse` may be the width for its option, or None for what it has by default.
    """
    scene = world(scene, view, **options)
    width = {"pulse_width_opl": pulse} if isinstance(pulse, Real) else {}
    integrator = theirs.TransientPath(properties(max_depth=max_depth, **width))
    if pulse is not None and not width:
        integrator.pulse = worlds.pulse(*pulse)
    return _render(integrator, scene, spp, seed, seeds)


def spread_lanes(theirs, pulse, opl, active):
    """Sum that `TransientPath.spread` puts for each lane; None for the package, which lacks it."""
    if theirs.TransientPath.__module__.startswith("tofrender."):
        return None
    film = mi.load_dict(worlds.camera((0, 0, 1), (0, 0, 0), bins=(60, 0.0, 0.1))["film"])
    integrator = theirs.TransientPath(properties())
    integrator.pulse = worlds.pulse(*pulse)
    number = len(opl)
    lane = dr.arange(mi.UInt32, number)
    total = dr.zeros(mi.Float, number)
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(0, number)

    def put(spectrum, opl, active):
        dr.scatter_add(total, mi.Color3f(spectrum).x, lane, mi.Bool(active))

    integrator.spread(film, put, sampler, mi.Color3f(1), mi.Float(opl), mi.Bool(active))
    return total


def confocal(theirs, scene, view, spp, seed, seeds=SEEDS, integrator=None, **options):
    """(steady, bins) of `ConfocalTransientIntegrator`, seeds in front."""
    scene = world(scene, view, **options)
    tracer = theirs.ConfocalTransientIntegrator(properties(**(integrator or {})))
    return _render(tracer, scene, spp, seed, seeds)


def _render(integrator, scene, spp, seed, seeds):
    steady = []
    transient = []
    for k in range(seeds):
        image, cube = integrator.render(scene, scene.sensors()[0], seed=seed + k, spp=spp)
        steady.append(np.array(image, dtype=np.float64))
        transient.append(np.array(cube, dtype=np.float64))
    return np.stack(steady), np.stack(transient)


# ----------------------------------------------------------------------------------- phasors


def phasors(theirs, transient, frequency_hz, start_opl, bin_width_opl):
    before = transient.copy()
    result = theirs.transient_to_phasor(transient, frequency_hz, start_opl, bin_width_opl)
    return _unless_changed(result, before, transient)


def summed_channels(theirs, I, Q, frequency_hz):  # noqa: E741
    before = I + 1j * Q
    return _unless_changed(theirs.sum_channels(I, Q, frequency_hz), before, I + 1j * Q)


def _unless_changed(result, before, after):
    if not np.array_equal(before, after):
        raise ValueError("the arrays that were given have been changed")
    return result


# -------------------------------------------------------------------------------- relay wall


def on_wall(theirs, names, x, y):
    """Whether the points that rays from (x, y, 1) along -z meet are on the shapes of these names.

    Three squares of 2 m lie side by side in z = 0, their middles at x = -2, 0, 2.
    """
    parts = {}
    for name, middle in (("left", -2.0), ("middle", 0.0), ("right", 2.0)):
        matrix = np.eye(4)
        matrix[0, 3] = middle
        parts[name] = worlds.rectangle(matrix, worlds.diffuse(0.5))
    scene = worlds.load(parts)
    return _on(theirs, scene, names, x, y, 1.0)


def on_shapes(theirs, parts, names, x, y, z):
    """Mask of rays from (x, y, z) that hit the relay wall, for other scenes."""
    return _on(theirs, worlds.described(None, parts), names, x, y, z)


def _on(theirs, scene, names, x, y, z):
    wall = tuple(shape for name in names for shape in scene.shapes() if shape.id() == name)
    rays = mi.Ray3f(mi.Point3f(mi.Float(x), mi.Float(y), z), mi.Vector3f(0, 0, -1))
    mask = mi.Bool(theirs.is_on_relay_wall(scene.ray_intersect(rays), wall))
    dr.eval(mask)  # as long as the scene is there
    return mask


# ------------------------------------------------------------------------- fog and polarizers


def absorbed(theirs, transient, mu_a, start_opl, bin_width_opl):
    return theirs.absorb(transient, mu_a, start_opl, bin_width_opl)


def turns(theirs, xi, g):
    return theirs.sample_turn(xi, g)


def wandered(theirs, seed, mu_s, g, opl, count):
    """Positions, computed twice with equal seeds."""
    return [theirs.wander(np.random.default_rng(seed), mu_s, g, opl, count) for _ in range(2)]


def clouds(theirs, seed, mu_s, g, opl, count):
    """⟨z⟩, ⟨x²⟩, ⟨y²⟩, ⟨z²⟩ of clouds of other seeds, and the positions of one."""
    each = []
    for k in range(SEEDS):
        p = np.asarray(theirs.wander(np.random.default_rng(seed + k), mu_s, g, opl, count), float)
        if p.shape != (count, 3):
            raise ValueError(f"wander gave an array of shape {p.shape} for {count} photons")
        each.append([p[:, 2].mean(), *(p**2).mean(axis=0)])
    return np.array(each), p


def behind_polarizer(theirs, stokes, angle):
    return theirs.through_polarizer(stokes, angle)
