"""What a capture says of its lengths, and what it leaves behind of its laser."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from helpers.support import camera, film
from oracles.nlos import Grid, Rectangle, Setup, confocal, load_nlos, single

import tofrender
from tofrender.nlos import without_first_and_last_legs

DEVICE, LASER, LIT = (-0.6, 0.3, 1.2), (-0.8, -0.5, 0.6), (-0.3, 0.25, 0.0)
DEPTH = 1.0
PATCH = Rectangle((0.0, 0.0, DEPTH), (-0.05, 0, 0), (0, 0.05, 0))


def capture(described: dict, **options):
    return tofrender.capture(load_nlos(described), progress=False, **options)


# ------------------------------------------------------------------------------------- lengths

KINDS = ["confocal_transient_path", "transient_nlos_path"]


def unwarped(kind: str, mode: str = "confocal", **options) -> dict:
    """The legs count, but for the one that `camera_unwarp` leaves out."""
    window = film(3, 3, bins=320, start=0.0, bin_width=0.02)
    more = {"camera_unwarp": True, "account_first_and_last_bounces": True} | options
    hidden = {"hidden": PATCH.shape()}
    if kind == "confocal_transient_path":
        return confocal(Setup(sensor=DEVICE), hidden, window, **more)
    setup = Setup(sensor=DEVICE, laser=LASER)
    return single(setup, hidden, LIT, window, capture_type=mode, **more)


def arrival(data) -> np.ndarray:
    """Mean length of each pixel's light [m], (y, x)."""
    values = data["transient"].values[..., 1].astype(float)
    assert (values.sum(axis=-1) > 0).all()
    return (values * data["opl"].values).sum(axis=-1) / values.sum(axis=-1)


@pytest.mark.parametrize("kind", KINDS)
def test_legs_are_what_the_lengths_count(kind):
    """Without its legs, a confocal capture's light is 2 r from wall to patch."""
    data = capture(unwarped(kind), mode="confocal", spp=1024)
    bare = without_first_and_last_legs(data)
    r = np.linalg.norm(Grid(3, 3).points() - np.array([0, 0, DEPTH]), axis=-1)
    assert arrival(bare) == pytest.approx(2 * r, abs=0.01)


@pytest.mark.parametrize("mode", ["single", "exhaustive"])
def test_only_the_lasers_leg_counts(mode):
    """With the camera's leg left out, lengths hold laser to wall, wall to patch to wall."""
    data = capture(unwarped("transient_nlos_path", "single"), mode=mode, spp=256)
    bare = without_first_and_last_legs(data)
    points = Grid(3, 3).points()
    r = np.linalg.norm(points - np.array([0, 0, DEPTH]), axis=-1)
    lit = points if mode == "exhaustive" else np.array([[LIT]])
    r_lit = np.linalg.norm(lit - np.array([0, 0, DEPTH]), axis=-1)
    expected = r_lit[:, :, None, None] + r if mode == "exhaustive" else r_lit + r
    assert arrival(bare) == pytest.approx(expected, abs=0.01)


def test_reconstruction_of_an_unwarped_capture():
    """A plate at 1 m is found there, not at .57 m."""
    plate = Rectangle((0.0, 0.0, DEPTH), (-0.3, 0, 0), (0, 0.3, 0))
    described = unwarped("confocal_transient_path") | {"hidden": plate.shape()}
    described["relay_wall"]["sensor"]["film"] |= {"width": 16, "height": 16}
    data = capture(described, mode="confocal", spp=64)
    volume = ((-0.5, 0.5, 12), (-0.5, 0.5, 12), (0.3, 1.4, 44))
    found = tofrender.reconstruct(data, "fbp", volume=volume, progress=False)["intensity"]
    place = found.where(found == found.max(), drop=True)
    assert float(place["z"][0]) == pytest.approx(DEPTH, abs=0.06)


# -------------------------------------------------------------------------------------- lasers


def looks(loaded: mi.Scene) -> np.ndarray:
    return np.array(mi.traverse(loaded)["laser.to_world"].matrix, dtype=float).reshape(4, 4)


def around(window: dict, **options) -> mi.Scene:
    setup = Setup(sensor=DEVICE, laser=LASER, legs=False)
    return load_nlos(single(setup, {"hidden": PATCH.shape()}, LIT, window, **options))


