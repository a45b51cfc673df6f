"""Each method finds closed-form scenes at their place, for different walls, windows and legs.

Also the true depth of hidden scenes, for walls in any pose.
"""

import math
from functools import lru_cache, partial

import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from helpers import hidden_scenes as scenes
from helpers.limits import lower
from oracles.nlos import Nodes, Rectangle

import tofrender
from tofrender.nlos import (
    METHODS,
    VolumeGrid,
    depth_error,
    depth_map,
    hidden_depth,
    make_capture,
    max_projection,
    reconstruct,
)
from tofrender.nlos.reconstruction import backprojection
from tofrender.nlos.reconstruction.volume import resample
from tofrender.nlos.reconstruction.wall_capture import Measured
from tofrender.vis.reconstructions import reconstruction_figure

TIME = {"width": 0.012, "bins": 125}
ALLOWED = [("confocal", m) for m in METHODS]
ALLOWED += [(mode, m) for mode in ("single", "exhaustive") for m in ("bp", "fbp", "phasor")]
pairs = pytest.mark.parametrize(("mode", "method"), ALLOWED)
each_method = pytest.mark.parametrize("method", METHODS)
SCENES = {
    # A plane that is parallel to the wall and reaches past its edge on one side
    "plane": partial(scenes.rectangle, (-0.8, 1.1), (-0.7, 0.9), 1.0, 0.04),
    "Z": scenes.letter_z,
    "spheres": scenes.two_spheres,
}


@lru_cache
def light_of(scene, wall: scenes.Wall, mode: str, **options) -> xr.Dataset:
    """Return the capture of a scene. All methods share it, so that it must not be changed."""
    return scenes.capture_of(scene(), wall, mode, **TIME | options)


def run(capture: xr.Dataset, method: str, **options) -> xr.Dataset:
    return reconstruct(capture, method, progress=False, **options)


def brightest(volume: xr.Dataset) -> np.ndarray:
    """Return the centroid of the brightest voxel and its neighbors, in the wall's frame."""
    values = volume["intensity"].values.astype(np.float64)
    at = np.unravel_index(values.argmax(), values.shape)
    near = tuple(slice(max(i - 1, 0), i + 2) for i in at)
    axes = [volume[axis].values[part] for axis, part in zip("zyx", near, strict=True)]
    places = np.stack(np.meshgrid(*axes, indexing="ij")[::-1], axis=-1).reshape(-1, 3)
    return np.average(places, axis=0, weights=values[near].ravel())


# Backprojection without a filter has no maximum at a plane (all that is before it is as bright),
# nor on a sphere; everything else finds surfaces to 2 cm. Points that are 62 mm apart see the
# slopes of spheres less well.
LIMITS = {("plane", "bp"): 0.06, ("spheres", "bp"): 0.11}
FEW = {("spheres", method): 0.03 for method in METHODS[1:]}
SMALL = {"wall": scenes.turned(32), "limits": FEW | LIMITS, "window": TIME}
LARGE = {"wall": scenes.Wall(64), "limits": LIMITS, "window": {"width": 0.006, "bins": 250}}
TRIED = [(s, *each, SMALL) for s in SCENES for each in ALLOWED if each[0] != "exhaustive"]
for scene, mode in (("plane", "confocal"), ("Z", "single"), ("spheres", "confocal")):
    TRIED += [(scene, *each, LARGE) for each in ALLOWED if each[0] == mode]


@pytest.mark.parametrize(("scene", "mode", "method", "size"), TRIED)
def test_depth_of_scenes(scene, mode, method, size):
    """Errors are below 2 cm for 64 x 64 points, bins of 6 mm, and a depth of 1 m."""
    volume = run(light_of(SCENES[scene], size["wall"], mode, **size["window"]), method)
    error = depth_error(volume, scenes.true_depth(SCENES[scene](), volume))
    assert error.median < size["limits"].get((scene, method), 0.02)
    if method != "bp" and mode == "confocal" and size is SMALL:
        assert error.found > 0.15
        assert error.extra < 0.45


def plate_error(method, z, half, mode="confocal", size=16, **window) -> float:
    """Return by how much the middle of a square plate that faces the wall is too deep [m]."""
    plate = scenes.rectangle((-half, half), (-half, half), z, half / 10)
    depth = depth_map(
        run(scenes.capture_of(plate, scenes.Wall(size), mode, start=0.0, **window), method)
    )
    middle = depth.sel(x=slice(-0.15, 0.15), y=slice(-0.15, 0.15))
    return float(np.nanmedian(middle)) - z


