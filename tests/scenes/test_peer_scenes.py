"""mitransient's scene files load and render as they are, and rightly."""

import re
import subprocess
import sys
import warnings
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from helpers import peer_scenes
from helpers.peer_scenes import tags
from helpers.scenes import refusal as refused
from helpers.support import agree, over_seeds
from oracles.nlos import Nodes, Setup, total

import tofrender
from tofrender.nlos.device.laser import axis
from tofrender.scenes.meshes import letter_z

ROOT = Path(__file__).parents[2]
DEVICE = (-0.5, 0.0, 0.25)
QUIET = pytest.mark.filterwarnings(
    "ignore:.*has no effect", "ignore:time_sampling = ", "ignore:.*do not look at the relay"
)


def edited(path: Path, *changes: tuple[str, str]) -> Path:
    """The file with some of its text replaced: (pattern, text)."""
    text = path.read_text(encoding="utf-8")
    for pattern, new in changes:
        assert re.search(pattern, text), pattern
        text = re.sub(pattern, new, text)
    path.write_text(text, encoding="utf-8")
    return path


def at_pixel(x: float, y: float) -> str:
    return f'<point name="laser_lookat_pixel" x="{x}" y="{y}" z="0"/>'


def at_point(x: float, y: float, z: float = 0) -> str:
    return f'<point name="laser_lookat_3d" x="{x}" y="{y}" z="{z}"/>'


def refusal(call, *arguments, **options) -> str:
    """What Mitsuba passes on in its own words, too."""
    with pytest.raises((ValueError, RuntimeError)) as error:
        call(*arguments, **options)
    text = str(error.value.__cause__ or error.value)
    assert "\n" not in text
    return text


def apart(path: Path, **settings) -> mi.Scene:
    return tofrender.load_scene(path, optimize=False, **settings)


def bins(loaded: mi.Scene, spp: int, seed: int = 0) -> np.ndarray:
    return np.array(mi.render(loaded, spp=spp, seed=seed)[1], dtype=np.float64)[..., 0]


def summed(loaded: mi.Scene, spp: int) -> np.ndarray:
    """(seeds, bins), all pixels together."""
    return over_seeds(lambda seed: bins(loaded, spp, seed).sum(axis=(0, 1)), range(12))


def coarse(histograms: np.ndarray) -> np.ndarray:
    """Ten bins in one, behind the sum of all."""
    rows = len(histograms)
    return np.column_stack([histograms.sum(axis=1), histograms.reshape(rows, -1, 10).sum(axis=2)])


@pytest.mark.parametrize("write", [peer_scenes.z_simple, peer_scenes.z_room])
def test_files_are_rendered_as_they_are(write, tmp_path):
    """Shapes without ids have the names of the file."""
    path = write(tmp_path, spp=1)
    loaded = mi.load_file(str(path))
    steady, transient = mi.render(loaded)
    assert (steady.shape, transient.shape) == ((32, 32, 3), (32, 32, 300, 3))
    assert np.array(transient).sum() > 0
    assert loaded.sensors()[0].sampler().sample_count() == 1
    names = [shape.id() for shape in apart(path).shapes()]
    assert names == [f"elm__{k}" for k in range(3, 3 + len(names))]


@pytest.mark.statistical
@pytest.mark.parametrize("write", [peer_scenes.z_simple, peer_scenes.z_room])
def test_hidden_geometry_sampling_of_what_the_camera_does_not_see(write, tmp_path):
    """Nothing says which shape is the wall: the same light, with far less noise."""
    loaded = apart(write(tmp_path, size=4))
    loaded.integrator().filter_bounces = 3
    sampled = coarse(summed(loaded, 1024))
    loaded.integrator().samples_hidden = False
    plain = coarse(summed(loaded, 8192))
    assert agree(sampled, plain, rounding=1e-3)
    if write is peer_scenes.z_simple:
        assert sampled[:, 0].std() < 0.3 * plain[:, 0].std()


