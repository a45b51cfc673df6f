"""Films and captures read by pieces: as in memory, with little of it, damage is told."""

import re
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from helpers.films_in_parts import script
from helpers.hidden_scenes import Wall, capture_of, letter_z
from helpers.limited import at_most, write_film
from helpers.limits import lower
from helpers.made_dataset import make_dataset
from helpers.refusals import refused

from tofrender import io, nlos, vis
from tofrender.analysis import transient_to_phasor
from tofrender.rendering import cubes
from tofrender.rendering.cubes import Cube
from tofrender.rendering.dataset import require_finite

zarr = pytest.importorskip("zarr")
pytestmark = pytest.mark.filterwarnings("ignore:Object at .receipts", "ignore:.*arrives outside")

CHUNKS = {"y": 4, "x": 3, "opl": 5, "channel": 2}
SIZE = 5000  # bytes that may be read at once, of 29 kB (RGB)


def film(channels: str = "RGB", **attrs):
    return make_dataset(13, 11, 17, channels, energy_outside_window=0.0, **attrs)


@pytest.mark.parametrize("chunks", [None, CHUNKS, {"y": 13, "x": 11, "opl": 17}, {"x": 1}])
@pytest.mark.parametrize("piece_bytes", [1, 700, 5000, 1 << 20])
def test_pieces_rows_and_frames_are_the_whole(monkeypatch, chunks, piece_bytes):
    lower(monkeypatch, piece_bytes=piece_bytes, view_bytes=piece_bytes, memory_share=1 << 40)
    data = film()["transient"]
    values, cube = data.values, Cube(data if chunks is None else data.chunk(chunks))
    found = np.full_like(values, np.nan)
    last: dict = {}
    for (*pixels, bins, channels), part in cube.pieces():
        here = tuple((s.start, s.stop) for s in pixels)
        assert bins.start == last.get(here, 0)  # In the order of time
        last[here] = bins.stop
        assert channels == slice(0, 3)
        if chunks is None:
            assert bins == slice(0, 17)
            assert np.shares_memory(part, values)
        found[(*pixels, bins, channels)] = part
    np.testing.assert_array_equal(found, values)
    rows = [part.reshape(-1) for _, part in cube.rows()]
    np.testing.assert_array_equal(np.concatenate(rows), values.reshape(-1))
    frames = [part for _, part in cube.frames()]
    np.testing.assert_array_equal(np.concatenate(frames, axis=2), values)
    for index in (0, 16, 3, 4, 5, 0):
        np.testing.assert_array_equal(cube.frame(index), values[:, :, index])
    positions = np.random.default_rng(0).integers(0, values.size, 500)
    taken = np.sort(cube.take(positions))
    np.testing.assert_array_equal(taken, np.sort(values.reshape(-1)[positions]))
    np.testing.assert_array_equal(cube.luminance("x"), cubes.luminance(values))


@pytest.mark.parametrize("shape", [(), (5,), (0,), (3, 4), (2, 3, 4), (2, 3, 2, 3, 4, 1)])
def test_any_shape(monkeypatch, shape):
    lower(monkeypatch, view_bytes=16)
    values = np.arange(np.prod(shape, dtype=int), dtype=np.float32).reshape(shape)
    found = np.full_like(values, -1)
    for place, part in Cube(values).pieces():
        found[place] = part
    np.testing.assert_array_equal(found, values)


@pytest.mark.parametrize("chunks", [None, CHUNKS])
def test_what_is_not_finite_is_told_as_of_an_array(monkeypatch, chunks):
    lower(monkeypatch, piece_bytes=700, view_bytes=700)
    dataset = film()
    values = dataset["transient"].values
    values[9, 0, 2, 1], values[3, 10, 16, 0], values[3, 10, 16, 2] = np.nan, -np.inf, np.nan
    said = "transient: 3 of 7293 values are not finite, the first is -inf at [3, 10, 16, 0]; must "
    with pytest.raises(ValueError, match=f"^{re.escape(said)}all be finite$"):
        require_finite(dataset if chunks is None else dataset.chunk(chunks))


def test_threads_that_draw_frames_decode_each_chunk_once():
    data, reads, lock = film()["transient"], [], threading.Lock()

    class Counted:
        shape, dtype, ndim = data.shape, data.dtype, 4

        def __getitem__(self, index):
            with lock:
                reads.append(index)
            return data.values[index]

    import dask.array

    lazy = dask.array.from_array(Counted(), chunks=(4, 11, 3, 3), name=False, meta=data.values[:0])
    cube = Cube(lazy)
    with ThreadPoolExecutor(8) as pool:
        frames = list(pool.map(cube.frame, range(17)))
    np.testing.assert_array_equal(np.stack(frames, axis=2), data.values)
    assert len(reads) == lazy.npartitions


def figure(drawn) -> list[np.ndarray]:
    """Pictures and lines of a figure."""
    found = [image.get_array().filled(-1) for axes in drawn.axes for image in axes.images]
    return found + [np.asarray(line.get_ydata()) for axes in drawn.axes for line in axes.lines]


