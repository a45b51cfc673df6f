"""The steady scenes of sampling and path tracing: their files, their mesh, their lights."""

from __future__ import annotations

from math import pi
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from mitsuba import parser

import tofrender
from tofrender.runtime import plugins
from tofrender.scenes import BUILT_IN
from tofrender.scenes.bust import PROFILE, bust
from tofrender.scenes.light_transport import (
    SPHERE_LIGHT_CENTER,
    SPHERE_LIGHT_POWER,
    SPHERE_LIGHT_RADII,
    VEACH_LIGHTS,
    VEACH_PLATES,
    VEACH_POWER,
)
from tofrender.scenes.meshes import HALVES, write
from tofrender.scenes.parts import PATH_TRACERS

FOLDER = Path(__file__).parents[2] / "scenes"
BUSTS = ["bust_simple", "bust_ao"]
SPHERE_LIGHTS = [f"sphere_light_{size}" for size in SPHERE_LIGHT_RADII]
RECTANGLES = ["rectangle_light_quad", "rectangle_light_triangles"]
PATH_TRACED = ["veach", *SPHERE_LIGHTS, *RECTANGLES, "small_box"]
OWN_INTEGRATORS = {"simple", "ao", *PATH_TRACERS}
SMALL = {"width": 24, "height": 18, "spp": 4}


def load(source, **parameters) -> mi.Scene:
    """A scene for Mitsuba's integrators: `path`, or depth and normals where `path` sees no light.

    Args:
        source: A dict, or the path of an XML file.
        **parameters: Values for the file's defaults.
    """
    config = parser.ParserConfig(mi.variant())
    config.parallel = False
    config.merge_equivalent = config.merge_meshes = False  # merging shuffles the lights
    resolver = mi.file_resolver()
    before = list(resolver)
    try:
        if isinstance(source, Path):
            resolver.prepend(str(source.parent))
            texts = {name: str(value) for name, value in parameters.items()}
            state = parser.parse_file(config, str(source), **texts)
        else:
            state = parser.parse_dict(config, source)
        parser.transform_resolve(config, state)
        for node in state.nodes:
            name = node.props.plugin_name()
            if name in ("simple", "ao"):
                node.props = mi.Properties("aov")
                node.props["aovs"] = "depth:depth,normal:sh_normal"
            elif name in PATH_TRACERS:
                bounces = node.props["max_bounces"]
                node.props = mi.Properties("path")
                node.props["max_depth"] = bounces + 1
        parser.transform_all(config, state)
        return parser.instantiate(config, state)
    finally:
        resolver.clear()
        for folder in before:
            resolver.append(folder)


def picture(scene: mi.Scene, spp: int, seed: int = 0) -> np.ndarray:
    return np.array(mi.render(scene, spp=spp, seed=seed), dtype=np.float64)


def xml(name: str) -> Path:
    return FOLDER / "a1" / f"{name}.xml"


# ------------------------------------------------------------------------------------- files


def test_every_scene_has_a_file():
    assert {path.stem for path in (FOLDER / "a1").glob("*.xml")} == {*BUSTS, *PATH_TRACED}


