"""Data sets as they are made: right contents, whatever happens on the way."""

import itertools
import json
import shutil
import signal
import tomllib
from collections import namedtuple
from copy import deepcopy
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
from helpers.distributions import choice, uniform
from helpers.refusals import refused

import tofrender
from tofrender import datasets
from tofrender.datasets import making
from tofrender.datasets.scene import load, scene_of

SIZE = {"width": 8, "height": 6, "spp": 16, "temporal_bins": 60}
PHASOR = {"frequencies_hz": [20e6, 50e6]}
CONFIG = {
    "records": 3,
    "seed": 11,
    "scene": "cornell_box",
    "render": SIZE | {"window": [3, 15], "max_depth": 4},
    "outputs": dict.fromkeys(("transient", "steady", "depth", "normals"), True)
    | {"noisy": {"spp": 2}, "phasor": PHASOR},
    "vary": {
        "turn": uniform(-40, 40, turn="small-box"),
        "eye": uniform([-0.1, -0.1, 3.0], [0.1, 0.1, 3.3], camera="origin"),
        "paint": uniform(0.4, 0.8, reflectance="white"),
        "boxes": {"present": ["small-box", "large-box"], "distribution": "subset", "least": 1},
    },
}
EYE = {"eye": uniform([0, 0, 1], [0, 0, 9], camera="origin")}
LIT = ("transient", "steady", "noisy", "phasor")
TIGHT = {"rtol": 1e-4, "atol": 1e-6}


def make(config: dict, out: Path, **options) -> xr.Dataset:
    return datasets.make_dataset(config, out, tell=lambda line: None, progress=False, **options)


def require_same(one: xr.Dataset, other: xr.Dataset, tight: dict = TIGHT) -> None:
    """Two data sets hold the same but for rounding of sums."""
    assert set(one.variables) == set(other.variables)
    for name in one.variables:
        a, b = one[name].values, other[name].values
        if a.dtype.kind == "f":
            np.testing.assert_allclose(a, b, err_msg=str(name), **tight)
        elif name != "made_with":
            assert (a == b).all(), name


def told(dataset: xr.Dataset, index: int = 0) -> dict:
    return json.loads(str(dataset["made_with"].values[index]))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    lines: list[str] = []
    out = tmp_path_factory.mktemp("made") / "boxes.zarr"
    return datasets.make_dataset(CONFIG, out, tell=lines.append, progress=False), lines


