"""Files that are damaged, cut or made up: one clear line, or exactly what was saved."""

from __future__ import annotations

import json
import os
import random
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import OpenEXR
import pytest
import xarray as xr
from helpers.bad_inputs import listing, one_clear_line
from helpers.hidden_scenes import Wall, capture_of, rectangle
from helpers.limited import write_film
from helpers.made_dataset import make_dataset
from hypothesis import HealthCheck, given, settings, strategies as st

import tofrender
from tofrender import io
from tofrender.io import exr
from tofrender.io.seals import _LENGTH as SEAL
from tofrender.runtime import memory


class Kind(NamedTuple):
    """A kind of file: what is saved, how, which file is damaged, how it is read and called."""

    make: Callable[[], xr.Dataset]
    save: Callable[[xr.Dataset, Path], Any]
    damaged: str
    load: Callable[[Path], xr.Dataset]
    called: str = "path"


def picture() -> xr.Dataset:
    return make_dataset(2, 3, 3)


def captured() -> xr.Dataset:
    patch = rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1)
    return capture_of(patch, Wall(3), bins=8, width=0.2).assign_attrs(scene="wall", spp=4)


def save_stack(dataset: xr.Dataset, path: Path) -> Path:
    layout = "multipart" if path.suffix else "frames"
    return io.save_exr_stack(dataset, path, layout=layout, progress=False)


def film() -> xr.Dataset:
    dataset = picture()
    dataset["transient"].attrs["long_name"] = "radiance per bin"
    return dataset


def save_film(dataset: xr.Dataset, path: Path) -> None:
    tofrender.save_zarr(dataset, path)


def load_film(folder: Path) -> xr.Dataset:
    return tofrender.load_zarr(folder / "a.zarr").load()


KINDS = {
    "npz": Kind(picture, io.save_npz, "a.npz", lambda p: io.load_npz(p / "a.npz")),
    "frame": Kind(picture, save_stack, "a/frame_0001.exr", lambda p: io.load_exr_stack(p / "a")),
    "steady": Kind(picture, save_stack, "a/steady.exr", lambda p: io.load_exr_stack(p / "a")),
    "parts": Kind(picture, save_stack, "a.exr", lambda p: io.load_exr_stack(p / "a.exr")),
    "film": Kind(film, save_film, "a.zarr/zarr.json", load_film),
    "list": Kind(film, save_film, "a.zarr/files.json", load_film),
    "axis": Kind(film, save_film, "a.zarr/opl/c/0", load_film),
    "tile": Kind(film, save_film, "a.zarr/transient/c/0/0/0/0", load_film, "film|path"),
    "capture": Kind(captured, io.save_capture, "a.h5", lambda p: io.load_capture(p / "a.h5")),
}
kinds = pytest.mark.parametrize("name", KINDS)


