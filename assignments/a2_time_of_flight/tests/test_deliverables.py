"""Checks of the notebook's results by properties of light, at any resolution."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_deliverables

WINDOW = {"start_opl": 3.5, "bin_width_opl": 0.02, "pulse_width_opl": 0.03}
BINS = 300
MEAN = np.array([0.2402, 0.1412, 0.0600])
"""Mean radiance of the Cornell box, max_depth 8: renders of this package, which Mitsuba's `path`
agrees with to 0.1 %."""
INSIDE = 0.9615
"""Part of its light that arrives in the window."""
MEAN_OPL = 5.18
"""Mean arrival of what arrives there [m]."""
NEAREST = 3.83
"""Distance of the lamp's nearest point from the camera: the shortest path of all [m]."""


def cube(submission, name):
    """A transient of the Cornell box, checked for shape and window, and its whole file."""
    file = f"deliverables/{name}"
    arrays = submission.arrays(file)
    require(arrays, file, "transient", *WINDOW)
    for key, wanted in WINDOW.items():
        expect.close(arrays[key], wanted, f"{key} of {file}", rtol=1e-4)
    data = arrays["transient"]
    right = data.ndim == 4 and data.shape[2:] == (BINS, 3) and min(data.shape[:2]) >= 8
    expect.true(
        right,
        f"{file}, transient: expected shape (height, width, {BINS}, 3) with 8 x 8 pixels or more, "
        f"came {data.shape}",
    )
    expect.finite(data, f"{file}, transient")
    expect.true(data.min() >= 0, f"{file}, transient: {data.min():g} is below 0, light is not")
    return data.astype(np.float64), arrays


def require(arrays, file, *names):
    missing = [name for name in names if name not in arrays]
    expect.true(not missing, f"{file} has no {', '.join(missing)}; it has {', '.join(arrays)}")


def centers(start=WINDOW["start_opl"], width=WINDOW["bin_width_opl"], bins=BINS):
    return start + width * (np.arange(bins) + 0.5)


def complex_phasors(data, frequencies):
    """Phasors of a cube, the frequencies in front."""
    waves = np.exp(2j * np.pi * np.outer(frequencies, centers()) / formulas.SPEED_OF_LIGHT)
    return np.einsum("yxtc,kt->kyxc", data, waves)


def phasor_file(submission, file, *names):
    """Frequencies and arrays of a file of phasors."""
    arrays = submission.arrays(file)
    require(arrays, file, "frequencies_hz", *names)
    frequencies = np.asarray(arrays["frequencies_hz"], np.float64)
    some = frequencies.ndim == 1 and 2 <= frequencies.size <= 3
    expect.true(some, f"{file}: two or three frequencies_hz; came {frequencies.tolist()}")
    for name in names:
        wanted = (frequencies.size, *arrays[names[0]].shape[1:3], 3)
        expect.shape(arrays[name], wanted, f"{file}, {name}", hint="(K, height, width, 3)")
        expect.finite(arrays[name], f"{file}, {name}")
    return frequencies, arrays


def test_transient(submission):
    """TransientPath on the Cornell box: energy, first light, mean arrival."""
    file = "deliverables/transient.npz"
    data, arrays = cube(submission, "transient.npz")
    require(arrays, file, "steady")
    steady = arrays["steady"]
    expect.shape(steady, (*data.shape[:2], 3), f"{file}, steady")
    hint = "cornell_box(width=..., height=...) as it is, max_depth 8, 64 spp or more"
    axis = {"x": range(3), "x_label": "channel"}
    mean = steady.mean((0, 1))
    expect.close(mean, MEAN, "mean of the steady image", rtol=0.08, hint=hint, **axis)
    part = data.sum() / steady.sum()
    hint = "radiance per bin: the sum over bins is the steady image, less what falls outside"
    expect.close(part, INSIDE, "sum over bins / steady image", rtol=0.03, hint=hint)
    profile = data.sum((0, 1, 3))
    early = centers() + 0.01 < NEAREST - 5 * WINDOW["pulse_width_opl"]
    hint = f"the shortest path is {NEAREST} m, camera to lamp; the pulse reaches 5 σ before it"
    what = "part of the light that comes before the first possible arrival"
    expect.close(profile[early].sum() / profile.sum(), 0, what, atol=1e-4, hint=hint)
    mean = (profile * centers()).sum() / profile.sum()
    hint = "lengths from the emitter to the sensor, camera segment included"
    expect.close(mean, MEAN_OPL, "mean arrival in the window [m]", rtol=0, atol=0.08, hint=hint)


