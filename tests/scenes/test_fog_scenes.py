"""Scenes with fog, milk and smoke: files, windows, clear air, light as Mitsuba finds it."""

from __future__ import annotations

import pickle
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.support import agree, over_seeds, parsed, require_equal, with_film, with_integrator

import tofrender
from tofrender.scenes import BUILT_IN, describe, fog
from tofrender.scenes.packing import packed, unpacked

FOLDER = Path(__file__).parents[2] / "scenes" / "fog"
ALL = ["cornell_box_fog", "lamp_in_milk", "smoke_corridor", "headlight_in_fog"]
FOLLOWING = ("transient_volpath", "transient_path", "path_tracer_mis")
MEDIUM = {"fog", "milk", "smoke"}
MOST = {
    "cornell_box_fog": fog.MAX_FOG,
    "lamp_in_milk": fog.MAX_MILK,
    "smoke_corridor": fog.MAX_SMOKE,
    "headlight_in_fog": fog.MAX_ROAD_FOG,
}
SEEDS = range(8)


def load(described: dict) -> mi.Scene:
    return tofrender.load_scene(described, optimize=False)


def without_medium(described: dict) -> dict:
    """The same scene in vacuum, without boundaries of equal index."""
    kept = {}
    for name, part in described.items():
        if name in MEDIUM or (isinstance(part, dict) and part.get("bsdf") == {"type": "null"}):
            continue
        if isinstance(part, dict):
            around = ("medium", "interior", "exterior")
            part = {key: value for key, value in part.items() if key not in around}
        kept[name] = part
    return kept


# ------------------------------------------------------------------------------------- files


def test_every_scene_has_a_file():
    assert {path.stem for path in FOLDER.glob("*.xml")} == set(ALL)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    "changes",
    [{}, {"width": 7, "spp": 3, "start_opl": 1.5, "integrator": "path_tracer_nee", "sigma_t": 0.4}],
)
def test_xml_is_the_dict(name, changes):
    file, described = parsed(FOLDER / f"{name}.xml", **changes), parsed(BUILT_IN[name](**changes))
    if name == "smoke_corridor":
        path = file["gridvolume"][1].pop("filename")
        grid = described["gridvolume"][1].pop("grid")
        assert path == "smoke.vol"
        kept = mi.VolumeGrid(str(FOLDER / path))
        np.testing.assert_allclose(np.array(kept), np.array(grid), atol=1e-7)
    require_equal(file, described)


@pytest.mark.parametrize("name", ALL)
def test_first_line_of_the_file_is_the_description(name):
    lines = (FOLDER / f"{name}.xml").read_text(encoding="utf-8").splitlines()
    assert lines[2].strip() == describe(name)
    assert len(describe(name)) <= 72


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral"])
def test_every_scene_renders_under_every_variant(variant):
    mi.set_variant(variant)
    for name in ALL:
        for source in (name, FOLDER / f"{name}.xml"):
            scene = tofrender.load_scene(source, width=8, height=8, temporal_bins=4)
            assert len(scene.emitters()) == 1
            steady, transient = (np.array(each) for each in mi.render(scene, spp=16))
            assert np.isfinite(steady).all()
            assert np.isfinite(transient).all()
            assert steady.max() > 0


@pytest.mark.parametrize("integrator", FOLLOWING)
@pytest.mark.parametrize("name", ALL)
def test_integrators_have_the_depth_that_is_given(name, integrator):
    scene = load(BUILT_IN[name](integrator=integrator, max_depth=3, width=4, height=4))
    assert scene.integrator().max_depth == 3
    assert np.isfinite(np.array(mi.render(scene, spp=1)[0])).all()


def test_a_grid_goes_to_another_process():
    described = BUILT_IN["smoke_corridor"]()
    sent = pickle.loads(pickle.dumps(packed("scene", described)))
    grids = [np.array(each["smoke"]["sigma_t"]["grid"]) for each in (unpacked(sent), described)]
    np.testing.assert_array_equal(*grids)


# ----------------------------------------------------------------------------------- windows


@pytest.mark.parametrize("name", ALL)
def test_windows_hold_the_light(name):
    """A warning would fail the test."""
    found = tofrender.render(BUILT_IN[name](width=32, height=32), spp=64)
    assert found.attrs["energy_outside_window"] < 0.01


@pytest.mark.parametrize("name", ALL)
def test_windows_start_before_the_first_light(name):
    described = BUILT_IN[name](width=32, height=32)
    start = described["sensor"]["film"]["start_opl"]
    bins = {"temporal_bins": 2, "start_opl": start - 10, "bin_width_opl": 10.0}
    before, after = light_in_bins(load(with_film(described, **bins)), spp=256).sum(axis=-1)
    assert before == 0
    assert after > 0


