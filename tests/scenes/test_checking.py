"""What a loaded scene must not have: media, polarization, numbers that are none."""

import time
from contextlib import nullcontext
from functools import partial

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.limits import lower
from helpers.parts import area_light, diffuse, gray, point_light, translate
from helpers.scenes import refusal as refused
from helpers.support import camera, film, load, rendered, scene

from tofrender.scenes import BUILT_IN, checking
from tofrender.scenes.checking import check_scene
from tofrender.scenes.loading import load_scene

NAN, INF = float("nan"), float("inf")
FOG = {"type": "homogeneous"}

refusal = partial(refused, check_scene)


def scaled(x: float, y: float, z: float):
    return mi.ScalarTransform4f().scale([x, y, z])


def of(**parts) -> mi.Scene:
    return load({"type": "scene", **parts})


def test_built_in_scenes_are_sound():
    for name in BUILT_IN:
        check_scene(load_scene(name, optimize=False), media=True)


def test_what_looks_odd_and_is_right():
    """Mirrored transforms, black, an open shutter, spectra whose coefficients are negative."""
    odd = {
        "light": {"type": "point", "position": [-1, -1, -1], "intensity": gray(0.0)},
        "ball": {"type": "sphere", "radius": 1e-4, "to_world": scaled(-1, 1, 1)},
        "dust": {"type": "rectangle", "to_world": scaled(1e-6, 1e-6, 1), "bsdf": diffuse(0)},
        "camera": {"type": "perspective", "shutter_open": 0.0, "shutter_close": 0.0},
        "texture": {
            "type": "rectangle",
            "bsdf": {"type": "normalmap", "normalmap": bitmap(-0.5), "bsdf": diffuse(0.5)},
        },
    }
    check_scene(of(**odd, fog=FOG))  # Nothing is in this fog
    mi.set_variant("llvm_ad_spectral")
    blue = {"type": "point", "intensity": {"type": "rgb", "value": [0.0, 0.0, 1.0]}}
    check_scene(of(light=blue, black={"type": "sphere", "bsdf": diffuse(0)}))


def bitmap(value: float) -> dict:
    pixels = np.full((2, 2, 3), value, dtype=np.float32)
    return {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(pixels)}


def test_a_large_mesh_takes_milliseconds():
    mesh = mi.Mesh("large", 1_000_000, 10)
    parameters = mi.traverse(mesh)
    positions = np.ones(3_000_000, dtype=np.float32)
    positions[:9] = np.arange(9)
    parameters["vertex_positions"] = positions
    parameters["faces"] = np.tile([0, 1, 2], 10).astype(np.uint32)
    parameters.update()
    scene = of(mesh=mesh)
    start = time.process_time()
    for _ in range(5):
        check_scene(scene)
    assert time.process_time() - start < 0.5
    positions[-1] = NAN
    parameters["vertex_positions"] = positions
    parameters.update()
    assert refusal(scene) == "mesh.vertex_positions[2999999] = nan: must be finite numbers"


LOOKS_AT_ITSELF = mi.ScalarTransform4f().look_at([0, 0, 1], [0, 0, 1], [0, 1, 0])


def emitters(value: float) -> list[tuple[str, dict]]:
    odd = {"type": "rgb", "value": [value, 1.0, 1.0]}
    sky = np.ones((4, 8, 3), dtype=np.float32)
    dark = sky.copy()
    dark[0, 0, 0] = value
    return [
        ("a.radiance.value", {"type": "constant", "radiance": odd}),
        ("a.intensity.value", {"type": "point", "intensity": odd}),
        ("a.intensity.value", {"type": "spot", "intensity": odd}),
        ("a.irradiance.value", {"type": "directional", "irradiance": odd}),
        ("a.irradiance.value", {"type": "projector", "irradiance": odd}),
        ("a.irradiance.data", {"type": "projector", "irradiance": bitmap(value)}),
        ("a.scale", {"type": "envmap", "bitmap": mi.Bitmap(sky), "scale": value}),
        ("a.data[", {"type": "envmap", "bitmap": mi.Bitmap(dark)}),
        ("radiance.value", {"type": "rectangle", "emitter": area_light(value)}),
    ]


@pytest.mark.parametrize("value", [NAN, INF, -1.0])
def test_light_must_be_finite_and_positive(value):
    for name, emitter in emitters(value):
        said = refusal(of(a=emitter))
        assert said.startswith("a.")
        assert name in said
        assert f"{value:g}" in said
        assert "must be 0 or more" in said if value == -1 else "must be finite numbers" in said
    mi.set_variant("llvm_ad_spectral")
    lamp = {"type": "point", "intensity": {"type": "rgb", "value": [INF] * 3}}
    assert "lamp.intensity" in refusal(of(lamp=lamp))