@pytest.mark.parametrize("bins", [125, 500])
@pytest.mark.parametrize("z", [0.25, 0.3, 0.5, 1.0])
def test_light_cone_transform_errs_by_half_a_step(z, bins):
    """The error is as documented, because steps are even in the square of the depth."""
    width = 0.02
    half_a_step = (bins * width / 2) ** 2 / (4 * z * bins)
    error = plate_error("lct", z, 0.2, width=width, bins=bins)
    assert abs(error) < half_a_step + width / 4  # And half a voxel
    if (z, bins) == (0.3, 500):
        assert abs(error) > 0.025  # The figure in the docstring is no exaggeration
    if bins == 125:
        assert abs(error) < 0.005


@pytest.mark.parametrize(("mode", "wavelength"), [("confocal", 0.5), ("single", 0.25)])
@pytest.mark.parametrize("z", [0.5, 1.0])
def test_phasor_fields_find_planes_too_deep(z, mode, wavelength):
    """Planes are too deep by about 0.2 λ² / z, as documented, and never too near."""
    size = round((8 if mode == "confocal" else 4) / wavelength)
    window = {"width": 0.02, "bins": 180}
    error = plate_error("phasor", z, 1.2, mode, size, **window)
    assert 0.05 < error / (wavelength**2 / z) < 0.4


@pairs
def test_a_letter_is_no_mirror_image(mode, method):
    grid = ((-1, 1, 24), (-1, 1, 24), (0.7, 1.3, 20))
    volume = run(light_of(scenes.letter_f, scenes.turned(24), mode), method, volume=grid)
    picture = max_projection(volume).values
    truth = np.isfinite(scenes.true_depth(scenes.letter_f(), volume)).astype(float)
    images = [turn(np.rot90(truth, k)) for k in range(4) for turn in (np.array, np.transpose)]
    fits = [np.corrcoef(picture.ravel(), image.ravel())[0, 1] for image in images]
    assert fits[0] > max(fits[1:]) + 0.03


POINT = np.array([0.32, -0.21, 0.93])


@lru_cache
def point_at(place: tuple):
    return partial(Nodes, np.array([place]), np.array([[0.0, 0, -1]]), np.array([1e-4]))


point = point_at(tuple(POINT))


def opposite(wall: scenes.Wall) -> tuple:
    """Return a position opposite to a point of the wall, near POINT."""
    x, y = wall.grid()[0, :, 0], wall.grid()[:, 0, 1]
    return float(x[abs(x - POINT[0]).argmin()]), float(y[abs(y - POINT[1]).argmin()]), POINT[2]


@pairs
@pytest.mark.parametrize("wall", [scenes.STRAIGHT, scenes.turned(32)], ids=["straight", "turned"])
@pytest.mark.parametrize("legs", [False, True])
def test_a_point_is_where_it_is(mode, method, wall, legs):
    wall = scenes.Wall(16 if mode == "exhaustive" else 24, wall.origin, wall.axes)
    place = opposite(wall)
    capture = light_of(point_at(place), wall, mode, legs=legs, lasers=3)
    volume = run(capture, method, volume=((0.1, 0.5, 16), (-0.4, 0, 16), (0.75, 1.1, 35)))
    off = brightest(volume) - place
    assert abs(off[2]) < 0.012  # a bin of path length is 6 mm of depth
    assert np.linalg.norm(off[:2]) < 0.03  # the wall's points are 83 mm apart (125 mm)
    frame = volume["frame_origin"].values + brightest(volume) @ volume["frame_axes"].values
    np.testing.assert_allclose(frame, wall.world(brightest(volume)), atol=1e-5)


@pairs
def test_the_window_may_start_anywhere(mode, method):
    """The window starts earlier by whole or half bins, or before any light can return."""
    grid, places = ((0.1, 0.5, 16), (-0.4, 0, 16), (0.7, 1.2, 50)), []
    for start in (1.3, 1.306, 1.546, -0.301):
        bins = 125 if start > 0 else 250
        capture = light_of(point, scenes.Wall(16), mode, start=start, lasers=2, bins=bins)
        places.append(brightest(run(capture, method, volume=grid)))
        np.testing.assert_allclose(places[-1], places[0], atol=0.005)