@pytest.mark.statistical
def test_a_merged_file_is_right_and_says_so(tmp_path):
    """One shape that is wall and letter: the light is the same, and a line tells of the noise."""
    path = peer_scenes.z_simple(tmp_path, size=4, flat=True)
    merged = mi.load_file(str(path))
    assert len(merged.shapes()) == 1
    with pytest.warns(UserWarning, match=r"\Anlos_hidden_geometry_sampling: .*optimize=False.*\Z"):
        found = coarse(summed(merged, 4096))
    expected = coarse(summed(apart(path), 1024))
    assert agree(found, expected, rounding=1e-3)
    assert not agree(1.05 * found, expected, rounding=1e-3)


def test_a_merged_wall_cannot_be_named_or_captured(tmp_path):
    merged = mi.load_file(str(peer_scenes.z_simple(tmp_path, size=4, flat=True)))
    assert "optimize=False" in refusal(tofrender.capture, merged, spp=1, progress=False)
    named = '<string name="relay_wall" value="elm__3"/>'
    path = peer_scenes.z_simple(tmp_path, size=4, flat=True, more=named)
    assert "optimize=False" in refusal(mi.render, mi.load_file(str(path)), spp=1)
    assert bins(apart(path), 16).sum() > 0


PROGRAM = """
import sys, warnings
warnings.simplefilter("ignore")
sys.path[:0] = [sys.argv[1], sys.argv[1] + "/.."]
import mitsuba as mi, numpy as np
import test_peer_scenes as test
import mitransient
loaded = mi.load_file(sys.argv[2])
np.save(sys.argv[3], test.summed(loaded, 8192))
"""


def of_mitransient(path: Path, save: Path) -> np.ndarray:
    """What it renders of a file, in a process of its own, where the plugins are its own."""
    command = [sys.executable, "-c", PROGRAM, str(ROOT / "tests/scenes"), str(path), str(save)]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return np.load(save)


@pytest.mark.statistical
def test_mitransient_renders_the_simple_file_alike(tmp_path):
    path = peer_scenes.z_simple(tmp_path, size=4)
    theirs = coarse(of_mitransient(path, tmp_path / "theirs.npy"))
    ours = coarse(summed(apart(path), 8192))
    assert agree(ours, theirs, rounding=1e-3)
    assert not agree(1.1 * ours, theirs, rounding=1e-3)
    assert not agree(np.roll(ours, 1, axis=1), theirs, rounding=1e-3)


@QUIET
@pytest.mark.parametrize("mode", ["single", "confocal", "exhaustive"])
def test_captures_of_a_camera_know_the_wall(mode, tmp_path):
    """The only shape that the pixels look at."""
    path = peer_scenes.z_simple(tmp_path)
    data = tofrender.capture(path, mode=mode, grid=(4, 4), spp=16, progress=False)
    assert data["transient"].sum() > 0
    seen = data["sensor_grid"].values
    assert seen[..., 2] == pytest.approx(0, abs=1e-5)
    inside = np.abs(seen[..., :2]).max(axis=-1) <= 1
    assert 4 < inside.sum() < 16
    assert np.array_equal(data["on_wall"].values, inside)
    dark = data["transient"].transpose("y", "x", ...).values[~inside]
    assert np.all(dark == 0)


def test_captures_of_rooms_are_told_the_wall(tmp_path):
    path = edited(peer_scenes.z_room(tmp_path), ('value="40"', 'value="110"'))
    said = refusal(tofrender.capture, path, grid=(8, 8), spp=1, progress=False)
    assert "'elm__4', 'elm__5'" in said
    with pytest.warns(UserWarning, match=r"\Asensor: \d+ of 64 pixels do not look at the relay"):
        data = tofrender.capture(path, grid=(8, 8), spp=4, relay_wall="elm__4", progress=False)
    assert 0 < data["on_wall"].sum() < 64
    said = refusal(tofrender.capture, path, grid=(8, 8), relay_wall="wand", progress=False)
    assert said.startswith("relay_wall = 'wand': the scene has no such shape; must be one of 'elm")
    both = ["elm__4", "elm__8"]
    with pytest.warns(UserWarning, match="of 64 pixels"):
        more = tofrender.capture(path, grid=(8, 8), spp=1, relay_wall=both, progress=False)
    assert more["on_wall"].sum() > data["on_wall"].sum()


