"""The filter of noise, on films that are known exactly.

An error ratio over four films, 221 000 values, has a standard error below 1 %. Bounds are two of
these away where the filter should do nothing, more elsewhere; the seeds are fixed.
"""

import numpy as np
import pytest
from helpers.limits import lower
from helpers.support import refused
from scipy.ndimage import minimum_filter

import tofrender
from tofrender.denoising import denoise_film, kernels

SHAPE = (24, 24, 32, 3)
Y, X = np.mgrid[:24, :24]
SIGMA = 0.1


def wall(**changes) -> dict:
    """A white wall that faces the camera."""
    ones = np.ones((24, 24, 3), np.float32)
    position = np.dstack([X / 240, Y / 240, 0 * X + 1])
    found = {"position": position, "normal": -ones * (0, 0, 1), "albedo": ones}
    return found | {"distance": ones[..., 0], "kind": 0 * X} | changes


def halves(truth: np.ndarray, seed: int = 0, sigma=SIGMA) -> tuple[np.ndarray, np.ndarray]:
    """Mean of two halves with noise, whose mean has the standard deviation `sigma`, and D."""
    noise = np.random.default_rng(seed).normal(0, 1, (2, *truth.shape)) * np.sqrt(2) * sigma
    return truth + noise.mean(axis=0), (noise[0] - noise[1]) / 2


def spike() -> np.ndarray:
    found = np.zeros(SHAPE)
    found[12, 12, 16] = 50
    return found


def moving_edge() -> np.ndarray:
    """Light that arrives in a bin of its own in each column, and stays."""
    return np.broadcast_to(np.arange(32) >= 4 + X[..., None], SHAPE[:3])[..., None] * np.ones(3)


CHECKED = np.broadcast_to(((X + Y) % 2)[..., None, None] * 2.0, SHAPE)
FILMS = {
    # truth, and the greatest mean error of the filtered film over that of the raw one
    "constant": (np.ones(SHAPE), 0.1),
    "spike": (spike(), 0.3),
    "checkerboard": (CHECKED, 1.02),
    "moving edge": (moving_edge(), 1.02),
    "ramp": (np.broadcast_to((X / 24)[..., None, None], SHAPE) + 0.5, 0.2),
}


def error(truth: np.ndarray, draws: int) -> float:
    """Mean squared error of the filtered film over that of the raw one."""
    filtered = raw = 0.0
    for seed in range(draws):
        mean, noise = halves(truth, seed)
        filtered += ((denoise_film(mean, noise, wall()) - truth) ** 2).sum()
        raw += ((mean - truth) ** 2).sum()
    return filtered / raw


@pytest.mark.statistical
@pytest.mark.parametrize("name", FILMS)
def test_noise_shrinks_and_harm_is_bounded(name):
    truth, bound = FILMS[name]
    assert error(truth, 4) < bound


@pytest.mark.statistical
def test_too_much_smoothing_is_found(monkeypatch):
    """The bug planted: residuals are removed whatever they are."""
    lower(monkeypatch, denoising_margin=0.0)
    for name in ("spike", "checkerboard", "moving edge"):
        assert error(FILMS[name][0], 1) > 1.4 * FILMS[name][1]


def test_nothing_is_lost_and_a_spike_stays():
    for truth in (spike() + 1, CHECKED + moving_edge()):
        mean, noise = halves(truth)
        found = denoise_film(mean, noise, wall(kind=np.where(X < 8, 2, 0)))
        for part in (X < 8, X >= 8):  # Each kind, each channel
            sums = [each[part].sum(axis=(0, 1), dtype=float) for each in (found, mean)]
            np.testing.assert_allclose(*sums, rtol=1e-5)
    found = denoise_film(*halves(spike() + 1), wall())
    assert found[12, 12, 16] == pytest.approx(51, rel=0.01)


def test_exchanged_halves_give_the_same():
    mean, noise = halves(moving_edge())
    np.testing.assert_array_equal(*(denoise_film(mean, d, wall()) for d in (noise, -noise)))