def flip(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def test_a_record_is_what_render_gives(made):
    dataset, _ = made
    config = datasets.read_config(CONFIG)
    for record in (0, 2):
        about = told(dataset, record)
        scene = scene_of(config, about["drawn"])
        film = tofrender.render(
            scene, spp=16, seed=about["render_seed"], settings=config.settings, progress=False
        )
        for name in ("transient", "steady"):
            np.testing.assert_allclose(dataset[name][record], film[name], **TIGHT)
        # A denoiser must not find the clean picture's own noise in the noisy one
        noisy, clean = dataset["noisy"].values[record], film["transient"].values
        assert clean.sum() == pytest.approx(noisy.sum(), rel=0.1)
        assert about["noise_seed"] != about["render_seed"]
        assert 0.1 < np.abs(noisy - clean).sum() / clean.sum() < 1.5
        np.testing.assert_allclose(dataset["opl"], film["opl"])
        assert about["fingerprint"] == film.attrs["fingerprint"]
        assert dataset["energy_outside_window"].values[record] == pytest.approx(
            film.attrs["energy_outside_window"], abs=1e-5
        )
        loaded = load(scene, config)
        I, Q, *_ = tofrender.render_amcw_phasor(  # noqa: E741
            *(loaded, loaded.sensors()[0], [20e6, 50e6], 16, about["render_seed"]),
            loaded.integrator(),
        )
        phasor = dataset["phasor"][record].values
        scale = np.abs(phasor).max()
        np.testing.assert_allclose(phasor[..., 0, :], I, rtol=1e-4, atol=1e-5 * scale)
        np.testing.assert_allclose(phasor[..., 1, :], Q, rtol=1e-4, atol=1e-5 * scale)
        truths = {"depth": tofrender.true_depth(loaded), "normals": tofrender.true_normals(loaded)}
        for name, truth in truths.items():
            np.testing.assert_allclose(dataset[name][record], truth, rtol=1e-6, err_msg=name)


def test_the_plan_is_told_first(made):
    _, lines = made
    assert lines[0].startswith("3 records of cornell_box; varied: turn, eye, paint, boxes\n")
    assert "transient  record, y, x, opl, channel              3 x 6 x 8 x 60 x 3    " in lines[0]
    assert lines[0].splitlines()[-1].startswith("in all ")
    assert lines[1].startswith("record 0 took ")
    assert "; the others take about " in lines[1]


def test_what_is_on_disk(made):
    """Plain Zarr, with a file for each record."""
    dataset, _ = made
    folder = Path(dataset.encoding["source"])
    for name in (*LIT, "depth", "normals"):
        files = sorted(path for path in (folder / name / "c").rglob("*") if path.is_file())
        assert [path.relative_to(folder / name).parts[1] for path in files] == ["0", "1", "2"]
    assert not list(folder.parent.glob(".tofrender-*"))
    opened = xr.open_zarr(dataset.encoding["source"], consolidated=True)
    assert opened["transient"].dims == ("record", "y", "x", "opl", "channel")
    assert opened["phasor"].dims == ("record", "frequency", "y", "x", "part", "channel")
    assert opened["normals"].dims == ("record", "y", "x", "xyz")
    assert opened["frequency"].values.tolist() == [20e6, 50e6]
    assert list(map(str, opened["channel"].values)) == ["R", "G", "B"]
    assert opened["opl"].attrs["units"] == "m"
    assert opened["transient"].chunks is not None
    assert opened["transient"].chunks[0] == (1, 1, 1)
    table = opened[opened.attrs["parameters"].split()].load()
    assert table["turn"].dims == ("record",)
    assert table["eye"].dims == ("record", "xyz")
    for record in range(3):
        drawn = datasets.read_config(CONFIG).draw(record)
        assert table["turn"].values[record] == drawn["turn"]
        assert table["boxes"].values[record] == " ".join(drawn["boxes"])
        assert table["eye"].values[record].tolist() == drawn["eye"]


def test_any_record_can_be_made_alone(made, tmp_path):
    dataset, _ = made
    alone = make(CONFIG, tmp_path / "one.zarr", only=[2])
    assert alone["record"].values.tolist() == [2]
    require_same(alone, dataset.isel(record=[2]))
    again = make(told(dataset, 2)["config"], tmp_path / "again.zarr", only=[2])
    require_same(again, alone)


def plane(width: int = 5, height: int = 4) -> dict:
    """A wall in z = 0, seen by a camera on the z axis."""
    film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"}}
    look = mi.ScalarTransform4f().look_at([0, 0, 2], [0, 0, 0], [0, 1, 0])
    wall = mi.ScalarTransform4f().scale(50)
    return {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 40, "to_world": look, "film": film},
        "wall": {"type": "rectangle", "to_world": wall},
    }


def test_depth_and_normals_of_a_plane(tmp_path):
    """Distance d of the camera: a pixel at the angle θ is d / cos θ away."""
    config = {"records": 3, "scene": plane(), "outputs": {"depth": True, "normals": True}}
    found = make(config | {"vary": EYE}, tmp_path / "plane.zarr")
    step = np.tan(np.radians(20)) * 2 / 5
    x, y = np.meshgrid((np.arange(5) - 2) * step, (np.arange(4) - 1.5) * step)
    for record in range(3):
        d = found["eye"].values[record, 2]
        expected = d * np.sqrt(1 + x**2 + y**2)
        np.testing.assert_allclose(found["depth"][record], expected, rtol=1e-5)
    np.testing.assert_allclose(found["normals"].values - [0, 0, 1], 0, atol=1e-6)