def light_in_bins(scene: mi.Scene, spp: int, seed: int = 0) -> np.ndarray:
    """Light of the whole picture, shape (bins, channels)."""
    transient = np.array(mi.render(scene, spp=spp, seed=seed)[1], dtype=np.float64)
    return transient.mean(axis=(0, 1))


# ---------------------------------------------------------------------------- gaps and leaks


def random_rays(center: list[float], lanes: int = 1 << 18) -> mi.Ray3f:
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, lanes)
    direction = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    return mi.Ray3f(mi.Point3f(center) + dr.zeros(mi.Float, lanes), direction)


def test_milk_has_a_closed_surface():
    """Seen from inside, all around, and nothing of the scene is in it but the lamp."""
    described = BUILT_IN["lamp_in_milk"]()
    del described["light"]
    scene = load(described)
    milk = [mi.ShapePtr(each) for each in scene.shapes() if each.id().startswith("milk")]
    for center in ([0, 0.04, 0], [0.03, 0.002, 0], [0, 0.099, 0.034]):
        hit = scene.ray_intersect(random_rays(center))
        assert len(milk) == 3
        assert dr.all((hit.shape == milk[0]) | (hit.shape == milk[1]) | (hit.shape == milk[2]))
        assert dr.all(dr.dot(hit.n, hit.to_world(hit.wi)) < 0)


@pytest.mark.parametrize("z", [0.5, 5.0, 9.7])
def test_the_corridor_is_closed(z):
    described = BUILT_IN["smoke_corridor"]()
    del described["smoke-end"]
    hit = load(described).ray_intersect(random_rays([0.1, 1.45, z]))
    assert dr.all(hit.is_valid())
    assert dr.all(hit.wi.z > 0)


# --------------------------------------------------------------------------------- the media


@pytest.mark.statistical
@pytest.mark.parametrize("name", ALL)
def test_no_density_is_clear_air(name):
    """In every tenth of the window."""
    described = BUILT_IN[name](width=16, height=16, sigma_t=0, max_depth=6)
    film = described["sensor"]["film"]
    length = film["temporal_bins"] * film["bin_width_opl"]
    described = with_film(described, temporal_bins=10, bin_width_opl=length / 10)
    scene, twin = load(described), load(without_medium(described))
    thin = over_seeds(lambda seed: light_in_bins(scene, 256, seed), SEEDS)
    clear = over_seeds(lambda seed: light_in_bins(twin, 256, seed + 100), SEEDS)
    kept = (thin > 0).all(axis=(0, 2)) & (clear > 0).all(axis=(0, 2))
    assert kept.sum() >= 5
    mean = clear[:, kept].mean(axis=0)
    assert agree(thin[:, kept] - clear[:, kept] + mean, mean)


@pytest.mark.statistical
@pytest.mark.parametrize("name", ALL)
def test_light_of_all_time_is_that_of_volpath(name):
    """Of the whole picture and its quarters.

    Mitsuba 3.9's `volpath` loses light of lamps that are close behind a boundary of equal index;
    here none is.
    """
    described = BUILT_IN[name](width=2, height=2, spp=1)
    sensor = described["sensor"]
    steady = {"type": "hdrfilm", "width": 2, "height": 2, "rfilter": {"type": "box"}}
    twin = described | {
        "sensor": sensor | {"film": steady, "sampler": {"type": "independent"}},
        "integrator": {"type": "volpath", "max_depth": -1},
    }
    ours, theirs = load(described), mi.load_dict(twin)
    found = over_seeds(lambda seed: np.array(mi.render(ours, spp=8192, seed=seed)[0]), SEEDS)
    wanted = over_seeds(lambda seed: np.array(mi.render(theirs, spp=8192, seed=seed + 100)), SEEDS)
    mean = wanted.mean(axis=0)
    assert agree(found - wanted + mean, mean)
    found, wanted = found.mean(axis=(1, 2)), wanted.mean(axis=(1, 2))
    assert agree(found - wanted + wanted.mean(axis=0), wanted.mean(axis=0))


def test_the_lamp_shines_through_milk():
    """Straight on: its light is later by the index, and less by what is scattered and reflected."""
    described = with_integrator(BUILT_IN["lamp_in_milk"](sigma_t=40), max_depth=2)
    lamp, index = described["light"], fog.MILK_INDEX
    x, y, z = lamp["center"]
    described["sensor"] |= {
        "fov": 0.05,
        "to_world": mi.ScalarTransform4f().look_at([x, y, z + 0.4], [x, y, z], [0, 1, 0]),
    }
    start = 0.4 - 0.035 + index * (0.035 - lamp["radius"]) - 1e-4
    window = {"width": 2, "height": 2, "temporal_bins": 2, "start_opl": start}
    scene = load(with_film(described, **window, bin_width_opl=2e-4))
    in_time, late = light_in_bins(scene, spp=4096)
    share = (1 - ((index - 1) / (index + 1)) ** 2) / index**2
    share *= np.exp(-40 * (0.035 - lamp["radius"]))
    np.testing.assert_allclose(
        in_time, share * np.array(lamp["emitter"]["radiance"]["value"]), rtol=0.05
    )
    assert late.max() < 0.05 * in_time.min()


