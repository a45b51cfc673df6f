"""Polarized light against Fresnel's equations, and against Mitsuba's `stokes` integrator."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import unit
from helpers.scenes import numbers, refusal
from helpers.support import load

import tofrender
from tofrender.films.sums import Radiance, Weighted
from tofrender.paths.camera import sample_camera
from tofrender.rendering.dataset import require_storable
from tofrender.scenes.checking import check_scene
from tofrender.signals import polarization

MONO, SPECTRAL = "llvm_ad_mono_polarized", "llvm_ad_spectral_polarized"
N = 1.5
BREWSTER = np.degrees(np.arctan(N))
GLASS = {"type": "dielectric", "int_ior": N, "ext_ior": 1.0}
INSIDE = {"type": "dielectric", "int_ior": 1.0, "ext_ior": N}
Y, Z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
ONE_PIXEL = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
LAMP = {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}


@pytest.fixture(autouse=True)
def _polarized(_variant):
    mi.set_variant(MONO)


def turned(v: np.ndarray, axis: np.ndarray, degrees: float) -> np.ndarray:
    """A vector, turned around an axis."""
    a = np.radians(degrees)
    across, along = np.cross(axis, v), axis * (axis @ v) * (1 - np.cos(a))
    return v * np.cos(a) + across * np.sin(a) + along


def look_at(origin, target, up):
    return mi.ScalarTransform4f().look_at(list(origin), list(target), list(up))


def narrow(origin, target, up) -> dict:
    """A camera of one pixel and nearly one ray."""
    view = {"fov": 0.01, "to_world": look_at(origin, target, up), "film": ONE_PIXEL}
    return {"type": "perspective", **view}


def facing(p, d, up, size: float, **more) -> dict:
    """A square at a point that looks along a direction."""
    look = look_at(p, np.add(p, d), up)
    return {"type": "rectangle", "to_world": look @ mi.ScalarTransform4f().scale(size), **more}


def bench(
    *mirrors: tuple[float, float],
    bsdf: dict = GLASS,
    polarizer: float | None = None,
    roll: float = 0.0,
    **integrator,
) -> mi.Scene:
    """A lamp of radiance 1, mirrors after each other, and a camera that looks into the last.

    Each mirror has an angle of incidence and a twist around the ray that arrives, both in degrees.
    Light that is polarized across the last plane of incidence oscillates along the camera's `up`
    if there is no `roll`. The polarizer before the lamp has an angle to the first mirror's plane.
    """
    p, d, s = np.zeros(3), -Z, Y
    scene = {"type": "scene", "lamp": facing(p, d, s, 0.3, emitter=LAMP)}
    if polarizer is not None:
        plate = {"type": "polarizer", "theta": {"type": "uniform", "value": polarizer}}
        scene["polarizer"] = facing(p + 0.1 * d, d, s, 0.4, bsdf=plate)
    for k, (incidence, twist) in enumerate(mirrors):
        p = p + d
        s = turned(s, d, twist)
        n = turned(-d, s, incidence)
        scene[f"mirror{k}"] = facing(p, n, s, 0.3, bsdf=bsdf)
        d = d - 2 * n * (n @ d)
    p = p + d
    scene["sensor"] = narrow(p, p - d, turned(s, d, roll))
    scene["integrator"] = {"type": "transient_path", "max_depth": 8, "rr_depth": 99, **integrator}
    return mi.load_dict(scene)


def traced(scene: mi.Scene, samples: int, measurement=None, seed: int = 0) -> np.ndarray:
    """The mean Stokes vector that the first sensor's rays bring, of the first channel."""
    sensor, sampler = scene.sensors()[0], numbers(seed, samples)
    pixel = dr.zeros(mi.UInt32, samples)
    camera = sample_camera(sensor, sensor.film(), sampler, pixel)
    plan, measurement = scene.integrator().plan(scene, sensor), measurement or Radiance.zero()
    measured, _ = plan.trace(sampler, camera.ray, camera.origin, measurement, frame=camera.frame)
    dr.eval(measured.total)
    return np.array([np.array(each[0], float).mean() for each in measured.total])


