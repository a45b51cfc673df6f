"""Scenes with fog, milk and smoke: no leaks, clear air, light as Mitsuba finds it."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.scenes import load, random_rays, seen
from helpers.support import agree, over_seeds, steady_twin, with_film, with_integrator

from tofrender.scenes import BUILT_IN, fog

ALL = pytest.mark.parametrize(
    "name", ["cornell_box_fog", "lamp_in_milk", "smoke_corridor", "headlight_in_fog"]
)
MEDIUM = {"fog", "milk", "smoke"}
SEEDS = range(8)


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


def light_in_bins(scene: mi.Scene, spp: int, seed: int = 0) -> np.ndarray:
    """Light of the whole picture, shape (bins, channels)."""
    transient = np.array(mi.render(scene, spp=spp, seed=seed)[1], dtype=np.float64)
    return transient.mean(axis=(0, 1))


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


@pytest.mark.statistical
@ALL
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
@ALL
def test_light_of_all_time_is_that_of_volpath(name):
    """Of the whole picture and its quarters.

    Mitsuba 3.9's `volpath` loses light of lamps that are close behind a boundary of equal index;
    here none is.
    """
    described = BUILT_IN[name](width=2, height=2, spp=1)
    twin = steady_twin(described) | {"integrator": {"type": "volpath", "max_depth": -1}}
    twin["sensor"] = twin["sensor"] | {"sampler": {"type": "independent"}}
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


def contrast(light: np.ndarray, target: np.ndarray, around: np.ndarray) -> float:
    """(target - around) / (target + around), of mean light."""
    a, b = light[target].mean(), light[around].mean()
    return float((a - b) / (a + b))


def test_a_gate_shows_the_sign_that_fog_hides():
    """Contrast of the sign with a ring around it: 0.8 in the gate, 0.05 in the light of all time.

    Noise of the second is 0.05. Nine tenths of the light arrive before the gate, by half its time.
    """
    described = BUILT_IN["headlight_in_fog"](width=48, height=48)
    target = seen(described, 48, "sign", "bar")
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
