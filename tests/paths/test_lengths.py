"""Path lengths to a tenth of a millimeter: near clip, ray epsilon, glass, far scenes.

Single paths, compared one by one with the geometry of their own ray in double precision. Single
precision itself leaves 2e-7 of a length: 1 µm at 4 m, 20 µm at 100 m.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, diffuse, plane, point_light, rotate, translate, unit
from helpers.support import beam, camera, camera_rays, film, follow, load, refused, rendered, scene
from oracles import films as oracles

import tofrender
from tofrender.paths.camera import ray_origin, sample_camera
from tofrender.paths.refraction import index_around

CAMERAS = {
    "perspective": {"fov": 80.0},
    "thinlens": {"fov": 80.0, "aperture_radius": 0.3, "focus_distance": 3.0},
    "orthographic": {},
}


@pytest.mark.parametrize("scale", [1.0, 25.0], ids=["4m", "100m"])
@pytest.mark.parametrize("near_clip", [0.001, 0.5])
@pytest.mark.parametrize("kind", CAMERAS)
def test_from_the_camera_to_a_floor_and_a_lamp(kind, near_clip, scale):
    """OPL = |c - x| + |x - l|, where c is the point of the lens and x that of the floor."""
    height = 2.0 * scale
    lamp = np.array([0.7, -0.4, 1.3]) * scale
    parts = {"floor": plane(size=100 * scale, bsdf=diffuse(0.5)), "lamp": point_light(lamp, 1.0)}
    options = CAMERAS[kind] | {"near_clip": near_clip * scale, "far_clip": 1000.0}
    # A tilted camera, so that its axis differs from the floor's normal
    eye = np.array([0.3, 0.5, 1.0]) * height
    sensor = camera(eye, (0.2, 0.1, 0), film(), kind=kind, **options)
    loaded = load(scene(parts, sensor))
    shot = camera_rays(loaded, 512)

    axis, start = unit(np.array([0.2, 0.1, 0]) - eye), np.array(shot.ray.o, dtype=np.float64).T
    d = np.array(shot.ray.d, dtype=np.float64).T
    d = np.broadcast_to(d / np.linalg.norm(d, axis=1, keepdims=True), start.shape)
    # Back from the near plane along the ray, to the plane through the eye
    lens = start - d * (((start - eye) @ axis) / (d @ axis))[:, None]
    if kind == "perspective":
        assert lens == pytest.approx(np.broadcast_to(eye, lens.shape), abs=1e-5 * scale)
    elif kind == "thinlens":
        assert np.linalg.norm(lens - eye, axis=1).max() == pytest.approx(0.3, rel=0.05)
    x = lens - d * (lens[:, 2] / d[:, 2])[:, None]
    opl = np.linalg.norm(x - lens, axis=1) + np.linalg.norm(x - lamp, axis=1)
    steep = d[:, 2] < -0.2
    assert steep.sum() > 300
    found = follow(loaded, shot.ray, origin=shot.origin)
    error = np.abs(found.opl[:, 0] - opl)[steep & (opl < 5 * scale)]
    assert error.max() < (1e-4 if scale == 1 else 1e-3)


def test_ray_origin_of_a_camera_without_near_plane():
    meter = {"type": "radiancemeter", "origin": [1, 2, 3], "direction": [0, 0, 1], "film": film()}
    sensor = load(meter)
    ray, _ = sensor.sample_ray(0.0, 0.0, mi.Point2f(0.5), mi.Point2f(0.5))
    assert np.ravel(ray_origin(sensor, ray)) == pytest.approx([1, 2, 3], abs=1e-4)  # Mitsuba's own


PATCH = translate(0.4, -0.7, 0.3) @ rotate((0.6, 0.8, 0), 35) @ mi.ScalarTransform4f().scale(0.8)
"""A tilted square, seen by distant sensors."""


def distant_view(target, **film_options) -> dict:
    """A glowing tilted square and a ball, seen from afar along a direction."""
    sensor = {
        "type": "distant",
        "direction": [0.3, -0.5, -1.2],
        "film": film(1, 1, **film_options),
        "sampler": {"type": "independent", "sample_count": 64},
    }
    if target is not None:
        sensor["target"] = target
    patch = {"type": "rectangle", "to_world": PATCH, "emitter": area_light(0.9)}
    ball = {"type": "sphere", "center": [-0.5, 0.8, -2.0], "radius": 0.3, "bsdf": diffuse(0)}
    return scene({"patch": patch, "ball": ball}, sensor, max_depth=1)


def start_plane(loaded) -> tuple[np.ndarray, float]:
    """Direction of the rays, and where along it they start: at the sphere around the scene."""
    direction = unit([0.3, -0.5, -1.2])
    sphere = loaded.bbox().bounding_sphere()
    center = np.ravel(np.array(sphere.center, dtype=float))
    return direction, float(center @ direction) - float(sphere.radius) * (1 + 1500 / 2**24)


TARGETS = [None, [0.1, -0.6, 0.4], [2.0, 1.0, -3.0], {"type": "rectangle", "to_world": PATCH}]


@pytest.mark.parametrize("target", TARGETS, ids=["none", "near", "far", "shape"])
def test_rays_of_a_distant_sensor_start_on_one_plane(target):
    loaded = load(distant_view(target))
    direction, start = start_plane(loaded)
    camera, sampler = loaded.sensors()[0], mi.load_dict({"type": "independent"})
    sampler.seed(3, 256)
    pixels = dr.zeros(mi.UInt32, 256)
    found = sample_camera(camera, camera.film(), sampler, pixels, scene=loaded)
    along = direction @ np.array(found.origin)
    assert along == pytest.approx(np.full(along.shape, start), abs=1e-5)
    across = np.cross(np.array(found.origin - found.ray.o).T, direction)
    assert across == pytest.approx(np.zeros(across.shape), abs=1e-5)


@pytest.mark.parametrize("target", [None, TARGETS[3]], ids=["none", "shape"])
def test_lengths_of_a_distant_sensor_depend_on_depth(target):
    """Emission of a square arrives from its nearest to its farthest corner, evenly in between."""
    corners = [PATCH @ mi.ScalarPoint3f(x, y, 0) for x in (-1, 1) for y in (-1, 1)]
    direction, start = start_plane(load(distant_view(target)))
    lengths = np.sort([float(np.array(corner) @ direction) - start for corner in corners])
    width, bins = 0.01, 600
    window = {"temporal_bins": bins, "start_opl": 0.2, "bin_width_opl": width}
    dataset = tofrender.render(distant_view(target, **window), spp=1 << 14, progress=False)
    light = dataset["transient"].values[0, 0, :, 0].astype(float)
    lit = np.flatnonzero(light)
    assert 0.2 + lit[0] * width == pytest.approx(lengths[0], abs=4 * width)
    assert 0.2 + (lit[-1] + 1) * width == pytest.approx(lengths[3], abs=4 * width)
    centers = 0.2 + (np.arange(bins) + 0.5) * width
    mean = (light @ centers) / light.sum()
    assert mean == pytest.approx(lengths.mean(), abs=0.01)
    spread = np.sqrt((light @ (centers - mean) ** 2) / light.sum())
    sides = np.array([lengths[1] - lengths[0], lengths[2] - lengths[0]])  # Sum of two even spreads
    assert spread == pytest.approx(np.sqrt((sides**2).sum() / 12), rel=0.02)


def test_a_distant_sensor_with_a_target_needs_the_scene():
    loaded = load(distant_view(TARGETS[1]))
    camera, sampler = loaded.sensors()[0], mi.load_dict({"type": "independent"})
    sampler.seed(3, 1)
    pixel = dr.zeros(mi.UInt32, 1)
    refused("with a target needs the scene", sample_camera, camera, camera.film(), sampler, pixel)
    depth = tofrender.true_depth(loaded)
    direction, start = start_plane(loaded)
    ray, _ = camera.sample_ray(0.0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
    seen = np.ravel(loaded.ray_intersect(mi.Ray3f(ray)).p) @ direction
    assert depth == pytest.approx(np.full((1, 1), seen - start), abs=1e-5)


@pytest.mark.parametrize(("gap", "tolerance"), [(4.0, 1e-4), (100.0, 1e-3)])
@pytest.mark.parametrize("bounces", [1, 2, 4, 8])
def test_between_parallel_mirrors(gap, tolerance, bounces):
    """Unfolded, the ray is straight: `bounces` gaps across at an angle, to a lamp across its way.

    Spawned rays start 0.09 mm per meter off the mirrors. `si.t` would lose that at each bounce;
    here it moves the vertices a little sideways, which a lamp across the ray does not show.
    """
    angle = np.radians(30)
    mirror = {"size": 20 * gap, "bsdf": {"type": "conductor", "material": "none"}}
    side = 1 if bounces % 2 == 0 else -1
    end = np.array([0.0, bounces * gap * np.tan(angle), 0.0])
    arriving = np.array([side * np.cos(angle), np.sin(angle), 0.0])
    facing = mi.ScalarTransform4f().look_at(end.tolist(), (end - arriving).tolist(), [0, 0, 1])
    parts = {
        "left": plane(translate(-gap / 2, 0, 0) @ rotate((0, 1, 0), 90), **mirror),
        "right": plane(translate(gap / 2, 0, 0) @ rotate((0, 1, 0), -90), **mirror),
        "lamp": plane(facing, size=0.05 * gap, emitter=area_light(1.0)),
    }
    eye, ahead = (0.0, 0.0, 0.0), (np.cos(angle), np.sin(angle), 0.0)
    loaded = load(scene(parts, camera(eye, ahead, film())))
    found = follow(loaded, beam(eye, ahead), max_depth=20, rr_depth=100)
    assert found.all()[1] == pytest.approx([1.0], rel=1e-4)
    opl = bounces * gap / np.cos(angle)
    assert found.all()[0] == pytest.approx([opl], abs=tolerance + 1e-7 * opl * bounces)


@pytest.mark.parametrize("scale", [1.0, 25.0], ids=["4m", "100m"])
def test_between_diffuse_walls(scale):
    """Chords of a diffuse sphere are point to point: after n bounces, OPL stays within its bounds.

    Light and camera sit at the center. Two bounces of a chord r arrive at 2 R + r, and the energy
    does not tell r; but the next path's first bounce arrives at 2 R exactly, and the k-th bounce's
    OPL differs from the one before by one chord, between 0 and 2 R.
    """
    radius = 2.0 * scale
    ball = {"type": "sphere", "radius": radius, "flip_normals": True, "bsdf": diffuse(0.6)}
    parts = {"ball": ball, "lamp": point_light((0, 0, 0), 1.0)}
    loaded = load(scene(parts, camera((0, 0, 0), (0, 0, 1), film())))
    found = follow(loaded, beam((0, 0, 0), (0.36, 0.48, 0.8), 4096), max_depth=6, rr_depth=100)
    tolerance = 1e-4 if scale == 1 else 1e-3
    assert found.opl[:, 0] == pytest.approx(np.full(4096, 2 * radius), abs=tolerance)
    chords = np.diff(found.opl[:, :5], axis=1)
    assert chords.min() > 0
    # Of 16384 chords the longest misses 2 R by 2 R / 32768 or so; `si.t` would miss 0.3 mm
    # (8 mm at 100 m) at each
    assert chords.max() < 2 * radius + tolerance


def slab(z: float, thickness: float, index: float = 1.5, half: float = 50.0) -> dict:
    """Of glass, across the z axis."""
    size = mi.ScalarTransform4f().scale([half, half, 0.5 * thickness])
    glass = {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}
    return {"type": "cube", "to_world": translate(0, 0, z) @ size, "bsdf": glass}


def glass_ball(radius: float, index: float = 1.5, outside: float = 1.0, **more) -> dict:
    """Around (0, 0, 2)."""
    bsdf = {"type": "dielectric", "int_ior": index, "ext_ior": outside, **more}
    return {"type": "sphere", "center": [0, 0, 2], "radius": radius, "bsdf": bsdf}


def refracted(angle: float) -> float:
    """Through a slab of .4 m and 3.6 m of air at the angle a: 3.6 / cos a + .6 / cos b."""
    a = np.radians(angle)
    b = np.arcsin(np.sin(a) / 1.5)
    return 3.6 / np.cos(a) + 1.5 * 0.4 / np.cos(b)


BEHIND = {
    "two slabs, and air between": (
        ((0.2, 0.1, 4), (0.2, 0.1, 0), 4 + 0.15 + 0.16, 2e-5),
        {"first": slab(2.0, 0.3, half=5), "second": slab(1.0, 0.2, 1.8, half=5)},
    ),
    "water in glass": (
        ((0, 0, 4), (0, 0, 0), 2.0 + 2 * 0.5 * 1.5 + 1.0 * 1.33, 2e-5),
        {"glass": glass_ball(1.0), "water": glass_ball(0.5, 1.33, 1.5)},
    ),
    # Started along the normal, .4 mm off the glass, rays would be .6 mm aside at 50 degrees
    **{
        f"a slab at {a} degrees": (
            ((0, 0, 4), (4 * np.tan(np.radians(a)), 0, 0), refracted(a), 1e-4 if a else 2e-5),
            {"slab": slab(1.0, 0.4)},
        )
        for a in (0, 20, 50)
    },
    # Null transmission adds a vertex and no length
    **{
        f"a {bsdf['type']}": (
            ((0.2, 0.1, 3), (0.5, 0, 0), np.linalg.norm((0.3, 0.1, 3)), 2e-5),
            {"sheet": plane(translate(0, 0, 1.2), bsdf=bsdf)},
        )
        for bsdf in (
            {"type": "mask", "opacity": 0.3, "nested": diffuse(0.0)},
            {"type": "thindielectric"},
        )
    },
}


@pytest.mark.parametrize("name", BEHIND)
def test_a_lamp_behind(name):
    """Glass counts with its index; more than half of all rays pass."""
    (eye, target, opl, tolerance), parts = BEHIND[name]
    lamp = {"lamp": plane(size=100, emitter=area_light(1.0))}
    loaded = load(scene(parts | lamp, camera(eye, (*eye[:2], 0), film())))
    found, _ = follow(loaded, beam(eye, target, 256), max_depth=5).all()
    assert found.size > 128
    assert found == pytest.approx(np.full(found.size, opl), abs=tolerance)


def test_mirror_far_away():
    """Form i at 100 m. Started along the mirror's normal, rays would meet the floor 4 mm aside."""
    eye, lamp, x = (-30.0, 5.0, 20.0), (30.0, 15.0, 40.0), (10.0, -8.0, 0.0)
    ceiling = translate(0, 0, 50) @ rotate((1, 0, 0), 180)
    parts = {
        "mirror": plane(ceiling, size=500, bsdf={"type": "conductor", "material": "none"}),
        "floor": plane(size=500, bsdf=diffuse(0.5)),
        "lamp": point_light(lamp, 1e4),
    }
    loaded = load(scene(parts, camera(eye, x, film())))
    image = oracles.mirrored(eye, (0, 0, 50), (0, 0, 1))
    ahead = unit(np.subtract(x, image)) * [1, 1, -1]
    found = follow(loaded, beam(eye, eye + ahead), max_depth=3)
    _, opl = oracles.point_light_on_plane(image, x, (0, 0, 1), lamp, 1e4, 0.5)
    assert found.all()[0] == pytest.approx([opl], abs=1e-3)


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_near_clip_counts_in_the_sensors_own_units(scale):
    """A camera whose space is stretched along its axis has its near plane further away."""
    to_world = mi.ScalarTransform4f().look_at([0, 0, 6], [0, 0, 0], [0, 1, 0])
    stretched = to_world @ mi.ScalarTransform4f().scale([1e-3, 1e-3, scale])
    sensor = load(
        {"type": "orthographic", "near_clip": 0.01, "to_world": stretched, "film": film()}
    )
    ray, _ = sensor.sample_ray(0, 0, mi.Point2f(0.5), mi.Point2f(0.5))
    assert np.ravel(ray_origin(sensor, ray)) == pytest.approx([0, 0, 6], abs=1e-5)


