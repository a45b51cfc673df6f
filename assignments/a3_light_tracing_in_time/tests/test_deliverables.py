"""a3.deliverables: what the notebook has rendered of the scene `caustic`."""

import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_deliverables

LAMP = np.array([-0.7, 0, -0.45])
BALL = np.array([-0.25, -0.56, -0.1])
EYE = np.array([0, 0, 3.9])
RADIUS = 0.4
INDEX = 1.5
FOV = 39.3077
NEAREST = 4.36  # from the lamp's near side to the camera [m]


def require(arrays, file, *names):
    missing = [name for name in names if name not in arrays]
    expect.true(not missing, f"{file}: has no {', '.join(missing)}", hint="the handout names all")


def require_size(submission, shape, what):
    """Pictures have the size of the caustic's."""
    steady = submission.arrays("deliverables/caustic.npz").get("steady", np.zeros((0, 0, 3)))
    same = tuple(shape) == steady.shape
    text = f"{what}: expected the size of caustic.npz, {steady.shape}; came {tuple(shape)}"
    expect.true(same, text, hint="all pictures have the same size")


def test_caustic(submission):
    """Bins and picture of all strategies, and when the caustic arrives."""
    file = "deliverables/caustic.npz"
    arrays = submission.arrays(file)
    require(arrays, file, "transient", "steady", "start_opl", "bin_width_opl")
    bins, steady = (np.asarray(arrays[name], float) for name in ("transient", "steady"))
    start = float(arrays["start_opl"])
    width = float(arrays["bin_width_opl"])
    good = bins.ndim == 4 and bins.shape[3] == 3 and min(bins.shape[:2]) >= 16
    what = f"{file}, transient: expected (height, width, bins, 3), 16 pixels or more; "
    expect.true(good, what + f"came {bins.shape}")
    expect.shape(steady, (*bins.shape[:2], 3), f"{file}, steady")
    what = f"{file}: number of bins, start_opl [m], bin_width_opl [m]"
    hint = "200 bins of 0.04 m from 4.2 m"
    expect.close([bins.shape[2], start, width], [200, 4.2, 0.04], what, hint=hint)
    expect.finite(bins, f"{file}, transient")
    hint = "max_depth 4; all of this light arrives between 4.2 m and 12.2 m"
    expect.close(bins.sum() / steady.sum(), 1.0, "sum over bins / picture", rtol=0.02, hint=hint)
    opl = start + width * (np.arange(bins.shape[2]) + 0.5)
    early = bins[:, :, opl + width / 2 < NEAREST].sum() / bins.sum()
    hint = "no light is faster than that from the lamp to the lens"
    expect.close(early, 0, "part of the light before the first possible", atol=1e-4, hint=hint)
    direction = (BALL - LAMP) / np.linalg.norm(BALL - LAMP)
    floor = LAMP + direction * (LAMP[1] + 1) / -direction[1]
    wanted = np.linalg.norm(floor - LAMP) + np.linalg.norm(floor - EYE)
    wanted += 2 * RADIUS * (INDEX - 1)
    # Where the middle of the pattern is in the picture
    height, wide = bins.shape[:2]
    half = np.tan(np.radians(FOV / 2)) * (EYE[2] - floor[2])
    x = int(wide / 2 + floor[0] / half * min(height, wide) / 2)
    y = int(height / 2 - floor[1] / half * min(height, wide) / 2)
    near = bins[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].sum((0, 1, 3))
    came = opl[near.argmax()]
    hint = "in glass, light takes index times as long"
    what = f"brightest bin of the pixels around ({x}, {y}) [m]"
    expect.close(came, wanted, what, rtol=0, atol=max(0.16, width), hint=hint)