@pytest.mark.parametrize("name", [*BUSTS, *PATH_TRACED])
def test_xml_is_the_dict(name):
    described = load(BUILT_IN[name](**SMALL))
    from_file = load(xml(name), **SMALL)
    assert len(described.emitters()) == len(from_file.emitters())
    pictures = [picture(scene, spp=4) for scene in (described, from_file)]
    assert pictures[0].std() > 0.01
    np.testing.assert_allclose(*pictures, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("name", [*BUSTS, *PATH_TRACED])
def test_xml_has_the_same_defaults(name):
    described, from_file = load(BUILT_IN[name]()), load(xml(name))
    for scene in (described, from_file):
        assert scene.integrator().class_name() in ("PathIntegrator", "AOVIntegrator")
    for attribute in ("film", "sampler"):
        ours, theirs = (getattr(s.sensors()[0], attribute)() for s in (described, from_file))
        assert ours.class_name() == theirs.class_name()
        if attribute == "film":
            assert list(ours.size()) == list(theirs.size())
            assert str(ours.rfilter()) == str(theirs.rfilter())
        else:
            assert ours.sample_count() == theirs.sample_count()
    names = [
        "".join(line for line in str(s.integrator()).splitlines()) for s in (described, from_file)
    ]
    assert names[0] == names[1]


def test_xml_of_the_small_box_knows_both_kinds_of_spheres():
    of_dict = load(BUILT_IN["small_box"](spheres="mirror_glass", **SMALL))
    of_file = load(xml("small_box"), spheres="mirror_glass", **SMALL)
    pictures = [picture(scene, spp=4) for scene in (of_dict, of_file)]
    np.testing.assert_allclose(*pictures, rtol=1e-3, atol=1e-5)
    other = picture(load(xml("small_box"), **SMALL), spp=4)
    assert abs(pictures[0] - other).max() > 0.1


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_spectral"])
def test_every_scene_loads_under_other_variants(variant):
    mi.set_variant(variant)
    for name in (*BUSTS, *PATH_TRACED):
        assert np.isfinite(picture(load(BUILT_IN[name](**SMALL)), spp=1)).all()


@pytest.mark.parametrize("name", [*BUSTS, *PATH_TRACED])
def test_every_scene_loads_with_its_own_integrator(name):
    assert {each.name for each in plugins.PLUGINS.values()} >= OWN_INTEGRATORS
    for source in (name, xml(name)):
        scene = tofrender.load_scene(source, width=16, height=12, spp=2)
        image = picture(scene, spp=2)
        assert np.isfinite(image).all()
        assert image.mean() > 0.01


@pytest.mark.parametrize("name", PATH_TRACED)
def test_path_takes_the_place_of_the_path_tracers(name):
    scene = BUILT_IN[name](integrator="path", max_bounces=3, **SMALL)
    assert scene["integrator"] == {"type": "path", "max_depth": 4}
    assert BUILT_IN[name](integrator="path", max_bounces=-1)["integrator"]["max_depth"] == -1
    tracer = BUILT_IN[name](integrator="path_tracer_nee")["integrator"]
    assert tracer == {"type": "path_tracer_nee", "max_bounces": 8 if name == "small_box" else 1}
    image = picture(tofrender.load_scene(scene), spp=4)
    assert image.mean() > 0.05


def test_changing_a_scene_changes_no_later_one():
    BUILT_IN["bust_simple"]()["integrator"]["position"].clear()
    assert len(BUILT_IN["bust_simple"]()["integrator"]["position"]) == 3
    BUILT_IN["small_box"]()["left-material"].clear()
    assert BUILT_IN["small_box"]()["left-material"]["type"] == "diffuse"


# -------------------------------------------------------------------------------------- mesh


def test_bust_is_closed_and_faces_outwards():
    vertices, faces, _ = bust()
    assert 5000 <= len(faces) <= 20000
    assert set(faces.ravel()) == set(range(len(vertices)))
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)  # no directed edge twice ...
    np.testing.assert_array_equal(  # ... and each one runs the other way in a neighbour
        np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0)
    )
    assert len(vertices) - len(edges) // 2 + len(faces) == 2  # Euler: a sphere, without handles
    corners = vertices[faces]
    volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert 0.015 < volume < 0.03


def test_bust_has_no_degenerate_triangle():
    vertices, faces, _ = bust()
    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(*np.moveaxis(np.diff(corners, axis=1), 1, 0)), axis=-1) / 2
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    assert areas.min() > 1e-7  # a tenth of a square millimetre
    assert (2 * areas / sides.max(axis=1)).min() > 5e-5  # height over the longest side [m]


