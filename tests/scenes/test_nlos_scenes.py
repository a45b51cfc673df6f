"""The scenes of non-line-of-sight captures: facts, files, identities, sight, and their plans."""

from __future__ import annotations

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.nlos import (
    ALL,
    BOXES,
    CONFOCAL,
    REGISTERED,
    WALLS,
    WITH_WALL,
    builder,
    register_retroreflector,
    stands_alone,
)
from mitsuba import parser

import tofrender
from tofrender.scenes import describe
from tofrender.scenes.bunny import bunny
from tofrender.scenes.meshes import STROKE, letter_z

FOLDER = Path(__file__).parents[2] / "scenes" / "nlos"
SMALL = {"width": 16, "height": 12, "spp": 4}
DEVICES = dict.fromkeys(WALLS, (-0.5, 0, 0.25)) | dict.fromkeys(BOXES, (0, 0, 0))


@pytest.fixture(autouse=True)
def _registered():
    """Register the retroreflector in the active variant."""
    register_retroreflector()


def nodes(source, **parameters) -> dict:
    """Every node of a scene, by id or plugin: plugin, properties, plugins of its children."""
    config = parser.ParserConfig(mi.variant())
    config.parallel = False
    if isinstance(source, Path):
        texts = {name: str(value) for name, value in parameters.items()}
        state = parser.parse_file(config, str(source), **texts)
    else:
        state = parser.parse_dict(config, source)
    parser.transform_resolve(config, state)
    found = {}
    for node in state.nodes:
        plain, children = {}, []
        for key, value in node.props.items():
            if isinstance(value, mi.Properties.ResolvedReference):
                children.append(nodes_text(state.nodes[value.index()]))
            elif not isinstance(value, mi.Mesh):
                plain[key] = np.array(value.matrix) if hasattr(value, "matrix") else value
        plugin = node.props.plugin_name()
        shapes = ("rectangle", "cube", "sphere", "twosided")
        if plugin in ("diffuse", "retroreflector"):
            continue  # they are in `children`
        found[node.props.id() if plugin in shapes else plugin] = (plugin, plain, sorted(children))
    return found


def nodes_text(node) -> str:
    """A material with its numbers, any other node by its plugin."""
    plain = [
        np.round(np.array(v, dtype=float), 6).tolist()
        for k, v in node.props.items()
        if k in ("reflectance", "lobe_exponent")
    ]
    return " ".join([node.props.plugin_name(), *map(str, plain)])


# ------------------------------------------------------------------------------------- files


def test_every_scene_has_a_file_and_a_name():
    assert {path.stem for path in FOLDER.glob("*.xml")} == {*ALL, "nlos_behind_fog"}
    assert tofrender.scenes.loading.find_scene("nlos-z") == "nlos_z"
    for name in ALL:
        assert 20 < len(describe(name)) <= 72


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("changes", [{}, {"width": 7, "spp": 3, "temporal_bins": 5}])
def test_xml_is_the_dict(name, changes):
    from_dict = nodes(builder(name, **changes))
    from_xml = nodes(FOLDER / f"{name}.xml", **changes)
    ready_made = {"ply"} if name in ("nlos_z", "nlos_bunny") else set()
    assert from_xml.keys() - ready_made == from_dict.keys()
    for node, (plugin, plain, children) in from_dict.items():
        assert from_xml[node][0] == plugin
        in_xml = [c for c in from_xml[node][2] if c != "ply"]
        assert in_xml == children, node
        assert from_xml[node][1].keys() == plain.keys(), node
        for key, value in plain.items():
            found = from_xml[node][1][key]
            if isinstance(value, str | bool):
                assert found == value
            else:
                np.testing.assert_allclose(np.array(found), np.array(value), atol=1e-6)


@pytest.mark.parametrize(("name", "file"), [("nlos_z", "letter_z"), ("nlos_bunny", "bunny")])
def test_xml_places_the_mesh_as_the_dict_does(name, file):
    mesh = builder(name)[f"hidden_{file.removeprefix('letter_')}"]
    text = (FOLDER / f"{name}.xml").read_text()
    assert f"../meshes/{file}.ply" in text
    to_world = mi.ScalarTransform4f().translate([0, 0, 1])
    if name == "nlos_bunny":
        assert '<rotate y="1" angle="25"/>' in text
        assert '<translate y="-0.44" z="1"/>' in text
        to_world = mi.ScalarTransform4f().translate([0, -0.44, 1]).rotate([0, 1, 0], 25)
    path = str(FOLDER.parent / "meshes" / f"{file}.ply")
    placed = mi.load_dict({"type": "ply", "filename": path, "to_world": to_world})
    ours, theirs = mi.traverse(mesh), mi.traverse(placed)
    for what in ("vertex_positions", *(["vertex_normals"] if name == "nlos_bunny" else [])):
        np.testing.assert_allclose(np.array(ours[what]), np.array(theirs[what]), atol=2e-6)