@pytest.mark.parametrize(
    ("incidence", "reflected", "degree"),
    [(45, 0.0502399, 0.8314794), (56.30993, 0.0739645, 1.0), (70, 0.1710425, 0.7515800)],
)
def test_glass_polarizes_what_it_reflects(incidence, reflected, degree):
    # p1. Across the plane of incidence, which is along the camera's up, and so negative
    S = traced(bench((incidence, 0)), 200_000)
    assert abs(S[0] / reflected - 1) < 0.02
    assert np.allclose(S[1:] / S[0], [-degree, 0, 0], atol=1e-4)


@pytest.mark.parametrize("roll", [0, 45, 90, -30])
def test_the_frame_turns_with_the_camera(roll):
    scene, a = bench((BREWSTER, 0), roll=roll), np.radians(2 * roll)
    S = traced(scene, 2_000)
    assert np.allclose(S[1:] / S[0], [-np.cos(a), np.sin(a), 0], atol=1e-4)


@pytest.mark.parametrize("twist", [0, 30, 90])
def test_two_mirrors_at_brewsters_angle(twist):
    # p3
    scene = bench((BREWSTER, 0), (BREWSTER, twist))
    S = traced(scene, 200_000)
    both = ((N**2 - 1) / (N**2 + 1)) ** 4 * np.cos(np.radians(twist)) ** 2 / 2
    assert abs(S[0] - both) < 0.05 * both + 1e-7
    assert np.allclose(S[1:], [-S[0], 0, 0], atol=1e-7)


def test_matrices_stand_in_the_order_of_the_path():
    # In the other order, S0 would be right, S1 18 % less, and S2 0.57 of S0
    scene = bench((70, 0), (BREWSTER, 40))
    S = traced(scene, 200_000)
    assert abs(S[0] / 0.0143022 - 1) < 0.05
    assert np.allclose(S[1:] / S[0], [-1, 0, 0], atol=1e-4)


def test_total_reflection_turns_phases():
    # p4. At 45 degrees by 2 atan(cos sqrt(sin² - 1 / n²) / sin²) = 36.869898 degrees
    S = traced(bench((45, 0), bsdf=INSIDE, polarizer=45.0), 1_000)
    assert abs(S[0] - 0.5) < 1e-5
    assert np.allclose(np.abs(S[1:]) / S[0], [0, 0.8, 0.6], atol=1e-5)


@pytest.mark.parametrize("incidence", [50.229, 53.258])
def test_a_fresnel_rhomb_makes_light_circular(incidence):
    left, right = (
        traced(bench(*2 * [(incidence, 0)], bsdf=INSIDE, polarizer=each), 1_000)
        for each in (45.0, -45.0)
    )
    for S in (left, right):
        assert np.allclose(np.abs(S[1:]) / S[0], [0, 0, 1], atol=1e-4)
    assert left[3] * right[3] < 0


def slab(degrees: float, thickness: float = 0.3) -> mi.Scene:
    """A slab of glass across the z axis before a wide lamp, seen under an angle."""
    a = np.radians(degrees)
    parts = {
        "lamp": facing([0, 0, -1 - thickness], Z, Y, 50, emitter=LAMP),
        "front": facing([0, 0, 0], Z, Y, 50, bsdf=GLASS),
        "back": facing([0, 0, -thickness], -Z, Y, 50, bsdf=GLASS),
        "sensor": narrow(2 * np.array([np.sin(a), 0, np.cos(a)]), [0, 0, 0], Y),
        "integrator": {"type": "transient_path", "max_depth": 12, "rr_depth": 99},
    }
    return mi.load_dict({"type": "scene", **parts})


