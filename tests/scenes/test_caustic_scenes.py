"""Scenes whose light hardly finds the camera: files, gaps and leaks, windows, what one sees."""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.support import parsed, require_equal, with_film, with_integrator
from scipy import ndimage

import tofrender
from tofrender.scenes import BUILT_IN, describe
from tofrender.scenes.caustics import HOLE_CENTER, MAX_HOLE_WIDTH, MAX_LAMP_RADIUS, WITH_DEPTH

FOLDER = Path(__file__).parents[2] / "scenes" / "caustics"
GLASS = ["caustic", "mirror_and_glass"]
ROOMS = ["lamp_in_fixture", "light_through_hole"]
ALL = [*GLASS, *ROOMS]
LANES = 1 << 18


def load(described: dict) -> mi.Scene:
    return tofrender.load_scene(described, optimize=False)


def from_the_lamp(described: dict, spp: int = 100) -> np.ndarray:
    """Mitsuba's `ptracer`, whose paths start at the lamp: float64 (64, 64, 3)."""
    steady = {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    sensor = described["sensor"] | {"film": steady, "sampler": {"type": "independent"}}
    integrator = described["integrator"] | {"type": "ptracer"}
    scene = mi.load_dict(described | {"sensor": sensor, "integrator": integrator})
    return np.array(mi.render(scene, spp=spp, seed=0), dtype=np.float64)


def seen(described: dict, name: str) -> np.ndarray:
    """Which of 64 x 64 pixels see the shape `name` at their center."""
    scene = load(described)
    index = dr.arange(mi.UInt32, 64 * 64)
    at = mi.Point2f((index % 64 + 0.5) / 64, (index // 64 + 0.5) / 64)
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, at, 0.5)
    (shape,) = (each for each in scene.shapes() if each.id() == name)
    return np.array(scene.ray_intersect(ray).shape == mi.ShapePtr(shape)).reshape(64, 64)


def random_directions(lanes: int, seed: int) -> mi.Vector3f:
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, lanes)
    return mi.warp.square_to_uniform_sphere(sampler.next_2d())


# ------------------------------------------------------------------------------------- files


def test_every_scene_has_a_file():
    assert {path.stem for path in FOLDER.glob("*.xml")} == set(ALL)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    "changes", [{}, {"width": 7, "spp": 3, "start_opl": 1.5, "integrator": "path_tracer_nee"}]
)
def test_xml_is_the_dict(name, changes):
    described = BUILT_IN[name](**changes)
    require_equal(parsed(FOLDER / f"{name}.xml", **changes), parsed(described))


@pytest.mark.parametrize("name", ALL)
def test_first_line_of_the_file_is_the_description(name):
    lines = (FOLDER / f"{name}.xml").read_text(encoding="utf-8").splitlines()
    assert lines[2].strip() == describe(name)
    assert len(describe(name)) <= 72


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral"])
def test_every_scene_renders_under_every_variant(variant):
    mi.set_variant(variant)
    for name in ALL:
        for source in (name, FOLDER / f"{name}.xml"):
            scene = tofrender.load_scene(source, width=8, height=8, temporal_bins=4)
            assert len(scene.emitters()) == 1
            steady, transient = (np.array(each) for each in mi.render(scene, spp=16))
            assert np.isfinite(steady).all()
            assert np.isfinite(transient).all()
            assert steady.max() > 0


@pytest.mark.parametrize("integrator", WITH_DEPTH)
@pytest.mark.parametrize("name", ALL)
def test_integrators_have_the_depth_that_is_given(name, integrator):
    scene = load(BUILT_IN[name](integrator=integrator, max_depth=3, width=4, height=4))
    assert scene.integrator().max_depth == 3
    assert np.isfinite(np.array(mi.render(scene, spp=1)[0])).all()


# ---------------------------------------------------------------------------- gaps and leaks


