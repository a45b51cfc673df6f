"""Gates, correlations and phasors: one trace, and the same light as the bins hold."""

# ruff: noqa: E741 (I is the field's name for the part in phase)

import math
from functools import partial

import mitsuba as mi
import numpy as np
import pytest
from helpers.limits import lower
from helpers.parts import diffuse, gray, plane, point_light, rotate, translate
from helpers.support import camera, film, load, refused, scene, with_integrator

import tofrender
from tofrender.films.phasor import fourier_transform, parse_frequencies
from tofrender.runtime import memory
from tofrender.signals.modulations import AMCWPulse
from tofrender.signals.pulses import GaussianPulse, SampledPulse

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")

C = 299_792_458.0
GATES = {"temporal_bins": 120, "start_opl": 3.0, "bin_width_opl": 0.1}
FREQUENCIES = [20e6, 50e6, 100e6]


def box(**options) -> mi.Scene:
    size = {"width": 32, "height": 32} | options
    # Gates and phasors are of the same paths as bins, with a connection each
    return tofrender.load_scene(with_integrator(tofrender.cornell_box(**size), light_samples=1))


def gated(**parameters) -> mi.Object:
    plugin = {"type": "time_gated_transient_path", "pulse_width_opl": 0.1, **parameters}
    return mi.load_dict(plugin, parallel=False)


PEAK = 1 / (0.1 * math.sqrt(2 * math.pi))  # Of the pulse of a gate


def one_path(color=(1.0, 1.0, 1.0)):
    """A point light and a plane: exactly one path. Returns scene, its length and radiance."""
    white = {"type": "rgb", "value": [0.5 * each for each in color]}
    floor = plane(size=10, bsdf={"type": "diffuse", "reflectance": white})
    parts = {"floor": floor, "lamp": point_light((0, 0, 1.5), 3.0)}
    loaded = load(scene(parts, camera((0, 0, 2.0), (0, 0, 0), film(), fov=1e-3)))
    return loaded, 3.5, 0.5 / math.pi * 3.0 / 1.5**2


def test_one_path_through_a_gate():
    """Form a: L p(t - opl), a density."""
    loaded, opl, radiance = one_path()
    for offset in (-0.15, 0.0, 0.05, 0.2):
        image = tofrender.render_at_time(loaded, gated(), loaded.sensors()[0], opl + offset, spp=4)
        expected = radiance * PEAK * math.exp(-0.5 * (offset / 0.1) ** 2)
        assert image[0, 0] == pytest.approx([expected] * 3, rel=2e-4), offset


@pytest.mark.parametrize(("start", "target"), [(-3.0, 1.8), (0.5, 5.3)])
def test_gates_of_pulses_that_begin_away_from_0(start, target):
    """The gate sees L p(t - opl). The pulse rises before or after its 0."""
    loaded, opl, radiance = one_path(color=(0.3, 0.6, 1.0))
    integrator = gated()
    integrator.pulse = SampledPulse([1.0, 2.0, 5.0], start_opl=start, bin_width_opl=0.9)
    image = tofrender.render_at_time(loaded, integrator, loaded.sensors()[0], target, spp=4)
    density = np.array([1.0, 2.0, 5.0])[int((target - opl - start) / 0.9)] / (8 * 0.9)
    assert image[0, 0] == pytest.approx(radiance * density * np.array([0.3, 0.6, 1.0]), rel=1e-4)


def test_all_gates_are_one_trace():
    """With a seed, every gate of `render_transient` is that gate's own render.

    Paths that are too long for a gate are left out of its own render: they count for nothing.
    Without connections, because a single gate's look for light that comes in time.
    """
    loaded = box(light="area")
    hits = gated(emitter_sampling=False)
    cube = tofrender.render_transient(loaded, hits, loaded.sensors()[0], GATES, spp=64)
    assert cube.shape == (32, 32, 120, 3)
    for k in (5, 10, 25, 40, 60, 100):
        target = 3.0 + (k + 0.5) * 0.1
        image = tofrender.render_at_time(loaded, hits, loaded.sensors()[0], target, spp=64)
        np.testing.assert_allclose(cube[:, :, k], image, atol=2e-5 * cube.max())
    assert float(gated().gate(5.0).closes[0]) == pytest.approx(5.5)