PARAMETERS = [
    ("a.x_fov = nan", {"type": "perspective", "fov": NAN}),
    ("a.far_clip = inf", {"type": "perspective", "far_clip": INF}),
    ("a.aperture_radius = nan", {"type": "thinlens", "aperture_radius": NAN}),
    ("a.to_world = [1, 0, 0, nan,", {"type": "perspective", "to_world": translate(NAN, 0, 0)}),
    ("a.to_world", {"type": "perspective", "to_world": LOOKS_AT_ITSELF}),
    ("a.to_world = [nan", {"type": "sphere", "radius": NAN}),
    ("a.to_world = [inf", {"type": "sphere", "radius": INF}),
    ("a.to_world = [nan", {"type": "cylinder", "radius": NAN}),
    ("a.to_world", {"type": "rectangle", "to_world": translate(INF, 0, 0)}),
    ("a.position = [nan, 0, 0]", {"type": "point", "position": [NAN, 0, 0]}),
    ("a.bsdf.reflectance.value = [nan", {"type": "sphere", "bsdf": diffuse(NAN)}),
    ("a.vertex_positions[0] = nan", {"type": "cube", "to_world": translate(NAN, 0, 0)}),
]


@pytest.mark.parametrize(("said", "part"), PARAMETERS)
def test_parameters_must_be_finite(said, part):
    assert refusal(of(a=part)).startswith(said)


@pytest.mark.parametrize("kind", ["rectangle", "disk", "sphere", "cylinder", "cube"])
def test_a_scale_of_0(kind):
    flat = of(a={"type": kind, "to_world": scaled(0, 0, 0)})
    assert refusal(flat).startswith("a.")
    if kind != "cube":
        assert "singular" in refusal(flat)
        line = of(a={"type": kind, "to_world": scaled(1, 1, 0)})
        assert "singular" in refusal(line)


@pytest.mark.parametrize(
    ("axis", "right"), [((0, 0, 2), False), ((1, 1, 0), False), ((0, 0.6, 0.8), True)]
)
def test_a_rotation_about_an_axis_that_is_no_unit_vector(axis, right):
    """Mitsuba takes its transpose for its inverse: a disk lamp was 10 % too dark."""
    far = translate(9, 0, 0).rotate(axis, 40).scale([1, 1, 1e-3])
    turned = of(a={"type": "disk", "to_world": far})
    with nullcontext() if right else pytest.raises(ValueError, match=r"to_world = .* length 1"):
        check_scene(turned)


@pytest.mark.parametrize(
    ("radius", "x", "right"), [(0.008, 0, False), (0.009, 0, True), (1, 200, False), (4, 200, True)]
)
def test_scenes_must_be_larger_than_gaps_beside_rays(radius, x, right):
    ball = of(ball={"type": "sphere", "radius": radius, "center": [x, 0, 0]})
    with nullcontext() if right else pytest.raises(ValueError, match="scene: its diagonal is "):
        check_scene(ball)


def test_an_object_without_an_id_goes_by_its_class(tmp_path):
    flat = '<transform name="to_world"><scale x="0"/></transform>'
    shapes = "".join(f'<shape type="rectangle">{inner}</shape>' for inner in ("", flat))
    (tmp_path / "a.xml").write_text(f'<scene version="3.0.0">{shapes}</scene>')
    said = refusal(load_scene(tmp_path / "a.xml", optimize=False))
    assert said.startswith("Rectangle 2.to_world = ")
    assert "singular" in said


def test_a_rotation_about_a_long_axis_in_a_file_or_a_dict(tmp_path):
    """Of a mesh, which keeps no transform; XML has the same rotation."""
    askew = mi.ScalarTransform4f().rotate([1, 1, 0], 40)
    rotation = '<transform name="to_world"><rotate x="1" y="1" angle="40"/></transform>'
    path = tmp_path / "askew.xml"
    path.write_text(f'<scene version="3.0.0"><shape type="cube" id="a">{rotation}</shape></scene>')
    for source in ({"type": "scene", "a": {"type": "cube", "to_world": askew}}, path):
        said = refused(load_scene, source)
        assert said.startswith("a.to_world = ")
        assert "length 1" in said


