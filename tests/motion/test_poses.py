"""Scenes in their pose at a time against scenes that are built so, and back at rest afterwards."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.moving import with_motions
from helpers.parts import area_light, diffuse, plane, point_light, rotate, translate, unit
from helpers.scenes import refusal
from helpers.support import camera, film, scene

import tofrender
from tofrender import Motion

ω = np.array([0.4, -1.1, 0.7])
MOTION = Motion(
    velocity=(0.3, -0.2, 0.5), angular_velocity=tuple(ω), rotation_center=(0.1, 0.2, -0.3)
)
TIME_S = 0.4
VIEW = camera((0.2, 0.4, 3.0), (0, 0, 0), film(8, 8), fov=50)


def carried():
    """The transform of MOTION over TIME_S."""
    c = np.array(MOTION.rotation_center)
    angle = np.degrees(np.linalg.norm(ω) * TIME_S)
    moved = c + np.array(MOTION.velocity) * TIME_S
    return translate(*moved) @ rotate(unit(ω), angle) @ translate(*-c)


def at(position) -> list[float]:
    """A point after TIME_S."""
    return list(np.array(carried().matrix, float)[:3] @ [*position, 1.0])


def ply(path) -> str:
    """A curved mesh with normals, coordinates of textures, and colors of vertices."""
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 7)))
    mesh = mi.Mesh("sheet", 49, 72, has_vertex_normals=True, has_vertex_texcoords=True)
    mesh.add_attribute("vertex_color", 3, np.clip(np.stack([u, v, u * v], -1), 0, 1).ravel())
    corner = np.array([7 * i + j for i in range(6) for j in range(6)])
    faces = [corner, corner + 1, corner + 8, corner, corner + 8, corner + 7]
    normals = np.stack([0.4 * u, 0.4 * v, np.ones(49)], -1)
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.stack([u, v, -0.2 * (u**2 + v**2)], -1).ravel()
    params["vertex_normals"] = (normals / np.linalg.norm(normals, axis=1)[:, None]).ravel()
    params["vertex_texcoords"] = np.stack([u, v], -1).ravel() / 2 + 0.5
    params["faces"] = np.stack(faces, -1).astype(np.uint32).ravel()
    params.update()
    mesh.write_ply(str(path))
    return str(path)


def background() -> dict:
    return {
        "back": plane(translate(0, 0, -2), 3.0, bsdf=diffuse(0.5)),
        "light": point_light((1, 2, 3), 9.0),
    }


def shapes(path, moved) -> dict:
    """Parts with one that moves, `part`, in its first place, or in that after TIME_S."""
    there = carried() if moved else mi.ScalarTransform4f()
    place = there @ translate(0.2, -0.1, 0.3) @ rotate((0, 1, 0), 30)
    small = mi.ScalarTransform4f().scale(0.6)
    texture = {"type": "checkerboard", "to_uv": small}
    painted = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    plastic = {"type": "roughplastic", "alpha": 0.3}
    group = {"type": "shapegroup", "id": "group", "each": {"type": "cube", "bsdf": plastic}}
    kinds = {
        "rectangle": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": texture}},
        **{
            kind: {"type": kind, "bsdf": plastic} for kind in ("cube", "sphere", "disk", "cylinder")
        },
        "ply": {"type": "ply", "filename": ply(path), "bsdf": painted},
        "instance": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}},
        "area": {"type": "rectangle", "emitter": area_light(4.0)},
    }
    parts = {name: {"part": each | {"to_world": place @ small}} for name, each in kinds.items()}
    parts["instance"] = {"group": group} | parts["instance"]
    parts["point"] = {"part": point_light(at((1, 0, 1)) if moved else (1, 0, 1), 3.0)}
    spot = {"type": "spot", "intensity": 9.0, "cutoff_angle": 40}
    aimed = there @ mi.ScalarTransform4f().look_at([1, 0, 2], [0, 0, -2], [0, 1, 0])
    return parts | {"spot": {"part": spot | {"to_world": aimed}}}


def rendered(loaded: mi.Scene) -> np.ndarray:
    found = tofrender.render(loaded, spp=4, seed=3, bins=30, window=(0, 15), progress=False)
    return found["transient"].values


KINDS = ["rectangle", "cube", "sphere", "disk", "cylinder", "ply", "instance", "area", "point"]


@pytest.mark.parametrize("kind", [*KINDS, "spot"])
def test_pose_of_a_part(kind, tmp_path):
    first, later = (
        scene(background() | shapes(tmp_path / "a.ply", moved)[kind], VIEW, max_depth=3)
        for moved in (False, True)
    )
    expected = rendered(tofrender.load_scene(later, optimize=False))
    loaded = with_motions(first, {"part": MOTION})
    resting = rendered(loaded)
    with tofrender.posed(loaded, TIME_S) as there:
        found = rendered(there)
    scale = expected.max()
    assert np.abs(resting - expected).max() > 0.01 * scale
    np.testing.assert_allclose(found.sum((2, 3)), expected.sum((2, 3)), atol=1e-3 * scale)
    assert np.array_equal(rendered(loaded), resting)


@pytest.mark.parametrize("kind", ["perspective", "thinlens"])
def test_pose_of_a_sensor(kind):
    view = VIEW | {"type": kind}
    view |= {"aperture_radius": 0.1, "focus_distance": 3.0} if kind == "thinlens" else {}
    parts = background() | {"ball": {"type": "sphere", "bsdf": diffuse(0.7)}}
    first = scene(parts, view | {"id": "eye"}, max_depth=3)
    placed = view | {"to_world": carried() @ view["to_world"]}
    expected = rendered(tofrender.load_scene(scene(parts, placed, max_depth=3), optimize=False))
    loaded = tofrender.load_scene(first, optimize=False)
    tofrender.moving(loaded, {"eye": MOTION})
    resting = rendered(loaded)
    with tofrender.posed(loaded, TIME_S) as there:
        found = rendered(there)
    scale = expected.max()
    np.testing.assert_allclose(found.sum((2, 3)), expected.sum((2, 3)), atol=1e-3 * scale)
    assert np.abs(resting - expected).max() > 0.01 * scale
    assert np.array_equal(rendered(loaded), resting)


def ball(motion: Motion = MOTION) -> mi.Scene:
    parts = background() | {"part": {"type": "sphere", "bsdf": diffuse(0.7)}}
    return with_motions(scene(parts, VIEW, max_depth=2), {"part": motion})


PLACE = (0.4, -0.2, 0.3)
OWN = {
    "sphere": {"type": "sphere", "center": list(PLACE), "radius": 0.2},
    "cube": {
        "type": "cube",
        "to_world": translate(*PLACE) @ rotate(unit((1, 2, 0)), 40),
    },
    "spot": {"type": "spot", "to_world": translate(*PLACE) @ rotate((0, 1, 0), 170)},
    "point": {"type": "point", "position": list(PLACE)},
    "sensor": VIEW | {"to_world": translate(*PLACE) @ rotate((0, 1, 0), 10)},
}


@pytest.mark.parametrize("by_name", [False, True])
@pytest.mark.parametrize("kind", OWN)
def test_a_part_rotates_about_its_own_center(kind, by_name):
    """Its center moves by the velocity alone, also where `center` or `position` is not 0."""
    spin = Motion(velocity=(0.0, 0.5, -0.25), angular_velocity=tuple(ω))
    moving = {"velocity": list(spin.velocity), "angular_velocity": list(spin.angular_velocity)}
    part = OWN[kind] | {"id": "part"} | ({} if by_name else moving)
    view = part if kind == "sensor" else VIEW
    parts = background() | ({} if kind == "sensor" else {"part": part})
    described = scene(parts, view, max_depth=2)
    loaded = with_motions(described, {"part": spin}) if by_name else tofrender.load_scene(described)
    motion = tofrender.motions_of(loaded)["part"]
    np.testing.assert_allclose(motion.rotation_center, PLACE, atol=1e-6)
    there = motion.matrix(TIME_S) @ [*PLACE, 1]
    np.testing.assert_allclose(there[:3], np.add(PLACE, (0, 0.2, -0.1)), atol=1e-6)


def test_a_mesh_rotates_about_the_center_of_its_box(tmp_path):
    """The sheet's z is from -0.4 to 0."""
    sheet = {"type": "ply", "filename": ply(tmp_path / "a.ply"), "to_world": translate(*PLACE)}
    spin = {"angular_velocity": list(ω)}
    loaded = tofrender.load_scene(scene(background() | {"part": sheet | spin}, VIEW, max_depth=2))
    center = tofrender.motions_of(loaded)["part"].rotation_center
    np.testing.assert_allclose(center, np.add(PLACE, (0, 0, -0.2)), atol=1e-6)


