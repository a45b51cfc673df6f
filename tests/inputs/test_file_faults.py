"""Files that are damaged, cut or made up: one clear line, or exactly what was saved."""

import json
import os
import random
import re
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
from helpers import measured_files
from helpers.bad_inputs import OTHER_FILES, listing, one_clear_line
from helpers.hidden_scenes import Wall, capture_of, rectangle
from helpers.limited import write_film
from helpers.limits import lower
from helpers.made_dataset import make_dataset
from hypothesis import HealthCheck, given, settings, strategies as st

import tofrender
from tofrender import io
from tofrender.io import exr
from tofrender.io.files import _LENGTH as SEAL
from tofrender.io.netcdf import load_measurement, save_measurement
from tofrender.runtime.versions import versions


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


def counted() -> xr.Dataset:
    sensor = {"cycles": 9, "photons": {"photons_per_cycle": 0.1}, "spad": {}}
    return tofrender.sensors.sense(picture(), sensor).assign_attrs(versions=versions())


def save_stack(dataset: xr.Dataset, path: Path) -> Path:
    layout = "multipart" if path.suffix else "frames"
    return io.save_exr_stack(dataset, path, layout=layout, progress=False)


def film() -> xr.Dataset:
    dataset = picture()
    dataset["transient"].attrs["long_name"] = "radiance per bin"
    return dataset


def film_kind(damaged: str, called: str = "path") -> Kind:
    load = lambda folder: tofrender.load_zarr(folder / "a.zarr").load()  # noqa: E731
    return Kind(film, tofrender.save_zarr, f"a.zarr/{damaged}", load, called)


