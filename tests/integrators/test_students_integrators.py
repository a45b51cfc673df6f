"""Integrators that students write: their own `sample` makes the picture, or a line says why not.

Classes here have the form of the assignment's text: `sample` takes (scene, sampler, ray,
target_time, medium, active), with a modulation no target time; it returns (color, valid, aovs).
"""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, plane
from helpers.support import camera, film, load, refused, scene

import tofrender

DISTANCE = 3.0
RADIANCE = 2.0
GATES = {"temporal_bins": 3, "start_opl": 2.5, "bin_width_opl": 0.5}


def lamp(width: int = 4, height: int = 2) -> mi.Scene:
    """A lamp that fills an orthographic picture of 2 m x 1 m, all of it at 3 m."""
    to_world = mi.ScalarTransform4f().look_at([0, 0, DISTANCE], [0, 0, 0], [0, 1, 0])
    sensor = camera((0, 0, DISTANCE), (0, 0, 0), film(width, height), kind="orthographic")
    sensor |= {"near_clip": 1e-3, "to_world": to_world}
    return load(scene({"lamp": plane(emitter=area_light(RADIANCE))}, sensor))


class StudentPulse:
    """A Gaussian as the assignment asks for it: `eval` and `sample`, nothing else."""

    def __init__(self, width_opl: float) -> None:
        self.width_opl = width_opl

    def eval(self, t):
        z = t / self.width_opl
        return dr.exp(-0.5 * z * z) / (self.width_opl * math.sqrt(2 * math.pi))

    def sample(self, xi):
        u = dr.clip(2 * xi - 1, -1 + 1e-6, 1 - 1e-6)
        return self.width_opl * math.sqrt(2) * dr.erfinv(u), mi.Float(1)


class Seven(tofrender.TimeGatedTransientPath):
    def sample(self, scene, sampler, ray, target_time, medium=None, active=True):
        return mi.Spectrum(7.0), mi.Bool(True), []


class Twice(tofrender.TimeGatedTransientPath):
    def sample(self, scene, sampler, ray, target_time, medium=None, active=True):
        spectrum, valid, aovs = super().sample(scene, sampler, ray, target_time, medium, active)
        return 2 * spectrum, valid, aovs


class Half(tofrender.TimeGatedTransientPath):
    """Only the upper half of the picture is valid."""

    def sample(self, scene, sampler, ray, target_time, medium=None, active=True):
        return mi.Spectrum(4.0) + 0 * ray.o.x, ray.o.y > 0, []


class Gated(mi.SamplingIntegrator):
    """Nothing of the package: a loop over emitters that rays run into, through a pulse."""

    def __init__(self, props=None):
        super().__init__(mi.Properties() if props is None else props)
        self.max_depth = 8
        self.pulse = StudentPulse(0.5)

    @dr.syntax
    def sample(self, scene, sampler, ray, target_time, medium=None, active=True):
        result = mi.Color3f(0.0)
        ray = mi.Ray3f(ray)
        active = mi.Bool(active)
        path_length = mi.Float(0.0)
        depth = mi.UInt32(0)
        while dr.hint(active, max_iterations=self.max_depth, label="Path"):
            si = scene.ray_intersect(ray, active)
            active &= si.is_valid()
            path_length[active] += si.t
            Le = si.emitter(scene).eval(si, active)
            result[active] += Le * self.pulse.eval(target_time - path_length)
            bs, _ = si.bsdf().sample(
                mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), active
            )
            ray = si.spawn_ray(si.to_world(bs.wo))
            depth += 1
            active &= depth < self.max_depth
        return result, mi.Bool(True), []


class Correlated(mi.SamplingIntegrator):
    """The same for a modulation."""

    def __init__(self, props=None):
        super().__init__(mi.Properties() if props is None else props)
        self.amcw = None

    def set_modulation(self, amcw_pulse):
        self.amcw = amcw_pulse

    def sample(self, scene, sampler, ray, medium=None, active=True):
        si = scene.ray_intersect(ray, active)
        Le = si.emitter(scene).eval(si, active)
        return mi.Color3f(Le * self.amcw.eval(si.t)), mi.Bool(True), []


class Columns(Correlated):
    """Where rays start along x, whatever the modulation."""

    def sample(self, scene, sampler, ray, medium=None, active=True):
        return mi.Color3f(ray.o.x + 2, ray.o.y + 2, 0), mi.Bool(True), []


class SevenCorrelated(tofrender.AMCWTransientPath):
    def sample(self, scene, sampler, ray, medium=None, active=True):
        return mi.Spectrum(7.0), mi.Bool(True), []


def made(kind: type) -> mi.Object:
    return kind(mi.Properties())