SLAB = (0.91161175, -0.0657889), (0.0026345074, 0.9244850), (1.5112234e-5, 0.9973043)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_what_goes_to_and_fro_in_a_slab(order):
    # p2. Unpolarized renderers have .91062428, .0019046309 and 3.98366e-6
    inside = np.cos(np.arcsin(np.sin(np.radians(40)) / N))
    first = 2 + 1 / np.cos(np.radians(40)) + N * 0.3 / inside
    opl = first + order * 2 * N * 0.3 / inside

    def near(length: mi.Float) -> mi.Float:
        return dr.select(dr.abs(length - opl) < 1e-3, mi.Float(1), 0)

    expected, degree = SLAB[order]
    S = traced(slab(40), (100_000, 1_000_000, 4_000_000)[order], Weighted.zero(near))
    assert abs(S[0] / expected - 1) < (0.01, 0.05, 0.4)[order]
    assert np.allclose(S[1:] / S[0], [-degree, 0, 0], atol=1e-3)


def metals(roll: float = 20.0, **film) -> dict:
    """Rough and smooth metals, glass and plastic in a room, seen by a camera that is rolled."""
    look = look_at([0, 0.9, 3], [0, 0, 0], turned(Y, unit([0, -0.3, -1]), roll))
    flat = {"type": "hdrfilm", "width": 24, "height": 16, "rfilter": {"type": "box"}}

    def ball(x, y, z, radius, **bsdf):
        return {"type": "sphere", "center": [x, y, z], "radius": radius, "bsdf": bsdf}

    def metal(alpha):
        fresnel = {"eta": 0.2, "k": 3.9, "specular_reflectance": 0.9}
        return {"type": "roughconductor", "alpha": alpha, **fresnel}

    light = {"type": "area", "radiance": {"type": "uniform", "value": 5.0}}
    return {
        "type": "scene",
        "floor": facing([0, -0.5, 0], Y, Z, 3, bsdf=metal(0.3)),
        "back": facing([0, 0, -1.5], Z, Y, 3, bsdf={"type": "diffuse"}),
        "a": ball(-0.7, 0, 0, 0.5, **metal(0.15)),
        "b": ball(0.5, 0, 0.2, 0.45, type="pplastic", alpha=0.1),
        "c": ball(0.1, -0.25, 0.9, 0.2, type="dielectric"),
        "lamp": facing([1, 1.6, 1], [-0.5, -1, -0.6], Z, 0.5, emitter=light),
        "sky": {"type": "constant", "radiance": {"type": "uniform", "value": 0.2}},
        "sensor": {"type": "perspective", "fov": 45, "to_world": look, "film": flat | film},
    }


AXIS = {"temporal_bins": 60, "bin_width_opl": 1.0}
LONG = {"type": "transient_hdr_film", **AXIS}


def traced_by(scene: dict, kind: str = "transient_path", **more) -> mi.Scene:
    return mi.load_dict(scene | {"integrator": {"type": kind, "max_depth": 6, **more}})


def by_mitsubas_stokes(kind: str, seed: int) -> np.ndarray:
    """Stokes vectors of the metals by Mitsuba's `stokes`, (height, width, 4, 3)."""
    stokes = {"type": "stokes", "nested": {"type": kind, "max_depth": 6}}
    image = np.array(mi.render(mi.load_dict(metals() | {"integrator": stokes}), spp=512, seed=seed))
    return image[:, :, -12:].reshape(*image.shape[:2], 4, 3)


def ours(scene: dict, spp: int, seed: int = 0, kind: str = "transient_path", **integrator):
    """Steady picture and bins of this package, (height, width, [bins,] 4, channels)."""
    loaded = traced_by(scene, kind, **integrator)
    found = [np.array(each) for each in mi.render(loaded, spp=spp, seed=seed)]
    return [each.reshape(*each.shape[:-1], 4, -1) for each in found]


