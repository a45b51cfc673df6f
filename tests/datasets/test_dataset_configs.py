"""Configs that are wrong: each is refused in one line that names the key."""

from collections.abc import Iterator
from copy import deepcopy
from datetime import date
from pathlib import Path

import pytest
from helpers.distributions import choice, uniform
from helpers.refusals import refused

from tofrender.cli.app import main
from tofrender.datasets.dataset_config import read_config
from tofrender.datasets.making import make_dataset, plan_dataset

ROOT = Path(__file__).parents[2]


def fixed(value, **what) -> dict:
    return what | {"distribution": "fixed", "value": value}


GOOD = {
    "records": 4,
    "seed": 1,
    "retry": 2,
    "scene": "cornell_box",
    "arguments": {"light": "area"},
    "render": {"width": 8, "height": 8, "spp": 4, "temporal_bins": 50, "window": [3, 15]},
    "outputs": {"transient": True, "noisy": {"spp": 2}, "phasor": {"frequencies_hz": [2e7, 5e7]}},
    "materials": {"glass": {"type": "dielectric", "int_ior": 1.5}},
    "objects": {"ball": {"type": "sphere", "radius": 0.2, "to_world": {"position": [0, 0, 0]}}},
    "vary": {
        "turn": uniform(-30, 30, turn="small-box"),
        "paint": uniform(0.1, 0.9, reflectance="white")
        | {"distribution": "normal", "mean": 0.5, "deviation": 0.2},
        "made_of": choice("white", "glass", material="ball") | {"weights": [1, 2]},
        "camera": {"camera": "origin", "distribution": "on_sphere"}
        | {"radius": [3, 3.5], "axis": [0, 0, 1], "angle": 10},
        "there": {"present": ["small-box", "large-box"], "distribution": "subset", "least": 1},
        "lamp": uniform(0.5, 2, path="light.emitter.radiance", times=True)
        | {"distribution": "log_uniform"},
    },
}


class _Left:
    """Stands for a key that is left out."""

    def __repr__(self) -> str:
        return "left out"


GONE = _Left()