@pairs
def test_a_planted_half_bin_is_seen(mode, method):
    """A path that is too long by half a bin (6 mm) is 3 mm too deep."""
    wall, grid = scenes.Wall(16), ((0.2, 0.5, 12), (-0.3, -0.1, 8), (0.85, 1.01, 64))
    captures = [light_of(point, wall, mode, lasers=2, delay=d) for d in (0.0, 0.006, 0.012)]
    right, half, whole = (
        float(np.nanmedian(depth_map(run(capture, method, volume=grid), 0.9)))
        for capture in captures
    )
    assert abs(right - POINT[2]) < (0.008 if method == "phasor" else 0.004)
    assert 0.0008 < half - right < 0.0055
    assert 0.004 < whole - right < 0.009


def test_any_geometry_for_backprojection():
    rng = np.random.default_rng(2)
    grid = rng.uniform(-1, 1, (1, 300, 3))
    grid[..., 2] = 0.1 * np.sin(3 * grid[..., 0])
    path = 2 * np.linalg.norm(grid - POINT, axis=-1)
    opl = 1.2 + (np.arange(150) + 0.5) * 0.012
    capture = make_capture(
        np.exp(-(((opl - path[..., None]) / 0.012) ** 2) / 2),
        mode="confocal",
        start_opl=1.2,
        bin_width_opl=0.012,
        sensor_grid=grid,
        sensor_normals=np.broadcast_to([0, 0, 1.0], grid.shape),
    )
    volume = run(capture, "bp", volume=((-1.5, 1.5, 60), (-1.5, 1.5, 60), (0.5, 1.5, 50)))
    world = volume["frame_origin"].values + brightest(volume) @ volume["frame_axes"].values
    np.testing.assert_allclose(world, POINT, atol=0.02)
    with pytest.raises(ValueError, match=r"not even, or not plane allows bp, fbp$"):
        run(capture, "phasor")


@each_method
def test_noise(method):
    volume = run(scenes.capture_of(scenes.letter_z(), scenes.Wall(32), noise=0.02, **TIME), method)
    # Where the letter is: how much else is above the threshold depends on the method.
    assert depth_error(volume, scenes.true_depth(scenes.letter_z(), volume), 0.0).median < 0.025


@pytest.mark.parametrize("mode", ["single", "confocal", "exhaustive"])
@pytest.mark.parametrize("weighting", backprojection.WEIGHTINGS)
def test_backprojection_is_its_formula(mode, weighting):
    rng = np.random.default_rng(0)
    capture = scenes.capture_of(
        point(), scenes.turned(4), mode, bins=60, width=0.03, legs=True, lasers=2
    )
    light = rng.random(capture["transient"].shape, dtype=np.float32)
    capture["transient"] = (capture["transient"].dims, light)
    grid = VolumeGrid((-1, 1, 5), (-1, 0.5, 4), (0.1, 1.4, 6))
    volume = run(capture, "bp", volume=grid, weighting=weighting)
    axes, origin = volume["frame_axes"].values, volume["frame_origin"].values
    z, y, x = np.meshgrid(*(grid.centers(a) for a in "zyx"), indexing="ij")
    voxels = origin + np.stack([x, y, z], axis=-1) @ axes
    seen = capture["sensor_grid"].values.reshape(-1, 3)
    lit = capture["laser_grid"].values.reshape(-1, 3)
    bins = light.reshape(-1, len(seen), 60)
    expected, count = np.zeros(grid.shape), 0
    for i, laser in enumerate(lit):
        for j, sensor in enumerate(seen):
            if mode == "confocal" and i != j:
                continue
            count += 1
            legs = np.linalg.norm(laser - capture["laser_origin"].values)
            legs += np.linalg.norm(sensor - capture["sensor_origin"].values)
            r = [np.linalg.norm(voxels - p, axis=-1) for p in (laser, sensor)]
            padded = np.pad(bins[0 if mode != "exhaustive" else i, j], 1)
            bin_centers = capture.attrs["start_opl"] + (np.arange(-1, 61) + 0.5) * 0.03
            found = np.interp(r[0] + r[1] + legs, bin_centers, padded, 0, 0)
            expected += found * (r[0] * r[1] if weighting == "r2" else 1)
    np.testing.assert_allclose(volume["intensity"], expected / count, rtol=1e-3, atol=2e-5)