def test_smoke_is_as_its_formula():
    density = fog.smoke_density()
    assert density.shape == (64, 20, 16, 1)
    assert 0 <= density.min() < 0.01
    assert 0.9 < density.max() <= 1
    assert 0.05 < density.mean() < 0.4
    assert not density.flags.writeable
    smoke = BUILT_IN["smoke_corridor"]()["smoke"]
    low, high = np.array(fog.SMOKE_LOW), np.array(fog.SMOKE_HIGH)
    corner = np.array(smoke["sigma_t"]["to_world"].matrix) @ [1, 1, 1, 1]
    np.testing.assert_allclose(corner[:3], high, atol=1e-6)
    for *center, _, _, share in fog.PUFFS:
        x, y, z = ((center - low) / (high - low) * (16, 20, 64)).astype(int)
        assert density[z, y, x, 0] > 0.8 * share


# ------------------------------------------------------------------------------ seen by a gate


def seen(described: dict, *names: str) -> np.ndarray:
    """Which pixels see one of these shapes at their center."""
    scene = load(described)
    film = described["sensor"]["film"]
    w, h = film["width"], film["height"]
    index = dr.arange(mi.UInt32, w * h)
    at = mi.Point2f((index % w + 0.5) / w, (index // w + 0.5) / h)
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, at, 0.5)
    shape = scene.ray_intersect(ray).shape
    found = [shape == mi.ShapePtr(each) for each in scene.shapes() if each.id() in names]
    return np.any(np.array(found), axis=0).reshape(h, w)


def contrast(light: np.ndarray, target: np.ndarray, around: np.ndarray) -> float:
    """(target - around) / (target + around), of mean light."""
    a, b = light[target].mean(), light[around].mean()
    return float((a - b) / (a + b))


def test_a_gate_shows_the_sign_that_fog_hides():
    """Contrast of the sign with a ring around it: 0.8 in the gate, 0.05 in the light of all time.

    Noise of the second is 0.05. Nine tenths of the light arrive before the gate, by half its time.
    """
    described = BUILT_IN["headlight_in_fog"](width=48, height=48)
    target = seen(described, "sign", "bar")
    rows, columns = np.nonzero(target)
    y, x = np.mgrid[:48, :48]
    away = np.hypot(y - rows.mean(), x - columns.mean()) - np.ptp(rows) / 2
    around = (away > 1.5) & (away < 4.5)
    bins = {"temporal_bins": 400, "start_opl": 0.0, "bin_width_opl": 0.1}
    transient = np.array(mi.render(load(with_film(described, **bins)), spp=512, seed=0)[1])
    light = transient.mean(axis=-1, dtype=np.float64)
    gated, steady = light[..., 300:302].sum(axis=-1), light.sum(axis=-1)
    assert contrast(gated, target, around) > 0.7
    assert abs(contrast(steady, target, around)) < 0.2
    assert gated[target].mean() < 0.05 * steady[target].mean()
    assert 0.85 < light[..., :150].sum() / light.sum() < 0.95
    assert 0.4 < light[..., :63].sum() / light.sum() < 0.6


# --------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"width": 0}, "width = 0: must be an integer from 1 to 65536"),
        ({"height": 2.5}, "height = 2.5: must be an integer"),
        ({"temporal_bins": 0}, "temporal_bins = 0: must be an integer from 1"),
        ({"start_opl": float("nan")}, "start_opl = nan: must be a finite number of metres"),
        ({"bin_width_opl": 0}, "bin_width_opl = 0: must be a finite number of metres above 0"),
        ({"spp": 0}, "spp = 0: must be an integer from 1 to 16777216"),
        ({"max_depth": 0}, r"max_depth = 0: must be -1 \(no limit\) or an integer"),
        ({"integrator": "transient_volpat"}, "did you mean 'transient_volpath'?"),
        ({"integrator": "volpath"}, "integrator = 'volpath': must be one of transient_path"),
        ({"integrator": "ao"}, "integrator = 'ao': must be one of transient_path"),
    ],
)
def test_bad_arguments_are_one_line(name, arguments, text):
    with pytest.raises(ValueError, match=text) as error:
        BUILT_IN[name](**arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [-0.1, 2000, float("nan"), float("inf"), "thick", None, True])
@pytest.mark.parametrize("name", ALL)
def test_bad_densities_are_one_line(name, value):
    allowed = f"must be a finite number of 1/m from 0 to {MOST[name]:g}"
    with pytest.raises(ValueError, match=rf"\Asigma_t = .*: {allowed}\Z"):
        BUILT_IN[name](sigma_t=value)