def letter(steps: int = 24) -> Nodes:
    """The letter at z = 1, in small triangles' centers; it faces the wall."""
    vertices, faces = letter_z()
    k, j = (a.ravel() for a in np.meshgrid(np.arange(steps), np.arange(steps)))
    s, t = (np.concatenate([(x + 1 / 3) / steps, (x + 2 / 3) / steps]) for x in (k, j))
    inside = s + t < 1
    st = np.stack([s[inside], t[inside]], axis=1)
    a, b, c = np.moveaxis(vertices[faces] + [0, 0, 1], 1, 0)
    sides = np.stack([b - a, c - a], axis=1)
    points = (a[:, None] + st @ sides).reshape(-1, 3)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    each = np.repeat(areas / len(st), len(st))
    return Nodes(points, np.broadcast_to([0.0, 0, -1], points.shape), each)


@QUIET
@pytest.mark.parametrize("size", [64, 9])
def test_the_meter_puts_the_laser_where_it_says(size, tmp_path):
    """Pixel (k, k) is a pixel's center, and a half more its edge."""
    at = size // 2
    for shift in (0, 0.5):
        path = peer_scenes.nlos_z(tmp_path, size=size, lookat=at_pixel(at + shift, at - shift))
        for loaded in (apart(path), mi.load_file(str(path))):
            mi.render(loaded, spp=1)
            origin, direction = (np.array(v).ravel() for v in axis(loaded.emitters()[0]))
            assert origin == pytest.approx(DEVICE)
            lit = (origin - direction * origin[2] / direction[2])[:2]
            expected = 2 * (at + 0.5 + shift * np.array([1, -1])) / size - 1
            assert lit == pytest.approx(expected, abs=1e-5)


@QUIET
@pytest.mark.statistical
@pytest.mark.parametrize("mode", ["single", "confocal"])
def test_the_letter_before_the_meter_is_its_formula(mode, tmp_path):
    kind = {"single": 1, "confocal": 2}[mode]
    paths = tags("integer", filter_bounces=3, capture_type=kind)
    three = {"path_options": paths, "lookat": at_pixel(1, 2)}
    path = peer_scenes.nlos_z(tmp_path, **three)
    edited(path, ('name="filter_depth" value="-1"', 'name="rr_depth" value="5"'))
    data = [
        tofrender.capture(path, mode=mode, grid=(4, 4), spp=256, seed=seed, progress=False)
        for seed in range(8)
    ]
    grid, nodes = data[0]["sensor_grid"].values.astype(float), letter()
    expected = np.zeros((4, 4))
    for y, x in np.ndindex(4, 4):
        lit = grid[2, 1] if mode == "single" else grid[y, x]
        away = np.subtract(DEVICE, lit)
        # Mitsuba's projector gives pi times its `irradiance` at a unit distance
        power = np.pi * away[2] / np.linalg.norm(away) ** 3
        setup = Setup(sensor=DEVICE, legs=False, albedo=1.0, power=power)
        expected[y, x] = total(setup, nodes, 1.0, lit, grid[y, x])
    found = np.mean([d["transient"].sum("opl").values[..., 0] for d in data], axis=0)
    assert found.sum() == pytest.approx(expected.sum(), rel=1e-3)
    assert found == pytest.approx(expected, rel=3e-3, abs=1e-3 * expected.max())