def rms(x: np.ndarray) -> np.ndarray:
    """Root mean square of each Stokes component."""
    return np.sqrt(np.mean(np.square(x, dtype=float), axis=(0, 1, 3)))


def agrees(found: np.ndarray, reference: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Which components differ from a reference by not twice of what another one does."""
    shown = found.shape[-1]
    return rms(found - reference[..., :shown]) < 2 * rms((other - reference)[..., :shown])


@pytest.mark.statistical
@pytest.mark.parametrize("variant", [MONO, SPECTRAL])
def test_bins_add_up_to_mitsubas_stokes(variant):
    mi.set_variant(variant)
    steady, bins = ours(metals(**LONG), 512, seed=2)
    reference, other = (by_mitsubas_stokes("path", seed) for seed in (0, 1))
    assert np.allclose(bins.sum(2), steady, atol=1e-4)
    assert agrees(steady, reference, other).all()
    # S1 and S2 are far above the noise: a camera that is rolled by another angle is told
    elsewhere, _ = ours(metals(roll=-20.0, **LONG), 512, seed=2)
    assert rms(steady)[1] > 2 * rms(other - reference)[1]
    assert not agrees(elsewhere, reference, other)[1:3].any()
    if variant == MONO:
        assert agrees(by_mitsubas_stokes("transient_path", 2), reference, other).all()


@pytest.mark.parametrize("rfilter", ["box", "tent", "gaussian"])
def test_filters_reach_over_all_components(rfilter):
    """And no bin is more polarized than wholly."""
    steady, bins = ours(metals(**LONG | {"rfilter": {"type": rfilter}}), 256)
    assert np.allclose(bins.sum(2), steady, atol=1e-4)
    for each in (steady, bins) if rfilter == "box" else ():
        polarized = np.sqrt(np.sum(each[..., 1:, :].astype(float) ** 2, axis=-2))
        assert np.all(polarized <= each[..., 0, :] * (1 + 1e-5) + 1e-6)
        assert polarized.max() > 0.05


@pytest.mark.parametrize("variant", [MONO, SPECTRAL])
def test_what_depolarizes_is_as_without_polarization(variant):
    results = []
    for name in (variant, variant.replace("_polarized", "")):
        mi.set_variant(name)
        scene = mi.load_dict(tofrender.cornell_box(width=8, height=8, temporal_bins=20))
        results.append([np.array(each) for each in mi.render(scene, spp=16, seed=0)])
    for polarized, plain in zip(*results, strict=True):
        count = plain.shape[-1]
        assert np.allclose(polarized[..., :count], plain, rtol=1e-4, atol=1e-6)
        assert not polarized[..., count:].any()


def test_light_is_a_column_that_stands_right_of_a_matrix():
    rng = np.random.default_rng(0)
    matrix, light = rng.random((4, 4)), rng.random(4)
    stokes = mi.SpectrumEntry(*[mi.UnpolarizedSpectrum(each) for each in light.tolist()])
    found = polarization.apply_throughput(mi.Spectrum(*matrix.ravel().tolist()), stokes)
    assert np.ravel(found) == pytest.approx(matrix @ light, rel=1e-5)


def test_films_add_tiles_and_muellers_matrices():
    small = LONG | {"width": 4, "height": 2, "rfilter": {"type": "box"}}
    whole = load(small)
    whole.prepare([])
    at, one = mi.Point2f(0.5, 0.5), mi.Float(1)
    matrix = mi.Spectrum(*[float(k) for k in range(16)])
    whole.add_transient_data(at, mi.Float(3.5), None, matrix, one, mi.Bool(True))
    for x in (0, 2):
        tile = load(small | {"crop_width": 2, "crop_height": 2, "crop_offset_x": x})
        tile.prepare([])
        light = mi.SpectrumEntry(*[mi.UnpolarizedSpectrum(k + 1.0) for k in range(4)])
        at = mi.Point2f(x + 1.5, 1.5)
        tile.add_transient_data(at, mi.Float(3.5), None, light, mi.Float(2), mi.Bool(True))
        whole.merge_tile(tile)
    bins = np.array(whole.develop()[1])[:, :, 3]
    assert bins[1, 1].tolist() == bins[1, 3].tolist() == [2, 4, 6, 8]
    assert bins[0, 0].tolist() == [0, 4, 8, 12]
    assert np.array(whole.time_slice(3))[1, 3].tolist() == [2, 4, 6, 8]
    assert whole.take()[1].sum() == 40 + 24


def test_gates_add_up_to_the_steady_picture():
    scene = traced_by(metals(**LONG), "time_gated_transient_path", pulse_width_opl=1.0)
    steady, cube = (np.array(each) for each in mi.render(scene, spp=64))
    assert cube.shape == (16, 24, 60, 4)
    assert np.allclose(cube.sum(2), steady, atol=2e-3 * steady.max())
    sensor, gated = scene.sensors()[0], scene.integrator()
    gates, quiet = AXIS | {"start_opl": 0.0}, {"progress": False}
    cubes = [
        tofrender.render_transient(scene, gated, sensor, gates, 1024, seed, **quiet)
        for seed in (0, 1)
    ]
    gate = tofrender.render_at_time(scene, gated, sensor, 6.5, spp=512, **quiet)
    assert gate.shape == (16, 24, 4)
    assert agrees(gate[..., None], *(each[:, :, 6, :, None] for each in cubes)).all()
    assert rms(gate[..., None])[1] > 1.5 * rms((cubes[0] - cubes[1])[:, :, 6, :, None])[1]


def test_phasors_are_sums_over_bins():
    fine = LONG | {"temporal_bins": 3000, "bin_width_opl": 0.02}
    _, bins = ours(metals(**fine), 64, light_samples=1)
    phasor_film = {"type": "phasor_hdr_film", "frequencies_hz": "20e6"}
    steady, phasors = ours(metals(**phasor_film), 64, light_samples=1)
    assert steady.shape == (16, 24, 4, 1)
    assert phasors.shape == (16, 24, 1, 2, 4, 1)
    turns = 20e6 / 299_792_458 * 0.02 * (np.arange(3000) + 0.5)
    expected = np.einsum("yxtsc,t->yxsc", bins, np.exp(2j * np.pi * turns))
    found = phasors[:, :, 0, 0] + 1j * phasors[:, :, 0, 1]
    assert np.allclose(found, expected, atol=2e-3 * np.abs(expected).max())
    assert np.abs(found[:, :, 1:3]).max() > 0.02 * np.abs(expected).max()


def test_correlations_carry_all_components():
    scene = mi.load_dict(metals())
    amcw = mi.load_dict({"type": "amcw_transient_path", "frequency_hz": 20e6, "max_depth": 6})
    sensor = scene.sensors()[0]
    image = tofrender.render_single_amcw(scene, amcw, sensor, spp=64, progress=False)
    I, *_ = tofrender.render_amcw_phasor(scene, sensor, 20e6, 64, 0, amcw, progress=False)  # noqa: E741
    assert image.shape == (16, 24, 4)
    assert np.allclose(image, I, atol=1e-5)


@pytest.mark.parametrize(("variant", "channels"), [(MONO, ["L"]), (SPECTRAL, ["R", "G", "B"])])
def test_datasets_have_an_axis_of_stokes_components(variant, channels):
    mi.set_variant(variant)
    scene = traced_by(metals(**LONG))
    dataset = tofrender.render(scene, spp=16, progress=False)
    assert dataset["transient"].dims == ("y", "x", "opl", "stokes", "channel")
    assert dataset["steady"].dims == ("y", "x", "stokes", "channel")
    assert dataset["stokes"].values.tolist() == ["S0", "S1", "S2", "S3"]
    assert dataset["channel"].values.tolist() == channels
    steady, bins = mi.render(scene, spp=16)
    for name, image in (("steady", steady), ("transient", bins)):
        image = np.array(image).reshape(dataset[name].shape)
        assert np.allclose(image.mean((0, 1)), dataset[name].mean(("y", "x")), atol=0.02)
    assert abs(dataset.attrs["energy_outside_window"]) < 1e-3
    intensity = dataset.sel(stokes="S0", drop=True)
    assert require_storable(intensity) is None
    assert np.allclose(intensity["transient"].sum("opl"), intensity["steady"], atol=1e-4)


def test_renders_go_on_and_have_errors():
    scene = traced_by(metals(**LONG))
    first = tofrender.render(scene, spp=8, progress=False)
    more = tofrender.render(scene, spp=16, resume=first, progress=False)
    at_once = tofrender.render(scene, spp=16, progress=False)
    assert more.attrs["spp"] == 16
    assert np.allclose(more["steady"], at_once["steady"], atol=1e-5)
    noisy = tofrender.render(scene, spp=16, errors=True, progress=False)
    assert noisy["steady_error"].dims == ("y", "x", "stokes", "channel")
    assert (noisy["steady_error"].sel(stokes="S1").mean() > 0).item()


def matte(**film) -> dict:
    """Rough metals without a sky, which all strategies find."""
    scene = metals(**LONG | {"width": 12, "height": 8} | film)
    for name in ("c", "sky"):
        del scene[name]
    for name in ("a", "b"):
        scene[name]["bsdf"] = scene["floor"]["bsdf"]
    return scene


@pytest.mark.statistical
def test_paths_from_both_ends_find_the_same():
    one, other = (ours(matte(), 2048, seed) for seed in (0, 1))
    both = ours(matte(), 2048, 2, "transient_bdpt")
    for found, first, second in zip(both, one, other, strict=True):
        if found.ndim == 5:
            found, first, second = (each.sum(2) for each in (found, first, second))
        assert agrees(found, first, second).all()
        assert rms(found)[3] > 3 * rms(first - second)[3]


@pytest.mark.statistical
@pytest.mark.parametrize("strategy", ["1,3", "2,2", "3,1"])
def test_each_strategy_finds_all_of_three_segments(strategy):
    # Frames of connections between vertices, and of those to the lens
    deep, shallow = (ours(matte(), 8192, 3, max_depth=depth)[0] for depth in (3, 2))
    alone = {"mis": "none", "strategy": strategy, "max_depth": 3}
    found = ours(matte(), 16384, 4, "transient_bdpt", **alone)[0]
    expected = deep - shallow
    for k in range(1, 3):
        both = np.stack([found[:, :, k].ravel(), expected[:, :, k].ravel()]).astype(float)
        slope = both[0] @ both[1] / (both[1] @ both[1])
        assert abs(slope - 1) < 0.15


def fog(sigma_t: float, albedo: float = 0.0, **phase) -> dict:
    """Fog behind the camera's half of the bench, and a lamp behind it."""
    medium = {"type": "homogeneous", "albedo": albedo, "sigma_t": sigma_t, **phase}
    move = mi.ScalarTransform4f().translate([0, 0, 1]) @ mi.ScalarTransform4f().scale([9, 9, 0.5])
    return {
        "type": "scene",
        "lamp": facing([0, 0, -2], Z, Y, 9, emitter=LAMP),
        "fog": {"type": "cube", "to_world": move, "bsdf": {"type": "null"}, "interior": medium},
        "sensor": narrow([0, 0, 3], [0, 0, 0], Y),
        "integrator": {"type": "transient_volpath", "max_depth": 16, "rr_depth": 99},
    }


def plate(z: float, **bsdf) -> dict:
    return facing([0, 0, z], Z, Y, 9, bsdf=bsdf)


@pytest.mark.parametrize("z", [-1.0, 1.1, 2.0])
def test_a_polarizer_before_behind_and_inside_fog(z):
    # A boundary of equal index would let all light through
    S = traced(mi.load_dict(fog(1.0) | {"plate": plate(z, type="polarizer")}), 100_000)
    assert abs(S[0] / (0.5 * np.exp(-1)) - 1) < 0.02
    assert np.allclose(S[1:] / S[0], [1, 0, 0], atol=1e-6)


def test_fog_keeps_what_it_does_not_scatter_and_depolarizes_the_rest():
    # What is not scattered is e^-1 of the light, wholly polarized, whatever the albedo
    absorbing, scattering = (
        traced(mi.load_dict(fog(1.0, albedo) | {"plate": plate(0, type="polarizer")}), 200_000)
        for albedo in (0.0, 0.9)
    )
    assert abs(scattering[1] / absorbing[1] - 1) < 0.02
    assert scattering[0] > 1.1 * absorbing[0]


@pytest.mark.parametrize("angle", [30, 90, 140])
@pytest.mark.parametrize("roll", [0, 25])
def test_small_particles_polarize_what_they_scatter_once(angle, roll):
    # Sunlight that is turned by an angle: (1 - c²) / (1 + c²), across the plane of both directions
    a, r = np.radians(angle), np.radians(2 * roll)
    scene = fog(0.1, 0.5, phase={"type": "rayleigh"})
    d = [float(np.sin(a)), 0.0, float(np.cos(a))]
    irradiance = {"type": "uniform", "value": 1.0}
    scene["lamp"] = {"type": "directional", "direction": d, "irradiance": irradiance}
    scene["integrator"]["max_depth"] = 2
    scene["sensor"] = narrow([0, 0, 3], [0, 0, 0], turned(Y, Z, roll))
    S = traced(mi.load_dict(scene), 20_000)
    degree = (1 - np.cos(a) ** 2) / (1 + np.cos(a) ** 2)
    assert S[0] > 1e-4
    assert np.allclose(S[1:] / S[0], [-degree * np.cos(r), degree * np.sin(r), 0], atol=1e-4)


def test_a_dipole_does_not_shine_along_its_axis():
    comes, goes = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 0, 1)
    matrix = np.array(polarization.rayleigh(mi.UnpolarizedSpectrum(0.1), comes, goes))
    matrix = matrix.reshape(4, 4)
    for axis, expected in (([0.0, 0.0, 1.0], 0.0), ([0.0, 1.0, 0.0], 0.2)):
        frame = np.array(polarization.frame_rotation(mi.Vector3f(-1, 0, 0), mi.Vector3f(axis)))
        light = np.linalg.inv(frame.reshape(4, 4)) @ [1, 1, 0, 0]  # Oscillates along the axis
        assert np.allclose((matrix @ light)[0], expected, atol=1e-6)
    straight = np.array(polarization.rayleigh(mi.UnpolarizedSpectrum(1), -goes, goes))
    assert np.allclose(straight.reshape(4, 4), np.eye(4), atol=1e-6)
    back = polarization.rayleigh(mi.UnpolarizedSpectrum(1), goes, goes)
    assert not dr.any(dr.isnan(back[3, 3]))[0]


