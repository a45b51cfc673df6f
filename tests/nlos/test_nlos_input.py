"""Errors of captures in one line, and shapes that are never confused silently."""

import gc
import math
import re
from collections.abc import Callable

import mitsuba as mi
import numpy as np
import pytest
from helpers.confocal import lit_by, projector, spots
from helpers.parts import diffuse, point_light
from helpers.support import agree, camera, film, over_seeds, rendered
from oracles import nlos

import tofrender
from tofrender.nlos import check_capture
from tofrender.nlos.capturing import capture

DEVICE = (-0.6, 0.3, 1.2)
LASER = (-0.8, -0.5, 0.6)
LIT = (-0.3, 0.25, 0.0)
PATCH = {"hidden": nlos.Rectangle.turned((0.35, 0.3, 1.1), 30, 240, half=(0.2, 0.2)).shape()}
WINDOW = {"bins": 60, "start": 0.0, "bin_width": 0.1}


def scan(hidden: dict | None = None, **options) -> dict:
    hidden = PATCH if hidden is None else hidden
    return nlos.confocal(nlos.Setup(sensor=DEVICE), hidden, film(2, 2, **WINDOW), **options)


def shot(hidden: dict | None = None, **options) -> dict:
    hidden = PATCH if hidden is None else hidden
    setup = nlos.Setup(sensor=DEVICE, laser=LASER)
    return nlos.single(setup, hidden, LIT, film(2, 2, **WINDOW), **options)


def by_camera(described: dict, fov: float = 20, **wall) -> dict:
    """Return the same scene with a camera, and without a sensor on the wall."""
    plain = {k: v for k, v in described["relay_wall"].items() if k != "sensor"}
    eye = camera(DEVICE, (0, 0, 0), film(4, 4, **WINDOW), fov=fov)
    return described | {"relay_wall": plain | wall, "sensor": eye}


def refusal(described: dict) -> str:
    """Return the error message for a scene, when it is loaded, rendered or captured."""
    with pytest.raises((ValueError, TypeError)) as error:
        tofrender.render(nlos.load_nlos(described), spp=4, progress=False)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_the_scenes_are_right_otherwise():
    for described in (scan(), shot(), by_camera(scan()), by_camera(shot())):
        assert rendered(nlos.load_nlos(described), spp=256)[0].max() > 0


@pytest.mark.parametrize(
    ("described", "name", "values"),
    [
        (scan, "power", [0, -1.0, math.inf]),
        # Eight of their tangents must fit into the widest projector
        (scan, "spot_sigma", [-0.1, 1.0]),
        (scan, "filter_bounces", [0, -2, True]),
        (shot, "filter_bounces", [0, -2, True]),
        (shot, "capture_type", [0, 4]),
        (scan, "max_depth", [0]),
        (scan, "laser_power", [2.0]),
        (scan, "capture_type", ["confocal"]),
        (shot, "spot_sigma", [0.1]),
        (shot, "nlos_laser_samplin", [True]),
    ],
)
def test_parameters(described, name, values):
    for value in values:
        assert name in refusal(described(**{name: value})), value


def renamed(described: dict, name: str) -> dict:
    """Return the same scene with another id of the wall."""
    return {name if key == "relay_wall" else key: part for key, part in described.items()}


AWAY = {"laser": nlos.spot(LASER, (3.0, 0.0, 0.0))}
IN_THE_WAY = nlos.Rectangle((-0.55, -0.125, 0.3), (0.05, 0, 0), (0, 0.05, 0)).shape()
NO_SHAPE = "the scene has no such shape; must be one of 'relay_wall'"


def two(shapes, **options) -> Callable[[], dict]:
    return lambda: two_plates(hidden_shapes=shapes, **options)


def unlit() -> dict:
    return {k: v for k, v in shot().items() if k != "laser"}


def with_power() -> dict:
    described = lit_by(projector())
    return described | {"integrator": described["integrator"] | {"power": 2.0}}


def unnamed() -> dict:
    return renamed(by_camera(scan(use_nlos_only=True)), "screen")