def test_the_center_of_a_part_is_not_known_without_a_scene():
    spin = Motion(angular_velocity=(0, 0, 1))
    with pytest.raises(ValueError, match="rotation_center is None"):
        spin.matrix(1.0)
    with pytest.raises(ValueError, match="rotation_center is None"):
        spin.affine()
    assert np.array_equal(Motion((0, 0, 2)).matrix(1.0)[:3, 3], (0, 0, 2))


def test_a_pose_ends_with_an_error():
    loaded = ball()
    resting, motions = rendered(loaded), tofrender.motions_of(loaded)
    with pytest.raises(KeyError), tofrender.posed(loaded, TIME_S):
        raise KeyError
    assert np.array_equal(rendered(loaded), resting)
    assert tofrender.motions_of(loaded) == motions


def test_a_pose_has_the_motion_of_its_time():
    """The axis of rotation has moved on, the velocity is the same."""
    loaded = ball()
    with tofrender.posed(loaded, 0.1):
        once = tofrender.motions_of(loaded)["part"]
        np.testing.assert_allclose(
            once.rotation_center, np.add(MOTION.rotation_center, (0.03, -0.02, 0.05))
        )
        assert (once.velocity, once.angular_velocity) == (MOTION.velocity, MOTION.angular_velocity)
        with pytest.raises(RuntimeError, match="already posed"), tofrender.posed(loaded, 0.2):
            pass


