"""load_scene: one way in for names, dicts and XML, and one line for whatever is wrong."""

import signal
import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import pytest
from helpers.scenes import refusal as refused

import tofrender  # noqa: F401  (picks the variant, registers the plugins)
from tofrender.films.transient import TransientHDRFilm
from tofrender.runtime.settings import check_settings
from tofrender.scenes import cornell_box, cornell_box_steady_state
from tofrender.scenes.loading import (
    find_scene,
    load_plugin,
    load_scene,
    require_light,
    require_sensor,
)

XML = Path(__file__).parents[2] / "scenes" / "cornell_box.xml"
WINDOW = {"temporal_bins": 7, "start_opl": 4.0, "bin_width_opl": 0.5}


def test_ctrl_c_is_no_error_of_the_scene():
    class Interrupted(TransientHDRFilm):
        def __init__(self, props):
            signal.raise_signal(signal.SIGINT)
            super().__init__(props)

    mi.register_film("interrupted_film", Interrupted)
    scene = cornell_box(width=4, height=4)
    scene["sensor"]["film"]["type"] = "interrupted_film"
    with pytest.raises(KeyboardInterrupt):
        load_scene(scene)
    with pytest.raises(KeyboardInterrupt):
        load_plugin("film", scene["sensor"]["film"])


def film_of(scene):
    return scene.sensors()[0].film()


def refusal(source, **options) -> str:
    text = refused(load_scene, source, **options)
    assert "Traceback" not in text
    assert ".cpp" not in text
    return text


def write(tmp_path: Path, text: str, name: str = "scene.xml") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


STEADY_XML = """<scene version="3.0.0">
    <default name="spp" value="4"/>
    <default name="albedo" value="0.5"/>
    <integrator type="path"><integer name="max_depth" value="3"/></integrator>
    <sensor type="perspective">
        <film type="hdrfilm">
            <integer name="width" value="20"/><integer name="height" value="10"/>
            <integer name="crop_offset_x" value="2"/><integer name="crop_width" value="5"/>
            <integer name="crop_height" value="10"/>
            <string name="pixel_format" value="rgb"/>
            <rfilter type="tent"/>
        </film>
        <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
    </sensor>
    <emitter type="constant"/>
    <shape type="sphere">
        <bsdf type="diffuse"><spectrum name="reflectance" value="$albedo"/></bsdf>
    </shape>
</scene>"""


@pytest.mark.parametrize("source", ["cornell_box", "cornell-box", XML, str(XML), "dict"])
def test_every_source_takes_every_setting(source):
    picture = {"width": 12, "height": 8, "spp": 16, "sampler": "multijitter"}
    paths = {"max_depth": 3, "integrator": "transient_path", "pulse_width_opl": 0.03}
    scene = load_scene(cornell_box() if source == "dict" else source, **picture, **paths, **WINDOW)
    film = film_of(scene)
    assert list(film.size()) == [12, 8]
    assert film.temporal_bins == 7
    assert film.start_opl == pytest.approx(4.0)
    assert film.bin_width_opl == pytest.approx(0.5)
    sampler = scene.sensors()[0].sampler()
    assert "Multijitter" in str(sampler)
    assert sampler.sample_count() == 16
    assert scene.integrator().max_depth == 3
    assert scene.integrator().pulse.width_opl == pytest.approx(0.03)


def test_dict_is_left_as_it_was():
    source = cornell_box_steady_state()
    load_scene(source, width=4, height=4, spp=1)
    assert source["sensor"]["film"]["width"] == 256


def test_steady_scene_turns_transient_and_keeps_its_film(tmp_path):
    scene = load_scene(write(tmp_path, STEADY_XML), **WINDOW)
    film = film_of(scene)
    assert type(film).__name__ == "TransientHDRFilm"
    assert list(film.size()) == [20, 10]
    assert list(film.crop_size()) == [5, 10]
    assert list(film.crop_offset()) == [2, 0]
    assert "Tent" in str(film.rfilter())
    assert type(scene.integrator()).__name__ == "TransientPath"
    assert scene.integrator().max_depth == 3


