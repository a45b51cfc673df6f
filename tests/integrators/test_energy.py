"""No light is lost or counted twice: bins against the steady image, ours against Mitsuba's `path`.

Given the same random numbers, our steady image and Mitsuba's are equal to float rounding, because
both draw the same numbers in the same order. These tests see a change of 1e-6 and need no
statistics. Those marked `statistical` hold for any order.
"""

import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES, emitter_grid
from helpers.light_paths import OTHER_SEEDS, SEEDS, blocks
from helpers.parts import gray, plane, rotate, translate
from helpers.support import (
    agree,
    camera,
    film,
    largest,
    load,
    over_seeds,
    path_image,
    rendered,
    scene,
    steady_twin,
    with_film,
    with_integrator,
    with_sampler,
)

from tofrender.scenes import cornell_box

pytestmark = pytest.mark.usefixtures("mitsubas_steps")


def all_its_light(described: dict, spp: int, seed: int) -> np.ndarray:
    """The steady picture, which is Mitsuba's, and the sum of the bins."""
    steady, transient = rendered(described, spp, seed)
    assert largest(steady, path_image(described, spp, seed)) < 1e-5
    assert largest(transient.sum(axis=2), steady) < 1e-5
    return steady


@pytest.mark.parametrize("name", SCENES)
def test_scene_has_all_its_light(name):
    assert all_its_light(SCENES[name](), spp=64, seed=1).max() > 0.05


@pytest.mark.parametrize("name", ["cornell", "constant environment", "many lights", "mask"])
def test_hide_emitters(name):
    described = with_integrator(SCENES[name](), hide_emitters=True)
    steady = all_its_light(described, spp=64, seed=1)
    shown = path_image(with_integrator(described, hide_emitters=False), spp=64, seed=1)
    assert largest(steady, shown) > 0.01


@pytest.mark.parametrize("name", ["cornell", "constant environment", "many lights", "glass"])
def test_discard_direct_light_drops_direct_emission_only(name):
    described = SCENES[name]()
    emission = path_image(described, spp=64, seed=1, max_depth=1)
    whole = path_image(described, spp=64, seed=1)
    steady, transient = rendered(with_integrator(described, discard_direct_light=True), 64, seed=1)
    assert emission.max() > 0.1
    assert largest(steady, whole - emission) < 1e-5
    assert largest(transient.sum(axis=2), steady) < 1e-5


@pytest.mark.parametrize(("max_depth", "rr_depth"), [(1, 5), (2, 1), (3, 5), (-1, 1), (-1, 5)])
def test_depths(max_depth, rr_depth):
    described = with_integrator(SCENES["glass"](), max_depth=max_depth, rr_depth=rr_depth)
    all_its_light(described, spp=16, seed=2)


@pytest.mark.parametrize(
    ("rfilter", "border"),
    [("gaussian", False), ("gaussian", True), ("tent", True), ("mitchell", False)],
)
def test_spatial_filters(rfilter, border):
    described = with_film(SCENES["cornell"](), rfilter={"type": rfilter}, sample_border=border)
    all_its_light(with_integrator(described, temporal_filter="box"), spp=16, seed=3)


CROP = {"crop_width": 3, "crop_height": 2, "crop_offset_x": 4, "crop_offset_y": 5}


@pytest.mark.parametrize("rfilter", ["box", "gaussian"])
@pytest.mark.parametrize("border", [False, True])
def test_crop_window(rfilter, border):
    window = {"rfilter": {"type": rfilter}, "sample_border": border, **CROP}
    described = with_film(SCENES["cornell"](), **window)
    steady = all_its_light(with_integrator(described, temporal_filter="box"), spp=64, seed=4)
    assert steady.shape == (2, 3, 3)


def test_crop_is_the_crop_of_the_whole():
    """Without noise, a crop equals the full picture's part: every pixel, every bin."""
    whole_scene, expected = emitter_grid(8, 6)
    part_scene, _ = emitter_grid(8, 6)  # Mitsuba empties a bitmap's data when it loads it
    _, whole = rendered(whole_scene, spp=4)
    steady, part = rendered(with_film(part_scene, **CROP | {"crop_offset_y": 3}), spp=4)
    assert whole[..., 0] == pytest.approx(expected, rel=1e-6)
    assert part == pytest.approx(whole[3:5, 4:7], rel=1e-6)
    assert steady == pytest.approx(whole[3:5, 4:7].sum(axis=2), rel=1e-6)


def full_window(width: int, height: int, bins: int = 2, **more) -> dict:
    """A Cornell box whose window holds all light."""
    window = {"temporal_bins": bins, "start_opl": 0.0, "bin_width_opl": 40.0 / bins}
    return with_sampler(cornell_box(width=width, height=height, **window, **more))


@pytest.mark.parametrize(
    ("spp", "bins"), [(1, 400), (2, 2), (3, 400), (4, 2), (6, 400), (7, 2), (64, 400)]
)
def test_no_deposit_is_lost_where_pixels_are_private(spp, bins):
    """Films of 1024 pixels or more add without atomics; the steady sum is kept in registers."""
    steady, transient = rendered(full_window(64, 64, bins, max_depth=8), spp=spp, seed=5)
    # Each bin of a pixel is rounded once per deposit
    assert np.abs(transient.sum(axis=2) - steady).max() < 2e-6 * steady.max()
    assert transient[:, :, :, 0].sum() == pytest.approx(steady[:, :, 0].sum(), rel=1e-6)