def test_a_pose_before():
    """A pose at a negative time is that from which the scene comes."""
    there = Motion(tuple(-np.array(MOTION.velocity)), tuple(-ω), MOTION.rotation_center)
    back, forth = ball(), ball(there)
    with tofrender.posed(back, -TIME_S), tofrender.posed(forth, TIME_S):
        np.testing.assert_array_equal(rendered(back), rendered(forth))


@pytest.mark.parametrize("time", [float("nan"), float("inf"), "1", None])
def test_times_that_are_none(time):
    loaded = ball()
    line = refusal(tofrender.posed(loaded, time).__enter__)
    assert line.startswith("time_s = ")
    assert "must be" in line


def print_of(loaded: mi.Scene) -> str:
    return tofrender.scenes.fingerprint.fingerprint(
        loaded, loaded.sensors()[0], loaded.integrator()
    )


def test_fingerprints():
    """They differ between motions, and between poses; scenes at rest have those of before."""
    described = scene(background() | {"part": {"type": "sphere"}}, VIEW, max_depth=2)
    resting = print_of(tofrender.load_scene(described, optimize=False))
    assert print_of(with_motions(described, {})) == resting
    assert print_of(with_motions(described, {"part": Motion()})) == resting
    moving = with_motions(described, {"part": MOTION})
    found = [print_of(moving), print_of(with_motions(described, {"part": Motion((0, 0, 1))}))]
    for time in (0.1, TIME_S):
        with tofrender.posed(moving, time):
            found.append(print_of(moving))
    assert len({resting, *found}) == 5
    assert print_of(moving) == found[0]
    for each in (MOTION, Motion((0, 0, 1))):  # Mitsuba's loader leaves no description
        found.append(print_of(tofrender.moving(mi.load_dict(described), {"part": each})))
    assert len({resting, *found}) == 7