@QUIET
def test_the_power_is_that_of_a_laser_that_was_turned_by_hand(tmp_path):
    by_file = bins(apart(peer_scenes.nlos_z(tmp_path, size=4, lookat=at_pixel(1, 2))), 256)
    turned = '<lookat origin="-0.5 0 0.25" target="-0.25 0.25 0" up="0 1 0"/>'
    fov = '<float name="fov" value="0.2"/>'
    bare = edited(
        peer_scenes.nlos_z(tmp_path, size=4, lookat=""),
        (fov, f'{fov}<transform name="to_world">{turned}</transform>'),
        ('<point name="laser_origin".*/>', ""),
    )
    assert by_file == pytest.approx(bins(apart(bare), 256), rel=1e-3, abs=1e-6 * by_file.max())


def warned(path: Path) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mi.render(apart(path), spp=1)
    texts = sorted(str(each.message) for each in caught)
    assert all("\n" not in text for text in texts)
    return texts


def test_what_has_no_effect_is_told(tmp_path):
    """Each once, and nothing else."""
    aim = at_pixel(1, 2)
    assert warned(peer_scenes.nlos_z(tmp_path, size=4, lookat=aim)) == [
        "account_first_and_last_bounces of nlos_capture_meter: has no effect; "
        "transient_nlos_path has it",
        "block_size = 1: has no effect; only scalar variants render in blocks",
    ]
    more = tags("integer", nlos_hidden_geometry_sampling_max_depth=2)
    more += tags("float", illumination_scan_fov=20)
    more += tags("boolean", force_equal_illumination_scanning="true")
    assert warned(peer_scenes.z_simple(tmp_path, size=4, more=more)) == [
        "illumination_scan_fov = 20.0: has no effect; the laser lights the sensor's points",
        "nlos_hidden_geometry_sampling_max_depth = 2: has no effect; paths are sent from the "
        "relay wall only",
    ]
    confocal = tags("integer", capture_type=2)
    told = warned(peer_scenes.nlos_z(tmp_path, size=4, lookat=aim, path_options=confocal))
    assert "confocal = False: has no effect; capture_type is 'confocal'" in told


@QUIET
def test_filter_depth_is_one_more_than_bounces(tmp_path):
    def filtered(line: str) -> mi.Scene:
        path = peer_scenes.nlos_z(tmp_path, size=2, lookat=at_pixel(1, 1))
        return apart(edited(path, ('<integer name="filter_depth" value="-1"/>', line)))

    four, three = tags("integer", filter_depth=4), tags("integer", filter_bounces=3)
    assert np.array_equal(bins(filtered(four), 64), bins(filtered(three), 64))
    said = refusal(filtered, four + three)
    assert said.endswith("filter_depth = 4: must be left out; filter_bounces is given")
    said = refusal(filtered, tags("integer", filter_depth=1))
    assert "filter_depth = 1: must be an integer from 2" in said


@QUIET
def test_a_confocal_meter(tmp_path):
    path = peer_scenes.nlos_z(tmp_path, size=3, lookat="")
    found = bins(apart(edited(path, ('"confocal" value="false"', '"confocal" value="true"'))), 256)
    confocal = {"path_options": tags("integer", capture_type=2)}
    expected = bins(apart(peer_scenes.nlos_z(tmp_path, size=3, lookat="", **confocal)), 256)
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-6 * expected.max())


@QUIET
@pytest.mark.parametrize("point", [(0.3, -0.2, 0), (-0.9, 0.9, 0)])
def test_a_laser_at_a_point(point, tmp_path):
    path = peer_scenes.nlos_z(tmp_path, lookat=at_point(*point))
    data = tofrender.capture(path, mode="single", grid=(2, 2), spp=1, progress=False)
    assert data["laser_grid"].values.ravel() == pytest.approx(point, abs=1e-5)