def test_what_has_no_noise_stays():
    truth = moving_edge() + CHECKED
    np.testing.assert_allclose(denoise_film(truth, 0 * truth, wall()), truth, atol=1e-6)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_the_unit_does_not_matter(scale):
    """Nor in films that have noise in one half only."""
    mean, noise = halves(1 + moving_edge(), sigma=SIGMA * (X < 12)[..., None, None])
    expected = denoise_film(mean, noise, wall())
    found = denoise_film(scale * mean, scale * noise, wall()) / scale
    np.testing.assert_allclose(found, expected, atol=1e-3)
    np.testing.assert_allclose(found[:, 16:], mean[:, 16:], atol=1e-3)


def test_an_edge_stays_in_its_bin():
    """Before light arrives there is none."""
    truth = moving_edge()
    mean, noise = halves(truth, sigma=SIGMA * truth)
    assert not denoise_film(mean, noise, wall())[truth == 0].any()


def striped(faint: float) -> np.ndarray:
    """Stripes of three columns that are lit early; the others are lit late and faintly."""
    times = np.arange(32)
    lit_at = np.where(X // 3 % 2 == 0, 8 + X // 8, 99)[..., None]
    late = faint * np.exp(-np.maximum(times - 14, 0) / 8) * (times >= 14)
    early = np.exp(-np.maximum(times - lit_at, 0) / 8) * (times >= lit_at)
    return (early + late)[..., None] * (1, 0.7, 0.4)


def photons(truth: np.ndarray, mean_photons: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and half difference of two films of photons, `mean_photons` for a light of 1."""
    rng = np.random.default_rng(seed)
    first, second = (rng.poisson(truth * mean_photons / 2) * 2 / mean_photons for _ in range(2))
    return (first + second) / 2, (first - second) / 2


def first_bins(film: np.ndarray) -> np.ndarray:
    """First bin with light of each pixel, the number of bins for pixels without light."""
    lit = film.any(axis=-1)
    return np.where(lit.any(axis=-1), lit.argmax(axis=-1), lit.shape[-1])


@pytest.mark.parametrize("faint", [0.1, 0.001])
@pytest.mark.parametrize("mean_photons", [1, 10, 100])
def test_no_light_before_the_first_of_the_neighborhood(mean_photons, faint):
    mean, noise = photons(striped(faint), mean_photons, 3)
    found = denoise_film(mean, noise, wall())
    earliest = minimum_filter(first_bins(mean), 3, mode="nearest")
    assert (first_bins(found) >= earliest).all()
    assert not np.array_equal(found, mean)
    sums = [each.sum(axis=(0, 1, 2), dtype=float) for each in (found, mean)]
    np.testing.assert_allclose(*sums, rtol=1e-5)


@pytest.mark.statistical
def test_faint_bins_do_not_get_worse_as_a_whole():
    """Levels of brightness of a film that decays: the mean squared error falls in each of them."""
    times = np.arange(32)
    arrival = (4 + X // 4)[..., None]
    truth = np.exp(-np.maximum(times - arrival, 0) / 3) * (times >= arrival)
    truth = truth[..., None] * np.ones(3)
    filtered = raw = 0.0
    for seed in range(4):
        mean, noise = photons(truth, 30, seed)
        filtered = filtered + (denoise_film(mean, noise, wall()) - truth) ** 2
        raw = raw + (mean - truth) ** 2
    for low in (0.1, 0.01, 0.001, 1e-4):
        level = (truth > low) & (truth <= 10 * low)
        assert filtered[level].sum() < raw[level].sum(), low


@pytest.mark.parametrize("kind", [1, 2])
def test_lamps_and_mirrors_are_not_mixed(kind):
    """The light of a bright half reaches no pixel beside it, and a lamp's pixels stay."""
    truth = np.where(X < 12, 100.0, 1.0)[..., None, None] * np.ones(SHAPE)
    mean, noise = halves(truth)
    found = denoise_film(mean, noise, wall(kind=np.where(X < 12, kind, 0)))
    assert abs(found[:, 12:] - 1).max() < 0.5
    if kind == 1:
        np.testing.assert_allclose(found[:, :12], mean[:, :12], rtol=1e-6)
    else:
        assert found[:, :12].std() < 0.8 * mean[:, :12].std()


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("kind", [1, 2])
def test_pixels_of_other_kinds_have_no_weights(kind, step):
    """Inside of blocks, too: column 10 is the last of the kind."""
    weights = kernels.pixel_weights(wall(kind=np.where(X < 11, kind, 0)), step)
    across = np.array([right for _, right in kernels.NEIGHBORS])
    assert not weights[:, :11].any()
    assert not weights[:, 11 : 11 + step][..., across < 0].any()
    assert (weights[step:-step, 11 + step : -step] > 0).all()


@pytest.mark.statistical
def test_weak_light_stays():
    """A checkerboard at a third of the noise: with noise taken for twice, it would be removed."""
    weak = 0.3 * SIGMA * (CHECKED - 1)
    found = np.mean([denoise_film(*halves(1 + weak, seed), wall()) for seed in range(4)], axis=0)
    assert ((found - 1) * weak).mean() > 0.9 * (weak**2).mean()


@pytest.mark.parametrize("feature", ["normal", "albedo", "position"])
def test_features_keep_surfaces_apart(feature):
    """A step of the light that a feature has, too, is as sharp as before."""
    right = X >= 11  # Inside of a block
    changes = {"normal": (1.0, 0, 0), "albedo": (0.3, 0.3, 0.3), "position": (0, 0, 3.0)}
    step = np.where(right[..., None], changes[feature], wall()[feature])
    truth = np.where(right, 5.0, 1.0)[..., None, None] * np.ones(SHAPE)
    found = denoise_film(*halves(truth), wall(**{feature: step}))
    assert abs(found - truth)[:, 10:12].mean() < SIGMA / 2


def test_stokes_vectors_stay_possible():
    """Components are mixed as S0 is: none gets longer than S0."""
    rng = np.random.default_rng(0)
    s0 = 1 + np.abs(rng.normal(0, SIGMA, (24, 24, 32, 1)))
    way = rng.normal(0, 1, (24, 24, 32, 3))
    vectors = np.concatenate([s0, s0 * way / np.linalg.norm(way, axis=-1, keepdims=True)], axis=-1)
    noise = np.concatenate([rng.normal(0, SIGMA, s0.shape), np.zeros((24, 24, 32, 3))], axis=-1)
    found = denoise_film(vectors, noise, wall())
    assert (np.linalg.norm(found[..., 1:], axis=-1) <= found[..., 0] * (1 + 1e-5)).all()
    assert found[..., 0].std() < 0.5 * s0.std()


@pytest.mark.parametrize("shape", [(1, 1, 1, 3), (1, 7, 3, 1), (5, 2, 33, 3)])
def test_films_of_any_size(shape):
    size = shape[:2]
    features = {n: np.ones((*size, 3)) for n in ("position", "normal", "albedo")}
    features |= {"distance": np.ones(size), "kind": np.zeros(size)}
    mean, noise = np.random.default_rng(0).random((2, *shape))
    found = denoise_film(mean, noise, features)
    assert found.shape == shape
    assert found.sum() == pytest.approx(mean.sum(), rel=1e-5)


def test_bad_films_are_refused():
    mean, noise = halves(np.ones(SHAPE))
    for text, arguments in {
        r"^mean with shape \(24, 24, 32\)": (mean[..., 0], noise, wall()),
        r"^half_difference with shape": (mean, noise[:12], wall()),
        r"^mean: 3 of .* values are not finite": (np.where(spike(), np.nan, mean), noise, wall()),
        r"^features = {}: must be a dict of position, normal": (mean, noise, {}),
        r"^features: albedo with shape": (mean, noise, wall(albedo=X)),
        r"^features: distance: 576 of 576": (mean, noise, wall(distance=X * np.nan)),
        r"^features = None": (mean, noise, None),
    }.items():
        refused(text, denoise_film, *arguments)
    assert tofrender.denoise_film is denoise_film
