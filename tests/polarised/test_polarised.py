"""Polarised light against Fresnel's equations, and against Mitsuba's `stokes` integrator."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import tofrender
from tofrender.films.sums import Radiance, Weighted
from tofrender.paths import records
from tofrender.paths.camera import sample_camera
from tofrender.rendering.dataset import check_dataset
from tofrender.scenes.checking import check_scene
from tofrender.signals import polarisation

MONO, SPECTRAL = "llvm_ad_mono_polarized", "llvm_ad_spectral_polarized"
N = 1.5
BREWSTER = np.degrees(np.arctan(N))
GLASS = {"type": "dielectric", "int_ior": N, "ext_ior": 1.0}
INSIDE = {"type": "dielectric", "int_ior": 1.0, "ext_ior": N}


@pytest.fixture(autouse=True)
def _polarised(_variant):
    mi.set_variant(MONO)


# ----------------------------------------------------------------------------------- a bench


def unit(v) -> np.ndarray:
    return np.asarray(v, float) / np.linalg.norm(v)


def turned(v: np.ndarray, axis: np.ndarray, degrees: float) -> np.ndarray:
    """A vector, turned around an axis."""
    a = np.radians(degrees)
    across, along = np.cross(axis, v), axis * (axis @ v) * (1 - np.cos(a))
    return v * np.cos(a) + across * np.sin(a) + along


def facing(p, d, up, size: float, **more) -> dict:
    """A square at a point that looks along a direction."""
    look = mi.ScalarTransform4f().look_at(list(p), list(np.add(p, d)), list(up))
    return {"type": "rectangle", "to_world": look @ mi.ScalarTransform4f().scale(size), **more}


def bench(
    *mirrors: tuple[float, float],
    bsdf: dict = GLASS,
    polariser: float | None = None,
    roll: float = 0.0,
    **integrator,
) -> mi.Scene:
    """A lamp of radiance 1, mirrors after each other, and a camera that looks into the last.

    Each mirror has an angle of incidence and a twist around the ray that arrives, both in degrees.
    Light that is polarised across the last plane of incidence oscillates along the camera's `up`
    if there is no `roll`. The polariser before the lamp has an angle to the first mirror's plane.
    """
    p, d, s = np.zeros(3), np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])
    light = {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}
    scene = {"type": "scene", "lamp": facing(p, d, s, 0.3, emitter=light)}
    if polariser is not None:
        plate = {"type": "polarizer", "theta": {"type": "uniform", "value": polariser}}
        scene["polariser"] = facing(p + 0.1 * d, d, s, 0.4, bsdf=plate)
    for k, (incidence, twist) in enumerate(mirrors):
        p = p + d
        s = turned(s, d, twist)
        n = turned(-d, s, incidence)
        scene[f"mirror{k}"] = facing(p, n, s, 0.3, bsdf=bsdf)
        d = d - 2 * n * (n @ d)
    p = p + d
    up = turned(s, d, roll)
    look = mi.ScalarTransform4f().look_at(list(p), list(p - d), list(up))
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    scene["sensor"] = {"type": "perspective", "fov": 0.01, "to_world": look, "film": film}
    scene["integrator"] = {"type": "transient_path", "max_depth": 8, "rr_depth": 99, **integrator}
    return mi.load_dict(scene)


def traced(scene: mi.Scene, samples: int, measurement=None, seed: int = 0) -> np.ndarray:
    """The mean Stokes vector that the first sensor's rays bring, of the first channel."""
    sensor, sampler = scene.sensors()[0], mi.load_dict({"type": "independent"})
    sampler.seed(seed, samples)
    pixel = dr.zeros(mi.UInt32, samples)
    camera = sample_camera(sensor, sensor.film(), sampler, pixel)
    measured, _ = (
        scene.integrator()
        .plan(scene, sensor)
        .trace(
            sampler,
            camera.ray,
            camera.origin,
            measurement or Radiance.zero(),
            frame=camera.frame,
        )
    )
    dr.eval(measured.total)
    return np.array([np.array(each[0], float).mean() for each in measured.total])


# ------------------------------------------------------------------------------ closed forms