KINDS = {
    "npz": Kind(picture, io.save_npz, "a.npz", lambda p: io.load_npz(p / "a.npz")),
    "frame": Kind(picture, save_stack, "a/frame_0001.exr", lambda p: io.load_exr_stack(p / "a")),
    "steady": Kind(picture, save_stack, "a/steady.exr", lambda p: io.load_exr_stack(p / "a")),
    "parts": Kind(picture, save_stack, "a.exr", lambda p: io.load_exr_stack(p / "a.exr")),
    **{"film": film_kind("zarr.json"), "list": film_kind("files.json")},
    "axis": film_kind("opl/c/0"),
    "tile": film_kind("transient/c/0/0/0/0", "film|path"),
    "counts": Kind(counted, save_measurement, "a.nc", lambda p: load_measurement(p / "a.nc")),
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
def test_flipped_bits_and_cut_files_are_found(saved, name, pytestconfig):
    file = saved[name]
    bits, lengths = range(8 * len(file.content)), range(len(file.content))
    everything = pytestconfig.getoption("--all-inputs")
    bits = random.Random(name).sample(bits, min(len(bits), 6000 if everything else 150))
    if not everything:
        lengths = [*lengths[:4], *lengths[4 : -2 * SEAL : 97], *lengths[-2 * SEAL :]]
    wrong = {f"bit {n}": what for n in bits if (what := file.outcome(file.flipped(n)))}
    wrong |= {f"cut to {n}": what for n in lengths if (what := file.outcome(file.content[:n]))}
    assert not wrong


damages = st.tuples(
    st.sampled_from(sorted(KINDS)),
    st.sampled_from(["flip", "set", "insert", "take out", "swap", "append"]),
    st.floats(0, 1, exclude_max=True),
    st.floats(0, 1, exclude_max=True),
    st.binary(min_size=1, max_size=16),
)


@settings(
    max_examples=200, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
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
    """Other programs write files without a seal."""
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


def become_folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


HARM: dict[str, Callable[[Path], Any]] = {
    "taken away": Path.unlink,
    "emptied": lambda file: file.write_bytes(b""),
    "a folder": become_folder,
    "longer": lambda file: file.write_bytes(file.read_bytes() + b"x"),
}


@pytest.mark.parametrize("harm", HARM)
def test_every_file_of_a_film_is_missed_when_it_is_opened(tmp_path, stored, harm):
    wrong = {}
    files = sorted(name for name, data in listing(stored[0]).items() if data)
    for number, name in enumerate(files):
        folder = tmp_path / f"{number}.zarr"
        shutil.copytree(stored[0], folder)
        HARM[harm](folder / name)
        try:
            tofrender.load_zarr(folder)
            wrong[name] = "was opened"
        except ValueError as error:
            wrong[name] = one_clear_line(error, "path", folder)
    assert len(wrong) > 10
    assert not {name: what for name, what in wrong.items() if what}


READERS = {"npz": io.load_npz, "exr": io.load_exr_stack, "h5": io.load_capture}


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.parametrize("what", OTHER_FILES)
def test_other_files(tmp_path, suffix, what):
    path = tmp_path / f"a.{suffix}"
    OTHER_FILES[what](path)
    assert not refused(lambda: READERS[suffix](path))


def refused(call: Callable[[], Any], name: str = "path") -> str:
    """How a call is refused: "" if in one clear line."""
    with pytest.raises((ValueError, OSError, MemoryError)) as error:
        call()
    return one_clear_line(error.value, name)


MISSING = object()

WRONG: dict[tuple[str, ...], list[Any]] = {
    # where in the description: what must not be there
    (): [[1], None, 3, {}],
    ("sizes",): [MISSING, [1, 2]],
    ("sizes", "x"): [MISSING, "3", 0, 4, 1 << 38],
    ("sizes", "y"): [2.5],
    ("sizes", "opl"): [-1],
    ("channel",): [MISSING, "RGB", [1, 2, 3], ["R", "G"]],
    ("attrs",): [MISSING, ["a"]],
    ("attrs", "extra"): [[1], None],
    ("attrs", "bin_width_opl"): [MISSING, "wide", 0.0, float("nan")],
    ("attrs", "start_opl"): [99.0],
    ("variables",): [MISSING, [], {"transient": {}}],
    ("variables", "opl"): ["m"],
}


def listed(table: dict[Any, list[Any]]) -> list[Any]:
    """Parameters of a test: each key with each of its values."""
    found = []
    for key, values in table.items():
        for value in values:
            text = f"{key} {'missing' if value is MISSING else value}"
            found.append(pytest.param(key, value, id=re.sub(r"\W+", " ", text)[:40].strip()))
    return found


def changed(about: Any, where: tuple[str, ...], value: Any) -> Any:
    """A description with another value somewhere in it."""
    if not where:
        return value
    inner = changed(about.get(where[0]), where[1:], value)
    return _without(about, where[0]) if inner is MISSING else about | {where[0]: inner}


def _without(given: dict, key: str) -> dict:
    return {name: value for name, value in given.items() if name != key}


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


@pytest.mark.parametrize(("where", "value"), listed(WRONG))
def test_wrong_descriptions(tmp_path, where, value):
    stack = rewritten_stack(tmp_path, lambda about: changed(about, where, value))
    assert not refused(lambda: io.load_exr_stack(stack))

    def described(arrays: dict) -> dict:
        about = changed(json.loads(str(arrays["tofrender"])), where, value)
        return arrays | {"tofrender": np.array(json.dumps(about))}

    archive = rewritten_npz(tmp_path, described)
    assert not refused(lambda: io.load_npz(archive))


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
    "pickle": lambda a: a | {"x": np.array([print], dtype=object)},
    **{
        f"no json {k}": lambda a, text=text: a | {"tofrender": np.array(text)}
        for k, text in enumerate(["", "{", "[" * 100_000, "{'a': 1}", "NaN"])
    },
    "description of numbers": lambda a: a | {"tofrender": np.ones(3)},
}


@pytest.mark.parametrize("what", ARRAYS)
def test_wrong_arrays(tmp_path, what):
    with np.errstate(invalid="ignore"):
        path = rewritten_npz(tmp_path, ARRAYS[what])
    assert not refused(lambda: io.load_npz(path))


def test_an_archive_that_claims_more_than_it_has(tmp_path):
    """And one of very many zeros: neither is made room for."""
    path = io.save_npz(picture(), tmp_path / "a.npz")
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    shape, claimed = b"(2, 3, 3, 3)", b"(200000, 300000, 3, 3)"
    header, padding = members["transient.npy"], b" " * (len(claimed) - len(shape))
    assert header.count(shape) == 1
    members["transient.npy"] = header.replace(shape, claimed).replace(padding + b"\n", b"\n", 1)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    assert not refused(lambda: io.load_npz(path))


def copied(source: str, target: str) -> Callable[[Path], Any]:
    return lambda stack: (stack / target).write_bytes((stack / source).read_bytes())


def frame(**changes: Any) -> Callable[[Path], Any]:
    return lambda stack: write_frame(stack, **changes)


GRAY = np.ones((2, 3), np.float32)
STACKS: dict[str, Callable[[Path], Any]] = {
    "no steady": lambda s: (s / "steady.exr").unlink(),
    "a frame less": lambda s: (s / "frame_0001.exr").unlink(),
    "a frame more": copied("frame_0001.exr", "frame_0009.exr"),
    "a frame twice": copied("frame_0001.exr", "frame_0002.exr"),
    "a frame that is the steady": copied("steady.exr", "frame_0002.exr"),
    "a steady that is a frame": copied("frame_0001.exr", "steady.exr"),
    "a frame that is a folder": lambda s: become_folder(s / "frame_0002.exr"),
    "a frame of another size": frame(pixels=np.ones((5, 5, 3), np.float32)),
    "a frame of another channel": frame(channel="Z"),
    "a gray frame": frame(channel="Y", pixels=GRAY),
    "a frame with more channels": frame(more={"Z": GRAY}),
    "no bin_index": frame(leave_out="bin_index"),
    **{f"bin_index {value}": frame(bin_index=value) for value in ("2", 3, -1)},
    "no opl_center": frame(leave_out="opl_center"),
    "opl_center of text": frame(opl_center="here"),
    "opl_center elsewhere": frame(opl_center=np.array([99.0])),
    "light that is NaN": frame(pixels=np.full((2, 3, 3), np.nan, np.float32)),
}


def write_frame(stack, channel=None, pixels=None, more=None, leave_out="", **changes: Any) -> None:
    header, channels = exr._Stack(picture(), "float").part(2)
    values = np.stack([*channels.values()], axis=-1) if pixels is None else pixels
    for each in ("dataWindow", "displayWindow"):
        del header[each]
    header = _without(header | changes, leave_out)
    image = values[..., 0].copy() if channel == "Z" else values
    channels = {channel or "RGB": image} | (more or {})
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
    lower(monkeypatch, free_memory=10)
    for suffix, path in (("exr", stack), ("npz", archive), ("h5", capture)):
        with pytest.raises(MemoryError, match=r"GiB, must be at most 0\.0 GiB") as error:
            READERS[suffix](path)
        assert not one_clear_line(error.value, "path")


def change_capture(path: Path, **changes: Any) -> None:
    with h5py.File(path, "a") as file:
        for name, value in changes.items():
            if name in file:
                del file[name]
            if value is not MISSING:
                file[name] = h5py.Empty("f8") if value is None else value


REQUIRED = (
    *("H", "H_format", "delta_t", "t_start", "t_accounts_first_and_last_bounces"),
    *("sensor_grid_xyz", "sensor_grid_format", "laser_grid_xyz", "laser_grid_format"),
)
NONE_OF_THEM = [MISSING, None, "text", np.ones((8, 3, 3), complex), np.zeros(0)]
FORMATS = [0, 9, 1.5, -1, np.nan, np.inf]
TIMES = [np.nan, np.inf, -np.inf]
CAPTURES: dict[str, list[Any]] = dict.fromkeys(REQUIRED, NONE_OF_THEM)
for name, values in {
    "H_format": FORMATS,
    "sensor_grid_format": FORMATS,
    "delta_t": [*TIMES, 0.0, -0.1],
    "t_start": TIMES,
    "t_accounts_first_and_last_bounces": [2, np.nan],
    "H": [
        *(np.ones(8), np.ones((8, 1, 1, 3, 3)), np.ones((8, 3, 4))),
        *(np.full((8, 3, 3), np.nan), np.ones((8, 3, 3), bool)),
    ],
    "sensor_grid_xyz": [np.full((3, 3, 3), np.nan), np.ones((3, 3, 2))],
    "sensor_grid_normals": [np.zeros((3, 3, 3)), "up"],
    "sensor_xyz": [np.ones(2), "here"],
    "laser_grid_xyz": [np.ones((3, 3, 3))],
}.items():
    CAPTURES[name] = [*CAPTURES.get(name, []), *values]

ABOUT: dict[tuple[str, ...], list[Any]] = {
    (): [[1], "x", {"attrs": [], "pixels": {}}],
    ("attrs",): [[1], {"a": [1]}, {"a": None}],
    ("pixels",): [[1], {"u": [1]}, {"opl": [1, 2, 3]}],
    ("pixels", "x"): [[0, 1], ["a", "b", "c"], [0.5, 1.5, 2.5], []],
    ("on_wall",): ["all", [0, 100], [-1, 10], [0.5, 8.5]],
}


@pytest.mark.parametrize(("where", "value"), [*listed(CAPTURES), *listed(ABOUT)])
def test_wrong_captures(tmp_path, where, value):
    path = io.save_capture(captured(), tmp_path / "a.h5")
    if isinstance(where, tuple):
        about = changed({"mode": "confocal", "attrs": {}, "pixels": {}}, where, value)
        where, value = "scene_info", json.dumps({"tofrender": about})
    change_capture(path, **{where: value})
    assert not refused(lambda: io.load_capture(path))


def endless_virtual(file: h5py.File, field: str, source: Path) -> None:
    """A virtual dataset without end, whose shape HDF5 looks up in its source."""
    endless = h5py.h5s.UNLIMITED
    spaces = []
    for _ in range(2):
        space = h5py.h5s.create_simple((1,), (endless,))
        space.select_hyperslab((0,), (1,), (1,), (endless,))
        spaces.append(space)
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_virtual(spaces[0], os.fsencode(source), b"x", spaces[1])
    shape = h5py.h5s.create_simple((1,), (endless,))
    h5py.h5d.create(file.id, field.encode(), h5py.h5t.NATIVE_DOUBLE, shape, made)


@pytest.mark.parametrize("field", ["H", "sensor_grid_xyz", "delta_t", "scene_info"])
@pytest.mark.parametrize(
    "how",
    [
        *("link", "external", "virtual", "loop", "group"),
        *("link through a group", "link through links", "link to a pipe", "virtual on a pipe"),
    ],
)
@pytest.mark.timeout(120)  # HDF5 waits for a pipe without end
def test_fields_that_are_elsewhere(tmp_path, field, how):
    """No other file is read, whatever this one says."""
    path = io.save_capture(captured(), tmp_path / "a.h5")
    other = io.save_capture(captured(), tmp_path / "other.h5")
    with h5py.File(path, "a") as file:
        shape = file[field].shape
        del file[field]
        if how == "link":
            file[field] = h5py.ExternalLink(str(other), field)
        elif how == "link through a group":
            file["way"] = h5py.ExternalLink(str(other), "/")
            file[field] = h5py.SoftLink(f"/way/{field}")
        elif how == "link through links":
            file["way"] = h5py.ExternalLink(str(other), "/")
            file["inner/back"] = h5py.SoftLink("/way")
            file["first"] = h5py.SoftLink("inner")
            file[field] = h5py.SoftLink(f"./first/back/{field}")
        elif how == "link to a pipe":
            os.mkfifo(tmp_path / "pipe")
            file["way"] = h5py.ExternalLink(str(tmp_path / "pipe"), "/")
            file[field] = h5py.SoftLink(f"/way/{field}")
        elif how == "virtual on a pipe":
            os.mkfifo(tmp_path / "pipe")
            endless_virtual(file, field, tmp_path / "pipe")
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


def test_links_within_a_file_are_followed(tmp_path):
    path = io.save_capture(captured(), tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        for field in ("H", "delta_t"):
            file[f"inner/deep/{field}"] = file[field]
            del file[field]
            file[f"inner/to_{field}"] = h5py.SoftLink(f"deep/{field}")
            file[field] = h5py.SoftLink(f"/inner/./to_{field}")
    assert io.load_capture(path).identical(captured())


@pytest.mark.timeout(120)
@pytest.mark.parametrize("field", ["data", "deltaT", "t"])
@pytest.mark.parametrize("how", ["file", "pipe"])
def test_fields_of_znlos_that_are_elsewhere(tmp_path, field, how):
    path, other = tmp_path / "a", tmp_path / "other"
    measured_files.znlos(path, "single")
    measured_files.znlos(other, "single")
    if how == "pipe":
        other.unlink()
        os.mkfifo(other)
    with h5py.File(path, "a") as file:
        del file[field]
        file["way"] = h5py.ExternalLink(str(other), "/")
        file[field] = h5py.SoftLink(f"/way/{field}")
    with pytest.raises(ValueError, match=f"{field}: is in another file") as error:
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