@pytest.mark.parametrize(
    ("variant", "size", "spp"),
    [
        *[("rgb", size, 24) for size in ((1, 1), (5, 3), (31, 33), (40, 30), (129, 8))],
        *[("mono", (64, 64), spp) for spp in (1, 3, 4, 16)],
    ],
)
def test_no_deposit_is_lost_in_odd_films_and_in_a_single_channel(variant, size, spp):
    mi.set_variant(f"llvm_ad_{variant}")
    steady, transient = rendered(full_window(*size), spp=spp, seed=6)
    assert largest(transient.sum(axis=2), steady) < 3e-6


@pytest.mark.parametrize(
    "kind", ["independent", "padded_sobol", "stratified", "multijitter", "orthogonal", "ldsampler"]
)
def test_every_sampler(kind):
    described = with_sampler(SCENES["glass"](), kind)
    steady, transient = rendered(described, spp=16, seed=7)
    assert largest(transient.sum(axis=2), steady) < 3e-6
    if kind != "padded_sobol":  # Mitsuba rounds the sample count in the same way
        assert largest(steady, path_image(described, spp=16, seed=7)) < 1e-5


@pytest.mark.parametrize(
    "options",
    [
        {"temporal_filter": "gaussian"},
        {"temporal_filter": "gaussian", "gaussian_stddev": 0.3},
        {"pulse_width_opl": 0.1},
        {"pulse_width_opl": 0.1, "temporal_filter": "gaussian"},
    ],
)
def test_pulse_and_temporal_filter_keep_the_energy(options):
    described = SCENES["glass"]()
    plain, bins = rendered(described, spp=16, seed=9)
    steady, spread = rendered(with_integrator(described, **options), spp=16, seed=9)
    assert largest(steady, plain) < 1e-6
    assert largest(spread.sum(axis=2), steady) < 1e-5
    assert largest(spread, bins) > 0.01


def test_same_seed_same_picture():
    described = load(SCENES["cornell"]())
    first, second, other = (rendered(described, spp=4, seed=seed) for seed in (3, 3, 4))
    assert largest(first[0], second[0]) < 1e-6
    assert largest(first[1], second[1]) < 1e-6
    assert largest(first[1], other[1]) > 0.1


def test_a_million_samples_in_one_pixel_are_not_low():
    """Added to one number in single precision, 2^20 lose 0.4 % of it."""
    lamp = plane(emitter={"type": "area", "radiance": gray(0.7)})
    described = scene({"lamp": lamp}, camera((0, 0, 3), (0, 0, 0), film(bins=8, bin_width=1.0)))
    steady, transient = rendered(described, spp=1 << 20)
    assert transient[0, 0, 3] == pytest.approx([0.7] * 3, rel=2e-4)
    assert steady[0, 0] == pytest.approx([0.7] * 3, rel=1e-4)


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["cornell", "glass", "many lights", "environment map"])
def test_scene_in_expectation(name):
    """With private pixels and several samples to a lane: 32 x 32 pixels."""
    size = {"width": 32, "height": 32, "temporal_bins": 100, "bin_width_opl": 0.4}
    described = with_film(SCENES[name](), **size)
    loaded, twin = load(described), load(steady_twin(described))
    ours = over_seeds(lambda s: blocks(rendered(loaded, 16, s)[1].sum(axis=2), 4), SEEDS)
    path = over_seeds(lambda s: blocks(np.array(mi.render(twin, spp=16, seed=s)), 4), OTHER_SEEDS)
    assert agree(ours, path)
    if name == "cornell":
        for wrong in (ours * 1.1, ours[:, ::-1], np.where(path == path.max(), np.nan, ours)):
            assert not agree(wrong, path)


def cube(described: dict, spp: int = 64, seeds=SEEDS, **integrator):
    """Arrival times, summed over pixels, for several seeds."""
    loaded = load(with_integrator(described, **integrator))
    return over_seeds(lambda s: rendered(loaded, spp, s)[1].sum(axis=(0, 1))[:, 0], seeds)


def large_light() -> dict:
    """The Cornell box with a light that paths run into often."""
    window = {"start_opl": 3.5, "temporal_bins": 40, "bin_width_opl": 0.2}
    described = with_film(SCENES["cornell"](), **window)
    above = translate(0, 0.95, 0) @ rotate((1, 0, 0), 90) @ mi.ScalarTransform4f().scale(0.8)
    described["light"] = described["light"] | {"to_world": above}
    return described


ALONE = {"spp": 256, "emitter_sampling": False}
UNLIMITED, LIMITED = {"rr_depth": 1, "max_depth": -1}, {"rr_depth": 100, "max_depth": 60}


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("sampler", "options", "other", "others"),
    [
        pytest.param("padded_sobol", {}, "padded_sobol", ALONE, id="emitter hits alone"),
        pytest.param("padded_sobol", UNLIMITED, "padded_sobol", LIMITED, id="roulette"),
        pytest.param("padded_sobol", {}, "independent", {"spp": 256}, id="sampler"),
        pytest.param("multijitter", {}, "independent", {"spp": 256}, id="sampler of Mitsuba"),
    ],
)
def test_arrival_times_do_not_depend_on(sampler, options, other, others):
    found = cube(with_sampler(large_light(), sampler), **options)
    reference = cube(with_sampler(large_light(), other), seeds=OTHER_SEEDS, **others)
    assert agree(found, reference)
    assert not agree(np.roll(found, 1, axis=1), reference)
    assert sampler != other or not agree(1.1 * found, reference)