@QUIET
def test_a_film_of_one_pixel_looks_at_the_lit_point(tmp_path):
    """As tools do that capture point by point: pixel (2, 1) of 4 x 3."""
    original = tags("integer", original_film_width=4, original_film_height=3)
    confocal = {"path_options": tags("integer", capture_type=2)}
    aim = {"lookat": at_point(0.25, 0), "meter_options": original} | confocal
    loaded = apart(peer_scenes.nlos_z(tmp_path, size=1, **aim))
    data = tofrender.capture(loaded, mode="confocal", spp=4096, progress=False)
    assert data["sensor_grid"].values.ravel() == pytest.approx([0.25, 0, 0], abs=1e-5)
    whole = tofrender.capture(
        peer_scenes.nlos_z(tmp_path, **confocal),
        mode="confocal",
        grid=(4, 3),
        spp=4096,
        progress=False,
    )
    one, all_of_it = (d["transient"].sum("opl").values[..., 0] for d in (data, whole))
    assert one[0, 0] == pytest.approx(all_of_it[1, 2], rel=0.01)
    for point in ([0.5, 0.5, 0], [-0.5, 0.25, 0]):
        tofrender.focus_laser(loaded, point=point)
        seen = tofrender.capture(loaded, mode="confocal", spp=1, progress=False)["sensor_grid"]
        assert seen.values.ravel() == pytest.approx(point, abs=1e-5)
    said = refused(apart, peer_scenes.nlos_z(tmp_path, size=2, meter_options=original))
    assert "original_film_width, original_film_height = [4, 3]" in said


@QUIET
def test_what_is_refused(tmp_path):
    def file(**options) -> Path:
        return peer_scenes.nlos_z(tmp_path, **options)

    three = tags("integer", capture_type=3)
    exhaustive = file(size=2, lookat=at_pixel(1, 1), path_options=three)
    assert "mode='exhaustive'" in refusal(mi.render, apart(exhaustive), spp=1)
    data = tofrender.capture(exhaustive, mode="exhaustive", spp=4, progress=False)
    assert data["transient"].shape == (2, 2, 2, 2, 300, 3)
    others = tags("boolean", force_equal_illumination_scanning="false")
    assert "force_equal_illumination" in refusal(apart, file(path_options=others))
    none = tags("integer", nlos_hidden_geometry_sampling_max_depth=0)
    assert "sampling_max_depth = 0" in refusal(apart, file(path_options=none))
    assert refusal(mi.render, apart(file(size=16)), spp=1) == (
        "laser_lookat_pixel = [32.0, 32.0]: must be a pixel of the film, which has [16, 16]"
    )
    away = file(lookat=at_point(0, 0, 1))
    assert "laser: its beam misses the relay wall" in refusal(mi.render, apart(away), spp=1)
    # In the plane of the wall, where the emitter is if nobody says otherwise: it lights nothing
    flat = edited(file(size=4, lookat=""), ('<point name="laser_origin".*/>', ""))
    assert "laser" in refusal(mi.render, apart(flat), spp=1)
    confocal = {"lookat": "", "path_options": tags("integer", capture_type=2)}
    flat = edited(file(size=4, **confocal), ('<point name="laser_origin".*/>', ""))
    said = refusal(tofrender.capture, flat, spp=1, progress=False)
    assert said.startswith("laser: its position [0.0, 0.0, 0.0] is in the plane of the surface")


def gated(**integrator) -> dict:
    """A wall under a laser that follows the camera, as in the fork's scenes."""
    projector = {"type": "confocal_projector", "grid_sigma": 0.2, "pulse_width_opl": 0.05}
    time = {"temporal_bins": 8, "start_opl": 3.6, "bin_width_opl": 0.1}
    film = {"type": "transient_hdr_film", "width": 2, "height": 2, **time}
    facing = mi.ScalarTransform4f().translate([0, 0, 2]).rotate([0, 1, 0], 180)
    integrator = {"confocal_projector": projector, **integrator}
    sensor = {"type": "perspective", "fov": 20.0, "film": film}
    wall = {"type": "rectangle", "to_world": facing}
    return {"type": "scene", "integrator": integrator, "sensor": sensor, "wall": wall}