REFUSED = {
    "no relay wall": (unnamed, "relay_wall.*screen"),
    "unknown wall, confocal": (lambda: scan(relay_wall="wand"), "wand.*hidden"),
    "unknown wall": (lambda: shot(relay_wall="wand"), "wand.*hidden"),
    "unknown second wall": (lambda: scan(relay_wall="relay_wall, wand"), "wand"),
    "nothing hidden, confocal": (lambda: scan({}, use_nlos_only=True), "hidden"),
    "nothing hidden": (lambda: shot({}, use_nlos_only=True), "hidden"),
    "laser misses": (lambda: shot() | AWAY, "laser"),
    "laser hits something else": (lambda: shot(PATCH | {"plate": IN_THE_WAY}), "laser"),
    "two emitters": (lambda: shot() | {"lamp": point_light((0, 0, 1), 1.0)}, "emitter"),
    "no emitter": (unlit, "emitter"),
    "two powers": (with_power, "power"),
    # It would be black, as the laser is turned in thought only
    "no sampling": (lambda: shot(capture_type=2, nlos_laser_sampling=False), "nlos_laser_sampling"),
    "unknown hidden shape": (two("wand"), f"hidden_shapes = 'wand': {NO_SHAPE}"),
    "empty hidden shape": (two(""), f"hidden_shapes = '': {NO_SHAPE}"),
    "hidden wall": (two("relay_wall"), "'relay_wall': this shape is part of the relay wall"),
    "no id": (two(3), "hidden_shapes = 3: must be ids of shapes, separated by commas"),
    "hidden shapes without sampling": (
        two("hidden", nlos_hidden_geometry_sampling=False),
        "hidden_shapes = 'hidden': must be left out without",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_scenes(name):
    described, said = REFUSED[name]
    assert re.search(said, refusal(described()))


BENT = np.eye(4)
BENT[0, 0] = math.nan
FRAMES = [np.diag([1.0, 1, 0, 1]), np.diag([0.0, 0, 0, 1]), np.ones((4, 4)), BENT]
"""Flat, a point, skew to nothing, not finite."""


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("grid_sigma", [0.0, -0.1]),
        ("grid_intensity", [0.0, -1.0, math.nan]),
        ("fov", [0.0, 3.2]),
        ("max_rejection_samples", [0, 65]),
        ("spot_positions", ["0 zero"]),
        ("grid_sigmas", [0.1]),
    ],
)
def test_parameters_of_projectors(name, values):
    for value in values:
        assert name in refusal(lit_by(projector(**{name: value}))), value


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"pulse_type": "histogram"}, "pulse_values"),
        (spots([(0, 0)], [0.1, 0.2], [1]), "spot_sigmas"),
        (spots([(0, 0)], [0.0], [1]), "spot_sigmas"),
        (spots([(0, 0)], [0.1], [-1]), "spot_intensities"),
        (spots([(0, 0, 0)], [0.1], [1]), "spot_positions"),
        *(
            ({"frame": mi.ScalarTransform4f(frame)}, "must be finite, with three axes that span")
            for frame in FRAMES
        ),
    ],
)
def test_projectors(options, said):
    assert said in refusal(lit_by(projector(**options)))


def test_small_frames_are_frames():
    small = mi.ScalarTransform4f(np.diag([1e-4, 1e-4, 1e-4, 1]))
    mi.load_dict(projector(frame=small))


def fixed_projector() -> dict:
    frame = mi.ScalarTransform4f().look_at([0, 0, 1], [0, 0, 0], [0, 1, 0])
    return lit_by(projector(is_confocal=False, frame=frame), PATCH)


def of_copies() -> dict:
    group = {"type": "shapegroup", "plate": {"type": "rectangle"}}
    place = mi.ScalarTransform4f().translate([0, 0, 1]).rotate([0, 1, 0], 180).scale(0.2)
    copy = {"type": "instance", "to_world": place, "group": {"type": "ref", "id": "group"}}
    return scan({"group": group, "copy": copy})


@pytest.mark.parametrize(
    ("described", "options", "said"),
    [
        (scan, {"mode": "single"}, "confocal"),
        (scan, {"mode": "exhaustive"}, "confocal"),
        (lambda: shot() | {"integrator": ORDINARY}, {}, "transient_nlos_path"),
        (lambda: shot() | AWAY, {"mode": "single", "spp": 1}, "laser"),
        (lambda: scan({}), {}, r"\Ascene: hidden geometry is missing"),
        (fixed_projector, {}, r"\Ais_confocal = False: must be True"),
        (of_copies, {"spp": 1}, "hidden_shapes = 'copy': instances are not supported"),
    ],
)
def test_captures(described, options, said):
    with pytest.raises((ValueError, TypeError), match=said) as error:
        capture(described(), progress=False, **options)
    assert "\n" not in str(error.value)
    del error
    gc.collect()  # Dr.Jit asks every shape that exists for points, whatever its scene