def test_gates_are_the_histogram_convolved():
    loaded = box(width=16, height=16, temporal_bins=12000, start_opl=3.0, bin_width_opl=0.001)
    fine = tofrender.render(loaded, spp=16, progress=False)
    cube = tofrender.render_transient(loaded, gated(), loaded.sensors()[0], GATES, spp=16)
    times = 3.0 + (np.arange(120) + 0.5) * 0.1
    kernel = np.exp(-0.5 * ((times[:, None] - fine.opl.values) / 0.1) ** 2)
    kernel /= 0.1 * math.sqrt(2 * math.pi)
    expected = np.einsum("kt,yxtc->yxkc", kernel, fine.transient.values.astype(np.float64))
    # An arrival is half a fine bin off its center at most, times the pulse's steepest slope
    assert np.abs(cube - expected).max() < 0.0005 / 0.1 * math.exp(-0.5) * expected.max()


def test_stored_target_time_under_mitsubas_render():
    described = tofrender.cornell_box_steady_state(width=32, height=32)
    described["integrator"] = {"type": "time_gated_transient_path", "target_time": 5.9}
    loaded = mi.load_dict(described)
    image = np.array(mi.render(loaded, spp=16, seed=2))
    expected = tofrender.render_at_time(
        loaded, loaded.integrator(), loaded.sensors()[0], 5.9, spp=16, seed=2
    )
    np.testing.assert_allclose(image, expected, rtol=1e-4, atol=1e-6)
    without = mi.load_dict({"type": "time_gated_transient_path"}, parallel=False)
    refused("target_time is None. Set target_time", without.render, loaded, spp=1)


def test_the_call_of_the_text():
    """`sample(scene, sampler, ray, target_time, medium=None, active=True)`."""
    loaded, opl, radiance = one_path()
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 1)
    ray = mi.Ray3f(mi.Point3f(0, 0, 2), mi.Vector3f(0, 0, -1))
    integrator = gated(target_time=0.5)  # The one that is given counts
    spec, valid, aovs = integrator.sample(loaded, sampler, ray, opl, medium=None, active=True)
    assert spec.x[0] == pytest.approx(radiance * PEAK, rel=1e-4)
    assert valid[0]
    assert aovs == []


@pytest.mark.parametrize(
    ("config", "text"),
    [
        ({"temporal_bins": 3, "start_opl": 0.0}, "start_opl': 0.0}: bin_width_opl is missing"),
        (GATES | {"bins": 3}, "film_config key = 'bins': "),
        (GATES | {"temporal_bins": 0}, "temporal_bins = 0:"),
        (GATES | {"bin_width_opl": math.nan}, "bin_width_opl = nan:"),
    ],
)
def test_bad_film_config(config, text):
    loaded = box()
    refused(text, tofrender.render_transient, loaded, gated(), loaded.sensors()[0], config)