@pytest.mark.parametrize("name", GLASS)
def test_glass_is_a_closed_sphere_away_from_all_else(name):
    """The nearest that is seen from the sphere's surface, straight away from its center."""
    described = BUILT_IN[name](lamp_radius=MAX_LAMP_RADIUS)
    assert described["glass"] == {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    glass = described["glass-sphere"]
    del described["glass-sphere"]
    direction = random_directions(LANES, 0)
    start = mi.Point3f(glass["center"]) + direction * glass["radius"]
    scene = load(described)
    outwards = scene.ray_intersect(mi.Ray3f(start, direction))
    assert 0.03 < dr.min(outwards.t)[0] < 0.06
    inwards = mi.Ray3f(start, -direction)
    inwards.maxt = 2 * glass["radius"]
    assert not dr.any(scene.ray_test(inwards))


@pytest.mark.parametrize("name", ROOMS)
def test_rooms_are_closed_and_their_surfaces_face_in(name):
    """From the camera on, by way of what is hit, to points all over the room.

    One ray in a million starts below a wall's edge, by rounding, and sees the next wall's black
    back.
    """
    scene = load(BUILT_IN[name]())
    two_sided = [mi.ShapePtr(each) for each in scene.shapes() if each.id().startswith("housing")]
    origin = dr.zeros(mi.Point3f, LANES) + scene.sensors()[0].world_transform() @ mi.Point3f(0)
    ray = mi.Ray3f(origin, random_directions(LANES, 0))
    backs = 0
    for seed in range(1, 6):
        hit = scene.ray_intersect(ray)
        assert dr.all(hit.is_valid())
        back = dr.dot(hit.n, ray.d) >= 0
        for shape in two_sided:
            back &= hit.shape != shape
        backs += dr.count(back)[0]
        direction = random_directions(LANES, seed)
        ray = hit.spawn_ray(dr.select(dr.dot(direction, hit.n) > 0, direction, -direction))
    assert backs <= 3


@pytest.mark.parametrize("width", [0.05, 0.2, MAX_HOLE_WIDTH])
def test_light_comes_through_the_hole_only(width):
    described = BUILT_IN["light_through_hole"](hole_width=width)
    assert from_the_lamp(described).mean() > 0
    plug = mi.ScalarTransform4f().translate(HOLE_CENTER).scale(width / 2 + 1e-3)
    black = {"type": "ref", "id": "black"}
    closed = described | {"plug": {"type": "cube", "to_world": plug, "bsdf": black}}
    assert from_the_lamp(closed).max() == 0


def test_light_leaves_the_fixture_at_its_top_only():
    """But for the few paths whose vertex is on an edge, where rounding puts it outside."""
    described = BUILT_IN["lamp_in_fixture"]()
    open_top = from_the_lamp(described)
    assert open_top.mean() > 0.1
    (x, top, z), radius = described["housing"]["p1"], described["housing"]["radius"]
    lid = mi.ScalarTransform4f().translate([x, top, z]).scale([radius + 0.01, 0.01, radius + 0.01])
    black = {"type": "ref", "id": "black"}
    closed = described | {"lid": {"type": "cube", "to_world": lid, "bsdf": black}}
    assert from_the_lamp(closed).mean() < 1e-6 * open_top.mean()


# ----------------------------------------------------------------------------------- windows


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, {}) for name in ALL),
        *((name, {"lamp_radius": MAX_LAMP_RADIUS}) for name in GLASS),
        ("light_through_hole", {"hole_width": MAX_HOLE_WIDTH}),
    ],
)
def test_windows_start_a_little_before_the_first_light(name, options):
    described = BUILT_IN[name](width=32, height=32, **options)
    film = described["sensor"]["film"]
    start = film["start_opl"]
    bins = {"temporal_bins": 2, "start_opl": start - 10, "bin_width_opl": 10.0}
    before, after = bins_of(with_film(described, **bins), spp=256)
    assert before == 0
    assert after > 0
    bins |= {"start_opl": start, "bin_width_opl": 0.4}
    assert bins_of(with_film(described, **bins), spp=256)[0] > 0


@pytest.mark.parametrize("name", ALL)
def test_windows_end_when_most_light_has_come(name):
    """Of the light that is not the lamp itself, as seen by the camera, or in glass."""
    described = with_integrator(BUILT_IN[name](width=32, height=32), hide_emitters=True)
    film = described["sensor"]["film"]
    length = film["temporal_bins"] * film["bin_width_opl"]
    bins = {"temporal_bins": 10, "bin_width_opl": length}
    light = bins_of(with_film(described, **bins), spp=512)
    assert light[0] > 0.85 * light.sum()


