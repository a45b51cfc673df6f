"""The sampler `padded_sobol`: even in every pair, independent between pairs and pixels."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.limits import lower
from helpers.support import agree, load, over_seeds, rendered, with_sampler

import tofrender
from tofrender.scenes import cornell_box


def seeded(lanes: int, pixels: int = 1, seed: int = 0, spp: int | None = None):
    """A sampler whose first `lanes` lanes share a pixel."""
    sampler = mi.load_dict({"type": "padded_sobol", "sample_count": spp or lanes}, parallel=False)
    sampler.set_samples_per_wavefront(lanes)
    sampler.seed(seed, lanes * pixels)
    return sampler


def squares(lanes: int, pixels: int = 1, seed: int = 0, pairs: int = 1) -> np.ndarray:
    """Points of shape (pairs, pixels, lanes, 2)."""
    sampler = seeded(lanes, pixels, seed)
    points = [np.array(sampler.next_2d()).T.reshape(pixels, lanes, 2) for _ in range(pairs)]
    return np.array(points)


@pytest.mark.parametrize("m", [1, 4, 6, 9])
def test_elementary_boxes_hold_one_point_each(m):
    """A (0, 2)-net: every 2^k x 2^(m-k) grid, in every pair and pixel."""
    for points in squares(1 << m, pixels=3, seed=5, pairs=4).reshape(-1, 1 << m, 2):
        assert points.min() >= 0
        assert points.max() < 1
        for k in range(m + 1):
            cell = (points * [1 << k, 1 << (m - k)]).astype(int)
            index = cell[:, 0] * (1 << (m - k)) + cell[:, 1]
            assert np.array_equal(np.sort(index), np.arange(1 << m))


def test_parts_of_a_sequence_are_nets_too():
    """Points 2^m j ... 2^m (j + 1) of the sequence are a net for every j: it is no net by luck."""
    sampler = seeded(16, seed=9, spp=64)
    for _ in range(4):
        points = np.array(sampler.next_2d()).T
        for k in range(5):
            cell = (points * [1 << k, 1 << (4 - k)]).astype(int)
            assert np.unique(cell[:, 0] * 16 + cell[:, 1]).size == 16
        sampler.advance()


@pytest.mark.parametrize("m", [3, 6, 10])
def test_single_numbers_are_stratified(m):
    sampler = seeded(1 << m, seed=2)
    for _ in range(3):
        cells = (np.array(sampler.next_1d()) * (1 << m)).astype(int)
        assert np.array_equal(np.sort(cells), np.arange(1 << m))


@pytest.mark.statistical
def test_moments_are_uniform():
    """One point of each of many pixels is a plain random sample: mean 1/2, 1/3, and xy 1/4."""

    def moments(seed):
        x, y = squares(1, pixels=4096, seed=seed)[0, :, 0].T
        return [x.mean(), y.mean(), (x**2).mean(), (y**2).mean(), (x**3).mean(), (x * y).mean()]

    samples = over_seeds(moments, range(32))
    expected = np.array([1 / 2, 1 / 2, 1 / 3, 1 / 3, 1 / 4, 1 / 4])
    assert agree(samples, expected)
    assert not agree(samples * 1.1, expected)


@pytest.mark.statistical
def test_pairs_and_pixels_are_independent():
    """No correlation between pairs of one pixel, between pixels, or between seeds."""

    def products(seed):
        points = squares(4, pixels=1024, seed=seed, pairs=3) - 0.5
        after = squares(4, pixels=1024, seed=seed + 100_000) - 0.5
        own, next_pair, third = points[:, :, :, 0]
        return 1 + 12 * np.array(
            [
                (own * next_pair).mean(),
                (own * third).mean(),
                (next_pair * third).mean(),
                (own[1:] * own[:-1]).mean(),
                (own[2:] * own[:-2]).mean(),
                (own[32:] * own[:-32]).mean(),
                (own * after[0, :, :, 0]).mean(),
                (own * points[1, :, :, 1]).mean(),
            ]
        )

    samples = over_seeds(products, range(32))
    assert agree(samples, np.ones(8))
    assert not agree(samples + 0.1, np.ones(8))


def test_stopping_and_going_on_is_one_go():
    """Points come in the same order for any number of lanes."""
    whole = squares(64, pixels=5, seed=7, pairs=2)
    for lanes in (4, 16):
        sampler = seeded(lanes, pixels=5, seed=7, spp=64)
        parts = []
        for _ in range(64 // lanes):
            parts.append([np.array(sampler.next_2d()).T.reshape(5, lanes, 2) for _ in range(2)])
            sampler.advance()
        assert np.array_equal(np.concatenate(np.array(parts), axis=2), whole)


def test_clone_goes_on_and_fork_starts_anew():
    sampler = seeded(8, seed=1)
    sampler.next_2d()
    twin = sampler.clone()
    assert np.array_equal(np.array(sampler.next_2d()), np.array(twin.next_2d()))
    sampler.advance()
    assert not np.array_equal(np.array(sampler.next_1d()), np.array(twin.next_1d()))
    fork = sampler.fork()
    assert fork.sample_count() == sampler.sample_count()
    fork.set_samples_per_wavefront(8)
    fork.seed(1, 8)
    assert np.array_equal(np.array(fork.next_2d()).T, squares(8, seed=1)[0, 0])


def test_seeds():
    of_0, of_1, last, before = (squares(16, seed=n) for n in (0, 1, (1 << 32) - 1, (1 << 32) - 2))
    assert not np.array_equal(of_0, of_1)
    assert not np.array_equal(last, before)
    own = [mi.load_dict({"type": "padded_sobol", "sample_count": 16, "seed": n}) for n in (0, 5)]
    of_0, of_5 = map(first_numbers, own)
    assert not np.array_equal(of_0, of_5)
    for copy in (own[1].fork(), own[1].clone()):
        assert np.array_equal(first_numbers(copy), of_5)


def first_numbers(sampler: mi.Sampler) -> np.ndarray:
    sampler.seed(0, 16)
    return np.array(sampler.next_1d())


def test_runs_in_a_symbolic_loop():
    """The loop's numbers are those of one step after the other."""
    sampler = seeded(4, seed=6, spp=16)
    total = np.zeros(4)
    for _ in range(4):
        total += np.array(sampler.next_2d().x)
        sampler.advance()
    looping = seeded(4, seed=6, spp=16)
    left, sum_x = dr.full(mi.UInt32, 4, 4), dr.zeros(mi.Float, 4)

    def step(left, sum_x, sampler):
        sum_x += sampler.next_2d().x
        sampler.advance()
        return left - 1, sum_x, sampler

    _, sum_x, _ = dr.while_loop((left, sum_x, looping), lambda left, *_: left > 0, step)
    assert np.array(sum_x) == pytest.approx(total, rel=1e-6)