@pytest.mark.parametrize(
    ("incidence", "reflected", "degree"),
    [
        (45, 0.0502399, 0.8314794),
        (56.30993, 0.0739645, 1.0),
        (70, 0.1710425, 0.7515800),
    ],
)
def test_glass_polarises_what_it_reflects(incidence, reflected, degree):
    # p1. Across the plane of incidence, which is along the camera's up, and so negative
    S = traced(bench((incidence, 0)), 200_000)
    assert abs(S[0] / reflected - 1) < 0.02
    assert np.allclose(S[1:] / S[0], [-degree, 0, 0], atol=1e-4)


@pytest.mark.parametrize("roll", [0, 45, 90, -30])
def test_the_frame_turns_with_the_camera(roll):
    S = traced(bench((BREWSTER, 0), roll=roll), 2_000)
    a = np.radians(2 * roll)
    assert np.allclose(S[1:] / S[0], [-np.cos(a), np.sin(a), 0], atol=1e-4)


@pytest.mark.parametrize("twist", [0, 30, 90])
def test_two_mirrors_at_brewsters_angle(twist):
    # p3
    S = traced(bench((BREWSTER, 0), (BREWSTER, twist)), 200_000)
    both = ((N**2 - 1) / (N**2 + 1)) ** 4 * np.cos(np.radians(twist)) ** 2 / 2
    assert abs(S[0] - both) < 0.05 * both + 1e-7
    assert np.allclose(S[1:], [-S[0], 0, 0], atol=1e-7)


def test_matrices_stand_in_the_order_of_the_path():
    # In the other order, S0 would be right, S1 18 % less, and S2 0.57 of S0
    S = traced(bench((70, 0), (BREWSTER, 40)), 200_000)
    assert abs(S[0] / 0.0143022 - 1) < 0.05
    assert np.allclose(S[1:] / S[0], [-1, 0, 0], atol=1e-4)


def phase(incidence: float) -> float:
    """What total reflection turns one polarisation by against the other [rad]."""
    sine, cosine = np.sin(np.radians(incidence)), np.cos(np.radians(incidence))
    return 2 * np.arctan(cosine * np.sqrt(sine**2 - 1 / N**2) / sine**2)


def test_total_reflection_turns_phases():
    # p4
    assert abs(np.degrees(phase(45)) - 36.869898) < 1e-6
    S = traced(bench((45, 0), bsdf=INSIDE, polariser=45.0), 1_000)
    assert abs(S[0] - 0.5) < 1e-5
    assert np.allclose(np.abs(S[1:]) / S[0], [0, 0.8, 0.6], atol=1e-5)


@pytest.mark.parametrize("incidence", [50.229, 53.258])
@pytest.mark.parametrize("polariser", [45.0, -45.0])
def test_a_fresnel_rhomb_makes_light_circular(incidence, polariser):
    S = traced(bench((incidence, 0), (incidence, 0), bsdf=INSIDE, polariser=polariser), 1_000)
    assert np.allclose(np.abs(S[1:]) / S[0], [0, 0, 1], atol=1e-4)


def test_opposite_polarisers_turn_light_the_other_way():
    left, right = (
        traced(bench((50.229, 0), (50.229, 0), bsdf=INSIDE, polariser=each), 1_000)[3]
        for each in (45.0, -45.0)
    )
    assert left * right < 0


def slab(degrees: float, thickness: float = 0.3) -> mi.Scene:
    """A slab of glass across the z axis before a wide lamp, seen under an angle."""
    light = {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}
    up, across = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    a = np.radians(degrees)
    o = 2 * np.array([np.sin(a), 0, np.cos(a)])
    look = mi.ScalarTransform4f().look_at(list(o), [0, 0, 0], list(up))
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    return mi.load_dict(
        {
            "type": "scene",
            "lamp": facing([0, 0, -1 - thickness], across, up, 50, emitter=light),
            "front": facing([0, 0, 0], across, up, 50, bsdf=GLASS),
            "back": facing([0, 0, -thickness], -across, up, 50, bsdf=GLASS),
            "sensor": {"type": "perspective", "fov": 0.01, "to_world": look, "film": film},
            "integrator": {"type": "transient_path", "max_depth": 12, "rr_depth": 99},
        }
    )