CROP = {"crop_width": 3, "crop_height": 2, "crop_offset_x": 2, "crop_offset_y": 1}


@pytest.mark.parametrize("pixel", [(2, 1), (4, 2), (3, 1)])
def test_focus_on_a_pixel_of_a_camera_with_a_crop(pixel):
    """Pixels have their numbers in the whole film, as those of `nlos_capture_meter` have."""
    points = []
    for crop in ({}, CROP):
        setup = Setup(sensor=DEVICE, laser=LASER, legs=False)
        described = single(setup, {"hidden": PATCH.shape()}, LIT, film())
        described["relay_wall"].pop("sensor")
        described["sensor"] = camera((0.2, 0.1, 1.5), (0, 0, 0), film(7, 5, **crop), fov=40)
        loaded = load_nlos(described)
        points.append(tofrender.focus_laser(loaded, pixel=pixel))
        target = looks(loaded)[:3, 3] + np.linalg.norm(points[-1] - LASER) * looks(loaded)[:3, 2]
        assert target == pytest.approx(points[-1], abs=1e-5)
    assert points[1] == pytest.approx(points[0], abs=1e-5)


def test_focus_on_a_pixel_that_sees_nothing_is_refused():
    setup = Setup(sensor=DEVICE, laser=LASER, legs=False)
    described = single(setup, {"hidden": PATCH.shape()}, LIT, film())
    described["relay_wall"].pop("sensor")
    described["sensor"] = camera((0.2, 0.1, 1.5), (0.2, 0.1, 3), film(7, 5), fov=40)
    loaded = load_nlos(described)
    before = looks(loaded)
    with pytest.raises(
        ValueError, match=r"^pixel = \(3, 2\): sees nothing; must be one that"
    ) as error:
        tofrender.focus_laser(loaded, pixel=(3, 2))
    assert "\n" not in str(error.value)
    assert (looks(loaded) == before).all()


@pytest.mark.parametrize("package", [tofrender, tofrender.nlos])
def test_peers_way_to_turn_a_laser_is_refused_by_name(package):
    with pytest.raises(AttributeError, match=r"use focus_laser\(scene, pixel=\(x, y\)\)$") as error:
        _ = package.focus_emitter_at_relay_wall_pixel
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("pixel", [(2, 1), (4, 2)])
def test_focus_on_a_pixel_of_a_meter_with_a_crop(pixel):
    whole, part = (around(film(7, 5, **crop)) for crop in ({}, CROP))
    points = [tofrender.focus_laser(loaded, pixel=pixel) for loaded in (whole, part)]
    assert points[0] == pytest.approx(Grid(7, 5).point(*pixel), abs=1e-6)
    assert points[1] == pytest.approx(points[0], abs=1e-6)


def test_an_exhaustive_capture_leaves_the_laser_as_it_was():
    loaded = around(film(2, 2, bins=4, bin_width=1.0))
    before = looks(loaded)
    tofrender.capture(loaded, mode="exhaustive", spp=1, progress=False)
    np.testing.assert_array_equal(looks(loaded), before)


def test_an_interrupted_capture_leaves_the_laser_as_it_was(monkeypatch):
    loaded = around(film(2, 2, bins=4, bin_width=1.0))
    before, camera_of = looks(loaded), loaded.sensors()[0]
    count = []

    def interrupt(*args, **options):
        count.append(0)
        if len(count) > 2:
            raise KeyboardInterrupt
        return original(*args, **options)

    original = type(camera_of).sample_ray_differential
    monkeypatch.setattr(type(camera_of), "sample_ray_differential", interrupt)
    with pytest.raises(KeyboardInterrupt):
        tofrender.capture(loaded, mode="exhaustive", spp=1, progress=False)
    np.testing.assert_array_equal(looks(loaded), before)


def test_other_captures_leave_the_laser_as_it_was():
    for mode in ("single", "confocal"):
        loaded = around(film(2, 2, bins=4, bin_width=1.0))
        before = looks(loaded)
        tofrender.capture(loaded, mode=mode, spp=1, progress=False)
        np.testing.assert_array_equal(looks(loaded), before)
