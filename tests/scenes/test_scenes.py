"""The built-in scenes: their files, variants, integrators, windows of time, and bad arguments."""

import importlib
import pickle
import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from helpers.nlos import ALL as NLOS
from helpers.scenes import load, refusal
from helpers.support import parsed, require_equal, steady_twin, with_film, with_integrator

import tofrender
from tofrender.scenes import (
    BUILT_IN,
    START_OPL,
    caustics,
    cornell_box,
    cornell_box_flash,
    cornell_box_glass,
    cornell_box_mirror,
    cornell_box_steady_state,
    describe,
    fog,
    polarized,
)
from tofrender.scenes.light_transport import SPHERE_LIGHT_RADII
from tofrender.scenes.packing import packed, unpacked
from tofrender.scenes.views import WITH_DEPTH

ROOT = Path(__file__).parents[2]
GLASS, ROOMS = ["caustic", "mirror_and_glass"], ["lamp_in_fixture", "light_through_hole"]
CAUSTICS = [*GLASS, *ROOMS]
DENSEST = {
    "cornell_box_fog": fog.MAX_FOG,
    "lamp_in_milk": fog.MAX_MILK,
    "smoke_corridor": fog.MAX_SMOKE,
    "headlight_in_fog": fog.MAX_ROAD_FOG,
}
ANGLES = {"brewster_window": "polarizer", "strained_mirror_corridor": "angle"}
SPEEDS = {
    "fan": {"angular_speed": -3.0},
    "corridor": {"speed": -2.0, "swing": 4.0},
    "moving_mirror": {"speed": -5.0},
}
FOG, POLARIZED, MOVING = list(DENSEST), list(ANGLES), list(SPEEDS)
WITH_INTEGRATOR = [*CAUSTICS, *FOG, *POLARIZED, *MOVING]
BUSTS = ["bust_simple", "bust_ao"]
RECTANGLES = ["rectangle_light_quad", "rectangle_light_triangles"]
TRACED = ["veach", *(f"sphere_light_{size}" for size in SPHERE_LIGHT_RADII), *RECTANGLES]
PATH_TRACED = [*TRACED, "small_box"]
BOXES = ["cornell_box", *(f"cornell_box_{x}" for x in ("flash", "glass", "mirror", "steady_state"))]
FOLDERS = {
    "": ["cornell_box"],
    "a1": [*BUSTS, *PATH_TRACED],
    "caustics": CAUSTICS,
    "fog": FOG,
    "nlos": [*NLOS, "nlos_behind_fog"],
    "polarized": POLARIZED,
    "moving": MOVING,
}
FILES = {
    name: ROOT / "scenes" / f / f"{name}.xml" for f, names in FOLDERS.items() for name in names
}
MESHES = {
    **dict.fromkeys(BUSTS, ("bust",)),
    **dict.fromkeys(["nlos_z", "nlos_behind_fog"], ("hidden_z",)),
    "nlos_bunny": ("hidden_bunny",),
    "rectangle_light_triangles": ("upper-light", "lower-light"),
}
"""Shapes that are meshes of Mitsuba in the dict, and PLY files in the XML file."""
DATA = {
    "smoke_corridor": ("gridvolume", "grid", "smoke.vol", mi.VolumeGrid),
    "strained_mirror_corridor": ("bitmap", "bitmap", "retardance.exr", mi.Bitmap),
}
"""The same of a texture or volume: its plugin, its key, its file, and the type of both."""


def test_every_scene_has_a_file_and_every_file_a_scene():
    for folder, names in FOLDERS.items():
        assert {path.stem for path in (ROOT / "scenes" / folder).glob("*.xml")} == set(names)
    assert BUILT_IN.keys() - FILES.keys() == set(BOXES[1:])


def changes_of(name: str) -> dict:
    """Values for a file's defaults that are not those."""
    in_time = name not in FOLDERS["a1"]
    return {
        **{"width": 7, "spp": 3},
        **({"start_opl": 1.5, "temporal_bins": 5} if in_time else {}),
        **({"integrator": "path_tracer_nee"} if name in WITH_INTEGRATOR else {}),
        **({"sigma_t": 0.4} if name in (*FOG, "nlos_behind_fog") else {}),
        **({ANGLES[name]: 30.0} if name in POLARIZED else {}),
        **({"spheres": "mirror_glass"} if name == "small_box" else {}),
        **SPEEDS.get(name, {}),
    }