def test_phasors_follow_the_paths_of_a_steady_scene(tmp_path):
    """As deep as its own integrator, whatever that is."""
    config = {
        "records": 1,
        "scene": "cornell_box_steady_state",
        "arguments": {"max_depth": 2},
        "render": {"width": 4, "height": 4, "spp": 16},
        "outputs": {"phasor": {"frequencies_hz": [20e6]}},
    }
    found = make(config, tmp_path / "x.zarr")
    assert "opl" not in found.coords
    settings = {"width": 4, "height": 4, "max_depth": 2, "integrator": "transient_path"}
    loaded = tofrender.load_scene("cornell_box", **settings)
    seeded = (20e6, 16, told(found)["render_seed"], loaded.integrator())
    expected = tofrender.render_amcw_phasor(loaded, loaded.sensors()[0], *seeded)[0]
    np.testing.assert_allclose(found["phasor"][0, 0, :, :, 0], expected, rtol=1e-4, atol=1e-5)


def test_another_variant(tmp_path):
    mi.set_variant("llvm_ad_mono")
    config = CONFIG | {"records": 1, "vary": {"turn": CONFIG["vary"]["turn"]}}
    found = make(config, tmp_path / "x.zarr")
    assert found["channel"].values.tolist() == ["L"]
    assert found["phasor"].shape == (1, 2, 6, 8, 2, 1)
    assert found.attrs["variant"] == told(found)["variant"] == "llvm_ad_mono"


@pytest.mark.parametrize("name", ["boxes", "hidden", "room"])
def test_examples_work(name, tmp_path):
    """In small, with their windows: 4 records without a warning or another draw."""
    file = Path(datasets.__file__).parents[2] / "docs/datasets" / f"{name}.toml"
    config = tomllib.loads(file.read_text())
    config["records"] = 4
    config["render"]["spp"] = 16
    if name == "hidden":
        config["outputs"]["capture"]["grid"] = [8, 8]
    else:
        config["render"] |= {"width": 12, "height": 9}
    config["scene"] = config["scene"].replace("room.xml", str(file.with_name("room.xml")))
    found = make(config, tmp_path / "x.zarr")
    assert (found["attempt"].values == 0).all()
    for array in {*LIT, "capture"} & set(found):
        each = np.abs(found[array].values.reshape(4, -1))
        assert np.isfinite(each).all()
        assert (each.max(axis=1) > 0).all()
        assert len(set(each.sum(axis=1))) == 4
    for array in {"depth", "hidden_depth"} & set(found):
        values = found[array].values
        assert np.nanmin(values) > 0.3
        assert np.nanmax(values) < 10


HIDDEN = {
    "records": 2,
    "scene": "nlos_z",
    "arguments": {"occluder": False},
    "render": {"spp": 16, "temporal_bins": 80, "start_opl": 1.0, "bin_width_opl": 0.04},
    "outputs": {"capture": {"mode": "confocal", "grid": [4, 3]}},
    "vary": {
        "distance": uniform(0.8, 1.2, argument="distance"),
        "tilt": uniform(-30, 30, turn="hidden_z"),
    },
}