SLAB = (0.91161175, -0.0657889), (0.0026345074, 0.9244850), (1.5112234e-5, 0.9973043)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_what_goes_to_and_fro_in_a_slab(order):
    # p2. Unpolarised renderers have .91062428, .0019046309 and 3.98366e-6
    inside = np.cos(np.arcsin(np.sin(np.radians(40)) / N))
    first = 2 + 1 / np.cos(np.radians(40)) + N * 0.3 / inside
    opl = first + order * 2 * N * 0.3 / inside

    def near(length: mi.Float) -> mi.Float:
        return dr.select(dr.abs(length - opl) < 1e-3, mi.Float(1), 0)

    expected, degree = SLAB[order]
    S = traced(slab(40), (100_000, 1_000_000, 4_000_000)[order], Weighted.zero(near))
    assert abs(S[0] / expected - 1) < (0.01, 0.05, 0.4)[order]
    assert np.allclose(S[1:] / S[0], [-degree, 0, 0], atol=1e-3)


# ------------------------------------------------------------------------ against `stokes`


def metals(roll: float = 20.0, **film) -> dict:
    """Rough and smooth metals, glass and plastic in a room, seen by a camera that is rolled."""
    up = turned(np.array([0.0, 1.0, 0.0]), unit([0, -0.3, -1]), roll)
    look = mi.ScalarTransform4f().look_at([0, 0.9, 3], [0, 0, 0], list(up))

    def ball(x, y, z, radius, **bsdf):
        return {"type": "sphere", "center": [x, y, z], "radius": radius, "bsdf": bsdf}

    def conductor(**more):
        return {"eta": 0.2, "k": 3.9, "specular_reflectance": 0.9, **more}

    light = {"type": "area", "radiance": {"type": "uniform", "value": 5.0}}
    return {
        "type": "scene",
        "floor": facing(
            [0, -0.5, 0],
            [0, 1, 0],
            [0, 0, 1],
            3,
            bsdf={"type": "roughconductor", "alpha": 0.3, **conductor()},
        ),
        "back": facing([0, 0, -1.5], [0, 0, 1], [0, 1, 0], 3, bsdf={"type": "diffuse"}),
        "a": ball(-0.7, 0, 0, 0.5, type="roughconductor", alpha=0.15, **conductor()),
        "b": ball(0.5, 0, 0.2, 0.45, type="pplastic", alpha=0.1),
        "c": ball(0.1, -0.25, 0.9, 0.2, type="dielectric"),
        "lamp": facing([1, 1.6, 1], [-0.5, -1, -0.6], [0, 0, 1], 0.5, emitter=light),
        "sky": {"type": "constant", "radiance": {"type": "uniform", "value": 0.2}},
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": look,
            "film": {"type": "hdrfilm", "width": 24, "height": 16, "rfilter": {"type": "box"}}
            | film,
        },
    }


def mitsubas(scene: dict, spp: int, seed: int, **path) -> np.ndarray:
    """Mitsuba's Stokes vectors, (height, width, 4, 3)."""
    inner = {"type": "path", "max_depth": 6, **path}
    reference = mi.load_dict(scene | {"integrator": {"type": "stokes", "nested": inner}})
    image = np.array(mi.render(reference, spp=spp, seed=seed))
    return image[:, :, -12:].reshape(*image.shape[:2], 4, 3)


AXIS = {"temporal_bins": 60, "bin_width_opl": 1.0}
LONG = {"type": "transient_hdr_film", **AXIS}


def ours(scene: dict, spp: int, seed: int = 0, **integrator):
    """Steady picture and bins of this package, (height, width, [bins,] 4, channels)."""
    tracer = {"type": "transient_path", "max_depth": 6, **integrator}
    loaded = mi.load_dict(scene | {"integrator": tracer})
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
    reference, other = (mitsubas(metals(), 512, seed) for seed in (0, 1))
    assert np.allclose(bins.sum(2), steady, atol=1e-4)
    assert agrees(steady, reference, other).all()
    # S1 and S2 are far above the noise: a camera that is rolled by another angle is told
    elsewhere, _ = ours(metals(roll=-20.0, **LONG), 512, seed=2)
    assert rms(steady)[1] > 2 * rms(other - reference)[1]
    assert not agrees(elsewhere, reference, other)[1:3].any()


def test_no_bin_is_more_polarised_than_wholly():
    # p5
    for each in ours(metals(**LONG), 256):
        polarised = np.sqrt(np.sum(each[..., 1:, :].astype(float) ** 2, axis=-2))
        assert np.all(polarised <= each[..., 0, :] * (1 + 1e-5) + 1e-6)
        assert polarised.max() > 0.05