@pytest.mark.parametrize("name", ALL)
def test_every_scene_loads_with_its_own_plugins(name):
    needed = {"retroreflector", "confocal_projector"}
    needed |= {"nlos_capture_meter", "transient_nlos_path"} if name in WALLS else set()
    assert needed <= REGISTERED
    for source in (name, FOLDER / f"{name}.xml"):
        scene = tofrender.load_scene(source, width=8, height=8, spp=2)
        assert list(scene.sensors()[0].film().size()) == [8, 8]


# ---------------------------------------------------------------------------------- identity


@pytest.mark.parametrize("optimize", [True, False])
@pytest.mark.parametrize("name", WITH_WALL)
def test_shapes_keep_their_identity(name, optimize):
    described = builder(name, **SMALL)
    named = {key for key in described if key.startswith(("relay", "hidden", "occluder"))}
    assert "relay_wall" in named
    scene = stands_alone(described, optimize)
    assert sorted(shape.id() for shape in scene.shapes()) == sorted(named)
    wall = next(shape for shape in scene.shapes() if shape.id() == "relay_wall")
    half = 1 if name in WALLS else 2
    assert list(np.array(wall.bbox().max - wall.bbox().min).ravel()) == [2 * half, 2 * half, 0]


def test_what_a_default_load_does_to_equal_materials():
    """Rectangles and cubes of equal material are merged, ids of materials or not; sensors help."""
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}}
    far = mi.ScalarTransform4f().translate([0, 0, 5])
    parts = {
        "relay_wall": {"type": "rectangle", "bsdf": grey},
        "hidden_cube": {"type": "cube", "to_world": far, "bsdf": grey | {"id": "own"}},
        "hidden_ball": {"type": "sphere", "center": [0, 0, 9], "bsdf": grey},
    }
    scene = tofrender.load_scene({"type": "scene", **parts})
    assert sorted(shape.id() for shape in scene.shapes()) == ["", "hidden_ball"]
    meter = {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}}
    parts["relay_wall"] = parts["relay_wall"] | {"sensor": meter}
    scene = tofrender.load_scene({"type": "scene", **parts})
    assert {shape.id() for shape in scene.shapes()} == set(parts)
    scene = tofrender.load_scene({"type": "scene", **parts}, optimize=False)
    assert {shape.id() for shape in scene.shapes()} == set(parts)


# ------------------------------------------------------------------------------------- sight


def points_on(scene: mi.Scene, start: str, count: int = 4096) -> tuple:
    """Points and normals on the shapes whose ids start so."""
    numbers = mi.load_dict({"type": "independent"})
    numbers.seed(3, count)
    chosen = [shape for shape in scene.shapes() if shape.id().startswith(start)]
    for shape in chosen:
        sample = shape.sample_position(0, numbers.next_2d())
        yield sample.p, sample.n


def sees(scene: mi.Scene, origin, points) -> np.ndarray:
    """Whether nothing is between a place and points."""
    si = dr.zeros(mi.Interaction3f, dr.width(points))
    si.p = mi.Point3f(origin)
    way = points - si.p
    ray = mi.Ray3f(si.p, way, 1 - 1e-4, 0, [])
    return ~np.array(scene.ray_test(ray))


@pytest.mark.parametrize("name", [*WALLS, *BOXES])
def test_device_sees_the_wall_and_nothing_hidden(name):
    scene = stands_alone(builder(name, **({"occluder": True} if name in WALLS else {})))
    for points, _ in points_on(scene, "hidden"):
        assert not sees(scene, DEVICES[name], points).any()
    (wall, _), *_ = points_on(scene, "relay_wall")
    visible = sees(scene, DEVICES[name], wall)
    if name in WALLS:
        assert visible.all()
    else:
        assert (visible == (np.array(wall.y) > 0)).mean() > 0.999  # the upper half