def test_bust_normals_are_unit_and_agree_with_the_faces():
    vertices, faces, normals = bust()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
    corners = vertices[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    cosine = np.einsum("fi,fki->fk", flat, normals[faces])
    assert cosine.min() > 0.2  # at the edges of foot and hair
    assert np.quantile(cosine, 0.05) > 0.9


def test_bust_stands_on_the_ground_and_looks_forwards():
    vertices, _, normals = bust()
    assert vertices[:, 1].min() == 0
    assert vertices[:, 1].max() == pytest.approx(0.67, abs=0.01)
    assert vertices[:, 1].max() >= PROFILE[-1, 0]
    top, bottom = vertices[:, 1].argmax(), vertices[:, 1].argmin()
    assert normals[top, 1] > 0.9
    assert normals[bottom, 1] < -0.9
    nose = vertices[(vertices[:, 1] > 0.47) & (vertices[:, 1] < 0.51)]
    tip = nose[np.hypot(nose[:, 0], nose[:, 2]).argmax()]
    assert tip[2] > 0.1
    assert np.rad2deg(np.arctan2(tip[0], tip[2])) == pytest.approx(18, abs=3)


def test_mesh_files_are_the_meshes(tmp_path):
    write(tmp_path)
    kept = FOLDER / "meshes"
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in kept.iterdir()}
    for path in tmp_path.iterdir():
        assert (kept / path.name).stat().st_size < 1_000_000
        ours, theirs = (
            mi.traverse(mi.load_dict({"type": "ply", "filename": str(folder / path.name)}))
            for folder in (tmp_path, kept)
        )
        assert (np.array(ours["faces"]) == np.array(theirs["faces"])).all()
        for what in ("vertex_positions", "vertex_normals"):
            np.testing.assert_allclose(np.array(ours[what]), np.array(theirs[what]), atol=1e-6)
    with pytest.raises(NotADirectoryError, match="must be a folder that exists"):
        write(tmp_path / "missing")


# ------------------------------------------------------------------------------------ lights


def power(light: dict) -> np.ndarray:
    """Power of a sphere light [W]: its area times pi times its radiance."""
    radiance = np.array(light["emitter"]["radiance"]["value"])
    return 4 * pi * light["radius"] ** 2 * pi * radiance


def test_lights_of_veach_have_equal_power_and_distinct_colours():
    scene = BUILT_IN["veach"]()
    powers = [power(scene[f"{name}-light"]) for name in VEACH_LIGHTS]
    np.testing.assert_allclose([each.mean() for each in powers], VEACH_POWER)
    assert len({tuple(each.round(6)) for each in powers}) == len(VEACH_LIGHTS)
    radii = [scene[f"{name}-light"]["radius"] for name in VEACH_LIGHTS]
    assert radii == sorted(radii)
    assert radii[-1] / radii[0] >= 20


def test_camera_of_veach_sees_every_light():
    scene = BUILT_IN["veach"](max_bounces=0)
    image = picture(load(scene), spp=16)
    for name in VEACH_LIGHTS:
        radiance = scene[f"{name}-light"]["emitter"]["radiance"]["value"]
        whole = np.isclose(image, radiance, rtol=1e-3).all(axis=2)  # pixels that see nothing else
        assert whole.any(), name
        assert not whole[0].any(), name  # not cut by the frame
        assert not whole[:, [0, -1]].any(), name
    assert (image.max(axis=2) > 0).mean() < 0.1


def test_every_plate_of_veach_mirrors_the_lights_into_the_camera():
    for name, (_, y, z, tilt) in VEACH_PLATES.items():
        angle = np.deg2rad(tilt)
        normal = np.array([-np.sin(angle), np.cos(angle)])  # y and z
        to_camera, to_lights = np.array([4 - y, 14 - z]), np.array([4.2 - y, -1 - z])
        mirrored = 2 * normal * (normal @ to_camera) - to_camera
        cosine = mirrored @ to_lights / np.linalg.norm(mirrored) / np.linalg.norm(to_lights)
        assert cosine > np.cos(np.deg2rad(2)), name


