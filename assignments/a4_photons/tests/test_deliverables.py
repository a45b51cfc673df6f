"""a4.deliverables: what the notebook has made of the scene `cornell_box_flash`."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a4_deliverables

START = 5.0
WIDTH = 0.04
BINS = 325
# Distance of the back wall from the camera [m], field of view [degrees]
WALL = 4.9
FOV = 39.3077


def require(submission, file, *names):
    """Arrays of a file, as float64."""
    file = f"deliverables/{file}"
    arrays = submission.arrays(file)
    missing = [name for name in names if name not in arrays]
    expect.true(not missing, f"{file}: has no {', '.join(missing)}", hint="the handout names all")
    return [np.asarray(arrays[name], np.float64) for name in names]


def errors_on_the_back_wall(depth, file):
    """Errors of a depth map [m] in pixels that see the back wall over the boxes."""
    good = depth.ndim == 2 and min(depth.shape) >= 16
    what = f"{file}: depth maps (height, width) of 16 pixels or more; came {depth.shape}"
    expect.true(good, what)
    y, x = (1 - (2 * np.arange(n) + 1) / n for n in depth.shape)
    y, x = (each / max(depth.shape) * n for each, n in zip((y, x), depth.shape, strict=True))
    y, x = np.meshgrid(y, x, indexing="ij")
    seen = (np.abs(x) < 0.5) & (y > 0.25) & (y < 0.5)
    truth = WALL * np.sqrt(1 + (x**2 + y**2) * np.tan(np.radians(FOV / 2)) ** 2)
    return (depth - truth)[seen]


def factor_of_the_bound(submission):
    """Factor by which the submission's own `depth_bound` differs from the right one; 1 if unknown.

    The pulse of the deliverables has a standard deviation of 0.06 m.
    """
    own = submission.ask(
        "depth_bound",
        signal=np.array([1000.0]),
        background=0.05,
        sigma_s=0.06 / formulas.SPEED_OF_LIGHT,
        tail_s=0.0,
        width=WIDTH,
    )
    factor = float(own.reshape(-1)[0]) / (1.03 * 0.06 / (2 * np.sqrt(1000.0)))
    return factor if 0 < factor < np.inf and abs(factor - 1) > 0.1 else 1.0


def test_counts(submission):
    """Counts are first photons of the rates."""
    file = "counts.npz"
    names = ("counts", "rates", "cycles", "start_opl", "bin_width_opl")
    counts, rates, cycles, start, width = require(submission, file, *names)
    what = f"{file}: start_opl [m], bin_width_opl [m]"
    expect.close([start, width], [START, WIDTH], what, hint="325 bins of 0.04 m from 5 m")
    good = rates.ndim == 3 and rates.shape[2] == BINS and min(rates.shape[:2]) >= 16
    text = f"{file}, rates: expected (height, width, {BINS}), 16 pixels or more; came {rates.shape}"
    expect.true(good, text)
    expect.shape(counts, rates.shape, f"{file}, counts")
    expect.finite(rates, f"{file}, rates")
    right = rates.min() >= 0 and 1.5 < rates.sum(-1).mean() < 3
    text = f"{file}, rates: 2 photons per cycle in a pixel and 0.2 of ambient light; came "
    expect.true(right, text + f"{rates.sum(-1).mean():.3g}")
    whole = np.array_equal(counts, np.rint(counts)) and counts.min() >= 0
    expect.true(whole, f"{file}, counts: integers from 0")
    text = f"{file}, cycles: 1000 to 100000; came {cycles:g}"
    expect.true(1000 <= cycles <= 1e5, text)
    # By the end of a bin, a cycle has detected unless all bins so far are empty
    p = -np.expm1(-np.cumsum(rates, axis=-1))
    variance = cycles * p * (1 - p)
    sure = (cycles * p > 5) & (cycles * (1 - p) > 5)
    off = np.cumsum(counts, axis=-1) - cycles * p
    chi = (off[sure] ** 2 / variance[sure]).mean()
    hint = "sample_counts with a dead time of all bins: the first photon of each cycle"
    expect.close(
        chi, 1.0, "mean square of the counts' error, over its variance", rtol=0.1, hint=hint
    )


def test_depth(submission):
    """Corrected counts give the right depth in the median, uncorrected counts a smaller depth."""
    file = "depth.npz"
    counted, corrected, std = require(submission, file, "counted", "corrected", "depth_std")
    off = errors_on_the_back_wall(corrected, file)
    expect.shape(counted, corrected.shape, f"{file}, counted")
    expect.shape(std, corrected.shape, f"{file}, depth_std")
    hint = "the first bin starts at START"
    what = "median error of the corrected depth of the back wall [m]"
    expect.close(np.nanmedian(off), 0.0, what, atol=0.008, hint=hint)
    near = np.nanmedian(errors_on_the_back_wall(counted, file))
    text = f"median error of the uncorrected back wall: -5 to -60 mm; came {1000 * near:.1f} mm"
    expect.true(-0.06 < near < -0.005, text, hint="pile-up hides the late half of a pulse")
    wide = np.mean(~(np.abs(off) < 0.25))
    expect.close(wide, 0.0, "part of its pixels that are off by 0.25 m", atol=0.05)
    # A wrong bound loses its points in a4.bound only
    typical = np.median(std)
    text = f"median of depth_std: 0.2 to 3 mm; came {1000 * typical:.2f} mm"
    if not 2e-4 < typical < 3e-3:
        typical /= factor_of_the_bound(submission)
    expect.true(2e-4 < typical < 3e-3, text, hint="depth_bound of the counts in the return")


def test_bound(submission):
    """Errors that fall along the bound."""
    file = "bound.npz"
    signal, error, bound, ambient = require(
        submission, file, "signal", "error", "bound", "background"
    )
    good = signal.ndim == 1 and signal.size >= 4 and signal.min() > 0 and signal.max() >= 300
    expect.true(good, f"{file}, signal: four or more numbers of counts, up to 300 at least")
    expect.shape(error, signal.shape, f"{file}, error")
    few = ambient >= 0 and ambient <= 0.3
    expect.true(few, f"{file}, background: from 0 to 0.3 counts per bin; came {ambient:g}")
    strong = signal >= 300
    right = 1.03 * 0.06 / (2 * np.sqrt(signal))
    wanted = formulas.deviations(
        submission,
        bound[strong],
        right[strong],
        0.03,
        signal=signal[strong],
        background=ambient,
        sigma_s=0.06 / formulas.SPEED_OF_LIGHT,
        tail_s=0.0,
        width=WIDTH,
    )
    hint = "depth_bound of the pulse, 0.06 m wide"
    expect.close(
        bound[strong], wanted, f"{file}, bound [m] from 300 counts on", rtol=0.03, hint=hint
    )
    many = signal >= 100
    ratio = error[many] / right[many]
    text = f"error over bound from 100 counts on: 0.85 to 1.3; came {np.round(ratio, 2)}"
    expect.true(
        ratio.min() > 0.85 and ratio.max() < 1.3, text, hint="method ml, 400 or more pixels"
    )


def test_correlation_camera(submission):
    """Phases of the taps, depth of the phases, and multi-path light that makes it too great."""
    file = "itof.npz"
    names = ("taps", "phase", "depth", "frequency_hz", "contrast")
    taps, phase, depth, frequency, contrast = require(submission, file, *names)
    off = np.nanmedian(errors_on_the_back_wall(depth, file))
    expect.shape(taps, (4, *depth.shape), f"{file}, taps")
    expect.shape(phase, depth.shape, f"{file}, phase")
    wave = taps[0] - taps[2] + 1j * (taps[1] - taps[3])
    wanted = np.angle(wave) % (2 * np.pi)
    hint = "demodulate of the taps"
    expect.close(
        np.exp(1j * phase).real, np.cos(wanted), "cosine of the phase", atol=1e-4, hint=hint
    )
    expect.close(np.exp(1j * phase).imag, np.sin(wanted), "sine of the phase", atol=1e-4, hint=hint)
    wanted = formulas.SPEED_OF_LIGHT * phase / (4 * np.pi * frequency)
    expect.close(depth, wanted, f"{file}, depth [m]", hint="c φ / (4π f)")
    expect.true(0 < contrast <= 1, f"{file}, contrast: above 0, at most 1; came {contrast:g}")
    text = "median error of the back wall's depth, by multi-path light: 0.02 to 1.5 m; "
    text += f"came {off:.3g} m"
    hint = "the phase of a bin is 2π f opl / c, with opl from START on"
    expect.true(0.02 < off < 1.5, text, hint=hint)


def test_pictures(submission):
    """The map of depth."""
    from PIL import Image

    with Image.open(submission.path("deliverables/depth_map.png")) as image:
        pixels = np.asarray(image.convert("L"), np.float64)
    what = f"depth_map.png: a picture of 300 pixels or more in width; came {pixels.shape[::-1]}"
    expect.true(pixels.shape[1] >= 300 and pixels.std() > 1, what, hint="it must not be empty")