def small_box_of_a_file(nodes: dict, spheres: str) -> None:
    """Give the materials that are chosen by `spheres` their names in the dict; drop the others."""
    for name in [name for name in nodes if name.endswith(("-left", "-right"))]:
        kind, _, side = name.partition("-")
        node = nodes.pop(name)
        if kind == spheres:
            nodes[f"{side}-material"] = node
        for _, _, parts in nodes.values():
            if name in parts:
                parts.remove(name)
                parts.extend([f"{side}-material"] * (kind == spheres))
                parts.sort()


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("changed", [False, True])
def test_xml_is_the_dict(name, changed):
    changes = changes_of(name) if changed else {}
    described = BUILT_IN[name](**changes)
    meshes = set(MESHES.get(name, ()))
    assert {key for key, part in described.items() if isinstance(part, mi.Mesh)} == meshes
    expected = parsed({key: part for key, part in described.items() if key not in meshes})
    found = parsed(FILES[name], **changes)
    for mesh in meshes:
        found["scene"][2].remove(mesh)
        for part in [part for part in found if part == mesh or part.endswith(f" of {mesh}")]:
            del found[part]
    if name == "small_box":
        small_box_of_a_file(found, changes.get("spheres", "diffuse"))
    if name in DATA:
        plugin, key, file, kind = DATA[name]
        assert found[plugin][1].pop("filename") == file
        kept = np.array(kind(str(FILES[name].parent / file)))
        np.testing.assert_allclose(kept, np.array(expected[plugin][1].pop(key)), atol=1e-7)
    require_equal(found, expected, atol=3e-6 if name in BUSTS else 1e-6)  # ground of 50 m


@pytest.mark.parametrize("name", MESHES)
def test_meshes_of_a_file_are_those_of_the_dict(name):
    """Their vertices where they are placed, their materials and their light."""
    both = [
        {s.id(): mi.traverse(s) for s in tofrender.load_scene(source, optimize=False).shapes()}
        for source in (name, FILES[name])
    ]
    for mesh in MESHES[name]:
        ours, theirs = (each[mesh] for each in both)
        wanted = {key for key, value in ours if np.size(np.array(value))}
        assert wanted <= {key for key, _ in theirs}
        for key in wanted:
            np.testing.assert_allclose(
                np.array(theirs[key]), np.array(ours[key]), atol=2e-6, err_msg=f"{mesh}.{key}"
            )


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_scene_is_described_in_its_file_too(name):
    assert 20 < len(describe(name)) < 90
    if name in WITH_INTEGRATOR:
        assert FILES[name].read_text(encoding="utf-8").splitlines()[2].strip() == describe(name)


@pytest.mark.parametrize(
    ("name", "part", "texture", "data"),
    [
        ("smoke_corridor", "smoke", "sigma_t", fog.smoke_density),
        ("strained_mirror_corridor", "strained", "delta", polarized.retardance_of_plastic),
    ],
)
def test_data_go_to_another_process(name, part, texture, data):
    assert not data().flags.writeable
    described = BUILT_IN[name]()
    sent = unpacked(pickle.loads(pickle.dumps(packed("scene", described))))
    found, expected = (np.array(each[part][texture][DATA[name][1]]) for each in (sent, described))
    np.testing.assert_array_equal(found, expected)