def metered(described: dict, **options) -> dict:
    """Return the same scene with options of its capture meter."""
    wall = described["relay_wall"]
    return described | {"relay_wall": wall | {"sensor": wall["sensor"] | options}}


SCENE_MODES = {
    "single": (lambda: shot(capture_type="single"), ["single"]),
    "confocal": (lambda: shot(capture_type=2), ["confocal"]),
    "exhaustive": (lambda: shot(capture_type="exhaustive"), ["exhaustive"]),
    "undecided": (shot, ["confocal", "single", "exhaustive"]),
    "confocal path": (scan, ["confocal"]),
    "confocal meter": (lambda: metered(shot(), confocal=True), ["confocal"]),
    "meter that is not": (lambda: metered(shot(), confocal=False), ["single", "exhaustive"]),
}


@pytest.mark.parametrize("name", SCENE_MODES)
def test_the_scene_decides_the_mode(name):
    """The first mode is the default. Each mode that the scene excludes is an error."""
    described, modes = SCENE_MODES[name]
    options = {"spp": 1, "progress": False}
    assert capture(described(), **options).attrs["capture_mode"] == modes[0]
    for mode in ("single", "confocal", "exhaustive"):
        if mode in modes:
            assert capture(described(), mode=mode, **options).attrs["capture_mode"] == mode
        else:
            with pytest.raises(ValueError, match=rf"\Amode = '{mode}': .*'{modes[0]}'.*\Z"):
                capture(described(), mode=mode, **options)


ORDINARY = {"type": "tofrender_transient_path"}


@pytest.mark.parametrize("mode", ["single", "confocal", "exhaustive"])
def test_pixels_beside_the_wall(mode):
    described = by_camera(shot(nlos_hidden_geometry_sampling=True), fov=120)
    with pytest.warns(UserWarning, match=r"\Asensor: 12 of 16 pixels do not look at .* dark.*\Z"):
        data = capture(described, mode=mode, spp=64, progress=False)
    check_capture(data)
    on_wall = np.zeros((4, 4), bool)
    on_wall[1:3, 1:3] = True
    assert np.array_equal(data["on_wall"].values, on_wall)
    light = data["transient"].sum(("opl", "channel")).transpose("y", "x", ...).values
    assert np.isfinite(light).all()
    assert np.all(light[~on_wall] == 0)
    assert (light[on_wall].reshape(4, -1).sum(axis=1) > 0).sum() >= 3
    if mode == "exhaustive":
        lit = np.moveaxis(light, (2, 3), (0, 1))
        assert np.all(lit[~on_wall] == 0)
        assert lit[on_wall].sum() > 0
    # The points of the others continue the wall: all on its plane, in rows and columns
    grid, normals = data["sensor_grid"].values, data["sensor_normals"].values
    assert np.isfinite(grid).all()
    assert normals == pytest.approx(np.broadcast_to([0, 0, 1], grid.shape), abs=1e-5)
    towards = (grid - DEVICE) @ (np.array(DEVICE) / -np.linalg.norm(DEVICE))
    ahead = towards > 0
    assert ahead.sum() > 4
    assert grid[..., 2] == pytest.approx(0, abs=1e-4)
    away = by_camera(shot(), fov=1)
    away["relay_wall"]["to_world"] = mi.ScalarTransform4f().translate([9, 0, 0])
    with pytest.raises(ValueError, match=r"\A.*0 of 16 pixels look at the relay wall.*\Z"):
        capture(away, mode=mode, spp=1, progress=False)


def test_scans_do_not_care_where_the_laser_looks():
    for mode in ("confocal", "exhaustive"):
        data = capture(shot() | AWAY, mode=mode, spp=16, progress=False)
        assert data["transient"].max() > 0, mode