def test_backprojection_in_steps(monkeypatch):
    capture = scenes.capture_of(scenes.letter_z(), scenes.Wall(8), bins=50, width=0.03)
    whole = run(capture, "bp")
    lower(monkeypatch, backprojected_pairs=64 * 77)
    np.testing.assert_array_equal(run(capture, "bp")["intensity"], whole["intensity"])


def test_sharpening_is_exact_for_parabolas():
    """Minus the Laplacian of -(x² + 2 y² + 3 z²) is 12, also for voxels that are not cubes."""
    grid = VolumeGrid((-1, 1, 5), (-1, 0.5, 6), (0.1, 1.4, 7))
    z, y, x = np.meshgrid(*(grid.centers(axis) for axis in "zyx"), indexing="ij")
    found = backprojection.sharpen(-(x**2 + 2 * y**2 + 3 * z**2), grid)
    np.testing.assert_allclose(found[1:-1, 1:-1, 1:-1], 12, rtol=1e-5)


def test_light_that_is_not_finite_is_refused():
    capture = scenes.capture_of(scenes.letter_z(), scenes.Wall(8), **TIME)
    capture["transient"].values[3, 4:7, 20:22] = np.nan
    said = r"\Acapture: transient: 6 of 8000 values .*, the first is nan at \[3, 4, 20, 0\].*\Z"
    for method in METHODS:
        with pytest.raises(ValueError, match=said):
            run(capture, method)


@pytest.mark.parametrize("method", ["lct", "fk"])
def test_rows_that_are_farther_apart_than_columns(method):
    wall = scenes.Wall(16)
    place = (wall.grid()[0, 8, 0], wall.grid()[7, 0, 1], 1.0)
    capture = scenes.capture_of(point_at(place)(), wall, **TIME).isel(y=slice(1, None, 2))
    off = brightest(run(capture, method)) - place
    assert abs(off[0]) < 0.06  # Columns are 125 mm apart, rows 250 mm
    assert abs(off[1]) < 0.12
    assert abs(off[2]) < 0.012


@pytest.mark.parametrize("method", ["lct", "fk"])
def test_falloff_of_retroreflectors(method):
    near, far = (
        scenes.rectangle((x, x + 0.15), (-0.1, 0.05), z, 0.03) for x, z in ((-0.5, 0.8), (0.4, 1.3))
    )
    ratios = {}
    for light, power in (("diffuse", 0), ("retroreflective", 2)):  # r^-4 by f1, and r^-2
        capture = scenes.capture_of(near + far, scenes.Wall(32), **TIME)
        capture["transient"].values[:] *= (capture["opl"].values[:, None] / 2) ** power
        for surface in ("diffuse", "retroreflective"):
            volume = run(capture, method, surface=surface)["intensity"]
            left, right = volume.sel(x=slice(None, 0)), volume.sel(x=slice(0, None))
            ratios[light, surface] = np.log(float(left.max()) / float(right.max()))
        other = {"diffuse": "retroreflective", "retroreflective": "diffuse"}[light]
        assert abs(ratios[light, other] - ratios[light, light]) > 0.5
    right = [ratios[each, each] for each in ("diffuse", "retroreflective")]
    assert right[0] == pytest.approx(right[1], abs=0.14)


def test_options_change_what_they_say():
    capture = scenes.capture_of(scenes.letter_z(), scenes.Wall(16), noise=0.05, **TIME)
    for method, option, low, high in (
        ("lct", "snr", 1, 1e4),
        ("phasor", "wavelength", 0.3, 0.6),
        ("phasor", "cycles", 3, 8),
    ):
        a, b = (run(capture, method, **{option: value}) for value in (low, high))
        assert (a.attrs[option], b.attrs[option]) == (low, high)
        assert not np.allclose(a["intensity"], b["intensity"])


@each_method
def test_a_volume_of_ones_own(method):
    capture = scenes.capture_of(scenes.letter_z(), scenes.Wall(16), **TIME)
    axes = ((-0.5, 0.7, 9), (-0.6, 0.5, 7), (0.8, 1.3, 11))
    volume = run(capture, method, volume=axes)
    assert volume["intensity"].shape == (11, 7, 9)
    assert volume["intensity"].dtype == np.float32
    assert np.isfinite(volume["intensity"]).all()
    assert (volume["intensity"] >= 0).all()
    np.testing.assert_allclose(volume["z"][[0, -1]], [0.8 + 0.5 / 22, 1.3 - 0.5 / 22])
    assert volume.attrs["method"] == method
    assert run(capture, method, volume=VolumeGrid(*axes)).identical(volume)
    beyond = run(capture, method, volume=((-3, 3, 20), (-3, 3, 21), (0.9, 1.1, 4)))
    x, y = brightest(beyond)[:2]
    assert abs(x) < 0.5
    assert abs(y) < 0.5