@pytest.mark.parametrize("variant", [MONO, SPECTRAL])
def test_what_depolarises_is_as_without_polarisation(variant):
    results = []
    for name in (variant, variant.replace("_polarized", "")):
        mi.set_variant(name)
        scene = mi.load_dict(tofrender.cornell_box(width=8, height=8, temporal_bins=20))
        results.append([np.array(each) for each in mi.render(scene, spp=16, seed=0)])
    for polarised, plain in zip(*results, strict=True):
        count = plain.shape[-1]
        assert np.allclose(polarised[..., :count], plain, rtol=1e-4, atol=1e-6)
        assert not polarised[..., count:].any()


def test_through_stokes_of_mitsuba():
    inner = {"type": "transient_path", "max_depth": 6}
    wrapped = mi.load_dict(metals() | {"integrator": {"type": "stokes", "nested": inner}})
    image = np.array(mi.render(wrapped, spp=512, seed=2))[:, :, -12:]
    image = image.reshape(*image.shape[:2], 4, 3)
    assert agrees(image, *(mitsubas(metals(), 512, seed) for seed in (0, 1))).all()


@pytest.mark.parametrize("rfilter", ["tent", "gaussian"])
def test_filters_reach_over_all_components(rfilter):
    steady, bins = ours(metals(**LONG | {"rfilter": {"type": rfilter}}), 64)
    assert np.allclose(bins.sum(2), steady, atol=1e-4)


def test_tiles_make_the_whole():
    whole = mi.load_dict(LONG | {"width": 4, "height": 2, "rfilter": {"type": "box"}})
    whole.prepare([])
    for x in (0, 2):
        crop = {"crop_width": 2, "crop_height": 2, "crop_offset_x": x}
        tile = mi.load_dict(LONG | {"width": 4, "height": 2, "rfilter": {"type": "box"}} | crop)
        tile.prepare([])
        light = mi.SpectrumEntry(*[mi.UnpolarizedSpectrum(k + 1.0) for k in range(4)])
        at = mi.Point2f(x + 1.5, 1.5)
        tile.add_transient_data(at, mi.Float(3.5), None, light, mi.Float(2), mi.Bool(True))
        whole.merge_tile(tile)
    _, bins = whole.develop()
    assert np.array(bins)[1, 1, 3].tolist() == np.array(bins)[1, 3, 3].tolist() == [2, 4, 6, 8]
    assert np.array(whole.time_slice(3))[1, 3].tolist() == [2, 4, 6, 8]
    assert whole.take()[1].sum() == 40


def test_a_film_takes_muellers_matrices():
    film = mi.load_dict(LONG | {"width": 1, "height": 1, "rfilter": {"type": "box"}})
    film.prepare([])
    matrix = mi.Spectrum(*[float(k) for k in range(16)])
    at, one = mi.Point2f(0.5), mi.Float(1)
    film.add_transient_data(at, mi.Float(3.5), None, matrix, one, mi.Bool(True))
    assert np.array(film.develop()[1])[0, 0, 3].tolist() == [0, 4, 8, 12]


# ------------------------------------------------------------------- gates, phasors, Datasets


def test_gates_add_up_to_the_steady_picture():
    tracer = {"type": "time_gated_transient_path", "max_depth": 6, "pulse_width_opl": 1.0}
    scene = mi.load_dict(metals(**LONG) | {"integrator": tracer})
    steady, cube = (np.array(each) for each in mi.render(scene, spp=64))
    assert cube.shape == (16, 24, 60, 4)
    assert np.allclose(cube.sum(2), steady, atol=2e-3 * steady.max())
    sensor, gated = scene.sensors()[0], scene.integrator()
    cubes = [
        tofrender.render_transient(
            *(scene, gated, sensor, {**AXIS, "start_opl": 0.0}, 1024, seed), progress=False
        )
        for seed in (0, 1)
    ]
    gate = tofrender.render_at_time(scene, gated, sensor, 6.5, spp=512, progress=False)
    assert gate.shape == (16, 24, 4)
    assert agrees(gate[..., None], *(each[:, :, 6, :, None] for each in cubes)).all()
    assert rms(gate[..., None])[1] > 1.5 * rms((cubes[0] - cubes[1])[:, :, 6, :, None])[1]


def test_phasors_are_sums_over_bins():
    fine = LONG | {"temporal_bins": 3000, "bin_width_opl": 0.02}
    _, bins = ours(metals(**fine), 64, light_samples=1)
    steady, phasors = ours(
        metals(type="phasor_hdr_film", frequencies_hz="20e6"), 64, light_samples=1
    )
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
    tracer = {"type": "transient_path", "max_depth": 6}
    scene = mi.load_dict(metals(**LONG) | {"integrator": tracer})
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
    assert check_dataset(intensity) is None
    assert np.allclose(intensity["transient"].sum("opl"), intensity["steady"], atol=1e-4)