BAD = [
    # Keys that there are not
    ("record", 3, "record: is not known, did you mean records? Must be one of records, seed"),
    ("render.ssp", 3, "render.ssp: is not known, did you mean spp? Must be"),
    ("outputs.normal", True, "outputs.normal: is not known, did you mean normals? Must be"),
    ("outputs.capture.moed", "single", "outputs.capture.moed: is not known, did you mean mode?"),
    ("vary.turn.lo", 3, "vary.turn.lo: is not known, did you mean low? Must be one of turn, dis"),
    ("vary.turn.mean", 3, "vary.turn.mean: is not known; must be one of turn, distribution"),
    ("vary.it", {"trun": "ball", "distribution": "uniform"}, "vary.it.trun: is not known, did you"),
    # Tables and values of the wrong kind
    *[(name, GONE, f"{name}: must be given") for name in ("records", "scene", "outputs")],
    ("records", 0, "records = 0:"),
    ("retry", 2000, "retry = 2000:"),
    ("scene", 3, "scene = 3:"),
    ("scene", "cornel_box", "scene = 'cornel_box':"),
    ("scene", "nowhere.xml", r"scene = '.*nowhere.xml':"),
    ("outputs", True, "outputs = True:"),
    ("vary.turn", 3, "vary.turn = 3:"),
    ("parameters", {"spp": 3}, "parameters: must be left out, only XML files have them"),
    ("materials.glass", {"int_ior": 2}, "materials.glass: must be a table with a plugin's name"),
    ("objects.ball.type", 3, "objects.ball: must be a table with a plugin's name as its type"),
    ("materials.glass.int_ior", None, "materials.glass.int_ior = None:"),
    ("materials.glass.int_ior", float("nan"), "int_ior = nan:"),
    ("materials.glass.int_ior", 10**400, "glass.int_ior = an integer of 1329 bits:"),
    ("materials.glass.day", date(2020, 1, 1), "glass.day = .*: must be a number, text, a list"),
    # The render
    ("render.spp", "many", "render.spp = 'many':"),
    ("render.max_depth", 0, r"render.max_depth = 0:"),
    ("render.integrator", "pathtracer", "render.integrator = 'pathtracer': did you mean"),
    ("render.pulse_width_opl", 0, "render.pulse_width_opl = 0:"),
    ("render.window", [15, 3], r"render.window = \[15, 3\]:"),
    ("render.window", "auto", r"render.window = 'auto':"),
    ("render.start_opl", 1.0, "render.start_opl = 1:"),
    ("render.temporal_bins", GONE, "render.temporal_bins: must be given with window"),
    ("render.sensor", -1, "render.sensor = -1:"),
    # What records hold
    ("outputs", {}, "outputs: must ask for one output or more"),
    ("outputs", {"transient": False}, "outputs: must ask for one output or more"),
    ("outputs.transient", 1, "outputs.transient = 1:"),
    ("outputs.phasor", [20e6], r"outputs.phasor = \[20000000.0\]:"),
    ("outputs.phasor.frequencies_hz", [], r"frequencies_hz = \[\]:"),
    ("outputs.noisy.spp", 0, "outputs.noisy.spp = 0:"),
    ("outputs.capture", {"mode": "both"}, "outputs.capture.mode = 'both':"),
    ("outputs.capture", {"grid": 8}, r"outputs.capture.grid = 8:"),
    ("outputs.capture", {"grid": [8, 0]}, "outputs.capture.grid = 0:"),
    ("outputs.capture", {"relay_wall": 3}, "outputs.capture.relay_wall = 3:"),
    # The sensor
    ("sensor", "flash", "sensor = 'flash': did you mean 'flash_dtof'"),
    ("sensor", "no.toml", "sensor = .*no.toml:"),
    ("sensor", {}, "sensor = {}:"),
    ("sensor", {"cycle": 1}, "sensor.cycle: is not known, did you mean cycles"),
    # What is varied
    ("vary.sensor_counts", {"turn": "ball"}, "vary.sensor_counts: must have another name"),
    ("vary.a-b", {"turn": "ball"}, "vary.'a-b': must be a name of letters, digits and _"),
    ("vary.depth", {"turn": "ball"}, "vary.depth: must have another name"),
    ("vary.it", {"distribution": "uniform"}, "vary.it: says not what is varied; must have one of"),
    ("vary.turn.move", "ball", "vary.turn: has move and turn; must have one of"),
    ("vary.turn.distribution", "unifrm", "distribution = 'unifrm': did you mean 'uniform'?"),
    ("vary.turn.low", float("nan"), "vary.turn.low = nan:"),
    ("vary.turn.low", 30, "vary.turn.low = 30:"),
    ("vary.turn.low", [-1, -2], "vary.turn.distribution = 'uniform':"),
    *[
        (f"vary.{name}", [0, 0, 0], rf"vary.{name} = \[0, 0, 0\]: must not be zero")
        for name in ("turn.axis", "camera.axis", "camera.up")
    ],
    ("vary.turn.around", 3, "vary.turn.around = 3:"),
    ("vary.paint.low", 2, "vary.paint.low = 2:"),
    ("vary.paint.mean", GONE, "vary.paint.mean = None:"),
    ("vary.made_of.values", [{"type": "x"}, "white"], "vary.made_of.values = .*: must be"),
    ("outputs.capture", {"hidden_depth": "yes"}, "hidden_depth = 'yes':"),
    ("outputs.noisy", {}, "outputs.noisy.spp = None:"),
    ("vary.capture_x", {"turn": "ball"}, "vary.capture_x: must have another name"),
    ("vary.time", {"turn": "ball"}, "vary.time: must have another name"),
    ("outputs.capture", {"grid": [3, 2]}, "render.width: must be left out with outputs.capture.g"),
    ("vary.paint.deviation", 0, "vary.paint.deviation = 0:"),
    ("vary.paint.mean", 1e9, "vary.paint.low = 0.1:"),
    ("vary.paint.high", GONE, "vary.paint.reflectance = 'white':"),
    ("vary.paint.high", 1.5, "is drawn from 0.1 to 1.5; must be from 0 to 1"),
    ("vary.paint.mean", [0.1, 0.2], "vary.paint.distribution = 'normal':"),
    ("vary.lamp.low", 0, "vary.lamp.low = 0:"),
    ("vary.lamp.times", 1, "vary.lamp.times = 1:"),
    ("vary.made_of.values", [], r"vary.made_of.values = \[\]:"),
    ("vary.made_of.values", ["white", 3], "vary.made_of.weights|must be a choice of materials'"),
    ("vary.made_of.weights", [1], r"vary.made_of.weights = \[1\]:"),
    ("vary.made_of.weights", [0, 0], r"weights = \[0, 0\]:"),
    ("vary.camera.camera", "roll", "vary.camera.camera = 'roll':"),
    ("vary.camera.camera", "fov", "vary.camera.distribution = 'on_sphere':"),
    ("vary.camera.radius", [4, 3], r"vary.camera.radius = \[4, 3\]:"),
    ("vary.camera.center", [1, 2], r"center = \[1, 2\]:"),
    ("vary.camera.angle", 200, "angle = 200:"),
    ("vary.there.present", "small-box", "vary.there.present = 'small-box':"),
    ("vary.there.present", ["a", "a"], "vary.there.present = .*: must be a list of objects' name"),
    ("vary.there.least", 3, "vary.there.least = 3:"),
    ("vary.there.most", 0, "vary.there.most = 0:"),
    ("vary.there.distribution", "uniform", "least: is not known"),
    ("vary.it", {"path": "a", "distribution": "subset"}, "must be another than subset with path"),
    *[
        ("vary.it", value, f"vary.it.{text}")
        for value, text in (
            (choice("bell", present=["ball"]), "values = 'bell': is not known, did you mean ball"),
            (uniform(0, 1, scale="ball"), "scale = 'ball':"),
            (uniform(90, 180, camera="fov"), "camera = 'fov':"),
            (uniform(0, 1, move="ball"), "distribution = 'uniform':"),
            (choice("area", argument="light"), r"argument = 'light':"),
            (fixed(3, parameter="spp"), "parameter = 'spp':"),
            (choice("white", material="ball"), "material = 'ball':"),
        )
    ],
    ("vary.it", {"path": "a", "distribution": "fixed"}, "vary.it.value: must be given with fixed"),
]