def test_what_cannot_be_measured_is_refused_in_a_line():
    loaded = box()
    sensor = loaded.sensors()[0]
    for target in (-1.0, math.nan, "soon"):
        refused("target_time = ", tofrender.render_at_time, loaded, gated(), sensor, target)
    correlating = mi.load_dict({"type": "amcw_transient_path"}, parallel=False)
    one = tofrender.render_single_amcw
    refused("modulation is None. Set a modulation", one, loaded, correlating, sensor, 4)
    refused("modulation = 3:", correlating.set_modulation, 3)
    correlating.set_modulation(AMCWPulse(2e7))
    bad_film = "film = TransientHDRFilm:"
    refused(bad_film, correlating.render, loaded, spp=1)
    for plugin in ("amcw_transient_path", "time_gated_transient_path"):
        text = "cannot render in time; must be one of transient_path"
        refused(text, tofrender.render, loaded, integrator={"type": plugin})
    # Their light would be taken for a gate's or a correlation's, in other units
    for plugin in ("transient_path", "path_tracer_mis"):
        other = mi.load_dict({"type": plugin}, parallel=False)
        for call, more in (
            (tofrender.render_at_time, 5.0),
            (tofrender.render_transient, GATES),
            (tofrender.render_single_amcw, 4),
        ):
            refused(
                "(gates are|modulation is) not supported. Use", call, loaded, other, sensor, more
            )
    for frequency in (0, -1.0, math.nan, math.inf, "fast", [20e6, 0.0], []):
        refused(r"frequenc(y|ies)_hz", parse_frequencies, frequency)


def test_phasors_of_one_path():
    """Form d: P = L exp(+i k opl), depth = opl / 2 up to whole ranges."""
    color = np.array([1.0, 0.5, 0.2])
    loaded, opl, radiance = one_path(color)
    found = tofrender.render_amcw_phasor(loaded, loaded.sensors()[0], FREQUENCIES, spp=4)
    for frequency, *values in zip(FREQUENCIES, *found, strict=True):
        i, q, amplitude, phase, depth = (each[0, 0] for each in values)
        turn = 2 * math.pi * frequency * opl / C
        assert i == pytest.approx(radiance * math.cos(turn) * color, abs=1e-4 * radiance)
        assert q == pytest.approx(radiance * math.sin(turn) * color, abs=1e-4 * radiance)
        assert amplitude == pytest.approx(radiance * color, rel=1e-5)
        assert np.cos(phase - turn) == pytest.approx(np.ones(3), abs=1e-6)
        assert depth == pytest.approx(np.full(3, opl / 2 % (C / (2 * frequency))), abs=1e-4)


@pytest.mark.parametrize(
    "own",
    [
        *("transient_path", "transient_volpath", "path_tracer_mis", "amcw_transient_path"),
        *("time_gated_transient_path", "path", "volpath", "volpathmis", "prbvolpath", "prb"),
        "ptracer",
    ],
)
def test_phasors_are_of_the_scenes_own_integrator(own):
    """Form d in a corner: of two segments, half the length is the depth; of more, it is not."""
    flash, there = (0.5, 0.0, 2.0), (0.5, 0.0, 0.0)
    parts = {
        "floor": plane(bsdf=diffuse(0.8)),
        "wall": plane(translate(0, 0, 0) @ rotate((0, 1, 0), 90), bsdf=diffuse(0.8)),
        "lamp": point_light(flash, 1.0),
    }
    width = 0.05 if own == "time_gated_transient_path" else 0
    own = {"type": own} | ({"pulse_width_opl": width} if width else {})
    described = scene(parts, camera(flash, there, film(width=4, height=4), fov=0.01))
    loaded = load(described | {"integrator": own | {"max_depth": 2}})
    picture = tofrender.render_amcw_phasor(loaded, loaded.sensors()[0], 50e6, spp=16)
    if own["type"] != "ptracer":  # Its light lands in few pixels
        np.testing.assert_allclose(picture[4], 2.0, atol=1e-3)
        k, radiance = 2 * math.pi * 50e6 / C, 0.8 / math.pi / 4
        dimmed = math.exp(-0.5 * (k * width) ** 2)
        np.testing.assert_allclose(picture[2], radiance * dimmed, rtol=1e-3)
    deeper = load(described | {"integrator": own | {"max_depth": 8}})
    picture = tofrender.render_amcw_phasor(deeper, deeper.sensors()[0], 50e6, spp=16)
    assert picture[4].mean() > 2.02


