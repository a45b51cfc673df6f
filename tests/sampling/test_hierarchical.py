"""Hierarchical warping against its image, and environment light against Mitsuba's `envmap`."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.support import ALPHA, COMPARISONS, largest, refused, uniform

from tofrender.sampling import EnvironmentWarp, HierarchicalWarp, chi_square_test
from tofrender.sampling.cell_counts import pearson
from tofrender.sampling.images import MAX_SIDE, read_image, resized
from tofrender.sampling.statistics import smallest_allowed
from tofrender.signals.color import luminance

BOUND = smallest_allowed(ALPHA, COMPARISONS)
SIZE = {"samples": 100_000, "resolution": 32, "tests": COMPARISONS}


def probe(size: int = 64) -> np.ndarray:
    """Return an image like a light probe: a smooth sky, a small sun, a dark ground."""
    y, x = (np.mgrid[:size, :size] + 0.5) / size
    sky = np.where(y < 0.6, 0.2 + (1 - y) ** 2, 0.02 + 0.01 * np.sin(9 * x))
    return sky + 400 * (np.hypot(x - 0.7, y - 0.3) < 0.03)


def spikes(size: int = 64) -> np.ndarray:
    """Return an image with black quadrants, values over ten orders of magnitude, a hot pixel."""
    rng = np.random.default_rng(5)
    image = rng.random((size, size)) ** 40 * (rng.random((size, size)) < 0.3)
    image[: size // 2, : size // 2] = 0
    image[size // 2 :, size // 2 :] = 0
    image[size - 1, 3] = image.sum()
    return image


IMAGES = {
    "80/20": np.array([[0.5, 0.3], [0.05, 0.15]]),
    "probe": probe(),
    "spikes": spikes(),
    "hot pixel": np.where(np.arange(256).reshape(16, 16) == 77, 1e12, 0.0),
    "one texel": np.array([[3.0]]),
}


def texels(p: mi.Point2f, n: int) -> np.ndarray:
    return np.floor(np.array(p, dtype=np.float64)[::-1] * n).astype(int)


def p_value(observed: np.ndarray, expected: np.ndarray) -> float:
    """Return the p-value of counts, or 0 if a count is positive where 0 is expected."""
    if np.any(observed[expected == 0]):
        return 0.0
    chi2, freedom = pearson(observed, expected, np.zeros_like(expected))
    return 1 - mi.math_py.rlgamma(freedom / 2, chi2 / 2) if freedom > 0 else 1.0


def image_p_value(warp: HierarchicalWarp, image: np.ndarray, n: int = 200_000):
    """Return the p-value of the number of points in each texel of the image."""
    row, column = texels(warp.sample(uniform(n)), len(image))
    observed = np.bincount(row * len(image) + column, minlength=image.size)
    return p_value(observed, n * image.ravel() / image.sum())


@pytest.mark.statistical
@pytest.mark.parametrize("name", IMAGES)
def test_texels_are_hit_as_often_as_they_are_bright_and_evenly(name):
    warp = HierarchicalWarp(IMAGES[name])
    assert image_p_value(warp, IMAGES[name]) > BOUND
    column, row = (np.array(warp.sample(uniform(200_000)), dtype=np.float64) * warp.size % 1) * 16
    observed = np.bincount((np.floor(column) * 16 + np.floor(row)).astype(int), minlength=256)
    assert p_value(observed, np.full(256, 200_000 / 256)) > BOUND


@pytest.mark.statistical
def test_the_wrong_image_is_found():
    for image in (IMAGES["probe"].T, IMAGES["probe"][::-1], np.sqrt(IMAGES["probe"])):
        assert image_p_value(HierarchicalWarp(image), IMAGES["probe"]) < BOUND


@pytest.mark.parametrize("name", IMAGES)
def test_density_is_the_image_and_integrates_to_one(name):
    image = IMAGES[name]
    n = len(image)
    row, column = np.divmod(np.arange(n * n), n)
    density = np.array(HierarchicalWarp(image).pdf(mi.Point2f((column + 0.5) / n, (row + 0.5) / n)))
    assert density.mean(dtype=np.float64) == pytest.approx(1, rel=1e-6)
    assert density == pytest.approx(image.ravel() / image.mean(), rel=1e-6)


def test_density_ends_at_the_square_and_does_not_overflow():
    warp = HierarchicalWarp([[1.0, 3.0], [5.0, 7.0]])
    p = mi.Point2f([0, 1, 1, -1e-6, 0.5, 1e30, math.nan], [0, 1, 0.4, 0.5, 1.001, 0.5, 0.5])
    assert np.array(warp.pdf(p)) == pytest.approx([0.25, 1.75, 0.75, 0, 0, 0, 0])
    warp = HierarchicalWarp([[1e308, 1e308], [1e308, 0]])
    assert warp.pdf(mi.Point2f(0.1))[0] == pytest.approx(4 / 3)


@pytest.mark.parametrize("levels", [0, 1, 2, 5, 9, 11])
def test_black_texels_are_never_hit(levels):
    n = 2**levels
    rng = np.random.default_rng(levels)
    image = rng.random((n, n)) ** 8 * (rng.random((n, n)) < 0.5)
    image[: n // 2, : n // 2] = 0
    image[-1, -1] = 1
    edge = np.arange(64) / 2**24
    u = np.concatenate([edge, 1 - edge, rng.random(100_000), np.arange(n) / n])
    warp = HierarchicalWarp(image)
    p = warp.sample(mi.Point2f(u, rng.permutation(u)))
    row, column = texels(p, n)
    assert row.min() >= 0
    assert column.min() >= 0
    assert np.all(image[row, column] > 0)  # An index beyond the image fails here too
    corners = warp.sample(mi.Point2f([0, 1, 0, 1], [0, 0, 1, 1]))
    assert np.all(image[tuple(texels(corners, n))] > 0)


@pytest.mark.parametrize("levels", [0, 1, 7, 12])
def test_stratified_samples_stay_stratified(levels):
    """A constant image does not change points: all 24 bits survive twelve levels."""
    u = uniform(50_000)
    p = HierarchicalWarp(np.ones((2**levels, 2**levels))).sample(u)
    assert np.max(np.abs(np.array(p) - np.array(u))) <= 2.0**-24
    # What is left of a sample goes on: a grid of points gives each texel its share exactly
    x, y = np.meshgrid((np.arange(40) + 0.5) / 40, (np.arange(40) + 0.5) / 40)
    warp = HierarchicalWarp(IMAGES["80/20"])
    row, column = texels(warp.sample(mi.Point2f(x.ravel(), y.ravel())), 2)
    assert np.bincount(row * 2 + column) / 1600 == pytest.approx([0.5, 0.3, 0.05, 0.15])


def test_symbolic_loops():
    warp, light, u = HierarchicalWarp(IMAGES["probe"]), EnvironmentWarp(probe(16)), uniform(1000)

    def body(i, p, d, pdf, radiance):
        p = warp.sample(u)
        d, pdf = light.sample(u)
        return i + 1, p, d, pdf * warp.pdf(p), light.eval(d)

    zeros = (dr.zeros(kind, 1000) for kind in (mi.Point2f, mi.Vector3f, mi.Float, mi.Color3f))
    state = (mi.UInt32(0), *zeros)
    _, *after = dr.while_loop(state, lambda i, *_: i < 2, body)
    for a, b in zip(after, body(0, *state[1:])[1:], strict=True):
        assert np.array(a) == pytest.approx(np.array(b))


def test_monochrome():
    mi.set_variant("llvm_ad_mono")
    warp = HierarchicalWarp(IMAGES["80/20"])
    assert image_p_value(warp, IMAGES["80/20"]) > BOUND
    image = np.stack([probe(16), 2 * probe(16), 0 * probe(16)], axis=-1)
    light = EnvironmentWarp(image)
    reference = envmap(image, directions(200))
    assert np.array(light.eval(directions(200))) == pytest.approx(reference, rel=1e-3, abs=1e-3)


def test_other_sizes_are_resized_with_a_warning():
    image = np.arange(1.0, 16).reshape(3, 5)
    with pytest.warns(UserWarning, match=r"^image: 3 x 5 pixels; resized to 8 x 8, a square power"):
        warp = HierarchicalWarp(image)
    assert warp.size == 8
    u = (np.arange(8) + 0.5) / 8
    density = np.array(warp.pdf(mi.Point2f(np.tile(u, 8), np.repeat(u, 8)))).reshape(8, 8)
    assert density.mean() == pytest.approx(1)
    assert density == pytest.approx(resized(image, 8) / image.mean(), rel=1e-5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (3, 2), (5, 8), (8, 8)])
def test_resizing_keeps_the_mean_and_the_black(shape):
    image = np.random.default_rng(2).random(shape) * (np.indices(shape).sum(0) % 3 > 0)
    image[-1, -1] = 1
    finer = resized(image, 8)
    assert finer.mean() == pytest.approx(image.mean())
    rows, columns = (
        [range(j * size // 8, -(-(j + 1) * size // 8)) for j in range(8)] for size in shape
    )
    touched = [[image[np.ix_(row, column)].any() for column in columns] for row in rows]
    assert np.array_equal(finer > 0, touched)


@pytest.mark.parametrize("channels", [None, 1, 2, 3, 4])
def test_images_from_arrays_bitmaps_and_files(channels, tmp_path):
    rng = np.random.default_rng(3)
    image = rng.random((4, 4) if channels is None else (4, 4, channels)).astype(np.float32)
    colors = image if channels is None else image[..., : 3 if channels > 2 else 1].squeeze()
    weights = colors @ [0.212671, 0.715160, 0.072169] if colors.ndim == 3 else colors
    formats = mi.Bitmap.PixelFormat
    names = {None: formats.Y, 1: formats.Y, 2: formats.YA, 3: formats.RGB, 4: formats.RGBA}
    bitmap = mi.Bitmap(image if channels else image[..., None], names[channels])
    path = tmp_path / "image.exr"
    bitmap.write(str(path))
    for source in (image, mi.TensorXf(image), bitmap, path, str(path)):
        assert luminance(read_image(source)) == pytest.approx(weights, rel=1e-5)
        assert HierarchicalWarp(source).size == 4


BAD_IMAGES = {
    "empty": (np.zeros((0, 4)), r"^image: shape \(0, 4\) is empty; must have the shape"),
    "nan": ([[1.0], [math.nan]], r"^image: the value at row 1, column 0 is nan"),
    "infinite": ([[math.inf]], r"^image: the value at row 0, column 0 is inf"),
    "deep": (np.ones((2, 2, 5)), r"^image: shape \(2, 2, 5\); must have"),
    "large": (np.ones((1, MAX_SIDE + 1)), r"a side must have at most 16384$"),
}


@pytest.mark.parametrize("name", BAD_IMAGES)
@pytest.mark.parametrize("kind", [HierarchicalWarp, EnvironmentWarp])
def test_bad_images(kind, name):
    image, message = BAD_IMAGES[name]
    refused(message, kind, image)


def test_bad_files(tmp_path):
    (tmp_path / "notes.exr").write_text("not an image")
    layers = mi.Bitmap(mi.Bitmap.PixelFormat.MultiChannel, mi.Struct.Type.Float32, [4, 4], 5)
    for source, kind, message in (
        (tmp_path / "sky.exr", FileNotFoundError, r"sky.exr': must be a file that exists$"),
        (tmp_path, FileNotFoundError, "must be a file"),
        (tmp_path / "notes.exr", ValueError, r"notes.exr': must be an image that Mitsuba reads"),
        (layers, ValueError, r"^image: has 5 channels of other kinds; must be gray"),
    ):
        refused(message, HierarchicalWarp, source, kind=kind)


def test_samples_off_the_square_fail_in_debug_mode():
    warp = HierarchicalWarp(IMAGES["80/20"])
    light = EnvironmentWarp(probe(4))
    outside = mi.Point2f(1.5, 0.5)
    assert np.all(np.array(warp.sample(outside)) < 1)
    with dr.scoped_set_flag(dr.JitFlag.Debug, True):
        for sample in (warp.sample, light.sample):
            with pytest.raises(AssertionError, match="must lie in"):
                sample(outside)


def directions(n: int) -> mi.Vector3f:
    """Return directions, some near the poles. Nearer, Mitsuba's cosine would have no precision."""
    d = np.random.default_rng(0).normal(size=(3, n))
    d[:, :3] = np.array([[0.02, 1, 0], [1, 0, 0], [0.02, -1, 0.01]]).T
    d /= np.linalg.norm(d, axis=0)
    return mi.Vector3f(*(mi.Float(each) for each in d))