@pytest.mark.parametrize("spot_sigma", [0.0, 0.02])
def test_rays_that_miss_are_black(spot_sigma):
    small = mi.ScalarTransform4f().scale([0.4, 0.4, 1])
    described = by_camera(scan(spot_sigma=spot_sigma, filter_bounces=-1), 90, to_world=small)
    steady, transient = rendered(nlos.load_nlos(described), spp=64)
    assert np.isfinite(steady).all()
    assert np.isfinite(transient).all()
    assert np.all(steady[[0, 0, -1, -1], [0, -1, 0, -1]] == 0)
    assert steady.max() > 0


def alike() -> dict:
    """Return wall and hidden patch of the same material. A default load merges their meshes."""
    return by_camera(scan(use_nlos_only=True), bsdf=diffuse(0.7))


@pytest.mark.parametrize("nlos_only", [True, False])
def test_a_default_load_is_right_or_refused(nlos_only):
    described = alike()
    described["integrator"] = described["integrator"] | {"use_nlos_only": nlos_only}
    merged = tofrender.load_scene(described)
    assert len(merged.shapes()) == 1
    apart = rendered(nlos.load_nlos(described), spp=1 << 12)[0]
    data = capture(described, mode="confocal", spp=64, progress=False)  # Loads shapes apart
    assert data["transient"].max() > 0
    assert data["sensor_grid"].values[..., 2] == pytest.approx(0, abs=1e-5)
    if nlos_only:
        assert apart.max() > 0
        with pytest.raises(ValueError, match=r"^[^\n]*optimize=False[^\n]*$"):
            tofrender.render(merged, spp=1, progress=False)
    else:
        found = tofrender.render(merged, spp=1 << 15, progress=False)["steady"].values
        assert found.sum() == pytest.approx(apart.sum(), rel=0.05)


def test_named_walls_of_a_meter():
    described = scan(use_nlos_only=True)
    described["anything"] = described.pop("relay_wall")
    assert rendered(nlos.load_nlos(described), spp=64)[0].max() > 0


PLATES = {
    "hidden": nlos.Rectangle.turned((0.35, 0.3, 1.1), 30, 240, half=(0.2, 0.2)),
    "other": nlos.Rectangle.turned((-0.4, -0.3, 0.9), 20, 30, half=(0.2, 0.2)),
}


def aims(loaded: mi.Scene) -> list[mi.Shape]:
    """Return the target shapes of hidden-geometry sampling."""
    return loaded.integrator().plan(loaded, loaded.sensors()[0]).scattering.targets.shapes


def two_plates(**options) -> dict:
    return scan({name: plate.shape() for name, plate in PLATES.items()}, **options)


@pytest.mark.statistical
@pytest.mark.parametrize("value", ["hidden", "other", "hidden, other"])
def test_hidden_shapes_change_the_noise_alone(value):
    setup, points = nlos.Setup(sensor=DEVICE), nlos.Grid(2, 2).points().reshape(4, 3)
    expected = sum(nlos.total(setup, p.nodes(), 0.7, w, w) for p in PLATES.values() for w in points)
    loaded = nlos.load_nlos(two_plates(hidden_shapes=value))
    found = over_seeds(lambda seed: nlos.estimates(loaded, 1 << 14)(seed).sum(), range(12))
    assert agree(found, np.array(expected), rounding=1e-3)
    assert not agree(1.1 * found, np.array(expected), rounding=1e-3)
    names = [shape.id() for shape in aims(loaded)]
    assert names == value.split(", ")
    by_list = nlos.load_nlos(two_plates())
    by_list.integrator().hidden_shapes = [s for s in by_list.shapes() if s.id() in names]
    assert rendered(by_list, spp=64)[0] == pytest.approx(rendered(loaded, spp=64)[0], rel=1e-4)


def test_nothing_says_which_shape_is_the_wall():
    described = by_camera(shot(), fov=120)
    described["screen"] = described.pop("relay_wall")
    described["plate"] = nlos.Rectangle((3.0, 0, -0.5), (4.0, 0, 0), (0, 8.0, 0)).shape()
    with pytest.raises(ValueError, match=r"\Arelay_wall: the wall is unknown.* sensor sees .*\Z"):
        capture(described, progress=False)
    with pytest.warns(UserWarning, match="do not look"):
        data = capture(described, relay_wall="screen", spp=4096, progress=False)
    assert data["transient"].sum() > 0