def test_phasors_take_all_that_the_scenes_integrator_says():
    """The same light as through the integrator by hand: pulse, unwarping, hidden lamps."""
    traits = {"camera_unwarp": True, "hide_emitters": True, "rr_depth": 1, "max_depth": 3}
    described = tofrender.cornell_box(width=8, height=8)
    loaded = load(described | {"integrator": {"type": "transient_path", **traits}})
    loaded.integrator().pulse = tofrender.BoxPulse(0.4)
    other = load(described)
    tracer = mi.load_dict({"type": "amcw_transient_path", **traits})
    tracer.pulse = tofrender.BoxPulse(0.4)
    seen = tofrender.render_amcw_phasor(loaded, loaded.sensors()[0], 2e8, spp=8)
    wanted = tofrender.render_amcw_phasor(other, other.sensors()[0], 2e8, 8, integrator=tracer)
    np.testing.assert_allclose(seen[0], wanted[0], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("own", ["direct", "depth", "aov"])
def test_phasors_refuse_an_integrator_that_knows_no_paths(own):
    described = tofrender.cornell_box(width=8, height=8)
    more = {"aovs": "z:depth", "nested": {"type": "path"}} if own == "aov" else {}
    loaded = load(described | {"integrator": {"type": own, **more}})
    phasors = partial(tofrender.render_amcw_phasor, loaded, loaded.sensors()[0], 2e7, spp=1)
    refused(r"integrator = \w+: .* Use .*transient_path", phasors)
    tracer = mi.load_dict({"type": "amcw_transient_path"})
    phasors(integrator=tracer)


def test_correlation_images_are_the_parts_of_the_phasor():
    """The sine is phase_offset -pi/2."""
    loaded = box()
    sensor = loaded.sensors()[0]
    I, Q, *_ = tofrender.render_amcw_phasor(loaded, sensor, 50e6, spp=16)
    integrator = mi.load_dict({"type": "amcw_transient_path"}, parallel=False)
    for offset, part in ((0.0, I), (-math.pi / 2, Q)):
        integrator.set_modulation(AMCWPulse(50e6, offset))
        image = tofrender.render_single_amcw(loaded, integrator, sensor, 16)
        np.testing.assert_allclose(image, part, rtol=1e-4, atol=1e-5 * np.abs(part).max())


@pytest.mark.statistical
def test_sphere_with_all_bounces():
    """Form c: P = rho I / (pi R^2) e^{2ikR} / (1 - rho chi), chi the transform of the chords.

    Bounces are independent, with chord density r / (2 R^2) on [0, 2 R]:
    chi = int r e^{ikr} dr / (2 R^2) = [e^{ia} (1 - ia) - 1] / (2 (kR)^2) with a = 2 k R.
    """
    radius, albedo, intensity = 1.0, 0.6, 2.0
    sphere = {"type": "sphere", "radius": radius, "flip_normals": True, "bsdf": diffuse(albedo)}
    parts = {"sphere": sphere, "lamp": point_light((0, 0, 0), intensity)}
    loaded = load(scene(parts, camera((0, 0, 0), (0, 0, -1), film(width=8, height=8))))
    integrator = mi.load_dict({"type": "amcw_transient_path", "max_depth": -1}, parallel=False)
    I, Q, *_ = tofrender.render_amcw_phasor(
        loaded, loaded.sensors()[0], FREQUENCIES, spp=4096, integrator=integrator
    )
    phasors = I[..., 0].astype(complex) + 1j * Q[..., 0]
    for frequency, found in zip(FREQUENCIES, phasors, strict=True):
        k = 2 * math.pi * frequency / C
        a = 2 * k * radius
        chi = (np.exp(1j * a) * (1 - 1j * a) - 1) / (2 * (k * radius) ** 2)
        direct = albedo * intensity / (math.pi * radius**2) * np.exp(2j * k * radius)
        expected = direct / (1 - albedo * chi)
        error = found.std() / math.sqrt(found.size)
        assert abs(found.mean() - expected) < 5 * error + 1e-4 * abs(expected)
        assert error < 0.01 * abs(expected)  # Tight enough to see a wrong sign, chord or albedo


def test_phasors_at_many_frequencies():
    """An example of y-tal has 104: P = L exp(+i k opl) at each."""
    mi.set_variant("llvm_ad_mono")  # A third of the time to compile the kernel
    loaded, opl, radiance = one_path()
    frequencies = np.linspace(10e6, 60e6, 104)
    found = tofrender.render_amcw_phasor(loaded, loaded.sensors()[0], list(frequencies), spp=1)
    expected = radiance * np.exp(2j * math.pi * opl / C * frequencies)
    np.testing.assert_allclose(found[0][:, 0, 0, 0], expected.real, atol=1e-4 * radiance)
    np.testing.assert_allclose(found[1][:, 0, 0, 0], expected.imag, atol=1e-4 * radiance)


def test_memory_limits_the_number_of_frequencies(monkeypatch):
    """The image of 32 x 24 pixels with 100 frequencies takes 1.8 MB, and the work 9 times that."""
    lower(monkeypatch, available_memory=memory.RESERVE + 10_000_000)
    loaded = box(height=24)
    given = loaded, loaded.sensors()[0], [1e6 * k for k in range(1, 101)], 1
    text = "film of 32 x 24 pixels x 100 frequencies: takes"
    refused(text, tofrender.render_amcw_phasor, *given, kind=MemoryError)


def with_phasor_film(size: int, **more) -> mi.Scene:
    described = tofrender.cornell_box(width=size, height=size)
    phasor_film = {"type": "phasor_hdr_film", "width": size, "height": size, **more}
    described["sensor"]["film"] = phasor_film
    return mi.load_dict(described)


def test_film_of_phasors_under_mitsubas_render():
    crop = {"crop_width": 8, "crop_height": 4, "crop_offset_x": 4, "crop_offset_y": 6}
    loaded = with_phasor_film(16, frequencies_hz="20e6, 50e6", **crop)
    steady, phasors = mi.render(loaded, spp=16)
    assert steady.shape == (4, 8, 3)
    assert phasors.shape == (4, 8, 2, 2, 3)
    parts = tofrender.render_amcw_phasor(loaded, loaded.sensors()[0], [20e6, 50e6], spp=16)[:2]
    for k, part in enumerate(parts):
        values = np.array(phasors)[:, :, :, k].transpose(2, 0, 1, 3)
        np.testing.assert_allclose(values, part, rtol=1e-4, atol=1e-5)
    # Phasors at low frequency are as bright as the steady image
    assert np.abs(np.hypot(*parts)[0]).max() <= np.array(steady).max() * (1 + 1e-5)


def test_phasors_of_a_film_count_from_its_start():
    """A path of length L has the phasor E exp(2 pi i f (L - start) / c)."""
    loaded, opl, radiance = one_path(color=(1.0, 0.5, 0.2))
    phasor_film = {"type": "phasor_hdr_film", "width": 2, "height": 3}
    phasor_film |= {"start_opl": 1.3, "frequencies_hz": "20e6, 70e6"}
    sensor = mi.load_dict(camera((0, 0, 2.0), (0, 0, 0), phasor_film, fov=1e-3))
    phasors = np.array(mi.render(loaded, sensor=sensor, spp=4)[1])
    for index, frequency in enumerate([20e6, 70e6]):
        wave = np.exp(2j * math.pi * frequency * (opl - 1.3) / C)
        expected = radiance * np.array([1.0, 0.5, 0.2]) * wave
        found = phasors[2, 1, index, 0] + 1j * phasors[2, 1, index, 1]
        assert found == pytest.approx(expected, rel=1e-3)


def test_film_of_phasors_in_mono_has_mitransients_shape():
    mi.set_variant("llvm_ad_mono")
    wave = {"wl_mean": 0.5, "wl_sigma": 1.0, "temporal_bins": 400, "bin_width_opl": 0.02}
    _, phasors = mi.render(with_phasor_film(8, **wave), spp=4)
    assert phasors.shape == (8, 8, 9, 2)


@pytest.mark.parametrize("rfilter", ["gaussian", "tent"])
def test_phasors_are_filtered_as_the_image_is(rfilter):
    """At a frequency near 0 the phasor is the steady image."""
    loaded = with_phasor_film(32, frequencies_hz="1.0", rfilter={"type": rfilter})
    steady, phasors = (np.array(t) for t in mi.render(loaded, spp=8))
    np.testing.assert_allclose(phasors[:, :, 0, 0], steady, rtol=1e-4, atol=1e-6)


def test_a_pulse_dims_phasors_by_its_fourier_transform():
    assert fourier_transform(None, 1e8) == 1
    k = 2 * math.pi * 300e6 / C
    dimmed = math.exp(-0.5 * (k * 0.05) ** 2)
    assert fourier_transform(GaussianPulse(0.05), 300e6) == pytest.approx(dimmed, abs=1e-5)
    late = SampledPulse([1.0], start_opl=0.3, bin_width_opl=1e-3)
    assert fourier_transform(late, 300e6) == pytest.approx(np.exp(1j * k * 0.3005), abs=1e-4)
    loaded, opl, radiance = one_path()
    integrator = mi.load_dict({"type": "amcw_transient_path", "pulse_width_opl": 0.05})
    _, _, amplitude, phase, _ = tofrender.render_amcw_phasor(
        loaded, loaded.sensors()[0], 300e6, spp=4, integrator=integrator
    )
    assert amplitude[0, 0, 0] == pytest.approx(radiance * dimmed, rel=1e-4)
    assert math.cos(phase[0, 0, 0] - k * opl) == pytest.approx(1, abs=1e-5)


def test_a_scene_of_another_variant_is_refused_in_a_line():
    loaded = box()
    mi.set_variant("llvm_ad_mono")
    sensor, one = loaded.sensors()[0], tofrender.AMCWTransientPath(mi.Properties())
    one.set_modulation(tofrender.AMCWPulse(20e6))
    gate = tofrender.TimeGatedTransientPath(mi.Properties())
    for call, *more in (
        (tofrender.render_at_time, gate, sensor, 5.0),
        (tofrender.render_transient, gate, sensor, GATES),
        (tofrender.render_single_amcw, one, sensor, 4),
        (tofrender.render_amcw_phasor, sensor, 20e6),
        (mi.load_dict({"type": "transient_light_tracer"}, parallel=False).render,),
        (mi.load_dict({"type": "transient_bdpt"}, parallel=False).render,),
    ):
        refused("scene: belongs to the variant llvm_ad_rgb", call, loaded, *more)


def test_a_single_gate_sees_a_projector():
    """Its bounding box is none: as a bound of lengths it would end every path."""
    look = mi.ScalarTransform4f().look_at([0.3, 0, 2], [0, 0, 0], [0, 1, 0])
    lamp = {"type": "projector", "irradiance": gray(3.0), "fov": 40, "to_world": look}
    sensor = camera((0, 0, 2), (0, 0, 0), film(4, 4), fov=20)
    loaded = load(scene({"lamp": lamp, "floor": plane()}, sensor))
    integrator = tofrender.TimeGatedTransientPath(mi.Properties())
    integrator.pulse = tofrender.GaussianPulse(0.1)
    gates = {"temporal_bins": 1, "start_opl": 3.9, "bin_width_opl": 0.2}
    many = tofrender.render_transient(loaded, integrator, loaded.sensors()[0], gates, spp=64)
    one = tofrender.render_at_time(loaded, integrator, loaded.sensors()[0], 4.0, spp=64)
    assert many[:, :, 0].min() > 0
    assert one == pytest.approx(many[:, :, 0], rel=0.02)