def test_renders_go_on_and_have_errors():
    scene = mi.load_dict(metals(**LONG) | {"integrator": {"type": "transient_path"}})
    first = tofrender.render(scene, spp=8, progress=False)
    more = tofrender.render(scene, spp=16, resume=first, progress=False)
    at_once = tofrender.render(scene, spp=16, progress=False)
    assert more.attrs["spp"] == 16
    assert np.allclose(more["steady"], at_once["steady"], atol=1e-5)
    parts = [first, tofrender.render(scene, spp=8, seed=1, progress=False)]
    joined = tofrender.merge(parts)
    assert joined["transient"].dims == first["transient"].dims
    assert np.allclose(joined["steady"], sum(each["steady"] for each in parts) / 2, atol=1e-6)
    noisy = tofrender.render(scene, spp=16, errors=True, progress=False)
    assert noisy["steady_error"].dims == ("y", "x", "stokes", "channel")
    assert (noisy["steady_error"].sel(stokes="S1").mean() > 0).item()


# ---------------------------------------------------------------------------- from both ends


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
    both = ours(matte(), 2048, 2, type="transient_bdpt")
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
    alone = {"type": "transient_bdpt", "mis": "none", "strategy": strategy, "max_depth": 3}
    found = ours(matte(), 16384, 4, **alone)[0]
    expected = deep - shallow
    for k in range(1, 3):
        both = np.stack([found[:, :, k].ravel(), expected[:, :, k].ravel()]).astype(float)
        slope = both[0] @ both[1] / (both[1] @ both[1])
        assert abs(slope - 1) < 0.15


# ------------------------------------------------------------------------------------- media


def fog(sigma_t: float, albedo: float = 0.0, **phase) -> dict:
    """Fog behind the camera's half of the bench, and a lamp behind it."""
    up, along = [0, 1, 0], [0, 0, 1]
    light = {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}
    medium = {"type": "homogeneous", "albedo": albedo, "sigma_t": sigma_t, **phase}
    look = mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], up)
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    move = mi.ScalarTransform4f().translate([0, 0, 1]) @ mi.ScalarTransform4f().scale([9, 9, 0.5])
    return {
        "type": "scene",
        "lamp": facing([0, 0, -2], along, up, 9, emitter=light),
        "fog": {"type": "cube", "to_world": move, "bsdf": {"type": "null"}, "interior": medium},
        "sensor": {"type": "perspective", "fov": 0.01, "to_world": look, "film": film},
        "integrator": {"type": "transient_volpath", "max_depth": 16, "rr_depth": 99},
    }


def plate(z: float, **bsdf) -> dict:
    return facing([0, 0, z], [0, 0, 1], [0, 1, 0], 9, bsdf=bsdf)


@pytest.mark.parametrize("z", [-1.0, 1.1, 2.0])
def test_a_polariser_before_behind_and_inside_fog(z):
    # A boundary of equal index would let all light through
    S = traced(mi.load_dict(fog(1.0) | {"plate": plate(z, type="polarizer")}), 100_000)
    assert abs(S[0] / (0.5 * np.exp(-1)) - 1) < 0.02
    assert np.allclose(S[1:] / S[0], [1, 0, 0], atol=1e-6)


def test_fog_keeps_what_it_does_not_scatter_and_depolarises_the_rest():
    # What is not scattered is e^-1 of the light, wholly polarised, whatever the albedo
    absorbing, scattering = (
        traced(mi.load_dict(fog(1.0, albedo) | {"plate": plate(0, type="polarizer")}), 200_000)
        for albedo in (0.0, 0.9)
    )
    assert abs(scattering[1] / absorbing[1] - 1) < 0.02
    assert scattering[0] > 1.1 * absorbing[0]