def envmap(image: np.ndarray, d: mi.Vector3f) -> np.ndarray:
    emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(image.astype(np.float32))})
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(d))
    si.wi = -d
    return np.array(emitter.eval(si))


def sky(shape: tuple[int, int]) -> np.ndarray:
    return np.random.default_rng(1).random((*shape, 3)) ** 3


@pytest.mark.parametrize("shape", [(8, 16), (5, 7), (3, 2), (100, 200)])
def test_environment_is_mitsubas(shape):
    image, d = sky(shape), directions(5000)
    assert largest(np.array(EnvironmentWarp(image).eval(d)), envmap(image, d)) < 1e-4


@pytest.mark.statistical
@pytest.mark.parametrize("shape", [(8, 16), (5, 7), (3, 2)])
def test_environment_samples_follow_the_density(shape):
    light = EnvironmentWarp(sky(shape))

    def sample(u):
        d, pdf = light.sample(u)
        return d, mi.Float(1), pdf

    verdict = chi_square_test(sample, light.pdf, "sphere", **SIZE)
    assert verdict.passed, verdict


WRONG = {
    "sine": lambda d, pdf: pdf(d) * dr.norm(mi.Vector2f(d.x, d.z)) * (4 / math.pi),
    "upside down": lambda d, pdf: pdf(mi.Vector3f(d.x, -d.y, d.z)),
    "mirrored": lambda d, pdf: pdf(mi.Vector3f(-d.x, d.y, d.z)),
    "scale": lambda d, pdf: pdf(d) * (2 * math.pi),
}


