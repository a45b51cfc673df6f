"""What captures refuse, each in one line, and that shapes are never mixed up in silence."""

from __future__ import annotations

import math

import mitsuba as mi
import numpy as np
import pytest
from nlos_oracles import Rectangle, Setup, confocal, load_nlos, single, spot
from support import camera, diffuse, film, point_light, rendered
from test_projector import lit_by, projector, spots

import tofrender
from tofrender.nlos.capturing import capture
from tofrender.relay_wall import find_relay_wall, is_on_relay_wall

DEVICE = (-0.6, 0.3, 1.2)
LASER = (-0.8, -0.5, 0.6)
LIT = (-0.3, 0.25, 0.0)
PATCH = {"hidden": Rectangle.turned((0.35, 0.3, 1.1), 30, 240, half=(0.2, 0.2)).shape()}
WINDOW = {"bins": 60, "start": 0.0, "bin_width": 0.1}


def scan(hidden: dict | None = None, **options) -> dict:
    hidden = PATCH if hidden is None else hidden
    return confocal(Setup(sensor=DEVICE), hidden, film(2, 2, **WINDOW), **options)


def shot(hidden: dict | None = None, **options) -> dict:
    hidden = PATCH if hidden is None else hidden
    setup = Setup(sensor=DEVICE, laser=LASER)
    return single(setup, hidden, LIT, film(2, 2, **WINDOW), **options)


def by_camera(described: dict, fov: float = 20, **wall) -> dict:
    """The same with a camera; the wall has no sensor."""
    plain = {k: v for k, v in described["relay_wall"].items() if k != "sensor"}
    eye = camera(DEVICE, (0, 0, 0), film(4, 4, **WINDOW), fov=fov)
    return described | {"relay_wall": plain | wall, "sensor": eye}


def refusal(described: dict) -> str:
    """What is said of a scene, whether it is loaded, rendered or captured."""
    with pytest.raises((ValueError, TypeError)) as error:
        tofrender.render(load_nlos(described), spp=4, progress=False)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_the_scenes_are_right_otherwise():
    for described in (scan(), shot(), by_camera(scan()), by_camera(shot())):
        steady, _ = rendered(load_nlos(described), spp=256)
        assert steady.max() > 0


# ------------------------------------------------------------------------------------ numbers


@pytest.mark.parametrize("value", [0, 0.0, -1.0, math.nan, math.inf, "much"])
def test_power(value):
    assert "power" in refusal(scan(power=value))


@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf, 1.0])
def test_spot_sigma(value):
    """Eight of them must be less than a right angle."""
    assert "spot_sigma" in refusal(scan(spot_sigma=value))


@pytest.mark.parametrize("value", [0, -2, 1.5, True, "three"])
@pytest.mark.parametrize("described", [scan, shot])
def test_filter_bounces(described, value):
    assert "filter_bounces" in refusal(described(filter_bounces=value))


@pytest.mark.parametrize("value", ["foo", 0, 4, "", 1.5])
def test_capture_type(value):
    assert "capture_type" in refusal(shot(capture_type=value))


@pytest.mark.parametrize(
    ("described", "options"),
    [
        (scan, {"max_depth": 0}),
        (scan, {"use_nlos_only": "yes"}),
        (scan, {"nlos_hidden_geometry_sampling": 2}),
        (scan, {"account_first_and_last_bounces": 1.5}),
        (shot, {"nlos_laser_sampling": "on"}),
        (shot, {"nlos_hidden_geometry_sampling_do_rroulette": 7}),
        (shot, {"relay_wall": 5}),
        (scan, {"laser_power": 2.0}),
        (scan, {"capture_type": "confocal"}),
        (shot, {"spot_sigma": 0.1}),
        (shot, {"nlos_laser_samplin": True}),
    ],
)
def test_other_parameters(described, options):
    assert next(iter(options)) in refusal(described(**options))


# --------------------------------------------------------------------------------- wall, laser


