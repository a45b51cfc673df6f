"""Scenes whose light hardly finds the camera: gaps and leaks, and what one sees."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.scenes import load, random_directions, random_rays, seen
from helpers.support import with_integrator
from scipy import ndimage

from tofrender.scenes import BUILT_IN
from tofrender.scenes.caustics import HOLE_CENTER, MAX_HOLE_WIDTH, MAX_LAMP_RADIUS

GLASS = pytest.mark.parametrize("name", ["caustic", "mirror_and_glass"])
BLACK = {"type": "ref", "id": "black"}


def from_the_lamp(described: dict, spp: int = 100) -> np.ndarray:
    """Mitsuba's `ptracer`, whose paths start at the lamp: float64 (64, 64, 3)."""
    steady = {"type": "hdrfilm", "width": 64, "height": 64, "rfilter": {"type": "box"}}
    sensor = described["sensor"] | {"film": steady, "sampler": {"type": "independent"}}
    integrator = described["integrator"] | {"type": "ptracer"}
    scene = mi.load_dict(described | {"sensor": sensor, "integrator": integrator})
    return np.array(mi.render(scene, spp=spp, seed=0), dtype=np.float64)


@GLASS
def test_glass_is_a_closed_sphere_away_from_all_else(name):
    """The nearest that is seen from the sphere's surface, straight away from its center."""
    described = BUILT_IN[name](lamp_radius=MAX_LAMP_RADIUS)
    assert described["glass"] == {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    glass = described["glass-sphere"]
    del described["glass-sphere"]
    direction = random_directions()
    start = mi.Point3f(glass["center"]) + direction * glass["radius"]
    scene = load(described)
    outwards = scene.ray_intersect(mi.Ray3f(start, direction))
    assert 0.03 < dr.min(outwards.t)[0] < 0.06
    inwards = mi.Ray3f(start, -direction)
    inwards.maxt = 2 * glass["radius"]
    assert not dr.any(scene.ray_test(inwards))


@pytest.mark.parametrize("name", ["lamp_in_fixture", "light_through_hole"])
def test_rooms_are_closed_and_their_surfaces_face_in(name):
    """From the camera on, by way of what is hit, to points all over the room.

    One ray in a million starts below a wall's edge, by rounding, and sees the next wall's black
    back.
    """
    scene = load(BUILT_IN[name]())
    two_sided = [mi.ShapePtr(each) for each in scene.shapes() if each.id().startswith("housing")]
    ray = random_rays(scene.sensors()[0].world_transform() @ mi.Point3f(0))
    backs = 0
    for seed in range(1, 6):
        hit = scene.ray_intersect(ray)
        assert dr.all(hit.is_valid())
        back = dr.dot(hit.n, ray.d) >= 0
        for shape in two_sided:
            back &= hit.shape != shape
        backs += dr.count(back)[0]
        direction = random_directions(seed=seed)
        ray = hit.spawn_ray(dr.select(dr.dot(direction, hit.n) > 0, direction, -direction))
    assert backs <= 3


@pytest.mark.parametrize("width", [0.05, 0.2, MAX_HOLE_WIDTH])
def test_light_comes_through_the_hole_only(width):
    described = BUILT_IN["light_through_hole"](hole_width=width)
    assert from_the_lamp(described).mean() > 0
    plug = mi.ScalarTransform4f().translate(HOLE_CENTER).scale(width / 2 + 1e-3)
    closed = described | {"plug": {"type": "cube", "to_world": plug, "bsdf": BLACK}}
    assert from_the_lamp(closed).max() == 0


def test_light_leaves_the_fixture_at_its_top_only():
    """But for the few paths whose vertex is on an edge, where rounding puts it outside."""
    described = BUILT_IN["lamp_in_fixture"]()
    open_top = from_the_lamp(described)
    assert open_top.mean() > 0.1
    (x, top, z), radius = described["housing"]["p1"], described["housing"]["radius"]
    lid = mi.ScalarTransform4f().translate([x, top, z]).scale([radius + 0.01, 0.01, radius + 0.01])
    closed = described | {"lid": {"type": "cube", "to_world": lid, "bsdf": BLACK}}
    assert from_the_lamp(closed).mean() < 1e-6 * open_top.mean()


def bright_floor(described: dict) -> np.ndarray:
    """Which of 64 x 64 pixels see floor that is four times as bright as its median, or more."""
    light = from_the_lamp(described).mean(axis=2) * seen(described, 64, "floor")
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
    for count in (2, 1):
        assert ndimage.label(bright_floor(described), np.ones((3, 3)))[1] == count
        described["mirror-block"]["bsdf"] = {"type": "ref", "id": "white"}


@pytest.mark.parametrize(("name", "share"), [("lamp_in_fixture", 0.7), ("light_through_hole", 0.9)])
def test_most_of_the_picture_has_indirect_light_only(name, share):
    described = BUILT_IN[name]()
    direct = from_the_lamp(with_integrator(described, max_depth=2))
    assert direct.max() > 0
    assert (direct == 0).mean() > share


@GLASS
def test_power_of_the_lamp_does_not_depend_on_its_size(name):
    powers = []
    for radius in (0.01, 0.025, MAX_LAMP_RADIUS):
        light = BUILT_IN[name](lamp_radius=radius)["light"]
        assert light["radius"] == radius
        powers.append(radius**2 * np.array(light["emitter"]["radiance"]["value"]))
    np.testing.assert_allclose(powers, [powers[0]] * 3)
