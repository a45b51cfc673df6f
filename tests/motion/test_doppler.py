"""Doppler time of flight against closed forms, numerical integrals, and poses at many times."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, diffuse, plane, point_light, rotate, translate, unit
from helpers.support import agree, camera, film, over_seeds, scene

import tofrender

C = 299792458.0
FREQUENCY, EXPOSURE = 30e6, 1.5e-3
ω = 2 * np.pi * FREQUENCY
WAVEFORMS = {  # Coefficient of cos(k φ): of a triangle and of a rectangle of amplitude 1
    "sine": {1: 1.0},
    "triangle": {k: 8 / (np.pi * k) ** 2 for k in (1, 3, 5, 7)},
    "rectangle": {k: 4 / (np.pi * k) * (-1) ** (k // 2) for k in (1, 3, 5, 7)},
}


def measured(described, **more) -> tuple[np.ndarray, np.ndarray]:
    """Return homodyne and heterodyne, I + i Q of each pixel, means of the channels."""
    more = {"spp": 16, "frequency_hz": FREQUENCY, "exposure_s": EXPOSURE} | more
    found = tofrender.doppler(described, progress=False, **more)
    both = (found[name].mean("channel").astype(float) for name in ("homodyne", "heterodyne"))
    return tuple((each.sel(part="I") + 1j * each.sel(part="Q")).values for each in both)


def panel(v: float, at: float = 3.0) -> dict:
    """A lamp that fills the picture of a narrow camera and moves away from it: constant light."""
    lamp = plane(translate(0, 0, -at), emitter=area_light(2.0), velocity=[0.0, 0.0, -v])
    return scene({"lamp": lamp}, camera((0, 0, 0), (0, 0, -1), film(2, 2), fov=0.1), max_depth=1)


def wall(v: float, at: float = 3.0) -> dict:
    """A wall in front of camera and lamp, which are in one place: light falls off as z^-2."""
    parts = {
        "wall": plane(translate(0, 0, -at), bsdf=diffuse(0.5), velocity=[0.0, 0.0, -v]),
        "lamp": point_light((0, 0, 0), 3.0),
    }
    return scene(parts, camera((0, 0, 0), (0, 0, -1), film(2, 2), fov=0.1), max_depth=2)


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("v", [12.0, -12.0, 400.0, -400.0])
def test_constant_light(v, n):
    """Heterodyne over homodyne is x / (n π + x); at 30 MHz and 12 m/s x is .0056486."""
    x = ω * v * EXPOSURE / (2 * C)
    homodyne, heterodyne = measured(panel(v), cycles=n)
    np.testing.assert_allclose(heterodyne / homodyne, x / (n * np.pi + x), atol=3e-7, rtol=1e-4)
    phase = ω * (3.0 + v * EXPOSURE / 2) / C
    np.testing.assert_allclose(homodyne, 2 * np.exp(1j * phase) * np.sinc(x / np.pi), rtol=1e-5)


@pytest.mark.parametrize(("v", "cycles"), [(-90.0, 3), (35.0, 2), (12.0, 1)])
def test_rates_do_not_depend_on_the_number_of_cycles(v, cycles):
    settings = {"frequency_hz": FREQUENCY, "exposure_s": EXPOSURE, "cycles": cycles}
    found = tofrender.doppler(panel(v), spp=4, progress=False, **settings)
    assert tofrender.doppler_rate(found).values == pytest.approx(np.full((2, 2), v), rel=2e-3)


def test_light_of_the_sensor_s_frequency():
    """At V = -c n / (f T) light has the sensor's frequency: heterodyne is constant in time."""
    v = -C / (FREQUENCY * EXPOSURE)
    for each in (v, v * (1 + 1e-6), v + 0.5, v - 0.5):
        _, heterodyne = measured(panel(each, at=30.0))
        phase = ω * (30 + each * EXPOSURE / 2) / C + np.pi
        u = np.pi + ω * each * EXPOSURE / (2 * C)
        expected = 2 * np.exp(1j * phase) * np.sinc(u / np.pi)
        np.testing.assert_allclose(heterodyne, expected, atol=1e-3)