def at(integrator, opl: float = DISTANCE, spp: int = 16, loaded: mi.Scene | None = None):
    loaded = loaded or lamp()
    return tofrender.render_at_time(loaded, integrator, loaded.sensors()[0], opl, spp=spp)


def correlated(integrator, spp: int = 16) -> np.ndarray:
    loaded = lamp()
    return tofrender.render_single_amcw(loaded, integrator, loaded.sensors()[0], spp)


def test_an_overridden_sample_makes_the_picture():
    assert at(made(Seven)) == pytest.approx(np.full((2, 4, 3), 7.0))
    integrator = made(SevenCorrelated)
    integrator.set_modulation(tofrender.AMCWPulse(20e6))
    assert correlated(integrator) == pytest.approx(np.full((2, 4, 3), 7.0))


def test_an_overridden_sample_can_use_the_one_that_it_overrides():
    """At its arrival, the lamp has the peak of the pulse, times two."""
    integrator = made(Twice)
    integrator.pulse = tofrender.GaussianPulse(0.5)
    peak = RADIANCE / (0.5 * math.sqrt(2 * math.pi))
    assert at(integrator) == pytest.approx(np.full((2, 4, 3), 2 * peak), rel=1e-3)


def test_lanes_that_are_not_valid_are_black():
    image = at(made(Half))
    assert sorted(image[:, 0, 0].tolist()) == [0, 4]
    assert np.ptp(image, axis=(1, 2)).max() == 0


def test_an_integrator_of_the_text_alone():
    """Radiance times the pulse, at times before, at and after the light's arrival."""
    for opl in (2.6, 3.0, 3.3):
        pulse = math.exp(-0.5 * ((opl - DISTANCE) / 0.5) ** 2) / (0.5 * math.sqrt(2 * math.pi))
        assert at(Gated(), opl) == pytest.approx(np.full((2, 4, 3), RADIANCE * pulse), rel=5e-3)


def test_integrators_with_a_sample_see_one_gate_or_one_modulation():
    """All gates, and phasors, are refused: they would be of something else."""
    loaded = lamp()
    sensor = loaded.sensors()[0]
    for integrator in (Gated(), made(Twice)):
        integrator.pulse = StudentPulse(0.5)
        text = "which supports one time gate"
        refused(text, tofrender.render_transient, loaded, integrator, sensor, GATES, spp=16)
    text, options = "which supports one modulation", {"integrator": Correlated()}
    refused(text, tofrender.render_amcw_phasor, loaded, sensor, 20e6, spp=16, **options)


def test_a_pulse_needs_only_its_density_for_a_gate():
    """`eval` is all that a single gate uses."""
    images = []
    for pulse in (tofrender.GaussianPulse(0.5), StudentPulse(0.5)):
        integrator = made(tofrender.TimeGatedTransientPath)
        integrator.pulse = pulse
        images.append(at(integrator, 3.2))
    assert images[0].min() > 0
    assert images[1] == pytest.approx(images[0], rel=1e-4)


@pytest.mark.parametrize("render", [lambda i: at(i), lambda i: correlated(i)])
def test_what_cannot_sample_is_refused_in_a_line(render):
    for integrator in (object(), None, "path", lambda: None):
        refused(r"integrator.*sample", render, integrator)
    # Mitsuba's `path` has a `sample`, which knows neither gate nor modulation
    refused("integrator", render, mi.load_dict({"type": "path"}))


def test_a_pulse_without_a_density_is_refused_in_a_line():
    integrator = made(tofrender.TimeGatedTransientPath)

    def use():
        integrator.pulse = object()
        at(integrator)

    refused(r"pulse.*eval", use)


@pytest.mark.parametrize("offset", [0.0, -math.pi / 2])
def test_a_correlating_integrator_of_the_text_alone(offset):
    integrator = Correlated()
    modulation = tofrender.AMCWPulse(20e6, offset)
    integrator.set_modulation(modulation)
    expected = RADIANCE * math.cos(modulation.omega * DISTANCE / 299792458 + offset)
    found = correlated(integrator)
    assert found == pytest.approx(np.full((2, 4, 3), expected), rel=5e-3)


def test_each_pixel_has_its_own_samples():
    """Means over the pixels' own rays: columns and rows in the picture's order."""
    image = correlated(Columns(), spp=1024)
    assert image[..., 0] == pytest.approx(np.broadcast_to(image[:1, :, 0], (2, 4)), abs=0.02)
    steps = np.diff(image[0, :, 0])
    assert np.abs(steps) == pytest.approx(np.full(3, 0.5), abs=0.03)
    assert image[0, 0, 1] - image[1, 0, 1] == pytest.approx(0.5, abs=0.03)