def test_root_package_hands_the_builders_on(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    scenes = importlib.import_module("scenes")
    assert scenes.cornell_box is cornell_box
    assert set(scenes.__all__) == set(BUILT_IN)


def outline(part):
    """A description without its objects."""
    if isinstance(part, dict):
        return {key: outline(value) for key, value in part.items()}
    if isinstance(part, list):
        return [outline(value) for value in part]
    return part if isinstance(part, str | int | float) else type(part).__name__


def clear(part) -> None:
    for inner in part.values() if isinstance(part, dict) else part:
        if isinstance(inner, dict | list):
            clear(inner)
    part.clear()


@pytest.mark.parametrize("name", BUILT_IN)
def test_changing_a_scene_changes_no_later_one(name):
    described = BUILT_IN[name]()
    before = outline(described)
    shapes = [part for part in described.values() if isinstance(part, dict) and "bsdf" in part]
    assert name not in NLOS or len({id(each["bsdf"]) for each in shapes}) == len(shapes)
    clear(described)
    assert outline(BUILT_IN[name]()) == before


PLAIN = ["llvm_ad_rgb", "llvm_ad_mono", "llvm_ad_spectral"]
VARIANTS = [
    *((variant, [*FOLDERS["a1"], *WITH_INTEGRATOR]) for variant in PLAIN),
    *((f"llvm_ad_{each}_polarized", POLARIZED) for each in ("mono", "spectral")),
]


@pytest.mark.parametrize(
    ("variant", "name"), [(v, name) for v, names in VARIANTS for name in names]
)
def test_every_scene_renders_under_every_variant(variant, name):
    """From its file where that is another one than the tests' own."""
    mi.set_variant(variant)
    source = name if variant == "llvm_ad_rgb" else FILES[name]
    bins = {} if name in FOLDERS["a1"] else {"temporal_bins": 4}
    scene = tofrender.load_scene(source, width=16, height=12, **bins)
    found = mi.render(scene, spp=16)
    steady, *transient = (np.array(each) for each in (found if bins else [found]))
    assert np.isfinite(steady).all()
    assert steady.reshape(12, 16, -1)[..., 0].mean() > 1e-4
    assert all(np.isfinite(each).all() for each in transient)
    if name in (*CAUSTICS, *FOG):
        assert len(scene.emitters()) == 1


@pytest.mark.parametrize("variant", PLAIN)
def test_every_box_loads_under_other_variants(variant):
    mi.set_variant(variant)
    for name in BOXES:
        assert len(mi.load_dict(BUILT_IN[name](width=8, height=8, spp=1)).emitters()) == 1


@pytest.mark.parametrize("names", [CAUSTICS, FOG], ids=["caustics", "fog"])
def test_integrators_have_the_depth_that_is_given(names):
    """Each of them renders one of the scenes."""
    following = "transient_volpath", "transient_path", "path_tracer_mis"
    kinds = WITH_DEPTH if names is CAUSTICS else following
    for k, kind in enumerate(kinds):
        for name in names:
            scene = load(BUILT_IN[name](integrator=kind, max_depth=3, width=4, height=4))
            assert scene.integrator().max_depth == 3
            if name == names[k % len(names)]:
                assert np.isfinite(np.array(mi.render(scene, spp=1)[0])).all()


@pytest.mark.parametrize("name", PATH_TRACED)
def test_path_takes_the_place_of_the_path_tracers(name):
    scene = BUILT_IN[name](integrator="path", max_bounces=3)
    assert scene["integrator"] == {"type": "path", "max_depth": 4}
    assert BUILT_IN[name](integrator="path", max_bounces=-1)["integrator"]["max_depth"] == -1
    tracer = BUILT_IN[name](integrator="path_tracer_nee")["integrator"]
    assert tracer == {"type": "path_tracer_nee", "max_bounces": 8 if name == "small_box" else 1}


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, {}) for name in WITH_INTEGRATOR),
        *((name, {"lamp_radius": caustics.MAX_LAMP_RADIUS}) for name in GLASS),
        ("light_through_hole", {"hole_width": caustics.MAX_HOLE_WIDTH}),
    ],
)
def test_windows_start_before_the_first_light(name, options):
    """In scenes with small lamps, a little before: at most .4 m."""
    described = BUILT_IN[name](width=32, height=32, **options)
    start = described["sensor"]["film"]["start_opl"]
    window = {"temporal_bins": 50, "start_opl": start - 10, "bin_width_opl": 0.4}
    light = bins_of(with_film(described, **window), spp=256)
    assert light[:25].sum() == 0
    assert light[25 : 26 if name in CAUSTICS else None].sum() > 0


@pytest.mark.parametrize("name", CAUSTICS)
def test_windows_end_when_most_light_has_come(name):
    """Of the light that is not the lamp itself, as seen by the camera, or in glass."""
    described = with_integrator(BUILT_IN[name](width=32, height=32), hide_emitters=True)
    film = described["sensor"]["film"]
    window = {"temporal_bins": 10, "bin_width_opl": film["temporal_bins"] * film["bin_width_opl"]}
    light = bins_of(with_film(described, **window), spp=512)
    assert light[0] > 0.85 * light.sum()


@pytest.mark.parametrize("name", [*FOG, *POLARIZED, *MOVING])
def test_windows_hold_the_light(name):
    """A warning would fail the test."""
    found = tofrender.render(BUILT_IN[name](width=32, height=32), spp=64, progress=False)
    assert found.attrs["energy_outside_window"] < 0.01


def bins_of(described: dict, spp: int) -> np.ndarray:
    """Light of the whole picture in each bin."""
    return np.array(mi.render(load(described), spp=spp, seed=0)[1]).sum(axis=(0, 1, 3))