@pytest.mark.parametrize("name", WITH_WALL)
def test_wall_sees_every_hidden_shape(name):
    """From the wall's point that the device looks at, some part of each; and they face the wall."""
    scene = stands_alone(builder(name))
    spot = [0.0, 0.0, 0.01] if name in WALLS else [0.1, 0.5, -1.99]
    for points, normals in points_on(scene, "hidden"):
        facing = np.array(dr.dot(normals, mi.Point3f(spot) - points)) > 1e-3
        assert facing.any()
        # the shape itself is in the way of its far side; its near side is lit but for neighbours
        lifted = points + 1e-3 * normals
        share = (sees(scene, spot, lifted) & facing).sum() / facing.sum()
        assert share > 0.2


def test_occluder_shadows_little_between_wall_and_letter():
    scene = stands_alone(builder("nlos_z"))
    (wall, _), *_ = points_on(scene, "relay_wall")
    (letter, _), *_ = points_on(scene, "hidden")
    ray = mi.Ray3f(wall, letter - wall, 1 - 1e-4, 0, [])
    ray.o += 1e-4 * ray.d
    assert 0 < np.array(scene.ray_test(ray)).mean() < 0.02


@pytest.mark.parametrize("name", WALLS)
def test_window_starts_before_the_first_hidden_light(name):
    scene = stands_alone(builder(name))
    film = builder(name)["relay_wall"]["sensor"]["film"]
    nearest = min(float(dr.min(points.z)[0]) for points, _ in points_on(scene, "hidden"))
    assert 0.1 < 2 * nearest - film["start_opl"] < 0.2


def test_camera_scenes_render():
    """A point light at the camera in place of the projector: the wall is lit, nothing is NaN."""
    for name in CONFOCAL:
        scene = stands_alone(builder(name, **SMALL), lamp=True)
        steady, transient = (np.array(x) for x in mi.render(scene, spp=4))
        assert np.isfinite(transient).all()
        assert steady.shape == (12, 16, 3)
        rows = steady.mean(axis=(1, 2))
        assert rows[:6].min() > 0.02
        if name in BOXES:  # below is the box, which is almost black but retroreflects
            assert (steady[8:, :, 1:] < 1e-3).mean() > 0.5 or name == "wall_box_hi_nlos"


# ----------------------------------------------------------------------------------- shapes


def test_facts_of_the_confocal_scenes():
    scene = builder("wall_box_hi_nlos")
    assert scene["integrator"] == {
        "type": "transient_path",
        "camera_unwarp": False,
        "use_nlos_only": False,
        "max_depth": 8,
        "confocal_projector": builder("wall_box_behind")["integrator"]["confocal_projector"],
    }
    assert scene["integrator"]["confocal_projector"]["fov"] == 0.78
    sensor = scene["sensor"]
    assert (sensor["fov"], sensor["film"]["temporal_bins"]) == (45.0, 1000)
    assert sensor["sampler"] == {"type": "independent", "sample_count": 1000}
    spheres = [part for part in scene.values() if isinstance(part, dict) and "radius" in part]
    assert sorted({part["radius"] for part in spheres}) == [0.06, 0.08]
    assert all(part["bsdf"]["reflectance"]["value"] == [0, 0.05, 0] for part in spheres)
    box = builder("ourbox_confocal")
    assert box["sensor"]["film"]["temporal_bins"] == 700
    assert box["sensor"]["sampler"]["sample_count"] == 4096
    assert box["sensor"]["fov"] == 39.3077


def test_no_two_parts_share_a_description():
    """Changing a scene, or one of its shapes, changes no other."""
    for name in ALL:
        scene = builder(name)
        materials = [
            part["bsdf"] for part in scene.values() if isinstance(part, dict) and "bsdf" in part
        ]
        assert len({id(each) for each in materials}) == len(materials)
        scene["integrator"].clear()
        assert builder(name)["integrator"]["type"]


def test_letter_is_a_z_with_even_strokes():
    vertices, faces = letter_z()
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (cross[:, 2] < 0).all()  # faces -z, towards the wall
    area = np.linalg.norm(cross, axis=1).sum() / 2
    bar = 0.8 * STROKE
    diagonal = vertices[7] - vertices[4]
    across = np.array([vertices[5, 0] - vertices[4, 0], 0, 0])
    width = np.linalg.norm(np.cross(across, diagonal)) / np.linalg.norm(diagonal)
    assert width == pytest.approx(STROKE, rel=1e-9)
    assert area == pytest.approx(2 * bar + across[0] * (0.8 - 2 * STROKE))
    assert diagonal[0] > 0  # its diagonal rises to the right of who looks along -z
    assert diagonal[1] > 0
    np.testing.assert_allclose([vertices.min(0)[:2], vertices.max(0)[:2]], [[-0.4] * 2, [0.4] * 2])