@pytest.mark.parametrize("angle", [30, 90, 140])
@pytest.mark.parametrize("roll", [0, 25])
def test_small_particles_polarise_what_they_scatter_once(angle, roll):
    # Sunlight that is turned by an angle: (1 - c²) / (1 + c²), across the plane of both directions
    a, r = np.radians(angle), np.radians(2 * roll)
    scene = fog(0.1, 0.5, phase={"type": "rayleigh"})
    del scene["lamp"]
    d = [float(np.sin(a)), 0.0, float(np.cos(a))]
    irradiance = {"type": "uniform", "value": 1.0}
    scene["sun"] = {"type": "directional", "direction": d, "irradiance": irradiance}
    scene["integrator"]["max_depth"] = 2
    up = turned(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]), roll)
    look = mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], list(up))
    scene["sensor"]["to_world"] = look
    S = traced(mi.load_dict(scene), 20_000)
    degree = (1 - np.cos(a) ** 2) / (1 + np.cos(a) ** 2)
    assert S[0] > 1e-4
    assert np.allclose(S[1:] / S[0], [-degree * np.cos(r), degree * np.sin(r), 0], atol=1e-4)


def test_a_dipole_does_not_shine_along_its_axis():
    comes, goes = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 0, 1)
    matrix = np.array(polarisation.rayleigh(mi.UnpolarizedSpectrum(0.1), comes, goes))
    matrix = matrix.reshape(4, 4)
    for axis, expected in (([0.0, 0.0, 1.0], 0.0), ([0.0, 1.0, 0.0], 0.2)):
        frame = np.array(polarisation.turned(mi.Vector3f(-1, 0, 0), mi.Vector3f(axis)))
        light = np.linalg.inv(frame.reshape(4, 4)) @ [1, 1, 0, 0]  # Oscillates along the axis
        assert np.allclose((matrix @ light)[0], expected, atol=1e-6)
    straight = np.array(polarisation.rayleigh(mi.UnpolarizedSpectrum(1), -goes, goes))
    assert np.allclose(straight.reshape(4, 4), np.eye(4), atol=1e-6)
    back = polarisation.rayleigh(mi.UnpolarizedSpectrum(1), goes, goes)
    assert not dr.any(dr.isnan(back[3, 3]))[0]


def test_fog_of_small_particles_is_as_bright_as_it_is():
    # Many times scattered: no more polarised than wholly, and bounded by the light there is
    S = traced(mi.load_dict(fog(2.0, 1.0, phase={"type": "rayleigh"})), 100_000)
    assert 0 < S[0] < 1
    assert np.linalg.norm(S[1:]) < 0.02 * S[0]


def test_rayleigh_in_a_blend_is_refused():
    blend = {"type": "blendphase", "weight": 0.5, "a": {"type": "rayleigh"}, "b": {"type": "hg"}}
    scene = mi.load_dict(fog(1.0, 0.5, phase=blend))
    with pytest.raises(ValueError, match=r"\A\S+phase = blendphase: must have no rayleigh.*\Z"):
        check_scene(scene, media=True, polarisation=True)


# ---------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    "integrator",
    ["transient_nlos_path", "confocal_transient_path", "ao"],
)
def test_who_does_not_follow_polarised_light_says_so(integrator):
    with pytest.raises(ValueError, match=r"\Avariant = 'llvm_ad_mono_polarized': must be one"):
        tofrender.render(
            metals(**LONG) | {"integrator": {"type": integrator}}, spp=1, progress=False
        )


@pytest.mark.parametrize(
    "call",
    [
        lambda dataset, path: tofrender.save_video(dataset, path / "a.mp4"),
        lambda dataset, path: tofrender.summary_figure(dataset),
        lambda dataset, path: tofrender.visualize_transient(dataset),
        lambda dataset, path: tofrender.transient_to_phasor(dataset, 20e6),
    ],
)
def test_who_takes_one_component_says_so(call, tmp_path):
    scene = mi.load_dict(metals(**LONG) | {"integrator": {"type": "transient_path"}})
    dataset = tofrender.render(scene, spp=1, progress=False)
    with pytest.raises(ValueError, match=r"\A.*stokes.*\Z"):
        call(dataset, tmp_path)


# ------------------------------------------------------------------------------ planted bugs


def test_a_frame_that_is_not_turned_is_found(monkeypatch):
    monkeypatch.setattr("tofrender.paths.camera.sensor_frame", lambda sensor, ray: None)
    S = traced(bench((BREWSTER, 0), roll=45), 2_000)
    assert not np.allclose(S[1:] / S[0], [0, 1, 0], atol=0.1)


def test_matrices_in_the_other_order_are_found(monkeypatch):
    right = records.extended
    swapped = lambda β, f, importance=False: right(β, f, True)  # noqa: E731
    monkeypatch.setattr(records, "extended", swapped)
    S = traced(bench((70, 0), (BREWSTER, 40)), 20_000)
    assert not np.allclose(S[1:] / S[0], [-1, 0, 0], atol=0.1)


