"""Photon counts of hidden scenes: their background, and the noise of the remaining light."""

import numpy as np
import pytest
from helpers.hidden_scenes import Wall, capture_of, letter_f, rectangle
from helpers.refusals import refused
from scipy.stats import norm

from tofrender import load_capture, save_capture
from tofrender.nlos import make_capture, max_projection, reconstruct
from tofrender.nlos.captures import COUNTS
from tofrender.nlos.reconstruction.background import find_background
from tofrender.nlos.reconstruction.fourier import forward
from tofrender.nlos.reconstruction.light_cone import noise_spectrum, squared_depth
from tofrender.nlos.reconstruction.volume import VolumeGrid
from tofrender.sensors import sense

BINS, WIDTH, DARK = 256, 0.02, 0.3
ALPHA = 1e-4


def expected(direct: float = 300.0) -> np.ndarray:
    """Return counts (rows, columns, bins): the wall's reflection, dark counts, a hidden letter."""
    letter = capture_of(letter_f(1.2), Wall(24), start=0, width=WIDTH, bins=BINS)
    light = letter["transient"].values[..., 0]
    wall = direct * np.exp(-np.arange(BINS) / 10.0)
    return light * 2.0 / light.mean((0, 1)).max() + wall + DARK


def capture(counts: np.ndarray, **changes) -> object:
    grid = Wall(24).grid()
    normals = np.broadcast_to([0.0, 0, 1], grid.shape)
    given = {"mode": "confocal", "start_opl": 0, "bin_width_opl": WIDTH, "quantity": COUNTS}
    return make_capture(counts, sensor_grid=grid, sensor_normals=normals, **given | changes)


def noisy(seed: int, direct: float = 300.0) -> np.ndarray:
    return np.random.default_rng(seed).poisson(expected(direct)).astype(np.float32)


def letter_found(light, method="lct", **options) -> float:
    """Return the correlation of the front view with the letter."""
    volume = reconstruct(light, method, progress=False, **options)
    seen = max_projection(volume).values
    x, y = np.meshgrid(volume["x"].values, volume["y"].values)
    letter = letter_f(1.2).points[:, :2]
    near = np.hypot(x[..., None] - letter[:, 0], y[..., None] - letter[:, 1]).min(-1) < 0.06
    return float(np.corrcoef(seen.ravel(), near.ravel())[0, 1])


@pytest.mark.parametrize("direct", [0.0, 300.0])
@pytest.mark.parametrize("early", [0, 31])
def test_background(early, direct):
    """Bins after the wall's reflection, with light above a tenth of the largest, are kept.

    `early` is the number of bins before light meets the wall.
    """
    before = np.random.default_rng(early).poisson(DARK, (24, 24, early))
    counts = np.concatenate([before, noisy(early, direct)], axis=-1)
    true = np.append(np.zeros(early), expected(0.0).mean((0, 1)) - DARK)
    found = find_background(counts.sum((0, 1)), 24 * 24, early)
    assert abs(found.dark - DARK) < 0.03  # A low quantile of means of 576 pixels and 4 bins
    assert found.kept[true > 0.1 * true.max()].all()
    assert not found.kept[true < 1e-3 * true.max()].any()
    np.testing.assert_array_equal(found.variance, counts.sum((0, 1)) * found.kept)


def test_nothing_but_dark_counts_is_a_warning():
    """If no bin exceeds the dark counts, all bins are used. Without any counts, it is an error."""
    counts = np.random.default_rng(1).poisson(0.3, (24, 24, BINS))
    with pytest.warns(UserWarning, match=r"\Acapture: no bin exceeds the 0.2\d+ dark counts"):
        volume = reconstruct(capture(counts), "lct", progress=False)
    assert np.isfinite(volume["intensity"]).all()
    with refused("capture: all bins after the wall's reflection are empty"):
        reconstruct(capture(0 * counts), "lct")
    with refused("capture: bins = 1: must be 2 or more with lct"):
        reconstruct(capture(counts[..., :1]).assign_attrs(quantity="radiance per bin"), "lct")


@pytest.mark.parametrize("factor", [1.0, 1.1])
def test_spectrum_of_noise(factor):
    """The mean power of Poisson noise at each frequency along v. A factor of 1.1 is detected.

    For 64 x 64 pixels, padded with zeros, a mean over the frequencies of the wall has 4096
    independent squares, each with a relative deviation of at most 1.
    """
    bins, pixels = 32, 64
    rates = np.linspace(0.5, 20, bins)
    grid = VolumeGrid((-1, 1, 2), (-1, 1, 2), (0.0, 1.0, bins))
    matrix = squared_depth(grid, np.arange(bins + 1) / bins, "diffuse")
    noise = np.random.default_rng(5).poisson(rates, (pixels, pixels, bins)) - rates
    spectrum = forward((noise @ matrix.T.toarray()).astype(np.float32), (128, 128, 2 * bins))
    mean = np.square(abs(spectrum)).mean((0, 1))
    ratio = factor * mean / noise_spectrum(matrix, rates * pixels**2)
    bound = norm.isf(ALPHA / 2 / len(ratio)) * np.sqrt(2) / pixels
    assert (abs(ratio - 1).max() < bound) == (factor == 1.0), abs(ratio - 1).max() / bound