ROOM = {"type": "cube", "to_world": translate(0, 0, 2) @ mi.ScalarTransform4f().scale(5)}
FOG = {"type": "homogeneous", "sigma_t": 0.2, "albedo": 0.0}
ROUGH_BALL = glass_ball(1.0, type="roughdielectric", alpha=0.3)
MASK = {"type": "mask", "opacity": 0.3, "nested": glass_ball(1.0)["bsdf"]}
BUBBLE = glass_ball(0.2, 1.0, 1.33) | {"center": [0, 0, 1]}
AROUND = {
    "air, and a ball": (1.0, {"ball": glass_ball(0.5) | {"center": [0, 0, 0.5]}}),
    "water, and a bubble in it": (1.33, {"water": glass_ball(1.9, 1.33), "bubble": BUBBLE}),
    "glass": (1.5, {"ball": glass_ball(1.0)}),
    "rough glass": (1.5, {"ball": ROUGH_BALL}),
    "masked glass": (1.5, {"ball": glass_ball(1.0) | {"bsdf": MASK}}),
    "glass in a room": (1.5, {"ball": glass_ball(1.0), "room": ROOM}),
    "water in glass": (1.33, {"glass": glass_ball(1.0), "water": glass_ball(0.5, 1.33, 1.5)}),
    "the same told inside out": (
        1.33,
        {"glass": glass_ball(1.0), "hole": glass_ball(0.5, 1.5, 1.33) | {"flip_normals": True}},
    ),
    "half a space of water": (1.33, {"face": plane(bsdf=glass_ball(1, 1.33)["bsdf"])}),
}


