"""What the tests ask of a submission; runs in the submission's process."""

from __future__ import annotations

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
    # A constant may be one number for all lanes, but has to be an array of Dr.Jit
    return {
        "t": mi.Float(t),
        "weight": mi.Float(weight) + dr.zeros(mi.Float, len(xi)),
        "is_array": dr.is_array_v(weight),
    }


def defines(theirs, name):
    """Load it, or say why not."""
    getattr(theirs, name)


def check_pulse(theirs, name, width_opl):
    """What their test says of a pulse of `pulses_to_check`."""
    return trials.verdict(theirs.check_pulse, getattr(pulses_to_check, name)(width_opl))


def try_pulse(theirs, name, text):
    """What their test says of a solution of a2.gaussian_pulse."""
    made = trials.load(name, text)
    return trials.verdict(theirs.check_pulse, made.GaussianPulse(width_opl=0.05))


def modulation(theirs, frequency_hz, phase_offset, opl):
    """Its values and numbers."""
    wave = theirs.AMCWPulse(frequency_hz=frequency_hz, phase_offset=phase_offset)
    return {
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
    """What `sample` returns along one ray, for each target time: shape (times,)."""
    scene = world(scene, view)
    integrator = _gated(theirs, pulse, max_depth=max_depth)
    o, d = mi.Point3f(origin), dr.normalize(mi.Point3f(target) - mi.Point3f(origin))
    ray = mi.Ray3f(o + dr.zeros(mi.Float, 16), mi.Vector3f(d) + dr.zeros(mi.Float, 16))
    values = []
    for time in times:
        sampler = mi.load_dict({"type": "independent", "sample_count": 16})
        sampler.seed(0, 16)
        spec, _, _ = integrator.sample(scene, sampler, ray, float(time))
        values.append(float(np.mean(np.array(mi.Color3f(spec).x + dr.zeros(mi.Float, 16)))))
    return values


def gate_image(theirs, scene, view, time, pulse, spp, seed, max_depth=2):
    """Images of `render_at_time`, shape (seeds, height, width, 3)."""
    scene = world(scene, view)
    integrator, sensor = _gated(theirs, pulse, max_depth=max_depth), scene.sensors()[0]
    return over_seeds(
        lambda s: theirs.render_at_time(scene, integrator, sensor, time, spp=spp, seed=s), seed
    )


def gates(theirs, scene, view, bins, pulse, spp, seed, max_depth, **options):
    """Cubes of `render_transient`, shape (seeds, height, width, bins, 3)."""
    scene = world(scene, view, **options)
    integrator, sensor = _gated(theirs, pulse, max_depth=max_depth), scene.sensors()[0]
    names = ("temporal_bins", "start_opl", "bin_width_opl")
    config = dict(zip(names, (int(bins[0]), float(bins[1]), float(bins[2])), strict=True))
    return over_seeds(
        lambda s: theirs.render_transient(scene, integrator, sensor, config, spp=spp, seed=s), seed
    )


def kernels_of_gates(theirs, view, numbers):
    """How many kernels `render_transient` launches for each number of gates."""
    scene = world("lamp", view)
    integrator, sensor = _gated(theirs, ("hat", 0.1), max_depth=3), scene.sensors()[0]
    counts = []
    for number in numbers:
        config = {"temporal_bins": int(number), "start_opl": 3.0, "bin_width_opl": 0.02}
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            theirs.render_transient(scene, integrator, sensor, config, spp=16, seed=0)
            counts.append(len(dr.kernel_history((dr.KernelType.JIT,))))
    return counts


# -------------------------------------------------------------------------------------- AMCW


def amcw_along_ray(theirs, scene, view, origin, target, ramps, max_depth):
    """What `sample` returns along one ray, for each modulation (at zero, slope [1/m])."""
    scene = world(scene, view)
    integrator = theirs.AMCWTransientPath(properties(max_depth=max_depth))
    o, d = mi.Point3f(origin), dr.normalize(mi.Point3f(target) - mi.Point3f(origin))
    ray = mi.Ray3f(o + dr.zeros(mi.Float, 16), mi.Vector3f(d) + dr.zeros(mi.Float, 16))
    values = []
    for ramp in ramps:
        sampler = mi.load_dict({"type": "independent", "sample_count": 16})
        sampler.seed(0, 16)
        integrator.set_modulation(worlds.Ramp(*ramp))
        spec, _, _ = integrator.sample(scene, sampler, ray)
        values.append(float(np.mean(np.array(mi.Color3f(spec).x + dr.zeros(mi.Float, 16)))))
    return values


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
    """(steady, bins) of `TransientPath`, seeds in front."""
    scene = world(scene, view, **options)
    integrator = theirs.TransientPath(properties(max_depth=max_depth))
    integrator.pulse = worlds.pulse(*pulse)
    return _render(integrator, scene, spp, seed, seeds)


def confocal(theirs, scene, view, spp, seed, seeds=SEEDS, integrator=None, **options):
    """(steady, bins) of `ConfocalTransientIntegrator`, seeds in front."""
    scene = world(scene, view, **options)
    tracer = theirs.ConfocalTransientIntegrator(properties(**(integrator or {})))
    return _render(tracer, scene, spp, seed, seeds)


def _render(integrator, scene, spp, seed, seeds):
    steady, transient = [], []
    for k in range(seeds):
        image, cube = integrator.render(scene, scene.sensors()[0], seed=seed + k, spp=spp)
        steady.append(np.array(image, dtype=np.float64))
        transient.append(np.array(cube, dtype=np.float64))
    return np.stack(steady), np.stack(transient)


# ----------------------------------------------------------------------------------- phasors


def phasors(theirs, transient, frequency_hz, start_opl, bin_width_opl):
    return theirs.transient_to_phasor(transient, frequency_hz, start_opl, bin_width_opl)


def summed_channels(theirs, I, Q, frequency_hz):  # noqa: E741
    return theirs.sum_channels(I, Q, frequency_hz)


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
    wall = [shape for name in names for shape in scene.shapes() if shape.id() == name]
    rays = mi.Ray3f(mi.Point3f(mi.Float(x), mi.Float(y), 1), mi.Vector3f(0, 0, -1))
    return mi.Bool(theirs.is_on_relay_wall(scene.ray_intersect(rays), wall))