def test_timegated_transient_path():
    """Its gates fill the bins: the histogram that our integrator puts there."""
    described = gated(type="timegated_transient_path", time_sampling="random")
    with pytest.warns(UserWarning, match=r"\Atime_sampling = 'random': "):
        theirs = tofrender.load_scene(described)
    ours = tofrender.load_scene(gated(type="transient_path", max_depth=6))
    assert str(theirs.integrator()) == str(ours.integrator())
    assert bins(theirs, 64).sum() > 0
    assert bins(theirs, 64) == pytest.approx(bins(ours, 64), rel=1e-5)
    data = tofrender.render(gated(type="timegated_transient_path"), spp=4, progress=False)
    assert data.attrs["max_depth"] == 6
    said = refusal(tofrender.load_scene, gated(type="timegated_transient_path", time_sampling="no"))
    assert said == "time_sampling = 'no': must be one of stratified, random"
    bare = gated() | {"integrator": {"type": "timegated_transient_path"}}
    said = refusal(tofrender.load_scene, bare)
    assert said.startswith("integrator = 'timegated_transient_path': ")
    assert "confocal_projector" in said


@QUIET
def test_nlos_confocal(tmp_path):
    def with_option(value: str, more: str = "") -> mi.Scene:
        options = tags("boolean", nlos_confocal=value) + more
        return apart(peer_scenes.nlos_z(tmp_path, size=2, path_options=options))

    with pytest.warns(UserWarning, match=r"\Anlos_confocal = True: .*capture_type = 'confocal'"):
        assert with_option("true").integrator().capture_type == "confocal"
    assert with_option("false").integrator().capture_type == "single"
    said = refusal(with_option, "true", tags("integer", capture_type=2))
    assert said.startswith("nlos_confocal = True: ")
    assert "capture_type" in said


@pytest.mark.statistical
@pytest.mark.parametrize("kind", ["diffuse", "mirror"])
def test_cornell_boxes(kind, tmp_path):
    """Picture and bins are the light of Mitsuba's own picture, but for what is too late."""
    path = peer_scenes.cornell(tmp_path, kind)
    loaded = tofrender.load_scene(path, parameters={"res": 8, "spp": 1024})
    edited(
        path,
        ("transient_hdr_film", "hdrfilm"),
        ('<[a-z]+ name="(temporal|start|bin|camera|gaussian)_.*/>', ""),
        ('value="transient_path"', 'value="path"'),
    )
    plain = mi.load_file(str(path), res=8, spp=1024)

    def rows(picture) -> np.ndarray:
        return np.array(picture, dtype=np.float64)[..., :3].mean(axis=(1, 2))

    found = [mi.render(loaded, seed=seed) for seed in range(12)]
    assert found[0][1].shape == (8, 8, 400, 3)
    ours = np.array([rows(steady) for steady, _ in found])
    summed_bins = [rows(np.array(transient).sum(axis=2)) for _, transient in found]
    reference = over_seeds(lambda seed: rows(mi.render(plain, seed=50 + seed)), range(12))
    assert agree(ours, reference, rounding=2e-3)
    assert not agree(1.3 * ours, reference, rounding=2e-3)
    assert 0.95 * np.sum(ours) < np.sum(summed_bins) < 1.0001 * np.sum(ours)


def test_cornell_box_of_phasors(tmp_path):
    loaded = tofrender.load_scene(peer_scenes.cornell(tmp_path, "freq"), parameters={"res": 8})
    phasors = np.array(mi.render(loaded, spp=4)[1])
    assert np.isfinite(phasors).all()
    assert np.abs(phasors).max() > 0


def test_cornell_box_of_their_package():
    utils = pytest.importorskip("mitransient.utils")
    peer_scenes.give_names_back()
    theirs = tofrender.load_scene(utils.cornell_box(), width=8, height=8, spp=16)
    ours = tofrender.load_scene("cornell_box", width=8, height=8, spp=16, sampler="independent")
    for mine, other in zip(mi.render(ours), mi.render(theirs), strict=True):
        assert np.array(mine) == pytest.approx(np.array(other), rel=1e-5, abs=1e-6)