def test_fog_of_small_particles_is_as_bright_as_it_is():
    # Many times scattered: no more polarized than wholly, and bounded by the light there is
    S = traced(mi.load_dict(fog(2.0, 1.0, phase={"type": "rayleigh"})), 100_000)
    assert 0 < S[0] < 1
    assert np.linalg.norm(S[1:]) < 0.02 * S[0]


def test_rayleigh_in_a_blend_is_refused():
    blend = {"type": "blendphase", "weight": 0.5, "a": {"type": "rayleigh"}, "b": {"type": "hg"}}
    scene = mi.load_dict(fog(1.0, 0.5, phase=blend))
    said = refusal(check_scene, scene, media=True, polarization=True)
    assert "phase = blendphase: rayleigh" in said


@pytest.mark.parametrize("integrator", ["transient_nlos_path", "confocal_transient_path", "ao"])
def test_who_does_not_follow_polarized_light_says_so(integrator):
    scene = metals(**LONG) | {"integrator": {"type": integrator}}
    said = refusal(tofrender.render, scene, spp=1, progress=False)
    assert said.startswith("variant = 'llvm_ad_mono_polarized': ")
    assert "Use llvm_ad_mono" in said


def test_functions_of_light_use_s0(tmp_path):
    dataset = tofrender.render(traced_by(metals(**LONG)), spp=1, progress=False)
    intensity = dataset.sel(stokes="S0", drop=True)
    for light, other in zip(
        *(tofrender.transient_to_phasor(each, 20e6) for each in (dataset, intensity)), strict=True
    ):
        np.testing.assert_array_equal(light, other)
    pictures = [
        tofrender.summary_figure(each).axes[1].images[0].get_array()
        for each in (dataset, intensity)
    ]
    np.testing.assert_array_equal(*pictures)
    for name, each in (("a", dataset), ("b", intensity)):
        tofrender.save_video(each, tmp_path / f"{name}.gif")
    assert (tmp_path / "a.gif").read_bytes() == (tmp_path / "b.gif").read_bytes()
    lost = dataset.isel(stokes=[1, 2, 3])
    for call in (tofrender.summary_figure, tofrender.visualize_transient):
        assert "does not contain S0" in refusal(call, lost)