def test_resample():
    def linear(grid: VolumeGrid) -> np.ndarray:
        x, y, z = (grid.centers(a) for a in "xyz")
        return (z[:, None, None] + 10 * y[:, None] + 100 * x).astype(np.float32)

    coarse = VolumeGrid((0, 4, 4), (0, 2, 2), (0, 3, 3))
    fine = VolumeGrid((1, 3, 8), (0.5, 1.5, 5), (0.5, 2.5, 9))
    resampled = partial(resample, linear(coarse), coarse)
    np.testing.assert_allclose(resampled(fine), linear(fine), rtol=1e-5)
    means = resampled(VolumeGrid((0, 4, 2), (0, 2, 1), (0, 3, 1)))
    np.testing.assert_allclose(means[0, 0], [1.5 + 10 + 100, 1.5 + 10 + 300], rtol=1e-6)
    assert (resampled(VolumeGrid((4, 8, 4), (0, 2, 2), (0, 3, 3))) == 0).all()


def test_default_volume_holds_what_the_window_holds():
    for mode in ("confocal", "single"):
        capture = scenes.capture_of(point(), scenes.Wall(16), mode, start=1.5, **TIME)
        volume = run(capture, "bp")
        assert volume["intensity"].shape[1:] == (16, 16)
        np.testing.assert_allclose(volume["x"], capture["sensor_grid"].values[0, :, 0], atol=1e-6)
        step = float(volume["z"][1] - volume["z"][0])
        np.testing.assert_allclose(volume["z"][-1] + step / 2, (1.5 + 125 * 0.012) / 2)
    assert Measured.of(capture).spacing == pytest.approx(0.125)


BASE = scenes.capture_of(point(), scenes.Wall(8), bins=20, width=0.05)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "fkk"}, "method = 'fkk': did you mean 'fk'"),
        ({"method": "bp", "snr": 3}, "snr = 3: must be None, as it is for lct only"),
        ({"method": "phasor", "surface": "diffuse"}, "surface = .* for lct and fk only"),
        ({"method": "phasor", "wavelength": 0.02}, "wavelength = 0.02: must be above two bins"),
        ({"method": "bp", "volume": ((0, 1, 2), (0, 1, 2), (0, 1))}, r"volume: z = \(0, 1\): must"),
        ({"method": "bp", "volume": ((1, 0, 2), (0, 1, 2), (0, 1, 2))}, "volume: x .*low < high"),
        ({"method": "bp", "volume": ((0, 1, 0), (0, 1, 2), (0, 1, 2))}, "count of x = 0"),
        ({"method": "bp", "volume": ((0, 1, 2), (0, 1, 2), (-1, 1, 2))}, "before the wall"),
        ({"method": "bp", "volume": [(0, 1, 9999)] * 3}, r"voxels: must be at most"),
    ],
)
def test_bad_options_in_one_line(options, message):
    with pytest.raises(ValueError, match=rf"\A.*{message}.*\Z"):
        reconstruct(BASE, **options)


def test_captures_that_a_method_does_not_allow():
    uneven = BASE.isel(x=[0, 1, 3])
    run(uneven, "bp")
    early = scenes.capture_of(point(), scenes.Wall(4), start=-2, bins=10)
    refused = [
        (uneven, "lct", "a confocal capture on a grid that is not even.* bp, fbp$"),
        (BASE["transient"], "bp", "capture: expected a capture"),
        (early, "bp", "bins end before light can return"),
    ]
    for mode in ("single", "exhaustive"):
        capture = scenes.capture_of(point(), scenes.Wall(4), mode, bins=10, lasers=2)
        said = f"a {mode} capture .* allows bp, fbp, phasor$"
        refused += [(capture, "lct", said), (capture, "fk", said)]
    for capture, method, said in refused:
        with pytest.raises(ValueError, match=said):
            run(capture, method)


@pytest.mark.parametrize("method", ["lct", "fk", "phasor"])
def test_too_little_memory(monkeypatch, method):
    lower(monkeypatch, free_memory=1 << 10)
    with pytest.raises(MemoryError, match=f"^method = '{method}': it needs .* are free. Use"):
        run(BASE, method)


