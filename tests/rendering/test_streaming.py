"""Films on disk: the render that memory would hold, whatever happens while they grow."""

import errno
import json
import os
import re
import shutil
import signal
import tracemalloc
from functools import partial
from pathlib import Path

import dask.array
import mitsuba as mi
import numpy as np
import pytest
import xarray as xr
import zarr
from helpers.films_in_parts import (
    ROUNDING,
    box,
    check_same,
    crop,
    in_small_steps,
    in_tiles,
    names,
    render,
    script,
    watch_steps,
)
from helpers.nlos import builder
from helpers.refusals import one_line, refused
from helpers.support import with_film, with_integrator

import tofrender
from tofrender import load_zarr, save_zarr
from tofrender.rendering.renderer import make_job
from tofrender.rendering.settings import RenderSettings
from tofrender.rendering.stored_film import StoredFilm
from tofrender.rendering.streaming import stream

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")

TILES = 5  # How many 2 rows of 9 make


@pytest.fixture
def out(tmp_path, monkeypatch) -> Path:
    """Where a film goes that has five tiles."""
    in_tiles(monkeypatch, 2)
    return tmp_path / "film.zarr"


@pytest.fixture(scope="module")
def whole() -> xr.Dataset:
    """The render that the films are."""
    return render(box())


@pytest.fixture(scope="module")
def two_tiles(tmp_path_factory) -> Path:
    """The folder of a film that was stopped after two tiles."""
    place = tmp_path_factory.mktemp("stopped") / "film.zarr"
    with pytest.MonkeyPatch.context() as patch:
        in_tiles(patch, 2)
        stopped(patch, place, 2)
    return place.parent


@pytest.fixture
def begun(out, two_tiles) -> Path:
    """Where a film goes that has two tiles already."""
    shutil.copytree(two_tiles, out.parent, dirs_exist_ok=True)
    return out


def under_way(out: Path) -> Path:
    """The hidden folder of a film that grows."""
    (found,) = out.parent.glob(".*.film")
    assert not out.exists()
    return found


def tile_files(folder: Path) -> list[Path]:
    """The files of tiles, those of bins first."""
    found = (sorted(folder.glob(f"**/{name}/c/**/*")) for name in ("transient", "steady"))
    return [file for files in found for file in files if file.is_file()]


def receipts(out: Path) -> list[Path]:
    """What tells that tiles are finished."""
    return sorted(under_way(out).glob("receipts/tile*.json"))


def flipped(file: Path, place: float) -> None:
    """Change a bit of a file."""
    content = bytearray(file.read_bytes())
    content[int(place * len(content))] ^= 4
    file.write_bytes(content)


def stopped_after(monkeypatch, tiles: int) -> None:
    """Let SIGINT come before the step after so many tiles."""
    puts, put = [], StoredFilm.write

    def counted(self, *arguments):
        puts.append(None)
        return put(self, *arguments)

    def look(number):
        if len(puts) == tiles:
            puts.append(None)
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(StoredFilm, "write", counted)
    watch_steps(monkeypatch, look)


def stopped(monkeypatch, out: Path, tiles: int, **options) -> str:
    """Stop a render after so many tiles; the line with which it ends."""
    with monkeypatch.context() as patch:
        in_small_steps(patch)
        stopped_after(patch, tiles)
        with pytest.raises(KeyboardInterrupt) as error:
            render(box(), out=out, **options)
    return one_line(error)


def without_plan(said: str) -> str:
    """What is told but for the tiles that are planned."""
    return re.sub(r"^\d+ tiles of .* each.*\n", "", said, flags=re.M)


def test_a_film_is_the_render(out, whole):
    film = render(box(), out=out)
    check_same(film, whole)
    check_same(load_zarr(out), whole)
    check_same(load_zarr(str(out)), whole)
    assert names(out.parent) == {"film.zarr"}