@pytest.mark.parametrize("radius", [1.0, 0.009, 0.001])
@pytest.mark.parametrize("technique", ["transient_path", "transient_bdpt"])
def test_the_smallest_scenes_are_right(technique, radius, monkeypatch):
    """The inside of a diffuse sphere: energy and mean length of three bounces; .5 % are allowed.

    Noise is .02 %, smaller scenes are 1 % off.
    """
    lower(monkeypatch, scene_extent=0.0)
    bounces = np.arange(3)
    energy = 0.8 ** (bounces + 1) / np.pi
    window = film(4, 4, bins=4000, bin_width=0.004 * radius)
    eye = camera((0, 0, 0), (0, 0, 1), window, near_clip=1e-3 * radius, far_clip=9 * radius)
    ball = {"type": "sphere", "radius": radius, "flip_normals": True, "bsdf": diffuse(0.8)}
    described = scene({"ball": ball, "lamp": point_light((0, 0, 0), radius**2)}, eye, max_depth=4)
    described["integrator"]["type"] = technique
    steady, transient = rendered(described, 2048)
    arriving = transient.mean(axis=(0, 1, 3))
    length = arriving @ (np.arange(4000) + 0.5) * 0.004 / arriving.sum()
    errors = steady.mean() / energy.sum(), length / (energy @ (2 + 4 * bounces / 3) / energy.sum())
    error = np.abs(np.array(errors) - 1).max()
    assert error < 0.005 if radius > 0.008 else error > 0.01


def test_what_was_changed_after_the_load():
    scene = of(lamp={"type": "point"})
    parameters = mi.traverse(scene)
    parameters["lamp.intensity.value"] = -3.0
    parameters.update()
    assert refusal(scene).startswith("lamp.intensity.value = ")
    camera = mi.load_dict({"type": "perspective", "fov": NAN})
    assert "x_fov = nan" in refusal(of(lamp={"type": "point"}), camera)


def test_media_are_refused():
    """Of shapes, lamps, groups, and of the sensor that looks."""
    ball = {"type": "sphere", "bsdf": {"type": "null"}}
    end = " = HomogeneousMedium: "
    for side in ("interior", "exterior"):
        assert refusal(of(ball=ball | {side: FOG})).startswith(f"ball.{side}_medium{end}")
    assert refusal(of(lamp={"type": "point", "medium": FOG})).startswith(f"lamp.medium{end}")
    group = {"type": "shapegroup", "ball": ball | {"interior": FOG}}
    instance = {"type": "instance", "group": {"type": "ref", "id": "group"}}
    assert "interior_medium" in refusal(of(group=group, one=instance))
    scene = of(wet={"type": "perspective", "medium": FOG}, dry={"type": "perspective"})
    wet, dry = sorted(scene.sensors(), key=lambda each: each.id(), reverse=True)
    check_scene(scene, dry)
    assert refusal(scene, wet).startswith("wet.medium = ")
    assert refusal(scene).startswith("wet.medium = ")


def test_a_scene_of_another_variant():
    scene = of(ball={"type": "sphere"})
    mi.set_variant("llvm_ad_mono")
    line = refusal(scene)
    assert line.startswith("scene: belongs to the variant llvm_ad_rgb")
    assert "llvm_ad_mono" in line


@pytest.mark.parametrize("angle", [0.01, 0.04])
def test_spots_that_are_too_narrow_give_a_warning(angle):
    spot = {"type": "spot", "cutoff_angle": angle, "beam_width": 0.7 * angle}
    with pytest.warns(UserWarning, match=rf"lamp.cutoff_angle = {angle} degrees: .* wrong"):
        check_scene(of(lamp=spot))


def test_spots_of_a_twentieth_of_a_degree_are_right_to_a_percent():
    """Power of a beam of full intensity up to 3/4 of the angle, and a linear edge."""
    angle = np.radians(checking.NARROWEST_SPOT)
    spot = {"type": "spot", "cutoff_angle": checking.NARROWEST_SPOT, "intensity": 1.0}
    lamp = mi.load_dict(spot | {"beam_width": 0.75 * checking.NARROWEST_SPOT})
    check_scene(of(lamp=lamp))
    θ = np.linspace(0, 1.1 * angle, 100001)
    at = dr.zeros(mi.SurfaceInteraction3f, θ.size)
    at.p = mi.Point3f(mi.Float(np.sin(θ)), 0, mi.Float(np.cos(θ)))
    found = np.array(lamp.sample_direction(at, mi.Point2f(0.5))[1].x)
    expected = np.clip((angle - θ) / (0.25 * angle), 0, 1)
    assert np.sum(found * θ) == pytest.approx(np.sum(expected * θ), rel=0.01)