@pytest.mark.parametrize("mode", ["confocal", "single", "exhaustive"])
def test_captures_are_those_of_capture(tmp_path, mode):
    config = deepcopy(HIDDEN)
    config["outputs"]["capture"]["mode"] = mode
    found = make(config, tmp_path / "hidden.zarr")
    about = told(found, 1)
    read = datasets.read_config(config)
    scene = load(scene_of(read, about["drawn"]), read)
    expected = tofrender.capture(
        scene, mode=mode, spp=16, seed=about["render_seed"], progress=False
    )
    with pytest.raises(ValueError, match=r"record = \[0, 1\]:"):
        datasets.capture_of(found, [0, 1])
    one = datasets.capture_of(found, 1)
    assert set(one.data_vars) == set(expected.data_vars)
    for name in expected.data_vars:
        np.testing.assert_allclose(one[name], expected[name], rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(one["opl"], expected["opl"])
    truth = tofrender.hidden_depth(scene, expected)
    np.testing.assert_allclose(found["hidden_depth"][1], truth, rtol=1e-6)
    if mode == "confocal":
        assert tofrender.reconstruct(one, "lct").sizes


def test_time_bins_must_be_those_of_all(tmp_path):
    config = deepcopy(HIDDEN)
    config["render"] = {"spp": 4}
    with pytest.raises(ValueError, match=r"^record 1 cannot be made: its time bins start at \d"):
        make(config, tmp_path / "hidden.zarr")


def test_no_captures_no_capture(tmp_path):
    config = {"records": 1, "scene": plane(), "outputs": {"depth": True}}
    found = make(config, tmp_path / "plane.zarr")
    with pytest.raises(ValueError, match=r"dataset: has no captures"):
        datasets.capture_of(found, 0)
    with pytest.raises(ValueError, match=r"dataset = .*: must be what load_dataset returns"):
        datasets.capture_of(None, 0)
    with pytest.raises(ValueError, match=r"must be a finished data set that `make_dataset` wrote"):
        datasets.load_dataset(tmp_path)


def inside(share: float) -> dict:
    """The camera is inside of the large box in some records, and sees nothing there."""
    eye = {"camera": "origin", "distribution": "choice", "weights": [share, 1 - share]}
    eye["values"] = [[-0.33, -0.4, -0.28], [0, 0, 3.2]]
    return CONFIG | {"outputs": {"steady": True}, "vary": {"eye": eye}}


def test_what_cannot_be_rendered_ends_with_a_line(tmp_path):
    with refused(r"^record 0 cannot be made: .*\(eye = \[-0.33, -0.4, -0.28\]\)$"):
        make(inside(1.0), tmp_path / "x.zarr")
    with refused("record 0 cannot be made, and 2 more draws neither: "):
        make(inside(1.0) | {"retry": 2}, tmp_path / "y.zarr")


def test_what_cannot_be_rendered_is_drawn_again(tmp_path):
    config = inside(0.5) | {"records": 4, "retry": 20}
    found = make(config, tmp_path / "x.zarr")
    attempts = found["attempt"].values
    assert attempts.max() > 0
    assert (found["eye"].values == [0, 0, 3.2]).all()
    drawn = datasets.read_config(config)
    for record, attempt in enumerate(attempts):
        assert drawn.draw(record, int(attempt))["eye"] == [0, 0, 3.2]
        assert all(drawn.draw(record, a)["eye"][2] < 0 for a in range(attempt))
    assert (found["steady"].values.reshape(4, -1).max(axis=1) > 0).all()


SMALL = CONFIG | {"outputs": {"transient": True, "depth": True}}


def stopped(monkeypatch, out: Path, before: int, config: dict = SMALL) -> Path:
    """A run that was stopped before a record; returns where it is."""

    def make_record(config, layout, record, factor):
        if record == before:
            raise KeyboardInterrupt
        return datasets.record.make_record(config, layout, record, factor)

    with monkeypatch.context() as patch:
        patch.setattr(making, "make_record", make_record)
        with pytest.raises(KeyboardInterrupt, match=rf"interrupted after {before} of 3 records"):
            make(config, out)
    assert not out.exists()
    return making.under_way(out)


def ctrl_c_before(patch, name: str, number: int) -> None:
    """Let Ctrl-C come as a method of the store is called for the n-th time."""
    method, calls = getattr(making.StoredRecords, name), itertools.count()

    def interrupted(*arguments):
        if next(calls) == number:
            signal.raise_signal(signal.SIGINT)
        return method(*arguments)

    patch.setattr(making.StoredRecords, name, interrupted)


def test_a_record_that_is_written_when_somebody_stops_is_there_and_counted(tmp_path, monkeypatch):
    ctrl_c_before(monkeypatch, "write_part", 1)
    with pytest.raises(KeyboardInterrupt, match="interrupted after 2 of 3 records"):
        make(SMALL, tmp_path / "x.zarr")
    receipts = making.under_way(tmp_path / "x.zarr") / "receipts"
    assert len(list(receipts.glob("record *.json"))) == 2


def test_a_run_is_finished_once_all_records_are_there(tmp_path, monkeypatch):
    ctrl_c_before(monkeypatch, "finish", 0)
    with pytest.raises(KeyboardInterrupt):  # After it: whoever calls is to stop, too
        make(SMALL, tmp_path / "x.zarr")
    assert len(datasets.load_dataset(tmp_path / "x.zarr")["record"]) == 3
    assert not making.under_way(tmp_path / "x.zarr").exists()


def test_a_stopped_run_goes_on(made, tmp_path, monkeypatch):
    out = tmp_path / "x.zarr"
    folder = stopped(monkeypatch, out, 2)
    done = {path: path.stat().st_mtime_ns for path in folder.rglob("c/[01]/**/*")}
    assert done
    moved = {path.relative_to(folder / "set.zarr"): time for path, time in done.items()}
    lines: list[str] = []
    found = datasets.make_dataset(SMALL, out, tell=lines.append, progress=False)
    assert lines[1] == "resuming from 2 of 3 records"
    assert {path: (out / path).stat().st_mtime_ns for path in moved} == moved
    assert not folder.exists()
    for name in ("transient", "depth", "turn"):
        np.testing.assert_allclose(found[name], made[0][name], **TIGHT)


@pytest.mark.essential
def test_a_damaged_record_is_made_again(made, tmp_path, monkeypatch):
    out = tmp_path / "x.zarr"
    folder = stopped(monkeypatch, out, 2)
    file = next(path for path in (folder / "set.zarr/transient/c/1").rglob("*") if path.is_file())
    flip(file)
    shutil.rmtree(folder / "set.zarr/depth/c/0")
    with pytest.warns(UserWarning, match=r"record \d of .*: is damaged, making it again") as warned:
        found = make(SMALL, out)
    assert sum("is damaged" in str(each.message) for each in warned) == 2
    for name in ("transient", "depth"):
        np.testing.assert_allclose(found[name], made[0][name], **TIGHT)


def test_another_config_is_refused(tmp_path, monkeypatch):
    out = tmp_path / "x.zarr"
    folder = stopped(monkeypatch, out, 1)
    begun = ": the unfinished data set was begun with"
    for change, text in (
        ({"seed": 12}, f"seed = 12{begun} seed = 11"),
        ({"records": 9}, f"^records = 9{begun}"),
        ({"retry": 1}, f"retry = 1{begun}out retry"),
        ({"render": CONFIG["render"] | {"spp": 8}}, f"render.spp = 8{begun}"),
        ({"vary": {}}, f"without vary.turn|vary = {{}}{begun}"),
    ):
        with refused(text):
            make(SMALL | change, out)
    with refused(f"^only = .*{begun}"):
        make(SMALL, out, only=[0, 1])
    with refused("an unfinished data set is beside it", FileExistsError) as error:
        make(SMALL, out, resume=False)
    assert str(folder) in str(error.value)


ROOM = """<scene version="3.0.0">
  <sensor type="perspective"><film type="hdrfilm"><integer name="width" value="4"/>
    <integer name="height" value="4"/></film></sensor>
  <shape type="obj"><string name="filename" value="wall.obj"/></shape>
</scene>"""
WALL = "v -1 -1 2\nv 1 -1 2\nv 0 1 2\nf 1 2 3\n"


@pytest.mark.parametrize("way", ["of the scene", "of an object", "that is drawn"])
def test_a_changed_file_is_refused(tmp_path, monkeypatch, way):
    """Records of two meshes in one data set would not be told apart."""
    for name in ("wall.obj", "other.obj"):
        (tmp_path / name).write_text(WALL)
    config = {"records": 3, "scene": plane(), "outputs": {"depth": True}}
    wall = {"type": "obj", "filename": str(tmp_path / "wall.obj")}
    if way == "of the scene":
        (tmp_path / "room.xml").write_text(ROOM)
        config["scene"] = str(tmp_path / "room.xml")
    elif way == "of an object":
        config["objects"] = {"more": wall}
    else:
        (tmp_path / "room.xml").write_text(ROOM.replace('"wall.obj"', '"$mesh"'))
        files = [str(tmp_path / name) for name in ("other.obj", "wall.obj")]
        mesh = choice(*files, parameter="mesh")
        config |= {"scene": str(tmp_path / "room.xml"), "vary": {"mesh": mesh}, "seed": 1}
    out = tmp_path / "x.zarr"
    stopped(monkeypatch, out, 1, config)
    (tmp_path / "wall.obj").write_text(WALL.replace("2", "3", 1))
    with pytest.raises(ValueError, match=r"^checksum of scene and files = .*: the unfinished"):
        make(config, out)
    (tmp_path / "wall.obj").write_text(WALL)
    assert make(config, out).sizes["record"] == 3


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    config = {"records": 2, "scene": plane(), "outputs": {"depth": True, "normals": True}}
    out = tmp_path_factory.mktemp("set") / "small.zarr"
    return Path(make(config | {"vary": EYE}, out).encoding["source"])


@pytest.fixture
def copy(small, tmp_path) -> Path:
    return Path(shutil.copytree(small, tmp_path / "copy.zarr"))


@pytest.mark.parametrize("name", ["depth/c/1/0/0", "normals/c/0/0/0/0", "files.json"])
def test_a_file_that_is_missing_is_named(copy, name):
    """Zarr would read a missing record as zeros."""
    (copy / name).unlink()
    with refused(rf"^path = .*{name}.*; must be as .* written, copy"):
        datasets.load_dataset(copy)


@pytest.mark.parametrize(
    "name", ["made_with/c/0", "eye/c/0/0", "record/c/0", "zarr.json", "depth/zarr.json"]
)
def test_what_is_damaged_is_named(copy, name):
    flip(copy / name)
    with pytest.raises(ValueError, match=rf"\Apath = .*{name}.*\Z"):
        datasets.load_dataset(copy)


def test_a_damaged_record_is_named_when_it_is_read(copy):
    flip(copy / "depth/c/1/0/0")
    found = datasets.load_dataset(copy)
    assert np.isfinite(found["depth"].isel(record=0).values).all()
    with pytest.raises(OSError, match=r"\Adata set .*copy.zarr: depth/c/1/0/0 is damaged .*\Z"):
        np.asarray(found["depth"].isel(record=1))


def test_a_run_that_was_killed_as_it_finished_is_no_run(tmp_path):
    out = tmp_path / "x.zarr"
    make(SMALL | {"records": 1}, out)
    folder = making.under_way(out)
    (folder / "receipts").mkdir(parents=True)
    (folder / "receipts/plan.json").write_text("{}")
    shutil.rmtree(out)
    assert make(SMALL | {"records": 1}, out, resume=False).sizes["record"] == 1
    assert not folder.exists()


def test_a_small_disk_is_refused_before_work(tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10, 9, 1000))
    monkeypatch.setattr(making, "make_record", None)
    with pytest.raises(
        OSError, match=r"the disk is too full; needs up to .* KiB, 1000 bytes is free"
    ):
        make(CONFIG, tmp_path / "x.zarr")
    assert not list(tmp_path.iterdir())