def test_comparison(submission):
    """Pictures of four integrators, and their errors."""
    file = "deliverables/comparison.npz"
    arrays = submission.arrays(file)
    names = ("path", "light", "two", "bdpt")
    require(arrays, file, *names, "reference", "mask", "mse")
    reference = np.asarray(arrays["reference"], float)
    mask = np.asarray(arrays["mask"]) > 0.5
    require_size(submission, reference.shape, f"{file}, reference")
    expect.shape(mask, reference.shape[:2], f"{file}, mask")
    expect.true(mask.mean() > 0.3, f"{file}, mask: has too few pixels, {mask.sum()}")
    for name in names:
        expect.shape(arrays[name], reference.shape, f"{file}, {name}")
    errors = [((np.asarray(arrays[n], float) - reference)[mask] ** 2).mean() for n in names]
    hint = "the mean over pixels of the mask and channels of (picture - reference)²"
    expect.close(arrays["mse"], errors, f"{file}, mse", rtol=1e-3, hint=hint)
    means = [np.asarray(arrays[n], float)[mask].mean() for n in names[1:]]
    wanted = reference[mask].mean()
    hint = "what sees neither glass nor lamp is found by light alone, too"
    expect.close(means, np.full(3, wanted), "mean of the mask's pixels", rtol=0.05, hint=hint)
    what = "errors of path and bdpt: expected the path tracer's to be 5 times as large or more; "
    what += f"came {errors[0]:.2e} and {errors[3]:.2e}"
    expect.true(errors[0] > 5 * errors[3], what, hint="the caustic is noise in a path tracer")


def test_strategies(submission):
    """The strategies of four segments, alone and with their shares."""
    file = "deliverables/strategies.npz"
    arrays = submission.arrays(file)
    require(arrays, file, "strategies", "alone", "shared")
    wanted = [[s, 5 - s] for s in range(5)]
    expect.close(arrays["strategies"], wanted, f"{file}, strategies", atol=0, hint="(s, t)")
    alone, shared = (np.asarray(arrays[name], float) for name in ("alone", "shared"))
    expect.true(alone.ndim == 4 and len(alone) == 5, f"{file}, alone: came {alone.shape}")
    expect.shape(shared, alone.shape, f"{file}, shared")
    require_size(submission, alone.shape[1:], f"{file}, alone")
    expect.finite(alone, f"{file}, alone")
    height, width = alone.shape[1:3]
    corner = (slice(None), slice(0, height // 2), slice(width // 2, width))  # no glass, no lamp
    hint = "alone: mis 'none'; shared: mis 'power'"
    light = alone[corner].mean((1, 2, 3))
    expect.true(light[4] > 0, f"{file}: light of (4, 1) alone: none came")
    what = f"{file}: light of (2, 3) and (3, 2) alone over that of (4, 1), upper right"
    expect.close(light[2:4] / light[4], [1, 1], what, rtol=0.3, hint=hint)
    total = shared[corner].mean((1, 2, 3)).sum()
    what = f"{file}: all shares over the light of (4, 1) alone, upper right"
    expect.close(total / light[4], 1, what, rtol=0.15, hint="shares add up to 1")


def test_pictures(submission):
    """The response of a pixel, and light in flight."""
    from PIL import Image, ImageSequence

    with Image.open(submission.path("deliverables/caustic_response.png")) as image:
        pixels = np.asarray(image.convert("L"), np.float64)
    what = f"caustic_response.png: a plot of 300 pixels or more in width; came {pixels.shape[::-1]}"
    expect.true(pixels.shape[1] >= 300 and pixels.std() > 1, what, hint="it must not be empty")
    with Image.open(submission.path("deliverables/animation.gif")) as image:
        pairs = zip(ImageSequence.Iterator(image), range(40), strict=False)
        frames = [np.asarray(frame.convert("L"), np.float64) for frame, _ in pairs]
    apart = max((np.abs(frame - frames[0]).mean() for frame in frames), default=0)
    what = f"an animation of several frames that differ: came {len(frames)}"
    expect.true(len(frames) > 1 and apart > 0.2, what, hint="light moves from frame to frame")