def files(path: Path) -> list[np.ndarray]:
    """The bytes of a file, or of all files of a folder."""
    paths = sorted(path.iterdir()) if path.is_dir() else [path]
    return [np.frombuffer(file.read_bytes(), np.uint8).astype(int) for file in paths]


def played(dataset) -> list[np.ndarray]:
    animation = vis.visualize_transient(dataset)
    axes = animation._fig.axes[0]
    found = []
    for index in range(dataset.sizes["opl"]):
        animation._func(index)
        found.append(axes.images[0].get_array().copy())
    animation._draw_was_started = True  # It warns if nobody has shown it
    return found


def unwarped(dataset) -> list[np.ndarray]:
    distances = np.linspace(0, 0.1, 13 * 11).reshape(13, 11)
    distances[2, 3] = np.nan
    return [vis.unwarp_camera(dataset, distances)["transient"].values]


READERS = {
    "finite": lambda d, _: [np.array(require_finite(d) is None)],
    "phasor": lambda d, _: [*transient_to_phasor(d, [20e6, 3e8])],
    "summary": lambda d, _: figure(vis.summary_figure(d)),
    "pixel": lambda d, _: figure(vis.plot_pixel_transient(d, 4, 5)),
    "arrival": lambda d, _: figure(vis.light_in_flight(d)),
    "peak": lambda d, _: figure(vis.light_in_flight(d, style="peak")),
    "rainbow": lambda d, _: figure(vis.light_in_flight(d, style="rainbow")),
    "array": lambda d, _: figure(vis.light_in_flight(d["transient"], 3.5, 0.02)),
    "animation": lambda d, _: played(d),
    "exposure": lambda d, _: [np.array(vis.auto_exposure(d["transient"]))],
    "frames": lambda d, f: files(io.save_exr_stack(d, f / "s")),
    "multipart": lambda d, f: files(io.save_exr_stack(d, f / "s.exr", layout="multipart")),
    "npz": lambda d, f: files(io.save_npz(d, f / "s.npz")),
    "png": lambda d, f: files(io.save_png_frames(d, f / "p", min_size=16)),
    "video": lambda d, f: files(io.save_video(d, f / "v.mp4", min_size=16)),
}


def same(found: list[np.ndarray], expected: list[np.ndarray]) -> None:
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        assert a.shape == b.shape
        if a.dtype == np.uint8:  # Sums are rounded otherwise
            np.testing.assert_allclose(a.astype(int), b.astype(int), atol=1)
        else:
            np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-12)


@pytest.fixture
def one_thread(monkeypatch):
    from tofrender.io import files

    monkeypatch.setattr(files.os, "cpu_count", lambda: 1)


@pytest.mark.parametrize("channels", ["RGB", "L"])
@pytest.mark.parametrize("reader", READERS)
def test_readers_see_what_is_in_memory_and_keep_little(
    tmp_path, monkeypatch, one_thread, reader, channels
):
    lower(monkeypatch, tone_samples=1900)
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    dataset = film(channels)
    lazy = dataset.chunk(CHUNKS)
    expected = READERS[reader](dataset, tmp_path / "a")
    with at_most(SIZE, monkeypatch) as sizes:
        found = READERS[reader](lazy, tmp_path / "b")
    assert sum(sizes) > (100 if reader == "pixel" else dataset["transient"].nbytes * 0.9) / 2
    same(found, expected)


def test_the_limit_finds_a_reader_of_the_whole(monkeypatch):
    lazy = film().chunk(CHUNKS)
    with at_most(SIZE, monkeypatch), pytest.raises(AssertionError, match="bytes at once"):
        np.asarray(lazy["transient"].values)


def test_nearly_dark_films_have_the_same_exposure(monkeypatch):
    lower(monkeypatch, tone_samples=500)
    dataset = film()
    dataset["transient"].values[1:] = 0
    expected = vis.auto_exposure(dataset["transient"])
    with at_most(SIZE, monkeypatch):
        assert vis.auto_exposure(dataset.chunk(CHUNKS)["transient"]) == expected


def test_unwarping_needs_room_for_its_result_alone(monkeypatch):
    dataset = film()
    expected, lazy = unwarped(dataset), dataset.chunk(CHUNKS)
    with at_most(60000, monkeypatch):
        same(unwarped(lazy), expected)
    with at_most(SIZE, monkeypatch), refused(r"^dataset: takes .* must be at most .*", MemoryError):
        unwarped(lazy)


def capture(mode: str, legs: bool = False):
    options = {"lasers": 2} if mode == "exhaustive" else {}
    made = capture_of(letter_z(), Wall(8), mode, bins=40, width=0.06, legs=legs, **options)
    colors = made["transient"].values * np.float32([0.3, 1, 0.5])
    dims = made["transient"].dims
    made = made.drop_vars(["transient", "channel"]).assign(transient=(dims, colors))
    return made.assign_coords(channel=["R", "G", "B"])