def shown(value: object) -> str:
    return str(value)[:40]


def changed(key: str, value: object) -> dict:
    """The good config with one key changed or taken out."""
    config = deepcopy(GOOD)
    *tables, last = key.split(".")
    table = config
    for name in tables:
        table = table.setdefault(name, {})
    if value is GONE:
        del table[last]
    else:
        table[last] = value
    return config


@pytest.mark.parametrize(("key", "value", "text"), BAD, ids=shown)
def test_bad_configs_are_refused(key, value, text):
    with refused(text.replace("?", r"\?"), (ValueError, FileNotFoundError)):
        read_config(changed(key, value))


VALUES = [
    *(None, True, 0, -1, 3.5, 1e308, 10**400, float("inf"), float("nan"), date(2020, 1, 1)),
    *("", "x", "\0", "a.b", "..", "type", "sensor", "integrator"),
    *([], [1], [1, 2, 3], ["a"], [[1, 2], [3]], [None], [True, 1]),
    *({}, {"type": "x"}, {"a": {"b": 1}}, {"type": 3}),
]


def keys(table: dict, where: str = "") -> Iterator[str]:
    for name, value in table.items():
        yield where + name
        if isinstance(value, dict):
            yield from keys(value, f"{where}{name}.")


def test_whatever_stands_there_is_taken_or_refused_in_a_line():
    said = []
    for key in keys(GOOD):
        for value in VALUES:
            try:
                read_config(changed(key, value))
            except (ValueError, FileNotFoundError) as error:
                said.append(str(error))
    assert len(said) > 1000
    assert not [text for text in said if "\n" in text]


