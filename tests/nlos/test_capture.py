"""Captures: points of pixels, aims of lasers, path lengths, and equal light in all modes."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.support import agree, camera, film, over_seeds
from oracles import nlos

import tofrender
from tofrender.nlos import check_capture, focus_laser, without_first_and_last_legs
from tofrender.nlos.device.relay_wall import find_relay_wall, wall_points

DEVICE = (-0.6, 0.3, 1.2)
LASER = (-0.8, -0.5, 0.6)
LIT = (-0.3, 0.25, 0.0)
PATCH = nlos.Rectangle.turned((0.35, 0.3, 1.1), 30, 240, half=(0.2, 0.2))
PLATE = nlos.Rectangle((0.0, 0.0, 1.0), (-0.05, 0, 0), (0, 0.05, 0))
MOVED = mi.ScalarTransform4f().translate([0.5, -2, 3]).rotate([0.48, 0.64, 0.6], 70)
MOVED = MOVED.scale([1.5, 0.5, 1])


def matrix(to_world) -> np.ndarray:
    return np.eye(4) if to_world is None else np.array(to_world.matrix)


def capture(scene, progress: bool = False, **options):
    loaded = nlos.load_nlos(scene) if isinstance(scene, dict) else scene
    return tofrender.capture(loaded, progress=progress, **options)


def in_front(to_world) -> tuple:
    """Return a random position in front of a wall with any pose."""
    return tuple((matrix(to_world) @ [*DEVICE, 1])[:3].tolist())


def meter_scene(width: int, height: int, to_world=None, **more) -> dict:
    wall = nlos.relay_wall(
        nlos.Setup(sensor=in_front(to_world)), film(width, height, **more), to_world
    )
    integrator = {"type": "confocal_transient_path"}
    return {"type": "scene", "integrator": integrator, "relay_wall": wall}


def looked_at(loaded: mi.Scene, width: int, height: int) -> np.ndarray:
    """Return where the sensor's rays through pixel centers meet the wall, (y, x, 3)."""
    y, x = (a.ravel() + 0.5 for a in np.mgrid[:height, :width])
    ray, weight = loaded.sensors()[0].sample_ray(
        0, 0.5, mi.Point2f(x / width, y / height), mi.Point2f(0.5)
    )
    assert np.array(weight) == pytest.approx(1)
    return np.array(loaded.ray_intersect(mi.Ray3f(ray)).p).T.reshape(height, width, 3)