def test_the_number_of_the_formula():
    """30 MHz, V 12 m/s, T 1.5 ms, n 1: .00179801 less the share that x has in the denominator."""
    homodyne, heterodyne = measured(panel(12.0))
    x = ω * 12 * EXPOSURE / (2 * C)
    assert x / (np.pi + x) == pytest.approx(0.00179801, rel=1e-4)
    np.testing.assert_allclose((heterodyne / homodyne).real, 0.00179801, rtol=3e-4)


def test_light_that_drifts():
    """Falloff as z^-2 adds -ε/(2π) to the imaginary part, with ε = -2 v T / z."""
    v = 6.0
    x, ε = ω * 2 * v * EXPOSURE / (2 * C), -2 * v * EXPOSURE / (3 + v * EXPOSURE / 2)
    homodyne, heterodyne = measured(wall(v))
    ratio = heterodyne / homodyne
    np.testing.assert_allclose(ratio.imag, -ε / (2 * np.pi), rtol=5e-3)
    np.testing.assert_allclose(ratio.real, x / (np.pi + x), rtol=5e-3)


@pytest.mark.parametrize("waveform", WAVEFORMS)
@pytest.mark.parametrize("v", [6.0, -100.0, 250.0])
def test_numerical_integral(waveform, v):
    """Light of a receding wall times the sensor's modulation, step by step in time."""
    n, steps = 2, 20000
    t = (np.arange(steps) + 0.5) / steps
    z = 3 + v * t * EXPOSURE
    light = 3 * 0.5 / np.pi / z**2

    def correlated(cycles: int) -> complex:
        φ = 2 * np.pi * cycles * t + ω * 2 * z / C
        waves = WAVEFORMS[waveform].items()
        i, q = (
            sum(a * np.cos(k * (φ - lag)) for k, a in waves) @ light / steps
            for lag in (0, np.pi / 2)
        )
        return i + 1j * q

    homodyne, heterodyne = measured(wall(v), cycles=n, waveform=waveform)
    drift = (2 * v * EXPOSURE / 3) ** 2  # Light is linear in time between two poses there
    scale = abs(correlated(0))
    np.testing.assert_allclose(homodyne, correlated(0), atol=scale * (1e-5 + drift / 8))
    np.testing.assert_allclose(heterodyne, correlated(n), atol=scale * (3e-6 + drift / 8))


def still(kind: str) -> dict:
    """Scenes at rest: with an area lamp, mirrors and glass, or fog."""
    made = {
        "lamp": tofrender.cornell_box(width=8, height=8),
        "mirror": tofrender.scenes.cornell_box_mirror(width=8, height=8),
        "glass": tofrender.scenes.cornell_box_glass(width=8, height=8),
        "fog": tofrender.scenes.cornell_box_fog(width=8, height=8),
    }[kind]
    return made


@pytest.mark.parametrize("waveform", WAVEFORMS)
@pytest.mark.parametrize("kind", ["lamp", "mirror", "glass", "fog"])
def test_still_scenes_are_dark(kind, waveform):
    homodyne, heterodyne = measured(still(kind), waveform=waveform, spp=64)
    assert np.abs(homodyne).min() > 0
    assert np.all(heterodyne == 0)


@pytest.mark.parametrize("integrator", ["transient_light_tracer", "transient_bdpt"])
def test_still_scenes_are_dark_from_lamps(integrator):
    """Up to rounding of sums, whose order differs from one render to the next where paths splat."""
    homodyne, heterodyne = measured(still("lamp"), integrator=integrator, spp=64)
    assert np.abs(homodyne).max() > 0
    assert np.abs(heterodyne).max() < 1e-6 * np.abs(homodyne).max()