@pytest.mark.statistical
@pytest.mark.parametrize("bug", WRONG)
def test_a_wrong_environment_density_is_found(bug):
    light = EnvironmentWarp(sky((8, 16)))
    sample = lambda u: light.sample(u)[0]  # noqa: E731
    wrong = lambda d: WRONG[bug](d, light.pdf)  # noqa: E731
    assert not chi_square_test(sample, wrong, "sphere", **SIZE).passed


def test_environment_density_is_finite_and_its_weights_are_bounded():
    """Radiance over density varies as little as radiance within a texel, also at the poles."""
    light = EnvironmentWarp(sky((8, 16)))
    zero = [0.0, 0.0, -0.0, -0.0]
    poles = mi.Vector3f(zero, [1, -1, 1, -1], [0.0, 0.0, -0.0, 0.0])
    assert np.isfinite(np.array(light.eval(poles))).all()
    assert np.isfinite(np.array(light.pdf(poles))).all()
    assert np.all(np.array(light.pdf(poles)) > 0)
    ends = mi.Point2f([0, 0, 1, 1, 0.5], [0, 1, 0, 1, 0])
    for sample in (ends, uniform(100_000)):
        d, pdf = light.sample(sample)
        assert np.abs(np.array(dr.norm(d)) - 1).max() < 1e-6
        assert np.array(pdf).min() > 0
    assert np.mean(np.abs(np.array(light.pdf(d) / pdf) - 1) > 1e-3) < 1e-3  # Texels' edges
    mean = luminance(np.moveaxis(np.array(light.eval(d)), 0, -1)) / np.array(pdf)
    assert mean.std() / mean.mean() < 0.35


@pytest.mark.parametrize("row", [0, 10, 31])
def test_a_sun_is_found(row):
    """The sun is one pixel of a black sky, also at the poles.

    The pixel is interpolated over two columns. It fills two texels, and half of both neighbors,
    which have an eighth of the light each. Therefore an eighth of the samples are in black halves,
    and a few more because of rows.
    """
    image = np.zeros((32, 64))
    image[row, 40] = 1e6
    light = EnvironmentWarp(image)
    d, _ = light.sample(uniform(20_000))
    assert np.mean(np.array(light.eval(d).x) > 0) > 0.8
    assert np.array(light.pdf(-d)).max() == 0


def test_bad_environments():
    flat = np.ones((2, 8))
    refused("^image: 2 x 8 pixels; must be at least 3 x 2$", EnvironmentWarp, flat)
    mi.set_variant("llvm_ad_spectral")
    refused("^variant = 'llvm_ad_spectral': must be an rgb or mono", EnvironmentWarp, flat)
