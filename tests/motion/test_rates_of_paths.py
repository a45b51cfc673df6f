"""Rates of change of path lengths against formulas and finite differences by NumPy."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.moving import REST, rates_of, seen_by, share_at
from helpers.parts import area_light, diffuse, plane, point_light, rotate, translate, unit
from helpers.support import agree
from oracles.moving_optics import Surface, change, follow, rate, specular_length, turned

EYE, LAMP = np.array([0.4, -0.3, 3.0]), np.array([1.0, 0.3, 2.0])
SPOT = np.array([0.1, 0.2, 0.0])
MIRROR = {"type": "conductor", "material": "none"}
ALL = pytest.approx(1, abs=1e-4)


def lamp(position=LAMP, **motion) -> dict:
    return point_light(position, 3.0) | motion


def glass(int_ior: float = 1.5) -> dict:
    return {"type": "dielectric", "int_ior": int_ior, "ext_ior": 1.0}


# One part of the three moves: floor, lamp or camera; or two; or all.
V, W, U = (0.3, -1.1, 2.0), (-0.7, 0.4, 1.3), (0.2, 0.9, -0.6)


@pytest.mark.parametrize(
    "moves", ["floor", "lamp", "camera", "floor lamp", "lamp camera", "floor lamp camera"]
)
def test_of_a_plane_by_velocities(moves):
    v, w, u = (k if name in moves else REST for k, name in ((V, "floor"), (W, "lamp"), (U, "cam")))
    parts = {"floor": plane(bsdf=diffuse(0.5), velocity=list(v)), "lamp": lamp(velocity=list(w))}
    described = seen_by(EYE, SPOT, parts, sensor={"velocity": list(u)})
    expected = rate([EYE, SPOT, LAMP], [u, v, w])
    assert abs(expected) > 0.05
    assert share_at(described, expected) == ALL
    assert share_at(described, -expected) == 0


@pytest.mark.parametrize(
    "integrator",
    ["transient_path", "transient_volpath", "transient_light_tracer", "transient_bdpt"],
)
def test_without_the_first_segment(integrator):
    """`camera_unwarp` leaves its length out, and its change; light tracers see more."""
    parts = {"floor": plane(bsdf=diffuse(0.5), velocity=list(V)), "lamp": lamp(velocity=list(W))}
    fov, within = (1.0, 0.05) if integrator == "transient_light_tracer" else (0.006, 2e-3)
    sensor = {"velocity": list(U), "fov": fov}
    described = seen_by(EYE, SPOT, parts, 2, sensor, type=integrator, camera_unwarp=True)
    expected = rate([SPOT, LAMP], [V, W])
    assert share_at(described, expected, within, spp=1 << 18) == ALL


def test_of_parts_that_rotate():
    ω, c = np.array([0.5, 1.5, -0.8]), np.array([0.6, -0.2, 0.4])
    motion = {"angular_velocity": ω.tolist(), "rotation_center": c.tolist()}
    x = {"eye": EYE, "spot": SPOT, "lamp": LAMP}
    for moves in x:
        v = [np.cross(ω, x[each] - c) if each == moves else REST for each in x]
        by = {each: motion if each == moves else {} for each in x}
        parts = {"floor": plane(bsdf=diffuse(0.5), **by["spot"]), "lamp": lamp(**by["lamp"])}
        described = seen_by(EYE, SPOT, parts, sensor=by["eye"])
        assert share_at(described, rate(list(x.values()), v)) == ALL, moves


def test_velocity_and_rotation_add_up():
    v, ω, c = np.array(V), np.array([0.5, 1.5, -0.8]), np.array([0.6, -0.2, 0.4])
    motion = {"velocity": V, "angular_velocity": ω.tolist(), "rotation_center": c.tolist()}
    motion = {name: list(value) for name, value in motion.items()}
    described = seen_by(EYE, SPOT, {"floor": plane(bsdf=diffuse(0.5), **motion), "lamp": lamp()})
    expected = rate([EYE, SPOT, LAMP], [REST, v + np.cross(ω, SPOT - c), REST])
    assert share_at(described, expected) == ALL


@pytest.mark.parametrize("integrator", ["transient_volpath", "transient_bdpt"])
def test_other_integrators_of_paths_from_the_camera(integrator):
    parts = {"floor": plane(bsdf=diffuse(0.5), velocity=list(V)), "lamp": lamp(velocity=list(W))}
    described = seen_by(EYE, SPOT, parts, sensor={"velocity": list(U)}, type=integrator)
    assert share_at(described, rate([EYE, SPOT, LAMP], [U, V, W])) == ALL


def test_all_together_is_rest():
    """A rigid motion of everything changes no length, up to rounding of velocities of 1 m/s."""
    motion = {
        "velocity": list(V),
        "angular_velocity": [0.5, 1.5, -0.8],
        "rotation_center": [0.6, -0.2, 0.4],
    }
    parts = {
        "floor": plane(bsdf=diffuse(0.5), **motion),
        "wall": plane(translate(-2, 0, 0) @ rotate((0, 1, 0), 90), bsdf=diffuse(0.5), **motion),
        "ball": {"type": "sphere", "radius": 0.3, "bsdf": glass(), **motion},
        "lamp": lamp(**motion),
    }
    described = seen_by(EYE, SPOT, parts, 6, sensor=motion)
    described["sensor"]["fov"] = 60
    assert share_at(described, 0, 1e-5) == ALL


def test_an_area_lamp_moves_with_its_shape():
    """Seen directly, and by a floor: of a lamp of a millimeter."""
    at, v = np.array([0.5, 0.4, 1.5]), np.array([0.7, -0.4, 1.8])
    small = plane(translate(*at) @ rotate((1, 0, 0), 180), 5e-4, emitter=area_light(1e4))
    parts = {"floor": plane(bsdf=diffuse(0.5)), "panel": small | {"velocity": v.tolist()}}
    direct = seen_by((0.4, 0.1, 0.2), at, parts, 1)
    assert share_at(direct, v @ unit(at - (0.4, 0.1, 0.2))) == ALL
    described = seen_by(EYE, SPOT, parts, 2)
    assert share_at(described, rate([EYE, SPOT, at], [REST, REST, v]), 4e-3) == ALL


@pytest.mark.parametrize("ω", [REST, (0.4, -0.9, 0.3)])
def test_of_a_mirror(ω):
    """Camera, moving mirror, floor, lamp: the floor's image moves at twice the mirror's speed."""
    v, at = np.array([0.2, -0.5, 1.5]), np.array([-0.1, 0.15, 0.5])
    tilt = rotate(unit((1, 0.4, 0)), 25)
    normal = unit(np.array(tilt.matrix)[:3, 2])
    eye, target = np.array([0.5, -2.0, 1.4]), at
    d = unit(target - eye)
    _, x, turn = follow(eye, d, [Surface(at, normal)])
    ceiling = 3.0
    spot = x + turn * (ceiling - x[2]) / turn[2]
    light = np.add(spot, (0.8, 0.5, -1.0))
    parts = {
        "mirror": plane(
            translate(*at) @ tilt,
            0.3,
            bsdf=MIRROR,
            velocity=v.tolist(),
            angular_velocity=list(ω),
            rotation_center=[0.0, 0.0, 0.3],
        ),
        "ceiling": plane(translate(0, 0, ceiling) @ rotate((1, 0, 0), 180), bsdf=diffuse(0.5)),
        "lamp": lamp(light),
    }

    def length(t: float) -> float:
        angle, axis = np.linalg.norm(ω) * t, ω if any(ω) else (0, 0, 1)
        n = turned(normal, axis, angle)
        there = turned(at, axis, angle, (0, 0, 0.3)) + v * t
        return specular_length(eye, spot, d, [Surface(there, n)])

    expected = change(length)
    if not any(ω):
        assert expected == pytest.approx(-2 * (v @ normal) * (-d @ normal), rel=1e-6)
    assert share_at(seen_by(eye, target, parts, 3), expected) == ALL


def test_of_what_a_mirror_shows():
    """A lamp that moves, seen in a mirror that moves, from a camera that moves."""
    v, u, w = np.array([0.4, 0.2, 1.1]), np.array(U), np.array(W)
    eye, at = np.array([0.0, -0.5, 2.0]), np.array([0.0, 0.0, 0.0])
    light = np.array([0.0, 0.625, 2.5])  # At the mirror's angle
    parts = {
        "mirror": plane(bsdf=MIRROR, velocity=v.tolist(), size=1),
        "panel": plane(
            translate(*light) @ rotate((1, 0, 0), 180),
            0.01,
            emitter=area_light(3.0),
            velocity=w.tolist(),
        ),
    }

    def length(t: float) -> float:
        surface = Surface(at + v * t, (0, 0, 1))
        return specular_length(eye + u * t, light + w * t, unit(at - eye), [surface])

    described = seen_by(eye, at, parts, 2, sensor={"velocity": u.tolist()})
    assert share_at(described, change(length)) == ALL


def in_glass(eye, target, surfaces, parts, moved, spot, velocity, light, depth, **more):
    """Check the light by a specular path to a moving spot of a diffuse surface, then a lamp.

    `surfaces(t)` are those of the path; `velocity` is that of the spot; `light` is at rest.
    """
    behind = surfaces(0)[-1].indices[1]

    def length(t: float) -> float:
        x = spot + velocity * t
        first = specular_length(eye, x, unit(np.subtract(target, eye)), surfaces(t))
        return first + behind * np.linalg.norm(light - x)

    expected = change(length)
    found = share_at(seen_by(eye, target, parts, depth, **more), expected, 3e-3)
    assert found == ALL, (moved, expected)
    return expected


@pytest.mark.parametrize("moved", ["surface", "floor"])
def test_of_water(moved):
    """A surface of water over a floor, with the lamp in the water: lengths there times 4/3."""
    index, top = 4 / 3, 0.8
    eye, target = np.array([0.3, -0.9, 2.0]), np.array([0.0, 0.1, top])
    v = np.array([0.5, -0.3, 1.2])
    surface, floor = (v if moved == each else np.zeros(3) for each in ("surface", "floor"))

    def surfaces(t: float) -> list[Surface]:
        return [Surface(np.array([0, 0, top]) + surface * t, (0, 0, 1), indices=(1, index))]

    _, x, d = follow(eye, unit(target - eye), surfaces(0))
    spot = x + d * x[2] / -d[2]
    light = np.add(spot, (0.6, 0.3, 0.5))
    parts = {
        "water": plane(translate(0, 0, top), bsdf=glass(index), velocity=surface.tolist()),
        "floor": plane(bsdf=diffuse(0.5), velocity=floor.tolist()),
        "lamp": lamp(light),
    }
    expected = in_glass(eye, target, surfaces, parts, moved, spot, floor, light, 3)
    if moved == "surface":
        dz = -d[2] * index + unit(target - eye)[2]
        assert expected == pytest.approx(v[2] * dz, rel=1e-6)


@pytest.mark.parametrize("moved", ["slab", "rotating slab", "floor"])
def test_of_a_slab_of_glass(moved):
    """A slab that moves changes no length, unless it rotates."""
    index, low, high = 1.5, 0.6, 0.9
    eye, target = np.array([0.3, -0.9, 2.0]), np.array([0.0, 0.1, high])
    v = np.array([0.5, -0.3, 1.2])
    ω = np.array([0.7, -0.5, 0.2]) if "rot" in moved else np.zeros(3)
    center = np.array([0.05, 0.0, 0.75])
    slab, floor = (v if moved.endswith(each) else np.zeros(3) for each in ("slab", "floor"))

    def surfaces(t: float) -> list[Surface]:
        angle, axis = np.linalg.norm(ω) * t, ω if ω.any() else (0, 0, 1)
        n = turned((0, 0, 1), axis, angle)
        points = [turned((0, 0, z), axis, angle, center) + slab * t for z in (high, low)]
        return [
            Surface(p, n, indices=k) for p, k in zip(points, ((1, index), (index, 1)), strict=True)
        ]

    _, x, d = follow(eye, unit(target - eye), surfaces(0))
    spot = x + d * x[2] / -d[2]
    light = np.add(spot, (0.6, 0.3, 0.3))
    middle, half = (high + low) / 2, (high - low) / 2
    box = translate(0, 0, middle) @ mi.ScalarTransform4f().scale([0.5, 0.5, half])
    motion = {"velocity": slab, "angular_velocity": ω, "rotation_center": center}
    motion = {name: value.tolist() for name, value in motion.items()} if slab.any() else {}
    parts = {
        "slab": {"type": "cube", "to_world": box, "bsdf": glass(index), **motion},
        "floor": plane(bsdf=diffuse(0.5), velocity=floor.tolist()),
        "lamp": lamp(light),
    }
    expected = in_glass(eye, target, surfaces, parts, moved, spot, floor, light, 4)
    assert (abs(expected) < 1e-6) == (moved == "slab")


@pytest.mark.parametrize("moved", ["sphere", "floor"])
def test_of_a_sphere_of_glass(moved):
    index, at, radius = 1.5, np.array([0.0, 0.0, 0.8]), 0.4
    eye, target = np.array([0.5, -0.9, 2.5]), np.array([0.12, 0.08, 0.8])
    v = np.array([0.9, -0.6, 1.2])
    sphere, floor = (v if moved == each else np.zeros(3) for each in ("sphere", "floor"))

    def surfaces(t: float) -> list[Surface]:
        there = at + sphere * t
        return [Surface(there, None, radius, each) for each in ((1, index), (index, 1))]

    _, x, d = follow(eye, unit(target - eye), surfaces(0))
    spot = x + d * x[2] / -d[2]
    light = np.add(spot, (0.7, 0.3, 0.3))
    ball = {"type": "sphere", "center": at.tolist(), "radius": radius, "bsdf": glass(index)}
    parts = {
        "sphere": ball | {"velocity": sphere.tolist()},
        "floor": plane(bsdf=diffuse(0.5), velocity=floor.tolist()),
        "lamp": lamp(light),
    }
    assert abs(in_glass(eye, target, surfaces, parts, moved, spot, floor, light, 4)) > 0.05


@pytest.mark.parametrize("integrator", ["transient_light_tracer", "transient_bdpt"])
@pytest.mark.parametrize("moved", ["sphere", "lamp"])
def test_of_a_caustic(moved, integrator):
    """A beam through a sphere of glass to a floor, from the lamp on: lengths there times 3/2."""
    index, at, radius = 1.5, np.array([0.0, 0.0, 0.8]), 0.4
    light, target = np.array([0.5, -0.9, 2.5]), np.array([0.12, 0.08, 0.8])
    v = np.array([0.9, -0.6, 1.2])
    sphere, own = (v if moved == each else np.zeros(3) for each in ("sphere", "lamp"))

    def surfaces(t: float) -> list[Surface]:
        there = at + sphere * t
        return [Surface(there, None, radius, each) for each in ((1, index), (index, 1))]

    d = unit(target - light)
    _, x, onwards = follow(light, d, surfaces(0))
    spot = x + onwards * x[2] / -onwards[2]
    eye = np.add(spot, (0.7, 0.3, 0.3))
    aimed = mi.ScalarTransform4f().look_at(light.tolist(), target.tolist(), [0, 1, 0])
    parts = {
        "sphere": {
            "type": "sphere",
            "center": at.tolist(),
            "radius": radius,
            "bsdf": glass(index),
            "velocity": sphere.tolist(),
        },
        "floor": plane(bsdf=diffuse(0.5)),
        "lamp": {"type": "spot", "intensity": 9.0, "cutoff_angle": 0.06, "to_world": aimed}
        | {"velocity": own.tolist()},
    }

    def length(t: float) -> float:
        first = specular_length(light + own * t, spot, d, surfaces(t))
        return first + np.linalg.norm(eye - spot)

    expected = change(length)
    assert abs(expected) > 0.05
    described = seen_by(eye, spot, parts, 4, {"fov": 10.0}, type=integrator)
    assert share_at(described, expected, 5e-3, spp=1 << 12) == ALL


def inside(bounces: int, v, **more) -> dict:
    """Inside of a diffuse sphere, camera and lamp at its center: light of up to so many bounces."""
    ball = {"type": "sphere", "radius": 2.0, "flip_normals": True, "bsdf": diffuse(0.8)}
    parts = {"ball": ball | {"velocity": list(v)} | more, "lamp": lamp(REST)}
    return seen_by(REST, (0, 0, 1), parts, bounces + 1)


@pytest.mark.parametrize("bounces", [1, 2, 3])
def test_of_several_bounces(bounces):
    """V = v·(x_1 + x_n)/R; x_n is uniform on the sphere, and so v·x_n uniform between both ends.

    Each bounce has 0.8 of the light of the one before, and of all light of one bounce V is 2 v·x_1.
    """
    v, size = np.array([0.6, 0.0, 1.0]), np.hypot(0.6, 1.0)
    edges = np.linspace(v[2] - size, v[2] + size, 9)
    seeds = range(16)
    found = np.array(
        [
            rates_of(inside(bounces, v), (edges[0], edges[-1]), 8, spp=1024, seed=seed)
            for seed in seeds
        ]
    )
    share = 0.8 ** np.arange(bounces)
    share /= share.sum()
    expected = np.full(8, (1 - share[0]) / 8)
    expected[np.searchsorted(edges, 2 * v[2]) - 1] += share[0]
    assert agree(found, expected, rounding=1e-4)


def test_rotation_about_the_center_changes_nothing():
    described = inside(6, REST, angular_velocity=[1.0, -2.0, 0.5])
    assert share_at(described, 0, 2e-5) == ALL


def test_instances_move():
    """An instance by its id, with a velocity and a rotation about its own axis."""
    v, ω = np.array([0.3, -0.2, 1.1]), np.array([0.2, 0.9, -0.4])
    group = {"type": "shapegroup", "part": plane(bsdf=diffuse(0.5), size=1.0)}
    motion = {"velocity": v, "angular_velocity": ω, "rotation_center": np.array([0.5, 0.1, 0.0])}
    motion = {name: value.tolist() for name, value in motion.items()}
    there = {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}}
    parts = {
        "group": group,
        "moving": there | {"to_world": translate(0.2, 0, 0)} | motion,
        "resting": there | {"to_world": translate(5, 0, 0)},
        "lamp": lamp(),
    }
    speed = v + np.cross(ω, SPOT - (0.5, 0.1, 0.0))
    expected = rate([EYE, SPOT, LAMP], [REST, speed, REST])
    assert share_at(seen_by(EYE, SPOT, parts), expected) == ALL
    spot = np.array([5.1, 0.2, 0.0])
    parts["lamp"] = lamp(np.add(spot, (0, 0, 2)))
    assert share_at(seen_by(np.add(EYE, (5, 0, 0)), spot, parts), 0, 1e-6) == ALL


def test_meshes_move(tmp_path):
    mesh = mi.Mesh("square", 4, 2)
    params = mi.traverse(mesh)
    params["vertex_positions"] = [-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0]
    params["faces"] = [0, 1, 2, 0, 2, 3]
    params.update()
    mesh.write_ply(str(tmp_path / "square.ply"))
    v, ω = np.array([0.3, -0.2, 1.1]), np.array([0.2, 0.9, -0.4])
    described = {"type": "ply", "filename": str(tmp_path / "square.ply"), "bsdf": diffuse(0.5)}
    described |= {"velocity": v.tolist(), "angular_velocity": ω.tolist()}
    expected = rate([EYE, SPOT, LAMP], [REST, v + np.cross(ω, SPOT), REST])
    assert share_at(seen_by(EYE, SPOT, {"mesh": described, "lamp": lamp()}), expected) == ALL