def volume_of(values) -> xr.Dataset:
    values = np.asarray(values, np.float32)
    coords = {a: 0.1 * np.arange(n) for a, n in zip("zyx", values.shape, strict=True)}
    return xr.Dataset({"intensity": (("z", "y", "x"), values)}, coords)


def test_depth_map():
    columns = [
        (0, 1, 3, 1, 0),
        (0, 0, 2, 3, 2),  # the parabola's peak is on the voxel
        (4, 0, 0, 0, 0),  # at the edge: as it is
        (0, 0, 0.5, 0, 0),
    ]
    values = np.transpose(columns)[:, None]
    np.testing.assert_allclose(depth_map(volume_of(values))[0], [0.2, 0.3, 0, np.nan])
    np.testing.assert_allclose(depth_map(volume_of(values), 0.1)[0, 3], 0.2)
    z = np.arange(5) * 0.1
    parabola = volume_of((5 - (z - 0.23) ** 2)[:, None, None])
    np.testing.assert_allclose(depth_map(parabola)[0, 0], 0.23, atol=1e-4)
    assert np.isnan(depth_map(volume_of(0 * values))).all()
    np.testing.assert_array_equal(max_projection(volume_of(values))[0], [3, 3, 4, 0.5])
    for threshold in (-0.1, 1.1, np.nan):
        with pytest.raises(ValueError, match=r"threshold = .*: must be a finite number from 0 to"):
            depth_map(volume_of(values), threshold)


def test_depth_error():
    values = np.zeros((4, 1, 5))
    values[[1, 2, 3], 0, [0, 1, 3]] = 1
    truth = [[0.1, 0.23, 0.2, np.nan, 0.3]]
    error = depth_error(volume_of(values), truth)
    assert (error.pixels, error.found, error.extra) == (2, 2 / 4, 1 / 3)
    np.testing.assert_allclose((error.median, error.mean, error.bias), (0.015, 0.015, -0.015))
    np.testing.assert_allclose(error.rms, 0.03 / 2**0.5)
    labeled = depth_map(volume_of(values)).copy(data=truth)
    assert depth_error(volume_of(values), labeled.transpose()) == error
    with pytest.raises(ValueError, match=r"truth: the axis x has other labels"):
        depth_error(volume_of(values), labeled.assign_coords(x=labeled["x"] + 0.5))
    nothing = depth_error(volume_of(values), [[np.nan, np.nan, 0.2, np.nan, 0.3]])
    assert np.isnan(nothing.median)
    assert nothing.pixels == 0
    for truth, said in ((np.full((1, 5), np.nan), "pixels are NaN"), ([1, 2], "with shape")):
        with pytest.raises(ValueError, match=f"truth.* {said}"):
            depth_error(volume_of(values), truth)


def test_figure():
    for wall, down in ((scenes.STRAIGHT, False), (scenes.turned(16), None)):
        volume = run(
            scenes.capture_of(scenes.letter_z(), scenes.Wall(16, wall.origin, wall.axes), **TIME),
            "lct",
        )
        figure = reconstruction_figure(volume.assign_attrs(scene="letter"))
        views = figure.axes[:4]
        assert [a.get_title() for a in views] == ["front", "side", "top", "depth"]
        labels = [("x [m]", "y [m]"), ("z [m]", "y [m]"), ("x [m]", "z [m]"), ("x [m]", "y [m]")]
        assert [(a.get_xlabel(), a.get_ylabel()) for a in views] == labels
        assert len(figure.axes) == 6  # with a bar of intensity, and one of depth
        assert figure.get_suptitle() == "letter, lct"
        np.testing.assert_allclose(views[0].get_xlim(), (-1, 1), atol=1e-6)
        rows_down = float(volume["frame_axes"][1, 1]) < 0
        assert views[0].yaxis_inverted() == rows_down
        assert down is None or rows_down == down
    figure.canvas.draw()


AXES = ("z", "y", "x")