def test_bunny_is_closed_smooth_and_stands_on_the_ground():
    vertices, faces, normals = bunny()
    assert 5000 <= len(faces) <= 20000
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)
    np.testing.assert_array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
    assert len(vertices) - len(edges) // 2 + len(faces) == 2  # a sphere, without handles
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.einsum("fi,fi->f", corners[:, 0], cross).sum() / 6
    assert 0.05 < volume < 0.09
    areas = np.linalg.norm(cross, axis=1) / 2
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    assert (2 * areas / sides.max(axis=1)).min() > 1e-3  # height over the longest side [m]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
    cosine = np.einsum("fi,fki->fk", cross / (2 * areas[:, None]), normals[faces])
    assert cosine.min() > 0.3
    assert np.quantile(cosine, 0.05) > 0.95
    assert vertices[:, 1].min() == 0
    assert vertices[:, 1].max() == pytest.approx(0.88, abs=0.01)
    ears = vertices[vertices[:, 1] > 0.75]
    assert (abs(ears[:, 2]) > 0.03).all()  # two of them, apart


@pytest.mark.parametrize("tilt", [0.0, 30.0, -60.0])
def test_patch_has_its_size_place_and_tilt(tilt):
    patch = builder("nlos_patch", side=0.04, position=(0.3, -0.2, 0.8), tilt=tilt)["hidden_patch"]
    shape = mi.load_dict(patch)
    assert float(shape.surface_area()[0]) == pytest.approx(0.0016, rel=1e-5)
    middle = shape.sample_position(0, mi.Point2f(0.5))
    np.testing.assert_allclose(np.array(middle.p).ravel(), [0.3, -0.2, 0.8], atol=1e-6)
    angle = np.deg2rad(tilt)
    expected = [-np.sin(angle), 0, -np.cos(angle)]
    np.testing.assert_allclose(np.array(middle.n).ravel(), expected, atol=1e-6)


# --------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"width": 0}, "width = 0: must be an integer from 1 to 65536"),
        ({"temporal_bins": 2.5}, "temporal_bins = 2.5: must be an integer"),
        ({"bin_width_opl": 0.0}, "bin_width_opl = 0.0: must be a finite number of metres above 0"),
        ({"spp": True}, "spp = True: must be an integer from 1 to 16777216"),
    ],
)
def test_bad_arguments_are_one_line(name, arguments, text):
    with pytest.raises(ValueError, match=text) as error:
        builder(name, **arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "arguments", "text"),
    [
        ("nlos_z", {"distance": 0}, "distance = 0: must be a finite number of metres above 0"),
        ("nlos_z", {"distance": 0.2}, "device = .*: with an occluder, must be nearer"),
        ("nlos_z", {"device": (0, 0, 0)}, "device = .*: must be before the wall, z above 0"),
        ("nlos_z", {"device": (0, 0)}, r"device = \(0, 0\): must be 3 finite numbers of metres"),
        ("nlos_z", {"target": (0, 2)}, "target = .*: must be on the wall, from -1 to 1"),
        ("nlos_z", {"target": "00"}, "target = '00': must be 2 finite numbers"),
        ("nlos_z", {"occluder": 1}, "occluder = 1: must be True or False"),
        (
            "nlos_z",
            {"wall_reflectance": 1.1},
            "wall_reflectance = 1.1: must be a finite number from 0",
        ),
        (
            "nlos_z",
            {"hidden_reflectance": 0},
            "hidden_reflectance = 0: must be a finite number above 0",
        ),
        (
            "nlos_plane",
            {"hidden_reflectance": "x"},
            "hidden_reflectance = 'x': must be a finite number",
        ),
        ("nlos_plane", {"half_width": -1}, "half_width = -1: must be a finite number of metres"),
        ("nlos_patch", {"side": 0}, "side = 0: must be a finite number of metres above 0"),
        ("nlos_patch", {"tilt": 90}, "tilt = 90: must be between -90 and 90 degrees"),
        ("nlos_patch", {"position": (0, 0, 0)}, "position = .*: must leave all of the patch"),
        ("nlos_bunny", {"distance": 0.1}, "distance = 0.1: must leave all of the bunny before"),
        ("wall_box_behind", {"max_depth": 0}, "max_depth = 0: must be -1"),
        ("ourbox_confocal", {"start_opl": float("nan")}, "start_opl = nan: must be a finite"),
    ],
)
def test_bad_settings_are_one_line(name, arguments, text):
    with pytest.raises(ValueError, match=text) as error:
        builder(name, **arguments)
    assert "\n" not in str(error.value)