@pytest.mark.parametrize("rows", [0.3, 1, 4, 50])
def test_however_it_is_cut(tmp_path, monkeypatch, whole, rows):
    in_tiles(monkeypatch, rows)
    check_same(render(box(), out=tmp_path / "film.zarr"), whole)


@pytest.mark.essential
@pytest.mark.parametrize(
    ("described", "options"),
    [
        (lambda: with_film(box(), rfilter={"type": "gaussian"}, **crop(3, 2, 7, 6)), {}),
        (lambda: with_film(box(), rfilter={"type": "gaussian"}, sample_border=True), {}),
        (lambda: with_integrator(box(), pulse_width_opl=0.2), {"seed": 5}),
        (lambda: builder("nlos_z", width=5, height=4), {"spp": 64}),
        (box, {"window": "auto", "bins": 30}),
        (box, {"settings": {"max_depth": 3}, "spp": 11}),
        (box, {"integrator": "transient_bdpt"}),
        (box, {"errors": True, "spp": 32}),
        (lambda: tofrender.load_scene(box()), {}),
        (box, {"variant": "llvm_ad_mono"}),
        (box, {"variant": "llvm_ad_spectral"}),
    ],
)
def test_films_of_other_light(out, described, options):
    options = dict(options)
    mi.set_variant(options.pop("variant", mi.variant()))
    whole = render(described(), **options)
    assert ("transient_error" in whole) == ("errors" in options)
    film = render(described(), out=out, **options)
    check_same(film, whole, 1e-4 if "errors" in options else ROUNDING)
    assert names(out.parent) == {"film.zarr"}


def test_a_film_is_plain_zarr_and_read_when_it_is_used(out, whole):
    film = render(box(), out=out)
    for name, chunk in (("transient", (2, 12, 40, 3)), ("steady", (2, 12, 3))):
        assert isinstance(film[name].data, dask.array.Array)
        assert all(one <= most for one, most in zip(film[name].data.chunksize, chunk, strict=True))
    assert film.encoding["source"] == str(out)
    group = zarr.open_group(out, mode="r")
    assert group.metadata.zarr_format == 3
    assert group.metadata.consolidated_metadata is not None
    np.testing.assert_allclose(group["transient"][:], whole["transient"].values, atol=1e-6)
    with xr.open_zarr(out) as plain:
        assert plain["transient"].dims == ("y", "x", "opl", "channel")
        assert plain["transient"].attrs == film["transient"].attrs
        assert plain.attrs["quantity"] == whole.attrs["quantity"]


@pytest.mark.parametrize("tiles", [0, 1, 4])
def test_a_stopped_render_goes_on(out, monkeypatch, capsys, whole, tiles):
    text = stopped(monkeypatch, out, tiles)
    assert text.startswith(f"interrupted after {tiles} of {TILES} tiles; the same call goes on")
    assert len(receipts(out)) == tiles
    capsys.readouterr()
    if tiles:
        with refused("film.zarr: .* is of a stopped render; must be another", FileExistsError):
            save_zarr(whole, out)
    check_same(render(box(), out=out), whole)
    said = capsys.readouterr().out
    assert without_plan(said) == (f"resuming from {tiles} of {TILES} tiles\n" if tiles else "")
    assert names(out.parent) == {"film.zarr"}


