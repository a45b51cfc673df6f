"""Connections that look for light of a gate's length: the same mean, and less noise."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES
from helpers.scenes import numbers
from helpers.support import agree, over_seeds, with_sampler

import tofrender
from tofrender.paths.endpoints import GatedLights, SceneLights
from tofrender.paths.records import Path, Vertex
from tofrender.paths.space import Vacuum

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")

GATES = {"temporal_bins": 3, "start_opl": 3.75, "bin_width_opl": 1.5}  # At 4.5, 6 and 7.5 m

FLOOR = 0.01
"""Added to all values [1/m]: makes the far tails of a pulse, which few paths find, rounding."""


def gated(**parameters) -> mi.Object:
    plugin = {"type": "time_gated_transient_path", "pulse_width_opl": 0.1, **parameters}
    return mi.load_dict(plugin, parallel=False)


def quarters(image: np.ndarray) -> np.ndarray:
    """Means over the four quarters of a picture: noise falls, errors in space stay."""
    height, width, channels = image.shape
    return image.reshape(2, height // 2, 2, width // 2, channels).mean(axis=(1, 3))


@pytest.mark.parametrize("name", SCENES)
def test_single_gates_agree_with_all_gates(name):
    """`render_transient` connects without looking at lengths."""
    loaded = tofrender.load_scene(SCENES[name]())
    sensor = loaded.sensors()[0]
    integrator = gated(max_depth=6)

    def all_gates(seed):
        cube = tofrender.render_transient(loaded, integrator, sensor, GATES, spp=32, seed=seed)
        return FLOOR + np.stack([quarters(cube[:, :, k]) for k in range(3)])

    def each_gate(seed):
        images = (
            tofrender.render_at_time(loaded, integrator, sensor, opl, spp=32, seed=seed)
            for opl in (4.5, 6.0, 7.5)
        )
        return FLOOR + np.stack([quarters(image) for image in images])

    reference = over_seeds(all_gates, range(100, 124))
    assert agree(over_seeds(each_gate, range(24)), reference)


@pytest.mark.parametrize("name", [name for name in SCENES if name != "rough glass"])
def test_connections_agree_and_are_as_long_as_the_bound(name):
    """Irradiance through a gate from each light, and `nearest` below every length."""
    loaded = tofrender.load_scene(SCENES[name]())
    gate = tofrender.GaussianPulse(0.2)
    opl, η, lanes = mi.Float(3.0), mi.Float(1.25), 4096
    looking = GatedLights(loaded, None, lambda length: gate.eval(5.0 - length))

    def irradiance(lights, seed):
        sampler = numbers(seed, lanes)
        si = dr.zeros(mi.SurfaceInteraction3f, lanes)
        aside = mi.Point3f(*(sampler.next_1d() for _ in range(3)))
        si.p = mi.Point3f(0.1, -0.9, 0.8) + 0.1 * aside
        si.n = mi.Normal3f(0, 1, 0)
        si.sh_frame = mi.Frame3f(si.n)
        path = Path.start(mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, -1, 0)))
        path.opl, path.η = opl, η
        vertex = Vertex(si, mi.Float(0), mi.Bool(True))
        em = lights.connect(vertex, path, sampler, mi.Bool(True))
        em.weight *= Vacuum(loaded).transmittance(path, vertex, em, sampler).value
        assert dr.all(~em.active | (em.length >= lights.min_distance(si.p) - 1e-5))
        cos = dr.maximum(dr.dot(em.direction, si.n), 0)
        value = dr.mean(em.weight) * cos * gate.eval(5.0 - dr.fma(η, em.length, opl))
        return np.array(dr.mean(dr.select(em.active, value, 0)))

    reference = over_seeds(lambda seed: irradiance(SceneLights(loaded), seed), range(50, 82))
    values = over_seeds(lambda seed: irradiance(looking, seed), range(32))
    assert agree(values, reference) if np.any(reference) else not np.any(values)


@pytest.mark.parametrize(("opl", "less"), [(5.2, 4.0), (5.9, 2.0), (6.7, 1.5)])
def test_less_noise_at_equal_samples(opl, less):
    """The variance of one gate's picture against the same gate of a trace for all gates."""
    described = tofrender.cornell_box(width=48, height=48)
    loaded = tofrender.load_scene(with_sampler(described, "padded_sobol"))
    sensor = loaded.sensors()[0]
    integrator = gated(pulse_width_opl=0.03)
    gates = {"temporal_bins": 1, "start_opl": opl - 0.01, "bin_width_opl": 0.02}
    at = loaded, integrator, sensor
    all_gates, one = (
        over_seeds(render, range(8)).var(axis=0, ddof=1).mean()
        for render in (
            lambda seed: tofrender.render_transient(*at, gates, 16, seed)[:, :, 0],
            lambda seed: tofrender.render_at_time(*at, opl, 16, seed),
        )
    )
    assert all_gates > less * one