def test_warnings_are_told_once(tmp_path):
    config = deepcopy(SMALL)
    config["render"]["window"] = [3, 7]
    with pytest.warns(UserWarning, match="came with warnings") as warned:
        found = make(config, tmp_path / "x.zarr")
    texts = [str(each.message) for each in warned]
    assert len(texts) == 1
    assert texts[0].startswith("3 of 3 records came with warnings, which made_with has; the first")
    assert "of the energy arrives outside the window" in told(found)["warnings"][0]
    assert (found["energy_outside_window"].values > 0.01).all()


def test_two_workers_make_the_same(made, tmp_path):
    with tofrender.local_workers(2) as client:
        found = make(CONFIG, tmp_path / "x.zarr", client=client)
    require_same(found, made[0])


RENDER_READERS = {
    "transient_to_phasor": lambda film, _: tofrender.transient_to_phasor(film, 20e6),
    "rebin": lambda film, _: tofrender.rebin(film, 6),
    "report": lambda film, out: tofrender.report(film, out / "page.html"),
    "light_in_flight": lambda film, _: tofrender.light_in_flight(film),
    "save_exr_stack": lambda film, out: tofrender.io.save_exr_stack(film, out / "stack"),
    "save_npz": lambda film, out: tofrender.io.save_npz(film, out / "film.npz"),
    "sense": lambda film, _: tofrender.sensors.sense(film, SPAD),
}