def corner() -> mi.Scene:
    """A corner where floor, wall, lamp and camera move, with light of two bounces."""
    wall = {"velocity": [0.0, 0.0, -16.0], "angular_velocity": [4.0, 2.0, 0.0]}
    wall |= {"rotation_center": [0.0, 0.0, 0.0]}
    parts = {
        "floor": plane(rotate((1, 0, 0), -90), bsdf=diffuse(0.6), velocity=[2.0, 12.0, 0.0]),
        "wall": plane(translate(0, 0, -2), bsdf=diffuse(0.7), **wall),
        "lamp": point_light((0.8, 1.5, 0.6), 3.0) | {"velocity": [10.0, -6.0, 0.0]},
    }
    view = camera((0, 1, 3), (0, 0.5, 0), film(4, 4), fov=40, velocity=[0.0, 0.0, -8.0])
    return tofrender.load_scene(scene(parts, view, max_depth=3))


def by_poses(loaded: mi.Scene, seed: int, spp: int, times: int = 8) -> np.ndarray:
    """Return hetero- over homodyne of the picture by phasors of poses, all of the same seed.

    Of light that is linear in time, the sum is too large by (π/N) / sin(π/N).
    """
    total = {0: 0j, 1: 0j}
    for share in (np.arange(times) + 0.5) / times:
        with tofrender.posed(loaded, share * EXPOSURE) as there:
            eye = there.sensors()[0]
            i, q, *_ = tofrender.render_amcw_phasor(there, eye, FREQUENCY, spp=spp, seed=seed)
        phasor = (np.array(i, float) + 1j * np.array(q, float)).sum()
        for n in total:
            total[n] += phasor * np.exp(2j * np.pi * n * share)
    ratio = total[1] / total[0] * np.sin(np.pi / times) / (np.pi / times)
    return np.array([ratio.real, ratio.imag])


def by_doppler(loaded: mi.Scene, seed: int, spp: int) -> np.ndarray:
    homodyne, heterodyne = measured(loaded, spp=spp, seed=seed)
    ratio = heterodyne.sum() / homodyne.sum()
    return np.array([ratio.real, ratio.imag])


def sloped(v) -> tuple[dict, np.ndarray]:
    """A sloped wall before a camera with a lamp, and its normal."""
    tilt = rotate(unit((1, 0.5, 0)), 35)
    parts = {
        "wall": plane(translate(0, 0, -3) @ tilt, bsdf=diffuse(0.5), velocity=list(v)),
        "lamp": point_light((0, 0, 0), 3.0),
    }
    view = camera((0, 0, 0), (0, 0, -1), film(4, 4), fov=20)
    return scene(parts, view, max_depth=2), unit(np.array(tilt.matrix)[:3, 2])


@pytest.mark.parametrize("v", [(4.0, -3.0, 2.0), (0.0, 0.0, -12.0)])
def test_rate_of_a_sloped_wall(v):
    """Pixels see the wall's point that moves along their ray: V = 2 v·n/(d·n)."""
    described, normal = sloped(v)
    found = tofrender.doppler(described, spp=64, progress=False)
    rate = tofrender.doppler_rate(found).values
    loaded = tofrender.load_scene(described)
    k = dr.arange(mi.UInt32, 16)
    at = mi.Point2f((k % 4 + 0.5) / 4, (k // 4 + 0.5) / 4)
    ray, _ = loaded.sensors()[0].sample_ray(0, 0.5, at, 0.5)
    d = np.array(ray.d).T
    expected = (2 * (np.asarray(v) @ normal) / (d @ normal)).reshape(4, 4)
    np.testing.assert_allclose(rate, expected, rtol=0.01)


def test_rate_is_nan_without_light():
    described = wall(5.0)
    described["wall"] |= {"to_world": translate(50, 0, 0)}
    rate = tofrender.doppler_rate(tofrender.doppler(described, spp=4, progress=False))
    assert np.isnan(rate.values).all()


def test_poses_of_many_times():
    """Phasors at eight times, a method without rates, agree with two poses and rates.

    Seeds are the same, so that the difference of the two has little noise.
    """
    loaded = corner()
    found = over_seeds(lambda seed: by_doppler(loaded, seed, 1024), range(8))
    expected = over_seeds(lambda seed: by_poses(loaded, seed, 1024), range(8))
    size = np.linalg.norm(expected.mean(0))
    assert size > 0.01
    assert agree(1 + (found - expected) / size, np.ones(2), rounding=0.01)