def test_gates_and_film_agree(submission):
    """render_transient and TransientPath measure the same light: per meter, and per bin."""
    film, _ = cube(submission, "transient.npz")
    gated, _ = cube(submission, "gated.npz")
    per_bin = gated.sum((0, 1, 3)) * WINDOW["bin_width_opl"]
    profile = film.sum((0, 1, 3))
    hint = "gates give radiance per meter: times bin_width_opl it compares with film bins"
    expect.shape(gated, film.shape, "deliverables/gated.npz, transient", hint="one resolution")
    expect.close(per_bin.sum() / profile.sum(), 1.0, "light of gates / bins", rtol=0.06, hint=hint)
    groups = [values.reshape(30, 10).sum(axis=1) / values.sum() for values in (per_bin, profile)]
    apart = np.abs(groups[0] - groups[1]).sum()
    hint = "gate k is at start_opl + (k + 1/2) bin_width_opl"
    what = "difference of the two arrival-time distributions, part of the light"
    expect.close(apart, 0, what, atol=0.06, hint=hint)


def test_phasors(submission):
    """render_amcw_phasor on the Cornell box, against the phasor of the film's bins."""
    data, arrays = cube(submission, "transient.npz")
    frequencies, phasors = phasor_file(submission, "deliverables/phasors.npz", "I", "Q")
    expect.shape(phasors["I"][0], (*data.shape[:2], 3), "I of one frequency", hint="one resolution")
    total = float(arrays["steady"].sum()) if "steady" in arrays else data.sum()
    for k, frequency in enumerate(frequencies):
        came = np.sum(phasors["I"][k] + 1j * phasors["Q"][k])
        wanted = complex_phasors(data, [frequency]).sum()
        hint = "same scene, same lengths; Q is plus sine (phase_offset = -π/2)"
        for name, a, b in (("I", came.real, wanted.real), ("Q", came.imag, wanted.imag)):
            what = f"sum of {name} at {frequency / 1e6:g} MHz, part of the light"
            expect.close(a / total, b / total, what, rtol=0, atol=0.08, hint=hint)


def test_comparison(submission):
    """Phasors of the bins and of the paths, and their mean squared differences."""
    data, _ = cube(submission, "transient.npz")
    names = ("I_direct", "Q_direct", "I_converted", "Q_converted")
    file = "deliverables/comparison.npz"
    frequencies, came = phasor_file(submission, file, *names)
    others, phasors = phasor_file(submission, "deliverables/phasors.npz", "I", "Q")
    expect.close(frequencies, others, f"frequencies_hz of {file}, as in phasors.npz")
    require(came, file, "mse_I", "mse_Q")
    wanted = complex_phasors(data, frequencies)
    tiny = 1e-3 * np.abs(wanted).max()
    hint = "transient_to_phasor of transient.npz: film data has no factor of the bin width"
    for name, value in (("I", wanted.real), ("Q", wanted.imag)):
        direct = came[f"{name}_direct"]
        converted = came[f"{name}_converted"]
        expect.close(converted, value, f"{name}_converted", rtol=1e-3, atol=tiny, hint=hint)
        what = f"{name}_direct, as in phasors.npz"
        expect.close(direct, phasors[name], what, rtol=1e-3, atol=tiny)
        mse = np.mean((direct.astype(np.float64) - converted) ** 2, axis=(1, 2, 3))
        axis = {"x": frequencies / 1e6, "x_label": "frequency [MHz]"}
        expect.close(came[f"mse_{name}"], mse, f"mse_{name}", rtol=1e-2, atol=1e-9, **axis)


def test_pictures(submission):
    """Responses of pixels, and light in flight as an animation."""
    from PIL import Image

    with Image.open(submission.path("deliverables/pixel_responses.png")) as image:
        pixels = np.asarray(image.convert("L"), np.float64)
    what = f"pixel_responses.png: a plot of 300 pixels or more in width; came {pixels.shape[::-1]}"
    expect.true(pixels.shape[1] >= 300 and pixels.std() > 1, what, hint="it must not be empty")
    frames = animation_frames(submission)
    apart = max((np.abs(frame - frames[0]).mean() for frame in frames), default=0)
    what = f"an animation of several frames that differ: came {len(frames)}"
    expect.true(len(frames) > 1 and apart > 0.2, what, hint="light moves from frame to frame")


