"""What draws change: each kind of change does what it says to the scene, and to nothing else."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from tofrender.datasets.dataset_config import read_config
from tofrender.datasets.scene import load, scene_of
from tofrender.scenes import cornell_box

ROOT = Path(__file__).parents[2]


def scene(source: object = "cornell_box", tables: dict | None = None, **vary: dict) -> dict:
    """The first record's scene where these quantities are fixed or drawn."""
    kind = {"distribution": "fixed"}
    given = {n: (v if "distribution" in v else kind | v) for n, v in vary.items()}
    outputs = {"capture": {}} if source == "nlos_z" else {"steady": True}
    config = {"records": 1, "scene": source, "outputs": outputs, "vary": given} | (tables or {})
    read = read_config(config)
    return scene_of(read, read.draw(0))


def box_of(described: dict, name: str = "small-box") -> tuple[np.ndarray, np.ndarray]:
    """Bounds of a shape of a scene, and their middle."""
    shape = described[name]
    if isinstance(shape, dict):
        plain = {n: part for n, part in shape.items() if n not in ("bsdf", "emitter")}
        shape = mi.load_dict(plain)
    box = shape.bbox()
    low, high = np.ravel(np.array(box.min, float)), np.ravel(np.array(box.max, float))
    return high - low, (low + high) / 2


ACROSS = 0.6 * (np.cos(np.radians(17)) + np.sin(np.radians(17)))
SIZE, MIDDLE = np.array([ACROSS, 0.6, ACROSS]), np.array([0.335, -0.7, 0.38])


def pose(kind: str, value, **more) -> dict:
    return {kind: "small-box", "value": value} | more


POSES = {
    "moves": ([pose("move", [0.1, 0.2, 0.3]), pose("move", [1, 0, 0])], SIZE, [1.435, -0.5, 0.68]),
    "position": ([pose("position", [1, 2, 3])], SIZE, [1, 2, 3]),
    "turn": ([pose("turn", 17.0)], 0.6, MIDDLE),  # Straight then
    "turn around": ([pose("turn", 90.0, around=[0, 0, 0])], SIZE, [0.38, -0.7, -0.335]),
    "scale": ([pose("scale", 2)], 2 * SIZE, MIDDLE),
    "scale of axes": ([pose("scale", [1, 2, 1])], SIZE * [1, 2, 1], MIDDLE),
}


@pytest.mark.parametrize("name", POSES)
def test_poses(name):
    changes, size, middle = POSES[name]
    found = box_of(scene(**{f"change_{k}": change for k, change in enumerate(changes)}))
    np.testing.assert_allclose(found[0], np.broadcast_to(size, 3), atol=2e-5)
    np.testing.assert_allclose(found[1], middle, atol=1e-5)


def test_sizes_turns_and_moves_do_not_depend_on_their_order():
    changes = {
        "a": {"move": "small-box", "value": [0.1, 0.2, 0.3]},
        "b": {"turn": "small-box", "value": 30},
        "c": {"scale": "small-box", "value": 2},
    }
    matrices = [
        np.array(scene(**dict(order))["small-box"]["to_world"].matrix, float)
        for order in (list(changes.items()), list(changes.items())[::-1])
    ]
    np.testing.assert_allclose(*matrices, atol=1e-12)


def test_spheres_lights_and_ready_made_meshes_have_poses_too():
    ball = {"objects": {"ball": {"type": "sphere", "center": [1, 0, 0], "radius": 0.5}}}
    grown = scene(
        tables=ball, a={"scale": "ball", "value": 2}, b={"position": "ball", "value": [0] * 3}
    )
    size, middle = box_of(grown, "ball")
    np.testing.assert_allclose(size, 2, atol=1e-5)
    np.testing.assert_allclose(middle, 0, atol=1e-5)
    _, middle = box_of(scene(a={"position": "light", "value": [1, 2, 3]}), "light")
    np.testing.assert_allclose(middle, [1, 2, 3], atol=1e-5)
    flash = scene("cornell_box_flash", a={"move": "light", "value": [0, 1, 0]})
    assert flash["light"]["position"] == [0, 1, 3.9]
    before = box_of(scene("nlos_z"), "hidden_z")
    turned = scene(
        "nlos_z", a={"turn": "hidden_z", "value": 90}, b={"move": "hidden_z", "value": [0, 0, 1]}
    )
    size, middle = box_of(turned, "hidden_z")
    np.testing.assert_allclose(size, before[0][[2, 1, 0]], atol=1e-5)
    np.testing.assert_allclose(middle, before[1] + [0, 0, 1], atol=1e-5)