METHODS = {
    "confocal": ("bp", "fbp", "lct", "fk", "phasor"),
    "single": ("bp", "phasor"),
    "exhaustive": ("bp", "phasor"),
}


@pytest.mark.parametrize(
    ("mode", "method"), [(mode, method) for mode, them in METHODS.items() for method in them]
)
@pytest.mark.parametrize("legs", [False, True])
def test_reconstructions_of_captures_on_disk(monkeypatch, mode, method, legs):
    made = capture(mode, legs)
    expected = nlos.reconstruct(made, method, progress=False)["intensity"]
    lazy = made.chunk({"y": 3, "x": 8, "opl": 7})
    lower(monkeypatch, piece_bytes=1000)  # Rows come one by one
    found = nlos.reconstruct(lazy, method, progress=False)["intensity"]
    scale = float(abs(expected).max())
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * scale)


def test_backprojection_keeps_rows_and_others_say_what_they_need(monkeypatch):
    made = capture("confocal")
    expected = nlos.reconstruct(made, "bp", progress=False)["intensity"]
    lazy = made.chunk({"y": 1, "x": 8, "opl": 7})
    size = made["transient"].nbytes // 4  # Two rows
    with at_most(size, monkeypatch, free=2 * size):
        found = nlos.reconstruct(lazy, "bp", progress=False)["intensity"]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * float(expected.max()))
    with at_most(size, monkeypatch), refused(r"needs .* GiB", MemoryError):
        nlos.reconstruct(lazy, "fk", progress=False)


@pytest.mark.parametrize("mode", ["confocal", "exhaustive"])
def test_captures_on_disk_are_saved_by_bins(tmp_path, monkeypatch, mode):
    made = capture(mode)
    expected = io.load_capture(io.save_capture(made, tmp_path / "a.h5"))
    with at_most(made["transient"].nbytes // 4, monkeypatch):
        saved = io.save_capture(made.chunk({"y": 3, "x": 2, "opl": 7}), tmp_path / "b.h5")
    assert io.load_capture(saved).identical(expected)


DAMAGED = READERS | {
    "values": lambda d, _: d["transient"].values,
    "unwarp": lambda d, _: unwarped(d),
}


@pytest.mark.parametrize("harm", ["a bit", "half"])
@pytest.mark.parametrize("reader", DAMAGED)
def test_damage_names_the_film(tmp_path, monkeypatch, reader, harm):
    lower(monkeypatch, block_bytes=3000)
    lazy = write_film(tmp_path / "box.zarr", film(), (5, 11))
    file = tmp_path / "box.zarr/transient/c/1/0/0/0"
    content = bytearray(file.read_bytes())
    content[2345] ^= 8  # In a tile of rows 5 to 9
    file.write_bytes(content if harm == "a bit" else content[: len(content) // 2])
    vis.plot_pixel_transient(lazy, 4, 1)
    with refused(r"box\.zarr: transient/c/[\d/]+ is damaged", OSError) as caught:
        DAMAGED[reader](lazy, tmp_path)
    assert str(tmp_path / "box.zarr") in str(caught.value)


MEASURED = """
import sys
from pathlib import Path
import numpy as np
from helpers.made_dataset import make_dataset
from helpers.limited import write_film
from tofrender import io, vis
from tofrender.analysis import transient_to_phasor
from tofrender.rendering.cubes import Cube
from tofrender.rendering.stored_film import load_zarr

def read(film, folder):
    transient_to_phasor(film, 20e6)
    vis.summary_figure(film)
    vis.light_in_flight(film)
    vis.auto_exposure(film["transient"])
    io.save_npz(film, folder / "film.npz", overwrite=True)
    cube = Cube(film["transient"])
    for index in range(film.sizes["opl"]):
        cube.frame(index)

def peak():  # Not what getrusage says, which begins with the parent's
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmHWM:")[1].split()[0]) // 1024

folder = Path(sys.argv[1])
small = make_dataset(12, 16, 30, energy_outside_window=0.0)
read(write_film(folder / "small.zarr", small, (8, 8)), folder)
before = peak()
film = load_zarr(folder / "large.zarr")
read(film, folder)
by_pieces = peak() - before
film["transient"].values
print(by_pieces, peak() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="measures memory as Linux counts it")
def test_a_large_film_is_read_in_little_memory(tmp_path, monkeypatch):
    lower(monkeypatch, block_bytes=1 << 20)
    tile = make_dataset(20, 160, 800, energy_outside_window=0.0)
    large = xr.concat([tile.assign_coords(y=20 * k + np.arange(20)) for k in range(12)], "y")
    size = large["transient"].nbytes >> 20
    write_film(tmp_path / "large.zarr", large, (20, 160))
    process = script(MEASURED, tmp_path)
    said, err = process.communicate()
    assert process.returncode == 0, err
    by_pieces, as_a_whole = map(int, said.split())
    assert by_pieces < 0.6 * size < size < as_a_whole, (size, said)