@pytest.mark.parametrize("name", AROUND)
def test_index_around_a_camera(name):
    """Whichever way it looks."""
    expected, parts = AROUND[name]
    z = -2.0 if name.startswith("half") else 2.0
    for target in ((0, 0, 2.5 * z), (0, 0, 0)):
        loaded = load(scene(parts, camera((0, 0, z), target, film())))
        assert index_around(loaded, loaded.sensors()[0]) == pytest.approx(expected, abs=1e-5)


def seen_from_glass(ball: dict, **integrator) -> dict:
    """A lamp of radiance 1 at 2 m, the first of them in glass."""
    window = film(bins=500, bin_width=0.01)
    parts = {"ball": ball, "lamp": plane(size=1.0, emitter=area_light(1.0))}
    within = {"medium": ball["interior"]} if "interior" in ball else {}
    eye = camera((0, 0, 2), (0, 0, 0), window, fov=40.0, **within)
    return scene(parts, eye, **{"max_depth": 3} | integrator)


@pytest.mark.parametrize(
    ("kind", "ball"),
    [
        ("transient_path", glass_ball(1.0)),
        ("transient_path", ROUGH_BALL),
        ("transient_bdpt", ROUGH_BALL),
        ("transient_light_tracer", ROUGH_BALL),
        ("transient_volpath", glass_ball(1.0) | {"interior": FOG}),
    ],
)
def test_a_camera_in_glass_counts_its_own_segment_with_the_index(kind, ball):
    """All light comes after 1.5 + 1 m or more (5/3 m, were the index relative to the glass)."""
    _, transient = rendered(seen_from_glass(ball, type=kind), 1 << 15)
    light = transient[0, 0, :, 0]
    assert 2.49 <= 0.01 * np.flatnonzero(light)[0] < 2.6
    assert light[: int(2.7 / 0.01)].sum() > 0.8 * light.sum()


def test_gates_and_phasors_of_a_camera_in_glass():
    """Of 2.5 m."""
    described = seen_from_glass(glass_ball(1.0))
    loaded = load(described | {"sensor": described["sensor"] | {"fov": 1.0}})
    sensor = loaded.sensors()[0]
    depth = tofrender.render_amcw_phasor(loaded, sensor, 30e6, spp=64)[-1]
    assert depth == pytest.approx(np.full(depth.shape, 1.25), abs=2e-4)
    gate = {"type": "time_gated_transient_path", "pulse_width_opl": 0.02}
    gate = mi.load_dict(gate, parallel=False)
    seen, before = (tofrender.render_at_time(loaded, gate, sensor, t, 256) for t in (2.5, 1.6667))
    assert seen.mean() > 10
    assert before.mean() == 0


def test_around_the_corner_a_camera_in_glass_is_refused():
    parts = {"relay_wall": plane(bsdf=diffuse(0.5)), "ball": glass_ball(1.0)}
    eye = camera((0, 0, 2), (0, 0, 0), film())
    loaded = load(scene(parts, eye, type="confocal_transient_path"))
    text = r"sensor: .* glass or water of index 1\.5"
    refused(text, loaded.integrator().plan, loaded, loaded.sensors()[0])