def bins_of(described: dict, spp: int) -> np.ndarray:
    """Light of the whole picture in each bin."""
    return np.array(mi.render(load(described), spp=spp, seed=0)[1]).sum(axis=(0, 1, 3))


# ------------------------------------------------------------------------- what is to be seen


def bright_floor(described: dict) -> np.ndarray:
    """Which of 64 x 64 pixels see floor that is four times as bright as its median, or more."""
    light = from_the_lamp(described).mean(axis=2) * seen(described, "floor")
    return light > 4 * np.median(light[light > 0])


def test_the_camera_sees_the_caustic():
    """All of it, in the shadow before the sphere; without the sphere it is not there."""
    described = BUILT_IN["caustic"]()
    labels, _ = ndimage.label(bright_floor(described))
    sizes = np.bincount(labels.ravel())[1:]
    assert sizes.max() > 15
    spot = labels == sizes.argmax() + 1
    rows, columns = np.nonzero(spot)
    assert 50 < rows.min() < rows.max() < 60
    assert 24 < columns.min() < columns.max() < 44
    del described["glass-sphere"]
    assert not (bright_floor(described) & spot).any()


def test_the_mirror_makes_a_second_caustic():
    described = BUILT_IN["mirror_and_glass"]()
    assert ndimage.label(bright_floor(described), np.ones((3, 3)))[1] == 2
    described["mirror-block"]["bsdf"] = {"type": "ref", "id": "white"}
    assert ndimage.label(bright_floor(described), np.ones((3, 3)))[1] == 1


@pytest.mark.parametrize(("name", "share"), [("lamp_in_fixture", 0.7), ("light_through_hole", 0.9)])
def test_most_of_the_picture_has_indirect_light_only(name, share):
    described = BUILT_IN[name]()
    direct = from_the_lamp(with_integrator(described, max_depth=2))
    assert direct.max() > 0
    assert (direct == 0).mean() > share


def test_power_of_the_lamp_does_not_depend_on_its_size():
    for name in GLASS:
        powers = []
        for radius in (0.01, 0.025, MAX_LAMP_RADIUS):
            light = BUILT_IN[name](lamp_radius=radius)["light"]
            assert light["radius"] == radius
            powers.append(radius**2 * np.array(light["emitter"]["radiance"]["value"]))
        np.testing.assert_allclose(powers, [powers[0]] * 3)


# --------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"width": 0}, "width = 0: must be an integer from 1 to 65536"),
        ({"height": 2.5}, "height = 2.5: must be an integer"),
        ({"temporal_bins": 0}, "temporal_bins = 0: must be an integer from 1"),
        ({"start_opl": float("nan")}, "start_opl = nan: must be a finite number of metres"),
        ({"bin_width_opl": 0}, "bin_width_opl = 0: must be a finite number of metres above 0"),
        ({"spp": 0}, "spp = 0: must be an integer from 1 to 16777216"),
        ({"max_depth": 0}, r"max_depth = 0: must be -1 \(no limit\) or an integer"),
        ({"integrator": "transient_pat"}, "did you mean 'transient_path'?"),
        ({"integrator": "ao"}, "integrator = 'ao': must be one of transient_path"),
        ({"integrator": None}, "integrator = None: must be one of"),
    ],
)
def test_bad_arguments_are_one_line(name, arguments, text):
    with pytest.raises(ValueError, match=text) as error:
        BUILT_IN[name](**arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [0, -0.1, 0.6, float("inf"), "wide", None])
@pytest.mark.parametrize(
    ("name", "parameter", "most"),
    [
        ("caustic", "lamp_radius", MAX_LAMP_RADIUS),
        ("mirror_and_glass", "lamp_radius", MAX_LAMP_RADIUS),
        ("light_through_hole", "hole_width", MAX_HOLE_WIDTH),
    ],
)
def test_bad_sizes_are_one_line(name, parameter, most, value):
    allowed = f"must be a finite number of metres above 0 and at most {most}"
    with pytest.raises(ValueError, match=rf"\A{parameter} = .*: {allowed}\Z"):
        BUILT_IN[name](**{parameter: value})