class Saved:
    """A file of a kind, which can be damaged again and again."""

    def __init__(self, name: str, folder: Path):
        self.kind, self.folder = KINDS[name], folder
        self.dataset = self.kind.make()
        self.kind.save(self.dataset, folder / Path(self.kind.damaged).parts[0])
        self.file = folder / self.kind.damaged
        self.content = self.file.read_bytes()

    def outcome(self, content: bytes) -> str:
        """What is wrong with how these bytes are read, "" if nothing is."""
        self.file.write_bytes(content)
        try:
            found = self.kind.load(self.folder)
        except Exception as error:
            names = self.kind.called.split("|")
            return min((one_clear_line(error, name) for name in names), key=len)
        return "" if found.identical(self.dataset) else "was read, but is not what was saved"

    def flipped(self, bit: int) -> bytes:
        content = bytearray(self.content)
        content[bit // 8] ^= 1 << bit % 8
        return bytes(content)


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """The files of all kinds."""
    return {name: Saved(name, tmp_path_factory.mktemp(name)) for name in KINDS}


@kinds
def test_what_was_saved_is_read(saved, name):
    assert not saved[name].outcome(saved[name].content)
    assert saved[name].kind.load(saved[name].folder).identical(saved[name].dataset)


@kinds
def test_flipped_bits_are_found(saved, name, pytestconfig):
    file = saved[name]
    bits = range(8 * len(file.content))
    many = pytestconfig.getoption("--all-inputs")
    chosen = random.Random(name).sample(bits, min(len(bits), 6000 if many else 150))
    wrong = {bit: what for bit in chosen if (what := file.outcome(file.flipped(bit)))}
    assert not wrong


@kinds
def test_files_that_are_cut_are_found(saved, name, pytestconfig):
    file = saved[name]
    lengths = range(len(file.content))
    if not pytestconfig.getoption("--all-inputs"):
        lengths = [*lengths[:4], *lengths[4 : -2 * SEAL : 97], *lengths[-2 * SEAL :]]
    wrong = {n: what for n in lengths if (what := file.outcome(file.content[:n]))}
    assert not wrong


damages = st.tuples(
    st.sampled_from(sorted(KINDS)),
    st.sampled_from(["flip", "set", "insert", "take out", "swap", "append"]),
    st.floats(0, 1, exclude_max=True),
    st.floats(0, 1, exclude_max=True),
    st.binary(min_size=1, max_size=16),
)


@settings(
    max_examples=200,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(damage=damages)
def test_any_damage_is_found(saved, damage):
    name, how, at, to, some = damage
    file = saved[name]
    content = file.content
    i, j = sorted(int(x * len(content)) for x in (at, to))
    broken = {
        "flip": lambda: file.flipped(8 * i + j % 8),
        "set": lambda: content[:i] + some + content[i + len(some) :],
        "insert": lambda: content[:i] + some + content[i:],
        "take out": lambda: content[:i] + content[i + len(some) :],
        "swap": lambda: content[j:] + content[i:j] + content[:i],
        "append": lambda: content + some,
    }[how]()
    assert not file.outcome(broken)


def test_files_without_a_seal_are_read(saved):
    """Those of earlier versions and of other programs."""
    for file in saved.values():
        if not file.kind.damaged.startswith(("a.npz", "a.zarr")):
            assert file.content[-SEAL:].startswith(b"\ntofrender crc32 ")
            assert not file.outcome(file.content[:-SEAL])
            assert file.kind.load(file.folder).identical(file.dataset)
            file.file.write_bytes(file.content)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A film of four tiles, one of which is black."""
    dataset = make_dataset(4, 4, 3)
    for values in dataset.values():
        values[:2, :2] = 0
    folder = tmp_path_factory.mktemp("stored") / "a.zarr"
    write_film(folder, dataset, (2, 2))
    return folder, dataset


def test_black_tiles_need_no_file(stored):
    folder, dataset = stored
    assert not (folder / "transient/c/0/0").exists()
    np.testing.assert_array_equal(tofrender.load_zarr(folder)["transient"], dataset["transient"])


@pytest.mark.parametrize("harm", ["taken away", "emptied", "a folder", "longer"])
def test_every_file_of_a_film_is_missed_when_it_is_opened(tmp_path, stored, harm):
    wrong = {}
    for number, name in enumerate(
        sorted(name for name, data in listing(stored[0]).items() if data)
    ):
        folder = tmp_path / f"{number}.zarr"
        shutil.copytree(stored[0], folder)
        file = folder / name
        if harm in ("taken away", "a folder"):
            file.unlink()
        if harm == "a folder":
            file.mkdir()
        elif harm == "emptied":
            file.write_bytes(b"")
        elif harm == "longer":
            file.write_bytes(file.read_bytes() + b"x")
        try:
            tofrender.load_zarr(folder)
            wrong[name] = "was opened"
        except ValueError as error:
            wrong[name] = one_clear_line(error, "path", folder)
    assert len(wrong) > 10
    assert not {name: what for name, what in wrong.items() if what}


# ------------------------------------------------------------------------ what is no such file

READERS = {"npz": io.load_npz, "exr": io.load_exr_stack, "h5": io.load_capture}
PNG = b"\x89PNG\r\n\x1a\n" + bytes(40)
CONTENTS = {
    "empty": b"",
    "text": b"some text\n" * 9,
    "zeros": bytes(4096),
    "png": PNG,
    "zip": b"PK\x03\x04" + bytes(100),
    "exr": b"\x76\x2f\x31\x01" + bytes(200),
    "hdf5": b"\x89HDF\r\n\x1a\n" + bytes(200),
    "numpy": b"\x93NUMPY\x01\x00v\x00" + bytes(200),
    "pickle": b"cos\nsystem\n(S'true'\ntR.",
}


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.parametrize("content", CONTENTS)
def test_other_files(tmp_path, suffix, content):
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(CONTENTS[content])
    assert not refused(lambda: READERS[suffix](path))


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.parametrize("what", ["missing", "folder", "dangling", "loop", "pipe"])
def test_no_files(tmp_path, suffix, what):
    path = tmp_path / f"a.{suffix}"
    if what == "folder":
        path.mkdir()
    elif what in ("dangling", "loop"):
        path.symlink_to(path if what == "loop" else tmp_path / "nowhere")
    elif what == "pipe":
        os.mkfifo(path)
    assert not refused(lambda: READERS[suffix](path))


def refused(call: Callable[[], Any], name: str = "path") -> str:
    """How a call is refused: "" if in one clear line."""
    with pytest.raises((ValueError, OSError, MemoryError)) as error:
        call()
    return one_clear_line(error.value, name)


# ------------------------------------------------------------------- descriptions that are wrong

WRONG: dict[str, Callable[[dict], Any]] = {
    "no dict": lambda about: [1],
    "null": lambda about: None,
    "a number": lambda about: 3,
    "nothing in it": lambda about: {},
    **{f"no {key}": lambda a, key=key: _without(a, key) for key in ("sizes", "channel", "attrs")},
    "no variables": lambda about: _without(about, "variables"),
    "sizes is a list": lambda about: about | {"sizes": [1, 2]},
    "sizes lacks x": lambda about: about | {"sizes": _without(about["sizes"], "x")},
    "sizes of text": lambda about: _sized(about, x="3"),
    "sizes of 0": lambda about: _sized(about, x=0),
    "sizes below 0": lambda about: _sized(about, opl=-1),
    "sizes that are fractions": lambda about: _sized(about, y=2.5),
    "sizes beyond memory": lambda about: _sized(about, x=1 << 38),
    "sizes of another picture": lambda about: _sized(about, x=4),
    "channel is text": lambda about: about | {"channel": "RGB"},
    "channel of numbers": lambda about: about | {"channel": [1, 2, 3]},
    "two channels": lambda about: about | {"channel": ["R", "G"]},
    "attrs is a list": lambda about: about | {"attrs": ["a"]},
    "attrs holds a list": lambda about: _with_attrs(about, extra=[1]),
    "attrs holds null": lambda about: _with_attrs(about, extra=None),
    "no bin_width_opl": lambda about: about | {"attrs": _without(about["attrs"], "bin_width_opl")},
    "bin_width_opl is text": lambda about: _with_attrs(about, bin_width_opl="wide"),
    "bin_width_opl is 0": lambda about: _with_attrs(about, bin_width_opl=0.0),
    "bin_width_opl is NaN": lambda about: _with_attrs(about, bin_width_opl=float("nan")),
    "another start_opl": lambda about: _with_attrs(about, start_opl=99.0),
    "variables is a list": lambda about: about | {"variables": []},
    "variables lacks steady": lambda about: about | {"variables": {"transient": {}}},
    "attributes of a variable": lambda about: (
        about | {"variables": about["variables"] | {"opl": "m"}}
    ),
}


def _without(given: dict, key: str) -> dict:
    return {name: value for name, value in given.items() if name != key}


def _sized(about: dict, **sizes: Any) -> dict:
    return about | {"sizes": about["sizes"] | sizes}


def _with_attrs(about: dict, **attrs: Any) -> dict:
    return about | {"attrs": about["attrs"] | attrs}


def rewritten_stack(folder: Path, change: Callable[[dict], Any]) -> Path:
    """A stack whose steady picture has another header."""
    stack = io.save_exr_stack(picture(), folder / "s", progress=False)
    header, channels = exr._Stack(picture(), "float").part(-1)
    header["dataset"] = json.dumps(change(json.loads(header["dataset"])))
    OpenEXR.File(header, channels).write(str(stack / "steady.exr"))
    return stack


def rewritten_npz(folder: Path, change: Callable[[dict], Any]) -> Path:
    path = io.save_npz(picture(), folder / "a.npz")
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez(path, **change(arrays))
    return path


@pytest.mark.parametrize("what", WRONG)
def test_wrong_descriptions(tmp_path, what):
    change = WRONG[what]
    stack = rewritten_stack(tmp_path, change)
    assert not refused(lambda: io.load_exr_stack(stack))
    archive = rewritten_npz(
        tmp_path,
        lambda arrays: (
            arrays
            | {"tofrender": np.array(json.dumps(change(json.loads(str(arrays["tofrender"])))))}
        ),
    )
    assert not refused(lambda: io.load_npz(archive))


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "{'a': 1}", "NaN"])
def test_descriptions_that_are_no_json(tmp_path, text):
    path = rewritten_npz(tmp_path, lambda arrays: arrays | {"tofrender": np.array(text)})
    assert not refused(lambda: io.load_npz(path))


ARRAYS: dict[str, Callable[[dict], dict]] = {
    **{f"no {name}": lambda a, name=name: _without(a, name) for name in ("transient", "x", "opl")},
    "no description": lambda a: _without(a, "tofrender"),
    "doubles": lambda a: a | {"transient": a["transient"].astype(float)},
    "text": lambda a: a | {"transient": np.array(["a"])},
    "complex": lambda a: a | {"steady": a["steady"].astype(complex)},
    "another shape": lambda a: a | {"steady": a["steady"][:1]},
    "transposed": lambda a: a | {"transient": a["transient"].T},
    "pixels apart": lambda a: a | {"x": a["x"] * 2},
    "pixels that are fractions": lambda a: a | {"x": a["x"] + 0.5},
    "bins apart": lambda a: a | {"opl": a["opl"] ** 2},
    "bins that are NaN": lambda a: a | {"opl": a["opl"] * np.nan},
    "light that is NaN": lambda a: a | {"transient": a["transient"] * np.float32("nan")},
    "light that is infinite": lambda a: a | {"steady": a["steady"] * np.float32("inf")},
    "description of numbers": lambda a: a | {"tofrender": np.ones(3)},
}


@pytest.mark.parametrize("what", ARRAYS)
def test_wrong_arrays(tmp_path, what):
    with np.errstate(invalid="ignore"):
        path = rewritten_npz(tmp_path, ARRAYS[what])
    assert not refused(lambda: io.load_npz(path))


def test_pickles_are_not_run(tmp_path):
    path = rewritten_npz(tmp_path, lambda a: a | {"x": np.array([print], dtype=object)})
    assert not refused(lambda: io.load_npz(path))


def test_an_archive_that_claims_more_than_it_has(tmp_path):
    """And one of very many zeros: neither is made room for."""
    path = io.save_npz(picture(), tmp_path / "a.npz")
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    shape = b"(2, 3, 3, 3)"
    claimed = b"(200000, 300000, 3, 3)"
    header = members["transient.npy"]
    assert shape in header
    at = header.index(shape)
    taken = len(claimed) - len(shape)
    end = header.index(b" " * taken + b"\n")
    members["transient.npy"] = (
        header[:at] + claimed + header[at + len(shape) : end] + header[end + taken :]
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    assert not refused(lambda: io.load_npz(path))


# ------------------------------------------------------------------------------------ stacks


STACKS: dict[str, Callable[[Path], Any]] = {
    "no steady": lambda s: (s / "steady.exr").unlink(),
    "a frame less": lambda s: (s / "frame_0001.exr").unlink(),
    "a frame more": lambda s: (s / "frame_0009.exr").write_bytes(
        (s / "frame_0001.exr").read_bytes()
    ),
    "a frame twice": lambda s: (s / "frame_0002.exr").write_bytes(
        (s / "frame_0001.exr").read_bytes()
    ),
    "a frame that is the steady": lambda s: (s / "frame_0002.exr").write_bytes(
        (s / "steady.exr").read_bytes()
    ),
    "a steady that is a frame": lambda s: (s / "steady.exr").write_bytes(
        (s / "frame_0001.exr").read_bytes()
    ),
    "a frame that is a folder": lambda s: (
        (s / "frame_0002.exr").unlink(),
        (s / "frame_0002.exr").mkdir(),
    ),
    "a frame of another size": lambda s: write_frame(s, pixels=np.ones((5, 5, 3), np.float32)),
    "a frame of another channel": lambda s: write_frame(s, channel="Z"),
    "a grey frame": lambda s: write_frame(s, "Y", np.ones((2, 3), np.float32)),
    "a frame with more channels": lambda s: write_frame(s, more={"Z": np.ones((2, 3), np.float32)}),
    "no bin_index": lambda s: write_frame(s, leave_out="bin_index"),
    "bin_index of text": lambda s: write_frame(s, bin_index="2"),
    "bin_index too large": lambda s: write_frame(s, bin_index=3),
    "bin_index below 0": lambda s: write_frame(s, bin_index=-1),
    "no opl_center": lambda s: write_frame(s, leave_out="opl_center"),
    "opl_center of text": lambda s: write_frame(s, opl_center="here"),
    "opl_center elsewhere": lambda s: write_frame(s, opl_center=np.array([99.0])),
    "light that is NaN": lambda s: write_frame(s, pixels=np.full((2, 3, 3), np.nan, np.float32)),
}


def write_frame(
    stack: Path,
    channel: str | None = None,
    pixels: np.ndarray | None = None,
    more: dict | None = None,
    leave_out: str = "",
    **changes: Any,
) -> None:
    header, channels = exr._Stack(picture(), "float").part(2)
    ((name, values),) = channels.items()
    values = values if pixels is None else pixels
    for each in ("dataWindow", "displayWindow"):
        del header[each]
    header = _without(header | changes, leave_out)
    channels = {channel or name: values[..., 0].copy() if channel == "Z" else values} | (more or {})
    OpenEXR.File(header, channels).write(str(stack / "frame_0002.exr"))


@pytest.mark.parametrize("what", STACKS)
def test_wrong_stacks(tmp_path, what):
    stack = io.save_exr_stack(picture(), tmp_path / "s", progress=False)
    STACKS[what](stack)
    assert not refused(lambda: io.load_exr_stack(stack))


def test_stacks_that_do_not_fit_into_memory(tmp_path, monkeypatch):
    stack = io.save_exr_stack(picture(), tmp_path / "s", progress=False)
    archive = io.save_npz(picture(), tmp_path / "a.npz")
    capture = io.save_capture(captured(), tmp_path / "a.h5")
    monkeypatch.setattr(memory, "free_on_host", lambda: 10)
    for load, path in (
        (io.load_exr_stack, stack),
        (io.load_npz, archive),
        (io.load_capture, capture),
    ):
        with pytest.raises(MemoryError, match=r"GiB, must be at most 0\.0 GiB") as error:
            load(path)
        assert not one_clear_line(error.value, "path")


# ------------------------------------------------------------------------------------ captures

DELETE = object()


def change_capture(path: Path, **changes: Any) -> None:
    with h5py.File(path, "a") as file:
        for name, value in changes.items():
            if name in file:
                del file[name]
            if value is not DELETE:
                file[name] = h5py.Empty("f8") if value is None else value


def described(**changes: Any) -> str:
    about = {"mode": "confocal", "attrs": {}, "pixels": {}}
    return json.dumps({"tofrender": about | changes})


REQUIRED = (
    *("H", "H_format", "delta_t", "t_start", "t_accounts_first_and_last_bounces"),
    *("sensor_grid_xyz", "sensor_grid_format", "laser_grid_xyz", "laser_grid_format"),
)
CAPTURES: dict[str, dict[str, Any]] = {
    **{f"no {name}": {name: DELETE} for name in REQUIRED},
    **{f"empty {name}": {name: None} for name in REQUIRED},
    **{f"text in {name}": {name: "text"} for name in REQUIRED},
    **{f"complex {name}": {name: np.ones((8, 3, 3), complex)} for name in REQUIRED},
    **{f"nothing in {name}": {name: np.zeros(0)} for name in REQUIRED},
    **{
        f"{name} = {value}": {name: value}
        for name in ("H_format", "sensor_grid_format")
        for value in (0, 9, 1.5, -1, np.nan, np.inf)
    },
    **{
        f"{name} = {value}": {name: value}
        for name in ("delta_t", "t_start")
        for value in (np.nan, np.inf, -np.inf)
    },
    "delta_t = 0": {"delta_t": 0.0},
    "delta_t below 0": {"delta_t": -0.1},
    "legs = 2": {"t_accounts_first_and_last_bounces": 2},
    "legs = nan": {"t_accounts_first_and_last_bounces": np.nan},
    "H of one axis": {"H": np.ones(8)},
    "H of five axes": {"H": np.ones((8, 1, 1, 3, 3))},
    "H of other pixels": {"H": np.ones((8, 3, 4))},
    "H of NaN": {"H": np.full((8, 3, 3), np.nan)},
    "H of booleans": {"H": np.ones((8, 3, 3), bool)},
    "grid of NaN": {"sensor_grid_xyz": np.full((3, 3, 3), np.nan)},
    "grid of two": {"sensor_grid_xyz": np.ones((3, 3, 2))},
    "normals of 0": {"sensor_grid_normals": np.zeros((3, 3, 3))},
    "normals of text": {"sensor_grid_normals": "up"},
    "sensor of two": {"sensor_xyz": np.ones(2)},
    "sensor of text": {"sensor_xyz": "here"},
    "laser beside": {"laser_grid_xyz": np.ones((3, 3, 3))},
    "about is a list": {"scene_info": '{"tofrender": [1]}'},
    "about is text": {"scene_info": '{"tofrender": "x"}'},
    "about is null": {"scene_info": '{"tofrender": {"attrs": [], "pixels": {}}}'},
    "attrs is a list": {"scene_info": described(attrs=[1])},
    "attrs holds a list": {"scene_info": described(attrs={"a": [1]})},
    "attrs holds null": {"scene_info": described(attrs={"a": None})},
    "pixels is a list": {"scene_info": described(pixels=[1])},
    "pixels of an unknown axis": {"scene_info": described(pixels={"u": [1]})},
    "pixels of time": {"scene_info": described(pixels={"opl": [1, 2, 3]})},
    "too few pixels": {"scene_info": described(pixels={"x": [0, 1]})},
    "pixels apart": {"scene_info": described(pixels={"x": [0, 2, 4]})},
    "pixels of text": {"scene_info": described(pixels={"x": ["a", "b", "c"]})},
    "pixels that are fractions": {"scene_info": described(pixels={"x": [0.5, 1.5, 2.5]})},
    "no pixels": {"scene_info": described(pixels={"x": []})},
    "on_wall of text": {"scene_info": described(on_wall="all")},
    "on_wall of too many": {"scene_info": described(on_wall=[0, 100])},
    "on_wall below 0": {"scene_info": described(on_wall=[-1, 10])},
    "on_wall of fractions": {"scene_info": described(on_wall=[0.5, 8.5])},
}


@pytest.mark.parametrize("what", CAPTURES)
def test_wrong_captures(tmp_path, what):
    path = io.save_capture(captured(), tmp_path / "a.h5")
    change_capture(path, **CAPTURES[what])
    assert not refused(lambda: io.load_capture(path))


@pytest.mark.parametrize("field", ["H", "sensor_grid_xyz", "delta_t", "scene_info"])
@pytest.mark.parametrize("how", ["link", "external", "virtual", "loop", "group"])
def test_fields_that_are_elsewhere(tmp_path, field, how):
    """No other file is read, whatever this one says."""
    path = io.save_capture(captured(), tmp_path / "a.h5")
    other = io.save_capture(captured(), tmp_path / "other.h5")
    with h5py.File(path, "a") as file:
        shape = file[field].shape
        del file[field]
        if how == "link":
            file[field] = h5py.ExternalLink(str(other), field)
        elif how == "loop":
            file[field] = h5py.SoftLink(f"/{field}")
        elif how == "group":
            file.create_group(field)
        elif how == "virtual":
            layout = h5py.VirtualLayout(shape or (1,), "f8")
            layout[...] = h5py.VirtualSource(str(other), field, shape or (1,))
            file.create_virtual_dataset(field, layout)
        else:
            place = [("/etc/passwd", 0, 8 * int(np.prod(shape or (1,))))]
            file.create_dataset(field, shape or (1,), "f8", external=place)
    if (field, how) == ("scene_info", "group"):
        io.load_capture(path)  # None of ours: as if it was not there
        return
    with pytest.raises(ValueError, match=field) as error:
        io.load_capture(path)
    assert not one_clear_line(error.value, "path")


def test_only_what_is_asked_for_is_read(tmp_path):
    """Not a field of a terabyte that something else has put there."""
    path = io.save_capture(captured(), tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        file.create_dataset("junk", (1 << 40,), "f8", chunks=(1 << 20,))
        file["elsewhere"] = h5py.ExternalLink("/etc/passwd", "x")
    assert io.load_capture(path).identical(captured())


@pytest.mark.parametrize("field", ["H", "sensor_grid_xyz", "delta_t"])
def test_a_field_that_claims_a_terabyte(tmp_path, field):
    path = io.save_capture(captured(), tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        del file[field]
        file.create_dataset(field, (1 << 20, 1 << 10, 1 << 10), "f8", chunks=(1, 1 << 10, 1 << 10))
    with pytest.raises(MemoryError, match=rf"{field} with shape") as error:
        io.load_capture(path)
    assert not one_clear_line(error.value, "path")


def test_a_seal_is_lost_when_another_program_writes(tmp_path):
    path = io.save_capture(captured(), tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        file["t_start"][()] = 0.5
    assert io.load_capture(path).attrs["start_opl"] == 0.5


def test_sealed_files_are_read_by_others(tmp_path):
    """What stands behind the end does not disturb OpenEXR."""
    stack = io.save_exr_stack(picture(), tmp_path / "s.exr", layout="multipart", progress=False)
    assert len(OpenEXR.File(str(stack)).parts) == 4
    assert stack.read_bytes()[-SEAL:].startswith(b"\ntofrender crc32 ")