def test_missing_film_sampler_and_integrator_are_added():
    parts = {"camera": {"type": "perspective"}, "sky": {"type": "constant"}}
    scene = load_scene({"type": "scene"} | parts, width=4, height=3, spp=2, max_depth=2, **WINDOW)
    assert list(film_of(scene).size()) == [4, 3]
    assert scene.integrator().max_depth == 2


def test_optimize_false_keeps_shapes_apart():
    merged, apart = (load_scene("cornell_box_steady_state", optimize=on) for on in (True, False))
    assert len(apart.shapes()) == 8
    assert len(merged.shapes()) < 8


def test_a_seed_means_the_same_paths_at_each_load():
    """Mitsuba's merging of meshes orders them by their addresses, and their lamps with them."""

    def lamps(count: int) -> tuple[float, ...]:
        scene = {"type": "scene"}
        for k in range(2 * count):
            place = mi.ScalarTransform4f().translate([3 * k, 0, 0])
            lamp = {"emitter": {"type": "area"}} if k % 2 else {"bsdf": {"type": "diffuse"}}
            scene |= {f"lamp{k}": {"type": "rectangle", "to_world": place, **lamp}}
            scene |= {f"box{k}": {"type": "cube", "to_world": place}}
        loaded = load_scene(scene)
        return tuple(float(lamp.get_shape().bbox().min.x) for lamp in loaded.emitters())

    for count in (2, 3):
        assert len({lamps(count) for _ in range(40)}) == 1


def test_files_named_in_xml_are_found_beside_it(tmp_path):
    mi.load_dict({"type": "cube"}).write_ply(str(tmp_path / "cube.ply"))
    shape = '<shape type="ply"><string name="filename" value="cube.ply"/></shape>'
    path = write(tmp_path, f'<scene version="3.0.0">{shape}</scene>')
    assert len(load_scene(path).shapes()) == 1


def test_unknown_settings_scenes_and_files(tmp_path):
    with pytest.raises(TypeError, match="spps: unknown setting; must be one of width, height"):
        check_settings({"spps": 3})
    assert "Use cornell_box" in refusal("cornel_box")
    assert "one of cornell_box, cornell_box_mirror" in refusal("kitchen")
    for source in (tmp_path / "no.xml", "no.xml", str(tmp_path)):
        assert repr(str(source)) in refusal(source, kind=FileNotFoundError)


def test_file_wins_over_no_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, STEADY_XML, "scene")
    assert find_scene("scene") == Path("scene")


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ('\n<shape type="sphere">\n', "line 3"),
        ('\n<shape type="sphere"><float name="radius" value="big"/></shape>', "line 2"),
        ('\n<shape type="sphere"><float name="radios" value="1"/></shape>', '"radios"'),
        ('\n<shape type="spere"/>', 'Plugin "spere" not found'),
        ('\n<shape type="sphere"><ref id="no"/></shape>', '"no"'),
        ('\n<shape type="obj"><string name="filename" value="no.obj"/></shape>', "no.obj"),
        ('\n<shape type="sphere"><float name="radius" value="$r"/></shape>', "$r"),
        ('\n<sampler type="sobol"/>', "sobol"),
    ],
)
def test_bad_xml_says_where(tmp_path, body, text):
    path = write(tmp_path, f'<scene version="3.0.0">{body}</scene>')
    line = refusal(path)
    assert text in line
    assert "scene.xml" in line


def test_unknown_parameters(tmp_path):
    """Of a part, with settings too (which look for the film of a sensor); of the file; of none."""
    body = '<sensor type="perspective"><float name="fovv" value="3"/></sensor>'
    path = write(tmp_path, f'<scene version="3.0.0">{body}</scene>')
    assert '"fovv"' in refusal(path, width=4)
    text = refusal(XML, parameters={"sp": 3})
    assert text.startswith("parameter sp = '3'")
    assert "width, height, temporal_bins, start_opl, bin_width_opl, spp, max_depth" in text
    for source in ("cornell_box", cornell_box()):
        assert "only XML files have parameters" in refusal(source, parameters={"spp": 3})