def test_degrees_and_angles_of_a_render():
    scene = bench((70, 0), roll=30)
    S = traced(scene, 20_000)
    assert abs(tofrender.degree_of_linear_polarization(S, axis=0) - 0.7515800) < 1e-4
    # Along the mirror, which the camera sees turned against its roll
    assert abs(np.degrees(tofrender.angle_of_linear_polarization(S, axis=0)) - 60) < 0.01
    dataset = tofrender.render(traced_by(metals(**LONG)), spp=4, progress=False)
    degree = tofrender.degree_of_polarization(dataset["transient"])
    assert degree.dims == ("y", "x", "opl", "channel")
    lit = (dataset["transient"].sel(stokes="S0") > 1e-3).values
    assert np.isnan(degree.values[dataset["transient"].sel(stokes="S0").values <= 0]).all()
    assert degree.values[lit].max() <= 1 + 1e-4
    figure = tofrender.polarization_figure(dataset["steady"])
    assert [axes.get_title() for axes in figure.axes[::2]][2] == "linear angle"


def test_a_lamp_in_the_picture_does_not_make_the_rest_black():
    light = np.zeros((40, 40, 4, 1))
    light[:, :, 0] = 0.2
    light[:5, :5, 0] = 15.0  # 1.6 % of the pixels
    figure = tofrender.polarization_figure(light)
    assert figure.axes[0].images[0].get_clim() == pytest.approx((0, 0.2))
    assert tofrender.polarization_picture(light, "intensity")[20, 20].min() == 255


def test_pictures_in_false_colors():
    light = np.zeros((2, 3, 4, 1))
    light[0, :, 0] = light[0, :, 1] = 1  # Wholly polarized across `up`; no light below
    for shown, color in (("intensity", 255), ("circular", 221), ("angle", None)):
        found = tofrender.polarization_picture(light, shown, exposure=1)
        assert (found.shape, found.dtype) == ((2, 3, 3), np.uint8)
        assert found[0].any()
        assert not found[1].any()
        assert color is None or found[0, 0] == pytest.approx(3 * [color], abs=1)
    light = np.zeros((1, 3, 4, 1))  # Paler where less is polarized
    light[0, :, 0], light[0, :, 2] = 0.5, [[0.0], [0.2], [0.5]]
    spread = np.ptp(tofrender.polarization_picture(light, exposure=1).astype(int)[0], axis=-1)
    assert spread.tolist() == sorted(spread.tolist())
    assert spread[0] == 0 < spread[2]