def test_no_relay_wall():
    described = by_camera(scan(use_nlos_only=True))
    described["screen"] = described.pop("relay_wall")
    said = refusal(described)
    assert "relay_wall" in said
    assert "screen" in said


@pytest.mark.parametrize("described", [scan, shot])
def test_unknown_relay_wall(described):
    said = refusal(described(relay_wall="wand"))
    assert "wand" in said
    assert "hidden" in said


def test_unknown_second_wall():
    assert "wand" in refusal(scan(relay_wall="relay_wall, wand"))


@pytest.mark.parametrize("described", [scan, shot])
def test_nothing_is_hidden(described):
    assert "hidden" in refusal(described({}, use_nlos_only=True))


def test_laser_misses():
    away = shot() | {"laser": spot(LASER, (3.0, 0.0, 0.0))}
    assert "laser" in refusal(away)
    in_the_way = Rectangle((-0.55, -0.125, 0.3), (0.05, 0, 0), (0, 0.05, 0)).shape()
    assert "laser" in refusal(shot(PATCH | {"in_the_way": in_the_way}))


def test_number_of_emitters():
    two = shot() | {"lamp": point_light((0, 0, 1), 1.0)}
    assert "emitter" in refusal(two)
    none = shot()
    del none["laser"]
    assert "emitter" in refusal(none) or "light" in refusal(none)


def test_confocal_capture_needs_laser_sampling():
    """It would be black, as the laser is turned in thought only."""
    assert "nlos_laser_sampling" in refusal(shot(capture_type=2, nlos_laser_sampling=False))


# ------------------------------------------------------------------------------- projectors


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"grid_rows": 0}, "grid_rows"),
        ({"grid_cols": -1}, "grid_cols"),
        ({"grid_sigma": 0.0}, "grid_sigma"),
        ({"grid_sigma": -0.1}, "grid_sigma"),
        ({"grid_intensity": 0.0}, "grid_intensity"),
        ({"grid_intensity": -1.0}, "grid_intensity"),
        ({"grid_intensity": math.nan}, "grid_intensity"),
        ({"grid_spacing": "dense"}, "grid_spacing"),
        ({"fov": 0.0}, "fov"),
        ({"fov": 3.2}, "fov"),
        ({"max_rejection_samples": 0}, "max_rejection_samples"),
        ({"max_rejection_samples": 65}, "max_rejection_samples"),
        ({"pulse_type": "square"}, "pulse_type"),
        ({"pulse_width_opl": -0.1}, "pulse_width_opl"),
        ({"pulse_type": "histogram"}, "pulse_values"),
        (spots([(0, 0)], [0.1, 0.2], [1]), "spot_sigmas"),
        (spots([(0, 0)], [0.0], [1]), "spot_sigmas"),
        (spots([(0, 0)], [0.1], [-1]), "spot_intensities"),
        (spots([(0, 0, 0)], [0.1], [1]), "spot_positions"),
        ({"spot_positions": "0 zero"}, "spot_positions"),
        ({"grid_sigmas": 0.1}, "grid_sigmas"),
    ],
)
def test_bad_projectors(options, word):
    assert word in refusal(lit_by(projector(**options)))


def test_projector_with_power_too():
    described = lit_by(projector())
    described["integrator"]["power"] = 2.0
    assert "power" in refusal(described)