def test_same_picture_as_mitsubas_own_cornell_box():
    reference, ours = mi.cornell_box(), cornell_box_steady_state(width=24, height=24)
    for part in ("film", "sampler"):
        reference["sensor"][part] = ours["sensor"][part]
    pictures = [np.array(mi.render(mi.load_dict(s), spp=16, seed=1)) for s in (ours, reference)]
    np.testing.assert_allclose(*pictures, rtol=1e-3, atol=1e-4)


def test_variants_of_the_box():
    assert cornell_box_mirror()["red-wall"]["bsdf"]["type"] == "conductor"
    glass = cornell_box_glass(width=8)
    assert "small-box" not in glass
    sphere = glass["glass-sphere"]
    assert sphere["center"][1] - sphere["radius"] == pytest.approx(-1)  # stands on the floor
    assert sphere["bsdf"]["int_ior"] == 1.5


def test_flash_stands_at_the_camera_and_its_window_starts_in_time():
    flash = cornell_box_flash()
    camera = np.array(flash["sensor"]["to_world"].matrix)[:3, 3]
    np.testing.assert_allclose(flash["light"]["position"], camera)
    assert flash["sensor"]["film"]["start_opl"] == START_OPL["flash"]
    assert cornell_box_flash(start_opl=1.0)["sensor"]["film"]["start_opl"] == 1.0
    nearest = np.linalg.norm(camera - [1, 0, 1])  # the middle of a side wall's front edge
    assert 0 < 2 * nearest - START_OPL["flash"] < 0.2


def test_flash_and_ceiling_light_are_about_equally_bright():
    flash, ceiling = (
        np.median(np.array(mi.render(load(steady_twin(build(width=24, height=24))), spp=64)))
        for build in (cornell_box_flash, cornell_box)
    )
    assert 0.6 < flash / ceiling < 1.6


FINITE = "must be a finite number"
BAD = [
    ("cornell_box", "light", "flsh", r"did you mean 'flash'\?"),
    ("caustic", "integrator", "transient_pat", r"did you mean 'transient_path'\?"),
    ("caustic", "integrator", "ao", "must be one of transient_path"),
    ("smoke_corridor", "integrator", "transient_volpat", r"did you mean 'transient_volpath'\?"),
    ("smoke_corridor", "integrator", "volpath", "must be one of transient_path"),
    ("veach", "integrator", "path_tracer_mist", r"did you mean 'path_tracer_mis'\?"),
    ("small_box", "spheres", "glas", "must be one of diffuse, mirror_"),
    *(
        (name, parameter, 0.6, rf"{FINITE} of meters above 0 and at most {most}\Z")
        for parameter, most, names in (
            ("lamp_radius", caustics.MAX_LAMP_RADIUS, GLASS),
            ("hole_width", caustics.MAX_HOLE_WIDTH, ["light_through_hole"]),
        )
        for name in names
    ),
    *(
        (name, "sigma_t", 2000, rf"{FINITE} of 1/m from 0 to {m:g}\Z")
        for name, m in DENSEST.items()
    ),
    *((name, a, 200, rf"{FINITE} of degrees from -180 to 180\Z") for name, a in ANGLES.items()),
    *((name, s, 2e5, rf"{FINITE} of .*/s from") for name, of in SPEEDS.items() for s in of),
    ("corridor", "swing", -1.0, rf"{FINITE} of rad/s from 0 to 100000\Z"),
    ("nlos_z", "device", (0, 0, 0), "must be .* z above 0"),
    ("nlos_z", "device", (0, 0), "must be 3 finite numbers of meters"),
    ("nlos_z", "target", (0, 2), "must be on the wall, from -1 to 1"),
    ("nlos_z", "target", "00", "must be 2 finite numbers"),
    ("nlos_z", "wall_reflectance", 1.1, f"{FINITE} from 0"),
    ("nlos_z", "hidden_reflectance", 0, f"{FINITE} above 0"),
    ("nlos_patch", "tilt", 90, "must be between -90 and 90 degrees"),
    ("nlos_patch", "position", (0, 0, 0), ".* wall"),
    ("nlos_bunny", "distance", 0.1, ".* wall"),
]


@pytest.mark.parametrize(("name", "parameter", "value", "must"), BAD)
def test_limits_of_arguments_are_told(name, parameter, value, must):
    """Values that are bad for every scene are in `tests/inputs/test_functions.py`."""
    said = refusal(BUILT_IN[name], **{parameter: value})
    assert re.match(rf"{parameter} = .*: {must}", said)


def test_an_occluder_must_be_behind_the_device():
    said = refusal(BUILT_IN["nlos_z"], distance=0.2)
    assert re.match("device = .*: with an occluder", said)