def test_every_resolution_hits_its_pixels():
    """Resolutions from 1 to 128, on two walls, and samples anywhere in a pixel."""
    for size in range(1, 129):
        to_world = (None, MOVED)[size % 2]
        width, height = size, 129 - size
        loaded = nlos.load_nlos(meter_scene(width, height, to_world))
        # all columns of one row and all rows of one column
        x = np.concatenate([np.arange(width), np.full(height, width // 2)])
        y = np.concatenate([np.full(width, height // 2), np.arange(height)])
        grid = nlos.Grid(width, height, matrix(to_world))
        expected = np.array([grid.point(*pixel) for pixel in zip(x, y, strict=True)])
        offsets = np.array([[1e-4], [0.5], [0.9999]])
        sample = mi.Point2f(*(((a + offsets) / n).ravel() for a, n in ((x, width), (y, height))))
        ray, _ = loaded.sensors()[0].sample_ray(0, 0.5, sample, mi.Point2f(0.5))
        points = np.array(loaded.ray_intersect(mi.Ray3f(ray)).p).T.reshape(3, -1, 3)
        assert np.abs(points - expected).max() < 1e-5, (width, height)


def test_crop():
    """Pixels of a crop window look at the same points of the wall as in the whole film."""
    whole = nlos.load_nlos(meter_scene(7, 5, MOVED))
    part = nlos.load_nlos(meter_scene(7, 5, MOVED, **CROP))
    expected = looked_at(whole, 7, 5)[1:3, 2:5]
    assert looked_at(part, 3, 2) == pytest.approx(expected, abs=1e-6)
    points, normals, on_wall = wall_points(part, part.sensors()[0], find_relay_wall(part))
    assert on_wall.all()
    assert points == pytest.approx(expected, abs=1e-5)
    normal = np.cross(*matrix(MOVED)[:3, :2].T)
    normal /= np.linalg.norm(normal)
    assert normals == pytest.approx(np.broadcast_to(normal, normals.shape), abs=1e-5)


def test_mitsuba_renders_with_the_meter():
    described = meter_scene(5, 3) | {"lamp": {"type": "point", "position": list(LASER)}}
    described = nlos.in_pictures(described, nlos.picture_film(5, 3), type="direct")
    image = np.array(mi.render(nlos.load_nlos(described), spp=16))[..., 1]
    away = np.array(LASER) - nlos.Grid(5, 3).points()
    expected = away[..., 2] / np.linalg.norm(away, axis=-1) ** 3
    ratio = image / expected
    assert ratio == pytest.approx(np.full((3, 5), ratio[0, 0]), rel=1e-4)


CROP = {"crop_width": 3, "crop_height": 2, "crop_offset_x": 2, "crop_offset_y": 1}


def pose_of_laser(loaded: mi.Scene) -> np.ndarray:
    return np.array(mi.traverse(loaded)["laser.to_world"].matrix, dtype=float).reshape(4, 4)


def laser_of(loaded: mi.Scene) -> np.ndarray:
    """Return where the laser's axis meets the scene."""
    pose = pose_of_laser(loaded)
    ray = mi.Ray3f(pose[:3, 3].tolist(), pose[:3, 2].tolist())
    return np.array(loaded.ray_intersect(ray).p).ravel()


def aimed(the_film: dict, **options) -> mi.Scene:
    setup = nlos.Setup(sensor=DEVICE, laser=LASER, legs=False)
    return nlos.load_nlos(nlos.single(setup, {"hidden": PLATE.shape()}, LIT, the_film, **options))


def aimed_by_camera(the_film: dict, target=(0, 0, 0)) -> mi.Scene:
    setup = nlos.Setup(sensor=DEVICE, laser=LASER)
    described = nlos.single(setup, {"hidden": PLATE.shape()}, LIT, film())
    described["relay_wall"].pop("sensor")
    eye = camera((0.2, 0.1, 1.5), target, the_film, fov=40)
    return nlos.load_nlos(described | {"sensor": eye})


def projector() -> dict:
    to_world = mi.ScalarTransform4f().look_at(list(LASER), [0, 0, 0], [0, 1, 0])
    return {"type": "projector", "irradiance": 1.0, "fov": 0.2, "to_world": to_world}


@pytest.mark.parametrize("kind", ["spot", "projector"])
def test_focus(kind):
    lamp = nlos.spot(LASER, (0, 0, 0)) if kind == "spot" else projector()
    described = nlos.single(nlos.Setup(sensor=DEVICE, laser=LASER), {}, LIT, film(4, 3)) | {
        "laser": lamp
    }
    loaded = nlos.load_nlos(described)
    for aim, expected in (
        ({"point": [0.2, -0.7, 0]}, (0.2, -0.7, 0)),
        ({"uv": [0.25, 0.9]}, (-0.5, 0.8, 0)),
        ({"pixel": (0, 0)}, nlos.Grid(4, 3).point(0, 0)),
        ({"pixel": (3, 1)}, nlos.Grid(4, 3).point(3, 1)),
        ({"point": [*LASER[:2], 0]}, (*LASER[:2], 0)),  # straight down
    ):
        assert focus_laser(loaded, **aim) == pytest.approx(expected, abs=1e-6)
        assert laser_of(loaded) == pytest.approx(np.array(expected), abs=1e-5)


@pytest.mark.parametrize("scene_of", [aimed, aimed_by_camera])
def test_focus_on_a_pixel_of_a_crop(scene_of):
    whole, part = scene_of(film(7, 5)), scene_of(film(7, 5, **CROP))
    for pixel in ((2, 1), (4, 2), (3, 1)):
        points = [focus_laser(loaded, pixel=pixel) for loaded in (whole, part)]
        assert points[1] == pytest.approx(points[0], abs=1e-5)
        assert laser_of(part) == pytest.approx(points[0], abs=1e-5)
        if scene_of is aimed:
            assert points[0] == pytest.approx(nlos.Grid(7, 5).point(*pixel), abs=1e-6)


def test_focus_on_a_pixel_that_sees_nothing_is_refused():
    loaded = aimed_by_camera(film(7, 5), (0.2, 0.1, 3))
    before = pose_of_laser(loaded)
    with pytest.raises(ValueError, match=r"\Apixel = \(3, 2\): sees no surface. Choose.*\Z"):
        focus_laser(loaded, pixel=(3, 2))
    assert (pose_of_laser(loaded) == before).all()


@pytest.mark.parametrize("package", [tofrender, tofrender.nlos])
def test_peers_way_to_turn_a_laser_is_refused_by_name(package):
    with pytest.raises(AttributeError, match=r"\A.*use focus_laser\(scene, pixel=\(x, y\)\)\Z"):
        _ = package.focus_emitter_at_relay_wall_pixel


def test_captures_leave_the_laser_as_it_was(monkeypatch):
    loaded = aimed(film(2, 2, bins=4, bin_width=1.0))
    before = pose_of_laser(loaded)
    for mode in ("single", "confocal", "exhaustive"):
        capture(loaded, mode=mode, spp=1)
        np.testing.assert_array_equal(pose_of_laser(loaded), before)
    count, kind = [], type(loaded.sensors()[0])

    def interrupt(*args, **options):
        count.append(0)
        if len(count) > 2:
            raise KeyboardInterrupt
        return original(*args, **options)

    original = kind.sample_ray_differential
    monkeypatch.setattr(kind, "sample_ray_differential", interrupt)
    with pytest.raises(KeyboardInterrupt):
        capture(loaded, mode="exhaustive", spp=1)
    np.testing.assert_array_equal(pose_of_laser(loaded), before)


@pytest.mark.parametrize(
    ("aim", "words"),
    [
        ({}, "point"),
        ({"point": [0, 0, 0], "uv": [0.5, 0.5]}, "point"),
        ({"uv": [1.2, 0.5]}, "uv"),
        ({"pixel": (4, 0)}, "pixel"),
        ({"pixel": (-1, 0)}, "pixel"),
        ({"point": list(LASER)}, "point"),
    ],
)
def test_bad_aims(aim, words):
    loaded = aimed(film(4, 3))
    with pytest.raises(ValueError, match=rf"\A.*{words}.*\Z"):
        focus_laser(loaded, **aim)


SETUP = nlos.Setup(sensor=DEVICE, laser=LASER, legs=False)


def around_the_corner(mode: str | None = None, the_film=None, **options) -> dict:
    the_film = the_film or film(3, 2, bins=60, start=1.8, bin_width=0.1)
    decided = {} if mode is None else {"capture_type": mode}
    return nlos.single(SETUP, {"hidden": PATCH.shape()}, LIT, the_film, **decided, **options)


def quiet(mode: str, spp: int = 2048, seed: int = 1, **options):
    return capture(around_the_corner(mode, **options), mode=mode, spp=spp, seed=seed)


def intensity() -> float:
    """Return the intensity of the scene's spot, which sends one watt to a square meter at LIT."""
    return float(around_the_corner()["laser"]["intensity"]["value"][0])


def power(point) -> float:
    """Return the power of the spot on a square meter, if it is aimed at a point of the wall."""
    away = np.subtract(LASER, point)
    return intensity() * away[2] / np.linalg.norm(away) ** 3


def three(lit, seen) -> float:
    setup = nlos.Setup(sensor=DEVICE, laser=LASER, legs=False, power=power(lit))
    return nlos.total(setup, PATCH.nodes(), 0.7, lit, seen)


POINTS = nlos.Grid(3, 2).points()


def sums(data) -> np.ndarray:
    return data["transient"].sum("opl").values[..., 0].astype(float)


def test_captures_are_the_formula():
    expected = np.array(
        [[[[three(p, s) for s in row] for row in POINTS] for p in lit] for lit in POINTS]
    )
    exhaustive = sums(quiet("exhaustive", 4096))
    assert exhaustive.shape == (2, 3, 2, 3)
    assert exhaustive == pytest.approx(expected, rel=0.02)
    assert exhaustive.sum() == pytest.approx(expected.sum(), rel=0.003)
    diagonal = np.einsum("yxyx->yx", expected)
    assert sums(quiet("confocal", 4096)) == pytest.approx(diagonal, rel=0.02)
    loaded = nlos.load_nlos(around_the_corner())
    focus_laser(loaded, pixel=(2, 0))
    single_capture = sums(capture(loaded, mode="single", spp=4096))
    assert single_capture == pytest.approx(expected[0, 2], rel=0.02)


@pytest.mark.statistical
def test_power_of_a_projector():
    """The power is the irradiance at the lit point in Mitsuba, times one square meter."""
    described = around_the_corner() | {"laser": projector()}
    loaded = nlos.load_nlos(described)
    focus_laser(loaded, point=LIT)
    si = mi.Interaction3f(t=0, time=0, wavelengths=[], p=mi.Point3f(*LIT), n=mi.Normal3f(0, 0, 1))
    _, weight = loaded.emitters()[0].sample_direction(si, [0.5, 0.5])
    away = np.subtract(LASER, LIT)
    watts = float(np.array(weight).ravel()[0]) * away[2] / np.linalg.norm(away)
    setup = nlos.Setup(sensor=DEVICE, laser=LASER, power=watts)
    expected = [[nlos.total(setup, PATCH.nodes(), 0.7, LIT, s) for s in row] for row in POINTS]
    found = over_seeds(nlos.estimates(loaded, 1024), range(16))
    assert agree(found, np.array(expected), rounding=1e-3)


@pytest.mark.parametrize("mode", ["single", "confocal", "exhaustive"])
def test_a_capture_tells_the_light_that_its_window_loses(mode):
    """Light of form f1 is after the window; light of the laser spot before it does not count."""
    stop = 2.5
    window = film(3, 2, bins=7, start=1.8, bin_width=0.1)
    loaded = nlos.load_nlos(around_the_corner(the_film=window, filter_bounces=-1, max_depth=3))
    seen = POINTS.reshape(-1, 3)
    pairs = {
        "single": [(LIT, s) for s in seen],
        "confocal": [(s, s) for s in seen],
        "exhaustive": [(lit, s) for lit in seen for s in seen],
    }
    light, lost = 0.0, 0.0
    for lit, s in pairs[mode]:
        setup = nlos.Setup(sensor=DEVICE, laser=LASER, legs=False, power=power(lit))
        opl, each = nlos.three_bounces(setup, PATCH.nodes(), 0.7, lit, s)
        light, lost = light + each.sum(), lost + each[opl >= stop].sum()
    with pytest.warns(UserWarning, match="% of the energy arrives outside the window 1.8 to 2.5 m"):
        data = capture(loaded, mode=mode, spp=1024)
    assert 0.2 < lost / light < 0.95
    assert data.attrs["energy_outside_window"] == pytest.approx(lost / light, abs=0.01)


@pytest.mark.parametrize("mode", ["single", "confocal", "exhaustive"])
def test_dataset(mode):
    data = quiet(mode, 16)
    check_capture(data)
    lasers = {"laser_y": 2, "laser_x": 3} if mode == "exhaustive" else {}
    assert dict(data["transient"].sizes) == lasers | {"y": 2, "x": 3, "opl": 60, "channel": 3}
    assert data["opl"].values == pytest.approx(1.85 + 0.1 * np.arange(60))
    assert data["sensor_grid"].values == pytest.approx(POINTS, abs=1e-6)
    assert data["sensor_normals"].values == pytest.approx(np.tile([0, 0, 1], (2, 3, 1)), abs=1e-6)
    lit = np.reshape(LIT, (1, 1, 3)) if mode == "single" else POINTS
    assert data["laser_grid"].values == pytest.approx(lit, abs=1e-5)
    assert data["laser_normals"].values == pytest.approx(np.broadcast_to([0, 0, 1], lit.shape))
    assert data["sensor_origin"].values == pytest.approx(DEVICE)
    assert data["laser_origin"].values == pytest.approx(LASER)
    assert all(type(v) in (str, int, float) for v in data.attrs.values())
    told = {k: data.attrs[k] for k in ("capture_mode", "spp", "seed", "counts_first_and_last_legs")}
    assert told == {"capture_mode": mode, "spp": 16, "seed": 1, "counts_first_and_last_legs": 0}
    legs = quiet(mode, 1, account_first_and_last_bounces=True)
    assert legs.attrs["counts_first_and_last_legs"] == 1


@pytest.mark.statistical
def test_capture_with_a_camera():
    to_world = mi.ScalarTransform4f().rotate([0, 1, 0], 25)
    eye = (-0.5, 0.1, 1.6)
    wall = {k: v for k, v in nlos.relay_wall(SETUP, to_world=to_world).items() if k != "sensor"}
    window = film(2, 2, bins=200, start=4, bin_width=0.02)
    described = nlos.confocal(SETUP, {"hidden": PATCH.shape()}, account_first_and_last_bounces=True)
    described |= {"relay_wall": wall, "sensor": camera(eye, (0, 0, 0), window, fov=1)}
    data = capture(described, mode="confocal", spp=1 << 15)
    local = data["sensor_grid"].values @ matrix(to_world)[:3, :3]
    assert local[..., 2] == pytest.approx(0, abs=1e-5)
    assert 1e-3 < np.abs(local[..., :2]).max() < 0.03
    normal = matrix(to_world)[:3, 2]
    assert data["sensor_normals"].values == pytest.approx(np.tile(normal, (2, 2, 1)), abs=1e-5)
    assert data["sensor_origin"].values == pytest.approx(eye)
    assert data["laser_origin"].values == pytest.approx(eye)
    setup = nlos.Setup(sensor=eye, normal=normal)
    for seen, row in zip(data["sensor_grid"].values, data["transient"].values, strict=True):
        for point, bins in zip(seen, row, strict=True):
            opl, light = nlos.three_bounces(setup, PATCH.nodes(), 0.7, point, point)
            assert bins[:, 0].sum() == pytest.approx(light.sum(), rel=0.02)
            mean = (bins[:, 0] * data["opl"].values).sum() / bins[:, 0].sum()
            assert mean == pytest.approx(np.average(opl, weights=light), abs=0.003)


def test_grid_changes_the_film():
    data = tofrender.capture(around_the_corner(), mode="single", grid=(5, 4), spp=1, progress=False)
    assert data["transient"].shape[:2] == (4, 5)
    assert data["sensor_grid"].values == pytest.approx(nlos.Grid(5, 4).points(), abs=1e-6)


def unwarped(kind: str, mode: str) -> dict:
    """Return a capture that counts all legs except the leg that `camera_unwarp` excludes."""
    window = film(3, 3, bins=320, start=0.0, bin_width=0.02)
    more = {"camera_unwarp": True, "account_first_and_last_bounces": True}
    hidden = {"hidden": PLATE.shape()}
    if kind == "confocal_transient_path":
        return nlos.confocal(nlos.Setup(sensor=DEVICE), hidden, window, **more)
    setup = nlos.Setup(sensor=DEVICE, laser=LASER)
    return nlos.single(setup, hidden, LIT, window, capture_type=mode, **more)


@pytest.mark.parametrize(
    ("kind", "mode", "spp"),
    [
        ("confocal_transient_path", "confocal", 1024),
        ("transient_nlos_path", "confocal", 1024),
        ("transient_nlos_path", "single", 256),
        ("transient_nlos_path", "exhaustive", 256),
    ],
)
def test_legs_are_what_the_lengths_count(kind, mode, spp):
    data = without_first_and_last_legs(capture(unwarped(kind, mode), mode=mode, spp=spp))
    points = nlos.Grid(3, 3).points()
    r, r_lit = (np.linalg.norm(p - np.asarray(PLATE.center), axis=-1) for p in (points, LIT))
    expected = {"confocal": 2 * r, "single": r_lit + r, "exhaustive": np.add.outer(r, r)}[mode]
    values = data["transient"].values[..., 1].astype(float)
    assert (values.sum(axis=-1) > 0).all()
    arrived = (values * data["opl"].values).sum(axis=-1) / values.sum(axis=-1)
    assert arrived == pytest.approx(expected, abs=0.01)