def cube_variance(kind: str, spp: int) -> float:
    scene = cornell_box(width=8, height=8, temporal_bins=60, bin_width_opl=0.1)
    loaded = load(with_sampler(scene, kind))
    cubes = [rendered(loaded, spp, seed)[1] for seed in range(8)]
    return float(np.var(cubes, axis=0, ddof=1).sum())


@pytest.mark.usefixtures("mitsubas_steps")
def test_lower_variance_than_independent():
    """Most of it in the pixels that see the lamp."""
    assert cube_variance("padded_sobol", 64) < 0.25 * cube_variance("independent", 64)


@pytest.mark.usefixtures("mitsubas_steps")
@pytest.mark.parametrize("kind", ["multijitter", "ldsampler"])
def test_samplers_of_mitsuba_go_on_in_the_next_step(kind, monkeypatch):
    """In sixteen steps, 64 points are as even as in one; the same four again would be far worse."""
    lower(monkeypatch, step_samples=8 * 8 * 4)
    assert cube_variance(kind, 64) < 0.4 * cube_variance("independent", 64)


def test_render_in_steps_keeps_the_point_set(monkeypatch):
    """64 samples in one step or in several have the same points: the same picture."""
    scene = load(with_sampler(cornell_box(width=32, height=32), "padded_sobol"))
    whole = rendered(scene, 64, 2)[1]
    lower(monkeypatch, step_samples=32 * 32 * 8)
    parts = rendered(scene, 64, 2)[1]
    assert np.abs(parts - whole).max() < 1e-5 * whole.max()


@pytest.mark.statistical
def test_mitsubas_own_integrators_get_stratified_points():
    """They never say how many lanes share a pixel; without stratification the ratio would be 1."""
    errors = {}
    reference = None
    for kind, spp in (("independent", 4096), ("independent", 64), ("padded_sobol", 64)):
        described = tofrender.cornell_box_steady_state(width=16, height=16, spp=spp)
        described["sensor"]["sampler"]["type"] = kind
        image = np.array(mi.render(mi.load_dict(described), spp=spp, seed=3))
        if reference is None:
            reference = image
        else:
            errors[kind] = float(np.mean((image - reference) ** 2))
    assert errors["padded_sobol"] < 0.4 * errors["independent"]


def test_seeding_for_one_lane_leaves_no_trace():
    """Mitsuba seeds a scene's own sampler with one lane now and then."""
    pictures = []
    for seeded in (False, True):
        scene = mi.load_dict(tofrender.cornell_box_steady_state(width=8, height=8, spp=16))
        if seeded:
            scene.sensors()[0].sampler().seed(0, 1)
        pictures.append(np.array(mi.render(scene, spp=16, seed=1)))
    np.testing.assert_array_equal(*pictures)