IN_SCENE = [
    ("vary.turn.turn", "smal-box", "vary.turn.turn = 'smal-box':"),
    ("vary.turn.turn", "type", "vary.turn.turn = 'type':"),
    ("vary.paint.reflectance", "small-box", "uses the material 'white', which others may use too"),
    ("vary.paint.reflectance", "glass", "'glass': has no reflectance; must be a material"),
    ("vary.made_of.material", "bell", "vary.made_of.material = 'bell':"),
    ("vary.made_of.values", ["gloss", "gloss"], "values = 'gloss': is not known, did you mean gla"),
    ("vary.lamp.path", "light.emiter.radiance", "emiter: is not known, did you mean emitter?"),
    (
        "vary.lamp.path",
        "light.emitter.radiance.value.x",
        "the part before 'x' contains no further parts",
    ),
    ("vary.lamp.path", "light.emitter", "is a table, and cannot become"),
    ("vary.lamp.path", "sensor.film.width", "film is the same in all records"),
    ("vary.lamp.high", [1, 2], "vary.lamp.path = 'light.emitter.radiance':"),
    ("vary.there.present", ["small-box", "box"], "vary.there.present = 'box':"),
    ("materials.white", {"type": "diffuse"}, "materials.white: the scene has one already; must"),
    ("objects.ball.to_world.positon", 1, "objects.ball.to_world.positon: is not known, did you"),
    ("objects.ball.type", "sphare", "sphare"),
    ("objects.ball.raduis", 1.0, "raduis"),
    ("arguments.lite", "area", "arguments: cornell_box.. got an unexpected keyword argument 'li"),
    ("render.sensor", 1, "vary.camera.camera: the scene has no camera that can be moved"),
]


@pytest.mark.parametrize(("key", "value", "text"), IN_SCENE, ids=shown)
def test_what_the_scene_has_not_is_refused(key, value, text):
    config = changed(key, value) | {"retry": 0}
    with refused(text.replace("?", r"\?")):
        plan_dataset(config)


UP = fixed([0, 0, 3], camera="origin", up=[0, 0, 1])
STEADY = {"scene": "cornell_box_steady_state", "vary": {}, "render": {"width": 8, "height": 8}}


@pytest.mark.parametrize(
    ("config", "text"),
    [
        (changed("vary.camera", UP), r"^vary.camera.camera: the viewing direction \[.*parallel"),
        (
            changed("render.sensor", 1) | {"vary": {}},
            "render.sensor = 1:",
        ),
        (GOOD | STEADY, "render.temporal_bins: must be given, and window"),
    ],
)
def test_other_plans_are_refused(config, text):
    with refused(text):
        plan_dataset(config)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (None, "does not exist; must be a TOML file"),
        (b"records = ", "Invalid value"),
        (b"records = 1\nrecords = 2", "Cannot overwrite a value"),
        (b"\xff\xfe", "cannot be read"),
        (b"a = " + b"[" * 10_000, "nested too deeply"),
    ],
)
def test_files_that_are_no_toml_are_refused(tmp_path, capsys, content, text):
    path = tmp_path / "config.toml"
    if content is not None:
        path.write_bytes(content)
    assert main(["dataset", str(path), "--plan"]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"error: config = {path}: ")
    assert text in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("only", "text"),
    [
        *[([number], f"only = {number}: must be an integer from 0 to 3") for number in (4, 1.5)],
        *[(text, f"only = {text!r}: must be numbers of records") for text in ("3", 3)],
        ([], r"only = \[\]:"),
    ],
)
def test_records_that_there_are_not_are_refused(tmp_path, only, text):
    with pytest.raises(ValueError, match=text):
        make_dataset(GOOD, tmp_path / "x.zarr", only=only)