@pytest.mark.parametrize("seed", range(2))
def test_letters_are_found_without_tuning(seed):
    """The default is as good as the best ratio, if background is subtracted."""
    counts = noisy(seed)
    found = letter_found(capture(counts))
    best = max(letter_found(capture(counts), snr=snr) for snr in (1e-3, 0.1, 10, 1e3))
    assert found > max(0.8, best - 0.04)
    assert letter_found(capture(counts, quantity="radiance per bin")) < 0.6


@pytest.mark.statistical
def test_low_signal_is_found_with_a_warning():
    """The light of a small patch is a tenth of a count per bin, among ten dark counts.

    The brightest hundredth of the voxels contains voxels of the patch. Without light of the patch,
    the mean ratio of eight volumes is below 1.
    """
    patch = rectangle((0.25, 0.4), (-0.4, -0.25), 0.6, 0.05)
    light = capture_of(patch, Wall(24), start=0, width=WIDTH, bins=BINS)["transient"].values[..., 0]
    light = light / light.mean((0, 1)).max()

    def mean_ratio(counts_per_bin: float) -> float:
        ratios = []
        for seed in range(8):
            rates = counts_per_bin * light + 10
            counts = np.random.default_rng(seed).poisson(rates)
            volume = reconstruct(capture(counts), "phasor", progress=False)["intensity"]
            volume = volume.sel(z=slice(0.3, 2))
            near = volume.sel(x=slice(0.2, 0.45), y=slice(-0.45, -0.2), z=slice(0.5, 0.7))
            ratios.append(float(near.max() / volume.quantile(0.99)))
        return float(np.mean(ratios))

    with pytest.warns(UserWarning, match="no bin exceeds"):
        assert mean_ratio(0.1) > 1.1
    with pytest.warns(UserWarning, match="no bin exceeds"):
        assert mean_ratio(0.0) < 0.9


SPAD = {"cycles": 4000, "photons": {"photons_per_cycle": 0.05}, "spad": {"mode": "first_photon"}}


@pytest.mark.parametrize("legs", [False, True])
@pytest.mark.parametrize("mode", ["confocal", "single"])
def test_counts_of_a_sensor_are_a_capture(mode, legs, tmp_path):
    """`sense` keeps grid, mode and legs. The volume equals that of a manually created capture."""
    patch = rectangle((-0.2, 0.2), (-0.2, 0.2), 1.0, 0.05)
    light = capture_of(patch, Wall(8), mode, legs=legs, width=0.02, start=1.5, bins=160)
    measured = sense(light, SPAD, seed=2)
    volume = reconstruct(measured, "bp", progress=False)
    by_hand = light.copy(deep=True).assign_attrs(quantity=COUNTS, units="1")
    by_hand["transient"].values[..., 0] = measured["counts"].values
    expected_volume = reconstruct(by_hand, "bp", progress=False)
    np.testing.assert_allclose(volume["intensity"], expected_volume["intensity"], rtol=1e-4)
    again = load_capture(save_capture(measured, tmp_path / "a.h5"))
    assert again.attrs["capture_mode"] == mode
    np.testing.assert_array_equal(again["transient"][..., 0], measured["counts"])


def test_sensors_that_do_not_fit_captures():
    patch = rectangle((-0.2, 0.2), (-0.2, 0.2), 1.0, 0.05)
    light = capture_of(patch, Wall(4), width=0.02, start=1.5, bins=60)
    with refused("sensor: only spad is supported for captures"):
        sense(
            light,
            {name: SPAD[name] for name in ("cycles", "photons")}
            | {"itof": {"frequencies_hz": [2e7]}},
        )
    with refused("sensor.pixels is not supported for captures"):
        sense(light, SPAD | {"pixels": [2, 2]})
    with refused("sensor.spad.macro_pixel is not supported for captures"):
        sense(light, SPAD | {"spad": {"macro_pixel": [2, 2]}})


@pytest.mark.parametrize("method", ["bp", "fk", "phasor"])
def test_other_methods_use_counts_without_background(method):
    """Nothing is found at the wall's reflection, and `phasor` finds nothing else."""
    counts = np.random.default_rng(3).poisson(20 * expected())
    assert letter_found(capture(counts), method) > 0.7

    def near(light) -> float:
        intensity = reconstruct(light, method, progress=False)["intensity"]
        return float(intensity.sel(z=slice(0, 0.5)).max() / intensity.max())

    assert near(capture(counts)) < 0.25
    if method == "phasor":
        assert near(capture(counts, quantity="radiance per bin")) == 1


def test_legs_are_subtracted_first():
    """The window starts before the end of the first legs, so that no bin of the wall is cut."""
    patch = rectangle((-0.2, 0.2), (-0.2, 0.2), 1.0, 0.05)
    light = capture_of(patch, Wall(8), legs=True, width=0.02, start=0.5, bins=160)
    values = light["transient"].values
    counts = light.copy(deep=True).assign_attrs(quantity=COUNTS, units="1")
    counts["transient"].values[:] = np.round(values * 1e3 / values.max())
    for method in ("lct", "bp"):
        volume = reconstruct(counts, method, progress=False)["intensity"]
        assert abs(float(volume["z"][volume.argmax(...)["z"]]) - 1) < 0.08, method