@pytest.mark.parametrize("name", RENDER_READERS)
def test_functions_of_renders_accept_a_record(made, tmp_path, name):
    RENDER_READERS[name](datasets.render_of(made[0], 1), tmp_path)


@pytest.mark.parametrize("name", ["transient_to_phasor", "light_in_flight", "sense"])
def test_functions_of_light_accept_a_record_as_it_is(made, tmp_path, name):
    """The attributes of the data set say what its light is."""
    RENDER_READERS[name](made[0].isel(record=1), tmp_path)


def test_the_render_of_a_record_is_that_of_render(made):
    found = datasets.render_of(made[0], 2)
    about = told(made[0], 2)
    config = datasets.read_config(CONFIG)
    scene = load(scene_of(config, about["drawn"]), config)
    given = tofrender.render(scene, spp=16, seed=about["render_seed"], progress=False)
    assert found.sizes == given.sizes
    assert set(found.coords) == set(given.coords)
    for name in ("transient", "steady", "opl", "time", "x", "y"):
        np.testing.assert_allclose(found[name], given[name], **TIGHT)
        assert found[name].attrs == given[name].attrs, name
    changing = {"render_seconds", "energy_outside_window"}
    assert {k: v for k, v in found.attrs.items() if k not in changing} == {
        k: v for k, v in given.attrs.items() if k not in changing
    }