def test_matrices_in_their_own_frames_are_found(monkeypatch):
    monkeypatch.setattr("tofrender.paths.scattering.in_world", lambda si, f, comes, goes: f)
    S = traced(bench((BREWSTER, 0), (BREWSTER, 30)), 200_000)
    both = ((N**2 - 1) / (N**2 + 1)) ** 4 * 0.75 / 2
    assert abs(S[0] - both) > 0.1 * both or not np.allclose(S[1:] / S[0], [-1, 0, 0], atol=0.1)


# ---------------------------------------------------------------------------------- pictures


def test_degrees_and_angles_of_a_render():
    scene = bench((70, 0), roll=30)
    S = traced(scene, 20_000)
    assert abs(tofrender.degree_of_linear_polarisation(S, axis=0) - 0.7515800) < 1e-4
    # Along the mirror, which the camera sees turned against its roll
    assert abs(np.degrees(tofrender.angle_of_linear_polarisation(S, axis=0)) - 60) < 0.01
    dataset = tofrender.render(
        mi.load_dict(metals(**LONG) | {"integrator": {"type": "transient_path"}}),
        spp=4,
        progress=False,
    )
    degree = tofrender.degree_of_polarisation(dataset["transient"])
    assert degree.dims == ("y", "x", "opl", "channel")
    lit = (dataset["transient"].sel(stokes="S0") > 1e-3).values
    assert np.isnan(degree.values[dataset["transient"].sel(stokes="S0").values <= 0]).all()
    assert degree.values[lit].max() <= 1 + 1e-4
    figure = tofrender.polarisation_figure(dataset["steady"])
    assert [axes.get_title() for axes in figure.axes[::2]][2] == "angle"


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: tofrender.degree_of_polarisation(np.ones((3, 3))), "stokes with shape"),
        (lambda: tofrender.angle_of_linear_polarisation(1.0), "stokes with shape"),
        (lambda: tofrender.degree_of_polarisation(np.ones((4, 3)), axis=5), "axis = 5"),
        (lambda: tofrender.polarisation_figure(np.ones((4, 4, 3, 1))), "stokes with shape"),
        (lambda: tofrender.polarisation_figure(np.ones((4, 4, 4, 1)), exposure=0), "exposure = 0"),
    ],
)
def test_what_is_no_stokes_vector(call, said):
    with pytest.raises(ValueError, match=r"\A.+\Z") as error:
        call()
    assert str(error.value).startswith(said)


@pytest.mark.parametrize(
    ("shown", "colour"),
    [("intensity", (255, 255, 255)), ("circular", (221, 221, 221)), ("angle", None)],
)
def test_pictures_in_false_colours(shown, colour):
    light = np.zeros((2, 3, 4, 1))
    light[0, :, 0] = light[0, :, 1] = 1  # Wholly polarised across `up`; no light below
    found = tofrender.polarisation_picture(light, shown, exposure=1)
    assert found.shape == (2, 3, 3)
    assert found.dtype == np.uint8
    assert not found[1].any()
    assert found[0].any()
    if colour is not None:
        np.testing.assert_allclose(found[0, 0], colour, atol=1)


def test_false_colours_are_paler_where_less_is_polarised():
    light = np.zeros((1, 3, 4, 1))
    light[0, :, 0], light[0, :, 2] = 0.5, [[0.0], [0.2], [0.5]]
    found = tofrender.polarisation_picture(light, exposure=1).astype(int)[0]
    assert np.ptp(found, axis=-1).tolist() == sorted(np.ptp(found, axis=-1).tolist())
    assert np.ptp(found[0]) == 0 < np.ptp(found[2])


@pytest.mark.parametrize(
    ("light", "more", "said"),
    [
        (np.ones((4, 4, 3, 1)), {}, "stokes with shape"),
        (np.ones((4, 4, 4, 1)), {"shown": "hue"}, "shown = 'hue'"),
        (np.ones((4, 4, 4, 1)), {"exposure": 0}, "exposure = 0"),
    ],
)
def test_what_is_no_such_picture(light, more, said):
    with pytest.raises(ValueError, match=r"\A.+\Z") as error:
        tofrender.polarisation_picture(light, **more)
    assert str(error.value).startswith(said)