# ------------------------------------------------------------------------------------ captures


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"mode": "foo"}, "mode"),
        ({"mode": 3}, "mode"),
        ({"grid": (0, 4)}, "grid"),
        ({"grid": (4,)}, "grid"),
        ({"grid": "4x4"}, "grid"),
        ({"grid": (4.5, 4)}, "grid"),
        ({"spp": 0}, "spp"),
        ({"sensor": 1}, "sensor"),
        ({"seed": -1}, "seed"),
    ],
)
def test_capture_arguments(options, word):
    with pytest.raises(ValueError, match=word) as error:
        capture(shot(), progress=False, **options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("mode", ["single", "exhaustive"])
def test_modes_of_a_confocal_integrator(mode):
    with pytest.raises(ValueError, match="confocal") as error:
        capture(scan(), mode=mode, progress=False)
    assert "\n" not in str(error.value)


def test_capture_with_an_ordinary_integrator():
    described = shot() | {"integrator": {"type": "tofrender_transient_path"}}
    with pytest.raises((ValueError, TypeError), match="transient_nlos_path") as error:
        capture(described, progress=False)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("mode", ["single", "confocal", "exhaustive"])
def test_pixels_beside_the_wall(mode):
    with pytest.raises(ValueError, match="pixel") as error:
        capture(by_camera(shot(), fov=120), mode=mode, spp=1, progress=False)
    assert "\n" not in str(error.value)


def test_capture_whose_laser_misses():
    described = shot() | {"laser": spot(LASER, (3.0, 0.0, 0.0))}
    with pytest.raises(ValueError, match="laser") as error:
        capture(described, mode="single", spp=1, progress=False)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("mode", ["confocal", "exhaustive"])
def test_scans_do_not_care_where_the_laser_looks(mode):
    described = shot() | {"laser": spot(LASER, (3.0, 0.0, 0.0))}
    assert capture(described, mode=mode, spp=16, progress=False)["transient"].max() > 0


@pytest.mark.parametrize("spot_sigma", [0.0, 0.02])
def test_rays_that_miss_are_black(spot_sigma):
    """A small wall in a wide view; also rays that meet the hidden patch instead."""
    small = mi.ScalarTransform4f().scale([0.4, 0.4, 1])
    described = by_camera(scan(spot_sigma=spot_sigma, filter_bounces=-1), 90, to_world=small)
    steady, transient = rendered(load_nlos(described), spp=64)
    assert np.isfinite(steady).all()
    assert np.isfinite(transient).all()
    assert np.all(steady[[0, 0, -1, -1], [0, -1, 0, -1]] == 0)
    assert steady.max() > 0


# ------------------------------------------------------------------------------------ identity


def alike() -> dict:
    """Wall and hidden patch of one material: meshes that a default load makes one."""
    return by_camera(scan(use_nlos_only=True), bsdf=diffuse(0.7))


def test_load_without_optimization_keeps_shapes_apart():
    loaded = load_nlos(alike())
    wall = find_relay_wall(loaded)
    rays = mi.Ray3f(mi.Point3f([0, 0.35], [0, 0.3], 0.2), mi.Vector3f([0, 0], [0, 0], [-1, 1]))
    assert np.array(is_on_relay_wall(loaded.ray_intersect(rays), wall)).tolist() == [True, False]
    assert rendered(loaded, spp=256)[0].max() > 0


@pytest.mark.parametrize("nlos_only", [True, False])
def test_a_default_load_is_right_or_refused(nlos_only):
    described = alike()
    described["integrator"] = described["integrator"] | {"use_nlos_only": nlos_only}
    merged = tofrender.load_scene(described)
    assert len(merged.shapes()) == 1
    apart = rendered(load_nlos(described), spp=1 << 12)[0]
    if nlos_only:
        with pytest.raises(ValueError, match=r"^[^\n]*optimize=False[^\n]*$"):
            tofrender.render(merged, spp=1, progress=False)
    else:
        found = tofrender.render(merged, spp=1 << 15, progress=False)["steady"].values
        assert found.sum() == pytest.approx(apart.sum(), rel=0.05)


def test_capture_loads_shapes_apart():
    """From a dict, without a word of how to load it."""
    described = alike()
    described["integrator"] = described["integrator"] | {"use_nlos_only": False}
    data = capture(described, mode="confocal", spp=64, progress=False)
    assert data["transient"].max() > 0
    assert data["sensor_grid"].values[..., 2] == pytest.approx(0, abs=1e-5)


def test_named_walls_of_a_meter():
    """The wall is the shape that the meter is a child of, whatever it is called."""
    described = scan(use_nlos_only=True)
    described["anything"] = described.pop("relay_wall")
    assert rendered(load_nlos(described), spp=64)[0].max() > 0