def test_a_record_without_a_steady_picture_has_the_sum_of_its_bins(tmp_path):
    only = CONFIG | {"records": 1, "outputs": {"transient": True}}
    found = make(only, tmp_path / "whole.zarr")
    film = datasets.render_of(found, 0)
    np.testing.assert_allclose(film["steady"], found["transient"][0].sum("opl"), rtol=1e-5)
    short = only | {"render": SIZE | {"window": [3, 6], "max_depth": 4}}
    with pytest.warns(UserWarning, match="outside"):
        found = make(short, tmp_path / "short.zarr")
    with pytest.warns(UserWarning, match=r"steady is the sum of the bins, and .* outputs.steady"):
        datasets.render_of(found, 0)


def test_records_that_are_no_render(made, tmp_path):
    with refused("record = 7:"):
        datasets.render_of(made[0], 7)
    steady = make(CONFIG | {"records": 1, "outputs": {"steady": True}}, tmp_path / "a.zarr")
    with refused("dataset has no transients; make it with outputs.transient = true"):
        datasets.render_of(steady, 0)
    with refused(r"the additional axis record. Choose along the axis: isel\(record=0\)"):
        tofrender.transient_to_phasor(made[0], 20e6)


SPAD = {"cycles": 200, "pixels": [4, 3], "photons": {"photons_per_cycle": 0.5}, "spad": {}}


def test_a_sensor_measures_each_record(tmp_path):
    """Noisy counts with their expectation, on the sensor's own pixels, and the truth."""
    config = CONFIG | {"records": 2, "outputs": {"transient": True, "depth": True}}
    config |= {"sensor": SPAD, "vary": {}, "normalize_each_record": True}
    made = make(config, tmp_path / "counts.zarr")
    axes = ("record", "sensor_y", "sensor_x", "sensor_bin")
    assert made["sensor_counts"].dims == made["sensor_expected"].dims == axes
    assert made["sensor_counts"].shape == (2, 3, 4, 60)
    assert np.allclose(made["sensor_bin"], made["opl"])  # Meters
    plan = str(datasets.plan_dataset(config))
    assert "sensor_counts" in plan
    for index in (0, 1):
        about = told(made, index)
        film = datasets.render_of(made, index)
        given = tofrender.sensors.sense(film, SPAD, about["sensor_seed"])
        assert np.array_equal(made["sensor_counts"][index], given["counts"])
        assert np.allclose(made["sensor_expected"][index], given["expected"])
    assert told(made, 0)["sensor_seed"] != told(made, 1)["sensor_seed"]
    with refused("sensor.pixels = .*: must be numbers that divide the film of 8 x 6"):
        datasets.plan_dataset(config | {"sensor": SPAD | {"pixels": [5, 3]}})


LAMPS = [3.0, 1.0, 0.1]  # Radiance of the lamp in each record, relative