def test_what_cannot_be_changed_so():
    with pytest.raises(ValueError, match="'light': is a point; must be an object with a size"):
        scene("cornell_box_flash", a={"scale": "light", "value": 2})
    with pytest.raises(ValueError, match=r"'light.emitter.radiance': becomes \[inf, inf, inf\]"):
        scene(a={"path": "light.emitter.radiance", "value": 1e308, "times": True})


def test_values_by_their_path():
    where = "light.emitter.radiance"
    assert scene(a={"path": where, "value": [1, 2, 3]})["light"]["emitter"]["radiance"] == {
        "type": "rgb",
        "value": [1, 2, 3],
    }
    gray = scene(a={"path": f"{where}.value", "value": 5})
    assert gray["light"]["emitter"]["radiance"]["value"] == [5, 5, 5]
    brighter = scene(a={"path": where, "value": 2, "times": True})
    old = cornell_box()["light"]["emitter"]["radiance"]["value"]
    assert brighter["light"]["emitter"]["radiance"]["value"] == [2 * x for x in old]
    assert scene(a={"path": "integrator.max_depth", "value": 3})["integrator"]["max_depth"] == 3
    assert scene(a={"path": "sensor.fov_axis", "value": "x"})["sensor"]["fov_axis"] == "x"


def test_reflectances():
    white = scene(a={"reflectance": "white", "value": 0.5})["white"]
    assert white["reflectance"]["value"] == [0.5] * 3
    red = cornell_box()["red"]["reflectance"]["value"]
    half = scene(a={"reflectance": "red", "value": [0.5, 1, 1], "times": True})
    assert half["red"]["reflectance"]["value"] == [0.5 * red[0], *red[1:]]
    both = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {}}}
    sides = scene(tables={"materials": {"both": both}}, a={"reflectance": "both", "value": 0.25})
    assert sides["both"]["bsdf"]["reflectance"]["value"] == [0.25] * 3


def test_materials():
    mirror = {"materials": {"mirror": {"type": "conductor", "material": "none"}}}
    made = scene(tables=mirror, a={"material": "small-box", "value": "mirror"})
    assert made["small-box"]["bsdf"] == {"type": "ref", "id": "mirror"}
    assert made["large-box"]["bsdf"]["id"] == "white"
    kinds = {s.id(): s.bsdf().class_name() for s in mi.load_dict(made, optimize=False).shapes()}
    assert kinds["small-box"] == "SmoothConductor"
    file = scene(
        str(ROOT / "scenes/cornell_box.xml"), mirror, a={"material": "floor", "value": "red"}
    )
    assert [part for part in file["floor"].values() if isinstance(part, dict)] == [
        {"type": "ref", "id": "red"}
    ]