def seen_from(frame: np.ndarray, origin=(0.0, 0, 0), size: int = 41) -> xr.Dataset:
    """Return the frame of a volume over [-1, 1] x [-1, 1] of the wall."""
    at = np.linspace(-1, 1, size)
    variables = {
        "intensity": (AXES, np.zeros((1, size, size), np.float32)),
        "frame_origin": (("xyz",), np.asarray(origin, float)),
        "frame_axes": (("axis", "xyz"), np.asarray(frame, float)),
    }
    names = {"axis": [*"xyz"], "xyz": [*"xyz"]}
    return xr.Dataset(variables, {"x": at, "y": at, "z": [1.0], **names})


@pytest.mark.parametrize("steps", [0, 70])
def test_a_sphere(steps):
    pose = mi.ScalarTransform4f().translate([1, -2, 3]).rotate([0.6, 0, 0.8], steps)
    matrix = np.array(pose.matrix)
    ball = {"type": "sphere", "center": [0.2, -0.1, 1.5], "radius": 0.4, "to_world": pose}
    wall = {"type": "rectangle", "to_world": pose}
    scene = mi.load_dict({"type": "scene", "relay_wall": wall, "hidden_ball": ball})
    where = seen_from(matrix[:3, :3].T, matrix[:3, 3])
    depth = hidden_depth(scene, where)
    assert depth.dims == ("y", "x")
    x, y = np.meshgrid(where["x"], where["y"])
    square = 0.4**2 - (x - 0.2) ** 2 - (y + 0.1) ** 2
    expected = np.where(square > 0, 1.5 - np.sqrt(np.maximum(square, 0)), np.nan)
    edge = abs(square) < 1e-3
    assert depth.values[~edge] == pytest.approx(expected[~edge], abs=1e-4, nan_ok=True)


def test_the_letter_through_its_occluder():
    where = seen_from(np.eye(3), size=401)
    depth = hidden_depth("nlos_z", where).values
    assert np.nanmin(depth) == pytest.approx(1, abs=1e-5)
    assert np.nanmax(depth) == pytest.approx(1, abs=1e-5)
    shape = tofrender.load_scene("nlos_z", optimize=False)
    letter = next(s for s in shape.shapes() if s.id() == "hidden_z")
    area = np.isfinite(depth).mean() * 2.005**2
    assert area == pytest.approx(letter.surface_area()[0], rel=0.02)
    plate = hidden_depth("nlos_z", where, hidden_shapes="occluder").values
    assert np.nanmax(plate) < 0.5


def test_what_is_hidden_can_be_said():
    plates = {"near": 1.0, "far": 2.0}
    described = {"type": "scene", "relay_wall": {"type": "rectangle"}}
    for name, z in plates.items():
        place = mi.ScalarTransform4f().translate([0, 0, z])
        described[name] = {"type": "rectangle", "to_world": place}
    scene = mi.load_dict(described, optimize=False)
    second = scene.shapes()[1]
    for names, z in (
        (None, 1),
        ("far", 2),
        (["far", "near"], 1),
        (second, plates.get(second.id(), math.nan)),
    ):
        depth = hidden_depth(scene, seen_from(np.eye(3), size=5), hidden_shapes=names)
        assert depth.values[1:4, 1:4] == pytest.approx(np.full((3, 3), z), abs=1e-5, nan_ok=True)


def test_captures_have_their_own_points():
    wall = scenes.turned(8)
    capture = scenes.capture_of(scenes.rectangle((-0.5, 0.6), (-0.4, 0.8), 1.2, 0.2), wall, bins=4)
    places = [(-0.5, -0.4, 1.2), (0.6, -0.4, 1.2), (-0.5, 0.8, 1.2)]
    corner, across, along = wall.world(np.array(places))
    u, v = (across - corner) / 2, (along - corner) / 2
    scene = {"type": "scene", "hidden": Rectangle(corner + u + v, u, v).shape()}
    depth = hidden_depth(mi.load_dict(scene), capture).values
    x, y = np.moveaxis(wall.grid()[..., :2], -1, 0)
    inside = (x > -0.5) & (x < 0.6) & (y > -0.4) & (y < 0.8)
    assert depth == pytest.approx(np.where(inside, 1.2, np.nan), abs=1e-5, nan_ok=True)


def test_bad_input():
    where = seen_from(np.eye(3), size=3)
    with pytest.raises(ValueError, match=r"\Ahidden_shapes = 'w': the scene has no such.*\Z"):
        hidden_depth("nlos_z", where, hidden_shapes="w")
    with pytest.raises(ValueError, match=r"\Ascene: hidden shapes are missing.*by hidden_shapes"):
        hidden_depth({"type": "scene"}, where)