def test_settings_that_cannot_be():
    """Of what is loaded, of what nobody can tell the nature of, and half a window."""
    scene = load_scene(cornell_box_steady_state(width=4, height=4))
    assert load_scene(scene) is scene
    assert "width = 8: a loaded scene cannot be changed" in refusal(scene, width=8)
    camera = {"type": "perspective", "film": mi.load_dict({"type": "hdrfilm"})}
    said = refusal({"type": "scene", "camera": camera}, width=8)
    assert "film cannot be changed" in said
    mi.register_sampler("dice", lambda props: mi.load_dict({"type": "independent"}))
    camera = {"type": "perspective", "random": {"type": "dice"}}
    assert "'dice' may be its sampler" in refusal({"type": "scene", "camera": camera}, spp=4)
    line = refusal("cornell_box_steady_state", temporal_bins=30)
    assert line.startswith("temporal_bins = 30: ")
    assert "`start_opl` and `bin_width_opl`" in line


def test_scene_without_sensor_or_light():
    scene = load_scene({"type": "scene", "ball": {"type": "sphere"}})
    assert "sensor" in refused(require_sensor, scene)
    assert "light" in refused(require_light, scene)
    assert "sensor" in refusal({"type": "scene", "ball": {"type": "sphere"}}, spp=4)
    strange = {"type": "distantflux", "target": [0, 0, 0.5], "film": {"type": "hdrfilm"}}
    said = refusal({"type": "scene", "flux": strange}, spp=4)
    assert "its sensor has the unknown type 'distantflux'" in said
    whole = load_scene("cornell_box_steady_state")
    require_sensor(whole)
    require_light(whole)


@pytest.mark.parametrize(
    ("kind", "text"),
    [("../../evil", "must be a plugin's name"), ("evil", "native code"), ("/evil", "letters")],
)
def test_native_code_beside_a_scene_is_refused(tmp_path, monkeypatch, kind, text):
    (tmp_path / "plugins").mkdir()
    (tmp_path / "plugins" / "evil.so").write_bytes(b"")
    body = f'<bsdf type="{kind}" id="paint"/>'
    assert text in refusal(write(tmp_path, f'<scene version="3.0.0">{body}</scene>'))
    inner = write(tmp_path, f"<scene version='3.0.0'>{body}</scene>").rename(tmp_path / "in.xml")
    outer = write(tmp_path, f'<scene version="3.0.0"><include filename="{inner.name}"/></scene>')
    assert text in refusal(outer)
    monkeypatch.chdir(tmp_path)
    assert text in refusal({"type": "scene", "paint": {"type": "twosided", "in": {"type": kind}}})
    monkeypatch.undo()
    beside = {"here": {"type": "resources", "path": str(tmp_path)}, "paint": {"type": kind}}
    assert text in refusal({"type": "scene"} | beside)
    monkeypatch.chdir(tmp_path)
    assert text in refused(load_plugin, "integrator", {"type": kind})
    assert text in refusal("cornell_box", integrator={"type": "aov", "inner": {"type": kind}})


def test_mitsubas_plugins_come_from_its_own_folder(tmp_path):
    (tmp_path / "plugins").mkdir()
    for name in ("area", "d65", "diffuse", "hdrfilm", "path", "scene"):
        (tmp_path / "plugins" / f"{name}.so").write_bytes(b"no library: opening it fails")
    (tmp_path / "scene.xml").write_bytes(XML.read_bytes())
    size = ["--size", "4x4", "--spp", "1", "--window", "4,16", "--bins", "4", "--no-video"]
    command = [sys.executable, "-P", "-m", "tofrender", "render", "scene.xml"]
    done = subprocess.run(
        [*command, "--out", "out", *size], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