def lit_by(records: int = 3, **more) -> dict:
    """A data set of one scene with lamps of different radiance, seen by a sensor."""
    lamp = {"path": "light.emitter.radiance", "times": True, "distribution": "choice"}
    lamp |= {"values": LAMPS}
    config = CONFIG | {"records": records, "outputs": {"steady": True}, "vary": {"lamp": lamp}}
    config["render"] = config["render"] | {"max_depth": 3}
    return config | {"sensor": SPAD | {"spad": {"mode": "multi_hit"}}} | more


def expected_of(dataset: xr.Dataset) -> np.ndarray:
    """Mean expected signal of each record, in photons per pixel and cycle."""
    counts = dataset["sensor_expected"].sum("sensor_bin").mean(("sensor_y", "sensor_x"))
    return counts.values / SPAD["cycles"]


def test_one_factor_turns_the_light_of_all_records_into_photons(tmp_path):
    """Record 0 has `photons_per_cycle`; other records have more if their lamps are stronger."""
    made = make(lit_by(), tmp_path / "all.zarr")
    lamp = made["lamp"].values
    assert len(set(lamp)) > 1
    signal = expected_of(made)
    assert signal[0] == pytest.approx(0.5, rel=1e-3)
    light = made["steady"].mean(("y", "x", "channel")).values
    inside = 1 - made["energy_outside_window"].values
    np.testing.assert_allclose(signal / signal[0], light * inside / (light * inside)[0], rtol=1e-3)
    factors = {told(made, index)["photons_per_radiance"] for index in range(3)}
    assert len(factors) == 1

    # A record alone is the same, without record 0
    alone = make(lit_by(), tmp_path / "alone.zarr", only=[2])
    np.testing.assert_allclose(expected_of(alone), signal[2], rtol=1e-4)


def test_each_record_is_normalized_if_wanted(tmp_path):
    made = make(lit_by(2, normalize_each_record=True), tmp_path / "each.zarr")
    np.testing.assert_allclose(expected_of(made), 0.5, rtol=1e-3)
    first, second = (told(made, index)["photons_per_radiance"] for index in range(2))
    assert first != pytest.approx(second, rel=0.1)
    with refused("normalize_each_record has no effect without photons_per_cycle in the sensor"):
        datasets.plan_dataset(CONFIG | {"normalize_each_record": True})


def test_a_resumed_run_has_the_factor_of_its_first_records(tmp_path, monkeypatch):
    out, plain, done = tmp_path / "all.zarr", making.make_record, []

    def stopping(config, layout, record, factor):
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(record)
        return plain(config, layout, record, factor)

    with monkeypatch.context() as patch:
        patch.setattr(making, "make_record", stopping)
        with pytest.raises(KeyboardInterrupt):
            make(lit_by(), out)
    monkeypatch.setattr(
        making, "make_record", lambda *given: done.append(given[2]) or plain(*given)
    )
    resumed = make(lit_by(), out)
    assert done == [0, 1, 2]
    whole = make(lit_by(), tmp_path / "whole.zarr")
    np.testing.assert_allclose(expected_of(resumed), expected_of(whole), rtol=1e-4)


def test_a_sensor_in_a_file_beside_the_config(tmp_path):
    lines = (
        "cycles = 9\nphotons = { photons_per_cycle = 1.0 }\n[itof]\nfrequencies_hz = [2e7, 5e7]\n"
    )
    (tmp_path / "mine.toml").write_text(lines)
    text = 'records = 1\nscene = "cornell_box"\nsensor = "mine.toml"\noutputs = { depth = true }\n'
    text += "render = { width = 4, height = 4, spp = 4, temporal_bins = 60, window = [3, 15] }\n"
    (tmp_path / "config.toml").write_text(text)
    made = make(tmp_path / "config.toml", tmp_path / "a.zarr")
    assert made["sensor_taps"].dims[1:3] == ("sensor_frequency", "sensor_tap")
    assert made["sensor_frequency"].values.tolist() == [2e7, 5e7]
    assert made["sensor_depth"].shape == made["depth"].shape
    assert made["sensor_saturated"].dtype == bool
    (tmp_path / "mine.toml").write_text(lines.replace("9", "8"))
    with refused("is there, with another checksum"):
        making.require_complete(tmp_path / "config.toml", tmp_path / "a.zarr")