def either(submission, first, second):
    """The path of one of two files."""
    try:
        return submission.path(first)
    except expect.Failure:
        return submission.path(second)


def animation_frames(submission, most=40):
    """Frames of animation.gif or animation.mp4 in gray, at most so many."""
    from PIL import Image, ImageSequence

    path = either(submission, "deliverables/animation.gif", "deliverables/animation.mp4")
    if path.suffix == ".gif":
        with Image.open(path) as image:
            frames = ImageSequence.Iterator(image)
            pairs = zip(frames, range(most), strict=False)
            return [np.asarray(frame.convert("L"), np.float64) for frame, _ in pairs]
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(str(path))
    try:
        width, height = next(reader)["size"]
        pairs = zip(reader, range(most), strict=False)
        shape = (height, width, 3)
        return [np.frombuffer(f, np.uint8).reshape(shape).mean(-1) for f, _ in pairs]
    except (OSError, RuntimeError, StopIteration) as error:
        raise expect.Failure(f"deliverables/animation.mp4 cannot be read: {error}") from None
    finally:
        reader.close()


def test_around_the_corner(submission):
    """The letter behind the corner: arrival times, and the light that the filter removes."""
    file = "deliverables/nlos.npz"
    arrays = submission.arrays(file)
    require(arrays, file, "filtered", "unfiltered", "start_opl", "bin_width_opl")
    filtered = arrays["filtered"]
    both = arrays["unfiltered"]
    right = filtered.ndim == 4 and filtered.shape[3] == 3
    expect.true(right, f"{file}: shape (height, width, bins, 3); came {filtered.shape}")
    expect.shape(both, filtered.shape, "unfiltered")
    expect.finite(filtered, "filtered")
    expect.finite(both, "unfiltered")
    height, width, bins, _ = filtered.shape
    start = float(arrays["start_opl"])
    bin_width = float(arrays["bin_width_opl"])
    center = start + bin_width * (np.arange(bins) + 0.5)
    device = np.array([-0.5, 0.0, 0.25])
    columns, rows = (2 * (np.arange(n) + 0.5) / n - 1 for n in (width, height))
    x, y = np.meshgrid(columns, rows)
    points = np.stack([x, y, 0 * x], axis=-1)
    legs = 2 * np.linalg.norm(points - device, axis=-1)
    beside = np.maximum(np.abs(points[..., :2]) - 0.4, 0)
    nearest = legs + 2 * np.sqrt(1 + (beside**2).sum(-1))
    farthest = legs + 2 * np.sqrt(1 + ((np.abs(points[..., :2]) + 0.4) ** 2).sum(-1))
    floor = sum(floor_light(point, device) for point in points.reshape(-1, 3)) / points[..., 0].size
    came = (both.sum(2) - filtered.sum(2)).mean()
    hint = "use_nlos_only takes away the light between wall and floor, and nothing else"
    expect.close(came, floor, "light that the filter takes away", rtol=0.1, hint=hint)
    light = filtered.sum(-1).astype(np.float64)
    total = light.sum()
    expect.true(total > 0, "filtered: light of the hidden letter; came none")
    apart = np.abs(center - 0.5 * (nearest + farthest)[..., None])
    outside = apart > 0.5 * (farthest - nearest)[..., None] + 0.5 * bin_width + 1e-3
    hint = "2 d + 2 r, for r from the nearest to the farthest point of the letter"
    what = "part of the filtered light that comes before or after the letter's"
    expect.close(light[outside].sum() / total, 0, what, atol=1e-3, hint=hint)


def floor_light(point, device):
    """Light of the floor of `corner_scene`, closed form: 2 m x 2 m at y = -1, albedo 0.6."""
    x, z = formulas.patch((0.0, 1.0, 0.0), tilt=0, azimuth=0, half=(1, 1), cells=200)[0][:, :2].T
    points = np.stack([x, np.full(x.shape, -1.0), z], axis=1)
    upwards = np.array([0.0, 1.0, 0.0])
    area = 4 / x.size
    _, light = formulas.three_bounces(
        points, upwards, area, point, point, device, power=1.0, wall=0.8, hidden=0.6
    )
    return light.sum()