@pytest.mark.parametrize("errors", [False, True])
def test_a_tile_under_way_goes_on(out, monkeypatch, errors):
    options = {"spp": 32, "errors": errors}
    stopped(monkeypatch, out, 1, **options)
    assert len(list(under_way(out).rglob("*.npz"))) == 1
    taken: list[int] = []
    watch_steps(monkeypatch, taken.append)
    in_small_steps(monkeypatch)
    film = render(box(), out=out, **options)
    assert 0.5 < len(taken) / (TILES * 32 // 2) < 0.8
    check_same(film, render(box(), **options), 1e-4)


def test_a_tile_is_kept_as_often_as_asked(out, monkeypatch, whole):
    """The run ends as by a kill; meanwhile no other one may write there."""
    in_small_steps(monkeypatch)
    job, told, stops = make_job(RenderSettings(box(), spp=8)), [], []

    def look(number):
        if number == 2 and len(receipts(out)) == 2 and not stops:
            stops.append(number)
            with refused("out = .*film.zarr: another process", (ValueError, OSError)):
                render(box(), out=out)
            raise SystemExit

    with monkeypatch.context() as patch:
        watch_steps(patch, look)
        with pytest.raises(SystemExit):
            stream(job, out, seconds=1e-9, progress=False)
    assert len(list(under_way(out).rglob("*.npz"))) == 1
    check_same(stream(job, out, tell=told.append, progress=False), whole)
    assert told == ["5 tiles of 2 x 12 pixels, 15 KiB each", "resuming from 2 of 5 tiles"]
    assert names(out.parent) == {"film.zarr"}


def test_stopped_again_and_again(out, monkeypatch, whole):
    for tiles in (1, 1, 2):
        stopped(monkeypatch, out, tiles)
    assert len(receipts(out)) == 4
    check_same(render(box(), out=out), whole)


@pytest.mark.parametrize(
    ("described", "options", "text"),
    [
        (box, {"spp": 16}, "spp = 8"),
        (box, {"seed": 1}, "seed = 0"),
        (box, {"spp": 16, "errors": True}, ""),
        (lambda: box(light="flash", start_opl=3.5), {}, "fingerprint"),
        (lambda: with_film(box(), **crop(0, 0, 5, 5)), {}, "film = "),
        (lambda: with_film(box(), rfilter={"type": "gaussian"}), {}, "film = "),
    ],
)
def test_another_render_is_refused(begun, described, options, text):
    def times() -> dict[Path, int]:
        files = (file for file in under_way(begun).rglob("*") if file.is_file())
        return {file: file.stat().st_mtime_ns for file in files}

    before = times()
    with refused(f"was begun with .*{text}") as error:
        render(described(), out=begun, **options)
    assert str(under_way(begun)) in str(error.value)
    assert times() == before


HARMS = {
    **{f"byte at {p}": partial(flipped, place=p) for p in (0.0, 0.3, 0.6, 0.99999)},
    "cut": lambda file: file.write_bytes(file.read_bytes()[: file.stat().st_size // 2]),
    "longer": lambda file: file.write_bytes(file.read_bytes() + b"x"),
    "gone": Path.unlink,
    "empty receipt": lambda file: file.write_text("{}"),
    "no receipt": lambda file: file.write_text("no json"),
    "receipt gone": Path.unlink,
}


@pytest.mark.parametrize("number", [0, 2])
@pytest.mark.parametrize("harm", HARMS)
def test_a_damaged_tile_is_rendered_again(begun, capsys, whole, harm, number):
    files = receipts(begun) if "receipt" in harm else tile_files(under_way(begun))
    HARMS[harm](files[number // 2 if "receipt" in harm else number])
    if harm == "receipt gone":
        film = render(box(), out=begun)
    else:
        with pytest.warns(UserWarning, match=r"\A.*damaged.*\Z") as record:
            film = render(box(), out=begun)
        assert len(record) == 1
    assert "resuming from 1 of 5 tiles" in capsys.readouterr().out
    check_same(film, whole)


@pytest.mark.parametrize("array", ["transient", "steady"])
def test_a_changed_byte_of_a_finished_film_is_found(out, array):
    film = render(box(), out=out)
    flipped([file for file in tile_files(out) if array in file.parts][1], 0.5)
    with pytest.raises(OSError, match="checksum"):
        film[array].values  # noqa: B018


def test_a_film_that_the_disk_cannot_hold_is_refused(out, monkeypatch):
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda *_: usage._replace(free=20000))
    with pytest.raises(OSError, match=r"the disk is too full; needs .* KiB is free") as error:
        render(box(), out=out)
    assert str(out.parent) in one_line(error)
    assert names(out.parent) == set()


def test_a_disk_that_becomes_full_keeps_finished_tiles(out, monkeypatch, capsys, whole):
    put = zarr.storage.LocalStore.set
    written = []

    async def full(self, key, value, **options):
        if "/c/" in key:
            written.append(key)
            if len(written) > 4:
                raise OSError(errno.ENOSPC, "No space left on device")
        await put(self, key, value, **options)

    with monkeypatch.context() as patch:
        patch.setattr(zarr.storage.LocalStore, "set", full)
        with pytest.raises(OSError, match="the disk is too full") as error:
            render(box(), out=out)
    assert str(out.parent) in one_line(error)
    assert len(receipts(out)) == 2
    capsys.readouterr()
    check_same(render(box(), out=out), whole)
    assert without_plan(capsys.readouterr().out) == "resuming from 2 of 5 tiles\n"


_SHORT = """
import resource, sys, psutil
import tofrender, zarr
from tofrender.rendering import tiling
tiling.TILE_BYTES = 8 << 20
size = {"width": 100, "height": 100, "temporal_bins": 2000, "bin_width_opl": 0.006}
options = {"spp": 1, "progress": False}
tofrender.render("cornell_box", settings=size | {"width": 4, "height": 4}, **options)
room = psutil.Process().memory_info().vms + (700 << 20)
resource.setrlimit(resource.RLIMIT_AS, (room, room))
try:
    tofrender.render("cornell_box", settings=size, **options)
except MemoryError as error:
    print(error)
film = tofrender.render("cornell_box", settings=size, out=sys.argv[1], **options)
print(film["transient"].nbytes >> 20, float(film["transient"].sum() / film["steady"].sum()))
"""


def test_a_film_larger_than_memory(out):
    """`ulimit -v` in earnest: the process holds a tile, not the film."""
    process = script(_SHORT, out)
    said, err = process.communicate()
    assert process.returncode == 0, err
    refusal, film = without_plan(said).splitlines()
    assert refusal.startswith("film of 100 x 100 pixels x 2000 bins: takes ")
    size, share = film.split()
    assert int(size) == 228
    assert float(share) == pytest.approx(1, abs=0.05)
    assert names(out.parent) == {"film.zarr"}


def test_what_is_there_stays(out, whole):
    out.mkdir()
    (out / "precious").write_text("data")
    for write in (lambda: render(box(), out=out), lambda: save_zarr(whole, out)):
        with refused(r"film.zarr: exists; must be a new folder", FileExistsError):
            write()
    assert names(out) == {"precious"}


@pytest.mark.parametrize("name", ["checkpoint", "resume"])
def test_what_does_not_go_together(out, tmp_path, whole, name):
    value = {"checkpoint": tmp_path / "x.npz", "resume": whole}[name]
    with refused(f"^{name}: must be left out with `out`"):
        render(box(), spp=16, out=out, **{name: value})
    assert names(tmp_path) == set()


def test_a_render_is_saved_as_a_film(out, whole):
    film = save_zarr(whole, out)
    check_same(film, whole, 0)
    assert film.attrs == whole.attrs
    assert names(out.parent) == {"film.zarr"}
    check_same(save_zarr(film, out.with_name("again.zarr")), whole, 0)


def test_attributes_and_error_bars_are_saved(out, whole):
    noted = whole.assign({f"{n}_error": 0.1 * whole[n] + 1 for n in ("transient", "steady")})
    for name in ("transient", "opl", "x"):
        noted[name].attrs |= {"note": "a b", "offset": 0.5}
    xr.testing.assert_identical(save_zarr(noted, out).load(), noted)


def test_what_is_no_film_is_not_loaded(begun):
    with refused("does not exist", FileNotFoundError):
        load_zarr(begun)
    other = begun.with_name("other.zarr")
    xr.Dataset({"a": ("x", np.arange(3))}).to_zarr(other, zarr_format=3, consolidated=False)
    begun.mkdir()
    for folder in (begun, other, next(begun.parent.glob(".*.film"))):
        with refused("must be a finished film"):
            load_zarr(folder)


@pytest.mark.parametrize("load", [load_zarr, tofrender.load_dataset], ids=["film", "data set"])
@pytest.mark.parametrize("where", ["transient/zarr.json", "zarr.json"])
def test_codecs_that_may_run_code_are_refused(out, whole, where, load):
    """numcodecs.pickle would unpickle whatever the file holds."""
    save_zarr(whole, out)
    text = (out / where).read_text()
    (out / where).write_text(text.replace('"crc32c"', '"numcodecs.pickle"', 1))
    with pytest.raises(ValueError, match=r"\Apath = .*zarr.json has the codec .*pickle.*\Z"):
        load(out)


@pytest.mark.parametrize("load", [load_zarr, tofrender.load_dataset], ids=["film", "data set"])
@pytest.mark.parametrize("name", ["attributes", "consolidated_metadata", "metadata"])
@pytest.mark.parametrize("where", ["listed", "in a folder"])
def test_codecs_of_arrays_with_names_of_metadata_are_refused(out, whole, load, name, where):
    """Attributes of users are no codecs, but an array may have the name "attributes"."""
    save_zarr(whole.assign_attrs(codecs="mine"), out)
    root = json.loads((out / "zarr.json").read_text())
    arrays = root["consolidated_metadata"]["metadata"]
    text = json.dumps(arrays["steady"]).replace("crc32c", "numcodecs.pickle")
    if where == "listed":
        arrays[name] = json.loads(text)
        (out / "zarr.json").write_text(json.dumps(root))
    else:
        (out / name).mkdir()
        (out / name / "zarr.json").write_text(text)
    with pytest.raises(ValueError, match=r"\Apath = .*zarr.json has the codec .*pickle.*\Z"):
        load(out)


def resized(array: dict, axis: int, size: int, block: int | None = None) -> None:
    """Change the size of an axis in the metadata of an array, and of its blocks."""
    array["shape"][axis] = size
    grid = array["chunk_grid"]["configuration"]["chunk_shape"]
    inner = [c["configuration"] for c in array["codecs"] if c["name"] == "sharding_indexed"]
    for shape in (grid, *(each["chunk_shape"] for each in inner)):
        shape[axis] = shape[axis] if block is None else block


BOMBS = {
    "a long axis": ({"opl": (0, 10**9)}, "opl has 1000000000 values"),
    "a long axis of small blocks": ({"transient": (2, 10**9, 1)}, "transient has .* blocks"),
    "a large block": ({"steady": (0, 10**9, 10**9)}, "steady has blocks of .* values"),
    "no block": ({"steady": (0, 6, 0)}, "is damaged"),
    "a negative axis": ({"steady": (0, -6)}, "is damaged"),
}


@pytest.mark.parametrize("load", [load_zarr, tofrender.load_dataset], ids=["film", "data set"])
@pytest.mark.parametrize("name", BOMBS)
def test_films_that_claim_to_be_large(out, whole, load, name):
    """Missing files of Zarr read as zeros, so that a few bytes may be gigabytes."""
    save_zarr(whole, out)
    changes, said = BOMBS[name]
    root = json.loads((out / "zarr.json").read_text())
    for array, change in changes.items():
        resized(root["consolidated_metadata"]["metadata"][array], *change)
    (out / "zarr.json").write_text(json.dumps(root))
    (out / "files.json").write_text("{}")
    tracemalloc.start()
    with refused(rf"path = .*zarr\.json.* {said}"):
        load(out)
    assert tracemalloc.get_traced_memory()[1] < 64 << 20
    tracemalloc.stop()


def test_a_window_without_light_leaves_nothing(out):
    with refused("light"):
        render(with_film(box(), start_opl=0.0, bin_width_opl=3.0 / 40), out=out)
    assert names(out.parent) == set()


def test_read_only_places(out):
    if os.geteuid() == 0:
        pytest.skip("root may write anywhere")
    out.parent.chmod(0o500)
    try:
        with refused("", PermissionError):
            render(box(), out=out)
    finally:
        out.parent.chmod(0o700)