def reflection(scene: mi.Scene, plate: str, light: str) -> np.ndarray:
    """Whether each pixel of 192 x 128 sees the mirror image of `light` in `plate` of `veach`."""
    index = dr.arange(mi.UInt32, 192 * 128)
    at = mi.Point2f((index % 192 + 0.5) / 192, (index // 192 + 0.5) / 128)
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, at, 0.5)
    hit = scene.ray_intersect(ray)
    shapes = {shape.id(): mi.ShapePtr(shape) for shape in scene.shapes()}
    mirrored = hit.spawn_ray(hit.to_world(mi.reflect(hit.wi)))
    reached = scene.ray_intersect(mirrored).shape
    seen = (hit.shape == shapes[f"{plate}-plate"]) & (reached == shapes[f"{light}-light"])
    return np.array(seen).reshape(128, 192)


@pytest.mark.statistical
def test_veach_separates_the_ways_to_sample():
    """Noise of Mitsuba's `direct` with either or both ways, where mirror and light are extremes.

    Light sampling was 217 times better for the small light on the rough plate, material sampling
    206 times for the large light on the smooth plate. Both together took one sample each and had
    1.7 and 0.6 times the noise of the better one alone.
    """
    noise = {}
    for way, (lights, materials) in {"nee": (1, 0), "mats": (0, 1), "mis": (1, 1)}.items():
        scene = BUILT_IN["veach"](width=192, height=128)
        scene["integrator"] = {
            "type": "direct",
            "emitter_samples": lights,
            "bsdf_samples": materials,
        }
        loaded = load(scene)
        noise[way] = np.std([picture(loaded, 16, seed) for seed in range(8)], axis=0, ddof=1)
    small_and_rough = reflection(loaded, "roughest", "green")
    large_and_smooth = reflection(loaded, "smooth", "red")
    assert small_and_rough.sum() > 10
    assert large_and_smooth.sum() > 200
    nee, mats, mis = (noise[way][small_and_rough].mean() for way in ("nee", "mats", "mis"))
    assert mats > 30 * nee
    assert mis < 2 * nee
    nee, mats, mis = (noise[way][large_and_smooth].mean() for way in ("nee", "mats", "mis"))
    assert nee > 30 * mats
    assert mis < 2 * mats


def test_sphere_lights_have_equal_power_and_are_wholly_visible():
    for size, radius in SPHERE_LIGHT_RADII.items():
        scene = BUILT_IN[f"sphere_light_{size}"]()
        np.testing.assert_allclose(power(scene["light"]), SPHERE_LIGHT_POWER)
        assert scene["light"]["radius"] == radius < SPHERE_LIGHT_CENTER[1]  # above the floor
        assert radius < SPHERE_LIGHT_CENTER[2] + 1.6  # in front of the wall


@pytest.mark.parametrize(("width", "height"), [(32, 24), (24, 32), (64, 16)])
def test_camera_does_not_see_the_sphere_lights(width, height):
    for name in SPHERE_LIGHTS:
        image = picture(load(BUILT_IN[name](width=width, height=height, max_bounces=0)), spp=64)
        assert image.max() == 0


@pytest.mark.statistical
def test_sphere_lights_light_floor_and_wall_as_a_point_of_their_power_would():
    """L = ρ/π · Φ cosθ / (4π d²) at each pixel's center, for each radius.

    The standard error of a pixel is at most 0.5 % of it, and its mean and its center's value differ
    by less than 0.3 %, but for the two rows that see the edge of floor and wall. 4 % is seven
    standard errors.
    """
    size = {"width": 32, "height": 24}
    scene = load(BUILT_IN["sphere_light_small"](**size))
    index = dr.arange(mi.UInt32, 32 * 24)
    at = mi.Point2f((index % 32 + 0.5) / 32, (index // 32 + 0.5) / 24)
    ray, _ = scene.sensors()[0].sample_ray(0, 0.5, at, 0.5)
    hit = scene.ray_intersect(ray)
    to_light = np.array(SPHERE_LIGHT_CENTER)[:, None] - np.array(hit.p)
    distance = np.linalg.norm(to_light, axis=0)
    cosine = (np.array(hit.n) * to_light).sum(axis=0) / distance
    albedo = np.where(np.array(hit.n)[1] > 0.5, [[0.75], [0.65], [0.5]], [[0.2], [0.5], [0.55]])
    expected = albedo / pi * SPHERE_LIGHT_POWER * cosine / (4 * pi * distance**2)
    expected = expected.T.reshape(24, 32, 3)
    floor = np.array(hit.n)[1].reshape(24, 32) > 0.5
    edge = floor.any(axis=1) & ~np.roll(floor, 1, axis=0).all(axis=1)
    inside = ~(edge | np.roll(edge, -1))
    assert inside.sum() == 22
    means = []
    for name in SPHERE_LIGHTS:
        image = picture(load(BUILT_IN[name](**size)), spp=64)
        np.testing.assert_allclose(image[inside], expected[inside], rtol=0.04)
        means.append(image.mean())
    np.testing.assert_allclose(means, means[0], rtol=1e-3)


@pytest.mark.statistical
def test_quad_and_two_triangles_give_the_same_picture():
    """Means over 4 x 4 pixels of 8 seeds: no block may be off by 6 of its standard errors.

    With 7 + 7 degrees of freedom, |t| > 6 has probability 3e-5; 36 blocks and 3 channels that
    move together make a false alarm about once in a thousand runs, and the seeds are fixed.
    """
    pictures = []
    for name in RECTANGLES:
        scene = load(BUILT_IN[name](width=24, height=24))
        seeds = np.stack([picture(scene, spp=64, seed=seed) for seed in range(8)])
        pictures.append(seeds.reshape(8, 6, 4, 6, 4, 3).mean(axis=(2, 4)))
    a, b = pictures
    error = np.sqrt((a.var(axis=0, ddof=1) + b.var(axis=0, ddof=1)) / 8) + 1e-4
    assert (abs(a.mean(axis=0) - b.mean(axis=0)) / error).max() < 6
    assert a.mean() == pytest.approx(b.mean(), rel=5e-3)


@pytest.mark.parametrize("optimize", [True, False])
def test_triangles_are_two_lights(optimize):
    quad, triangles = (
        tofrender.load_scene(BUILT_IN[name](integrator="path", **SMALL), optimize=optimize)
        for name in RECTANGLES
    )
    assert len(quad.emitters()) == 1
    assert len(triangles.emitters()) == len(HALVES) == 2
    panel = quad.emitters()[0].get_shape()
    halves = [light.get_shape() for light in triangles.emitters()]
    area = float(panel.surface_area()[0])
    np.testing.assert_allclose([float(h.surface_area()[0]) for h in halves], area / 2, rtol=1e-5)
    at = mi.Point2f(0.3)
    for half in halves:
        normals = [np.array(s.sample_position(0, at).n).ravel() for s in (half, panel)]
        np.testing.assert_allclose(*normals, atol=1e-5)


@pytest.mark.statistical
def test_light_of_the_small_box_is_partly_indirect():
    direct, all_of_it = (
        picture(load(BUILT_IN["small_box"](width=16, height=16, max_bounces=bounces)), spp=64)
        for bounces in (1, 8)
    )
    share = 1 - np.median(direct) / np.median(all_of_it)
    assert 0.3 < share < 0.8


# --------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize("name", [*BUSTS, *PATH_TRACED])
@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"width": 0}, "width = 0: must be an integer from 1 to 65536"),
        ({"height": 2.5}, "height = 2.5: must be an integer"),
        ({"spp": 0}, "spp = 0: must be an integer from 1 to 16777216"),
    ],
)
def test_bad_arguments_are_one_line(name, arguments, text):
    with pytest.raises(ValueError, match=text) as error:
        BUILT_IN[name](**arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", PATH_TRACED)
@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"max_bounces": -2}, r"max_bounces = -2: must be -1 \(no limit\) or an integer from 0"),
        ({"max_bounces": 1.0}, r"max_bounces = 1.0: must be -1 \(no limit\) or an integer"),
        ({"max_bounces": True}, "max_bounces = True: must be -1"),
        ({"integrator": "path_tracer_mist"}, "did you mean 'path_tracer_mis'?"),
        ({"integrator": None}, "integrator = None: must be one of path_tracer_mats"),
    ],
)
def test_bad_integrators_are_one_line(name, arguments, text):
    with pytest.raises(ValueError, match=text) as error:
        BUILT_IN[name](**arguments)
    assert "\n" not in str(error.value)


def test_bad_spheres_are_one_line():
    with pytest.raises(
        ValueError, match="spheres = 'glas': must be one of diffuse, mirror_"
    ) as error:
        BUILT_IN["small_box"](spheres="glas")
    assert "\n" not in str(error.value)