def test_the_camera():
    camera = scene(
        a={"camera": "origin", "value": [1, 2, 3]},
        b={"camera": "target", "value": [0, 0, 0]},
        c={"camera": "fov", "value": 25},
    )["sensor"]
    assert camera["fov"] == 25
    matrix = np.array(camera["to_world"].matrix, float)
    np.testing.assert_allclose(matrix[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(matrix[:3, 2], -np.array([1, 2, 3]) / np.sqrt(14), atol=1e-6)
    alone = np.array(scene(a={"camera": "origin", "value": [1, 2, 3]})["sensor"]["to_world"].matrix)
    np.testing.assert_allclose(alone[:3, 2], [0, 0, -1], atol=1e-6)  # Looks where it did
    rolled = scene(a={"camera": "origin", "value": [0, 0, 3], "up": [1, 0, 0]})["sensor"]
    np.testing.assert_allclose(np.array(rolled["to_world"].matrix)[:3, 1], [1, 0, 0], atol=1e-6)


LOOK = mi.ScalarTransform4f().look_at
ROLL, SCALE = 25.0, [0.4, 0.3, 2.0]


def own_camera(*, mirrored: bool = False) -> dict:
    """Return a scene with an orthographic camera that has a scale, a roll, or a mirrored view."""
    scale = [-SCALE[0] if mirrored else SCALE[0], *SCALE[1:]]
    roll = mi.ScalarTransform4f().rotate([0, 0, 1], ROLL) @ mi.ScalarTransform4f().scale(scale)
    to_world = LOOK([1.0, 0.5, 3.0], [0.1, 0.2, 0.0], [0, 1, 0]) @ roll
    film = {"type": "hdrfilm", "width": 8, "height": 6}
    sensor = {"type": "orthographic", "to_world": to_world, "film": film}
    return {"type": "scene", "eye": sensor, "light": {"type": "constant"}}


def view_of(described: dict) -> np.ndarray:
    """Origins of the rays through three corners of an orthographic camera's film (3, 3)."""
    camera: dict = {n: v for n, v in described["eye"].items() if n != "sampler"}
    rays = [
        mi.load_dict(camera).sample_ray(0.0, 0.5, mi.Point2f(*at), mi.Point2f(0.5))[0]
        for at in ((0, 0), (1, 0), (0, 1))
    ]
    return np.array([np.ravel(np.array(ray.o, float)) for ray in rays])


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_moved_camera_keeps_its_scale_and_roll(mirrored):
    source = own_camera(mirrored=mirrored)
    before = view_of(source)
    place = {"camera": "origin", "value": [2.0, 1.0, 4.0]}
    np.testing.assert_allclose(
        view_of(scene(source, a=place)), np.add(before, [1, 0.5, 1]), atol=2e-6
    )

    # A new target: the camera has the same roll and the same scale
    there = {"camera": "target", "value": [0.3, -0.2, 0.5]}
    found = scene(source, a=place, b=there)
    roll = mi.ScalarTransform4f().rotate([0, 0, 1], ROLL)
    size = [-SCALE[0] if mirrored else SCALE[0], *SCALE[1:]]
    expected = LOOK(place["value"], there["value"], [0, 1, 0]) @ roll
    expected = expected @ mi.ScalarTransform4f().scale(size)
    matrix = np.array(found["eye"]["to_world"].matrix, float)
    np.testing.assert_allclose(matrix, np.array(expected.matrix, float), atol=2e-6)

    # The edges of the view have their length
    edges = np.diff(view_of(found)[[1, 0, 2]], axis=0)
    np.testing.assert_allclose(
        np.linalg.norm(edges, axis=1), [2 * SCALE[0], 2 * SCALE[1] * 6 / 8], rtol=1e-5
    )

    # With `up`, the roll is 0, and the scale is the same
    upright = scene(source, a=place | {"up": [1, 0, 0]}, b=there)
    expected = LOOK(place["value"], there["value"], [1, 0, 0]) @ mi.ScalarTransform4f().scale(size)
    matrix = np.array(upright["eye"]["to_world"].matrix, float)
    np.testing.assert_allclose(matrix, np.array(expected.matrix, float), atol=2e-6)


def test_a_camera_that_looks_down_can_be_moved():
    source = own_camera()
    source["eye"]["to_world"] = LOOK([1, 3, 2], [1, 0, 2], [0, 0, 1]) @ (
        mi.ScalarTransform4f().scale(SCALE)
    )
    before = view_of(source)
    place = {"camera": "origin", "value": [2.0, 3.0, 4.0]}
    np.testing.assert_allclose(
        view_of(scene(source, a=place)), np.add(before, [1, 0, 2]), atol=2e-6
    )
    aimed = scene(source, a={"camera": "target", "value": [0, 0, 0]})
    columns = np.linalg.norm(np.array(aimed["eye"]["to_world"].matrix, float)[:3, :3], axis=0)
    np.testing.assert_allclose(columns, SCALE, rtol=1e-6)
    with pytest.raises(ValueError, match=r"\Avary.a.camera: the viewing direction .*parallel"):
        scene(source, a={"camera": "target", "value": [1, 0, 2]})


def test_who_is_there():
    some = {"present": ["small-box", "large-box"]}
    assert "large-box" not in scene(a=some | {"distribution": "choice", "values": ["small-box"]})
    none = some | {"distribution": "subset", "most": 0}
    assert not {"small-box", "large-box"} & set(scene(a=none))
    assert {"small-box", "large-box"} <= set(scene(a=some | {"distribution": "subset", "least": 2}))


def test_arguments_and_parameters():
    assert scene(a={"argument": "light", "value": "flash"})["light"]["type"] == "point"
    file = str(ROOT / "scenes/cornell_box.xml")
    assert scene(file, a={"parameter": "max_depth", "value": 3})["integrator"]["max_depth"] == 3


def test_a_scene_given_as_a_dict_stays_as_it_is():
    given = cornell_box()
    changed = scene(
        given, a={"move": "small-box", "value": [1, 0, 0]}, b={"reflectance": "red", "value": 1}
    )
    assert given["red"] == cornell_box()["red"]
    assert str(given["small-box"]["to_world"]) == str(cornell_box()["small-box"]["to_world"])
    assert changed["red"] != given["red"]


def test_objects_are_described_by_their_place():
    tables = {
        "objects": {
            "lamp": {
                "type": "rectangle",
                "to_world": {"position": [0, 0.9, 0], "axis": [1, 0, 0], "angle": 90, "scale": 0.1},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [9, 9, 9]}},
            }
        },
        "render": {"width": 4, "height": 4},
    }
    described = scene(tables=tables)
    size, middle = box_of(described, "lamp")
    np.testing.assert_allclose(middle, [0, 0.9, 0], atol=1e-6)
    np.testing.assert_allclose(size, [0.2, 0, 0.2], atol=1e-6)
    given = {"records": 1, "scene": "cornell_box", "outputs": {"steady": True}} | tables
    assert len(load(described, read_config(given)).emitters()) == 2
