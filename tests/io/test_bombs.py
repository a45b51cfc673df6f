"""Small files that claim to be large, and damaged files: one clear line, and little memory."""

import struct
import tracemalloc
import zipfile
import zlib
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from helpers import measured_files as files
from helpers.bad_inputs import one_clear_line
from helpers.limits import lower
from helpers.refusals import refused
from scipy.io import loadmat, savemat

from tofrender.io import load_capture, matlab

WALL = {"wall_size": 1.0, "bin_width_s": 4e-12}
LITTLE = 64 << 20  # Bytes that a refusal may allocate
FREE = 4 << 30


@pytest.fixture
def little_memory(monkeypatch):
    """Four gigabytes are free, and a test must not allocate a part of them."""
    lower(monkeypatch, free_memory=FREE)
    tracemalloc.start()
    yield
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < LITTLE


def refuse(path: Path, *said: str, **options) -> None:
    with pytest.raises((ValueError, MemoryError), match="|".join(said)) as caught:
        load_capture(path, **options)
    assert not one_clear_line(caught.value, "path")


# ------------------------------------------------------------------------------------- MATLAB


def matrix(shape, data, flags=6, name=b"meas"):
    """An array of MATLAB 5, whose head may claim more than the data have."""
    axes = np.array(shape, "<i4").tobytes()
    content = struct.pack("<4I", 6, 8, flags, 0)
    content += struct.pack("<2I", 5, len(axes)) + axes.ljust(-(-len(axes) // 8) * 8, b"\0")
    content += struct.pack("<2I", 1, len(name)) + name.ljust(-(-len(name) // 8) * 8, b"\0")
    return struct.pack("<2I", 14, len(content) + len(data)) + content + data


def doubles(count, claimed=None):
    size = 8 * (count if claimed is None else claimed)
    return struct.pack("<2I", 9, size % 2**32) + bytes(8 * count)


def compressed(element):
    packed = zlib.compress(element, 9)
    return struct.pack("<2I", 15, len(packed)) + packed


def write(path, *elements):
    head = b"MATLAB 5.0 MAT-file".ljust(124, b" ") + b"\x00\x01IM"
    path.write_bytes(head + b"".join(elements))


def long_claim():
    """A compressed array whose first element claims four gigabytes."""
    element = bytearray(matrix((3, 4, 6), doubles(72)))
    element[4:8] = struct.pack("<I", 2**32 - 8)
    return compressed(bytes(element))


BOMBS = {
    "axes": matrix((40_000, 40_000, 500), doubles(1)),
    "axes that overflow": matrix((2**31 - 1,) * 6, doubles(1)),
    "more values than there are": matrix((3, 4, 6), doubles(72, 2**29 - 1)),
    "fewer values than axes": matrix((300, 400, 600), doubles(1)),
    "packed axes": compressed(matrix((40_000, 40_000, 500), doubles(1))),
    "packed claim": long_claim(),
    "packed zeros": compressed(matrix((3, 4, 6), doubles(72)) + bytes(2 * LITTLE)),
    "cells": matrix((60_000, 60_000), matrix((1, 1), doubles(1)), flags=1),
    "cells in cells": matrix((1, 1), matrix((1, 1), matrix((1, 1), doubles(1)), flags=1), flags=1),
    "negative axes": matrix((-3, -4, 6), doubles(72)),
    "no axes": matrix((), doubles(1)),
}


@pytest.mark.parametrize("name", BOMBS)
def test_matlab(tmp_path, little_memory, name):
    path = tmp_path / "a.mat"
    write(path, BOMBS[name])
    refuse(path, "must", start_s=0.0, **WALL)


@pytest.mark.parametrize("do_compression", [False, True])
@pytest.mark.parametrize("name", ["numbers", "cells"])
def test_flipped_bits_of_a_matlab_file(tmp_path, name, do_compression):
    """Some of them ended the process in `scipy.io.loadmat`. The first 116 bytes are text."""
    path = tmp_path / "a.mat"
    if name == "numbers":
        savemat(path, {"rect_data": files.COUNTS, "width": 0.35}, do_compression=do_compression)
    else:
        cells = np.empty((2, 3), object)
        for k in range(6):
            cells.flat[k] = np.arange(k, dtype=np.uint16)[:, None]
        savemat(path, {"D": cells}, do_compression=do_compression)
    content = path.read_bytes()
    wrong = {}
    for bit in range(8 * 116, 8 * len(content), 3):
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        try:
            load_capture(path, **WALL)
        except (ValueError, MemoryError) as error:
            wrong[bit] = one_clear_line(error, "path")
    assert not {bit: what for bit, what in wrong.items() if what}


KINDS = ["u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8", "?"]


@pytest.mark.parametrize("do_compression", [False, True])
def test_arrays_are_those_of_scipy(tmp_path, do_compression):
    rng = np.random.default_rng(1)
    arrays = {kind.replace("?", "bool"): (9 * rng.random((2, 3, 5))).astype(kind) for kind in KINDS}
    arrays |= {"small": np.array([[7.0]]), "empty": np.zeros((0, 3)), "flat": rng.random(9000)}
    cells = np.empty((2, 3), object)
    for k in range(6):
        cells.flat[k] = rng.random((k, 1))
    arrays["cells_of_a_longer_name"] = cells
    others = {"text": "abc", "complex": np.array([1j]), "record": {"a": 1.0}}
    path = tmp_path / "a.mat"
    savemat(path, arrays | others, do_compression=do_compression)
    heads = {head.name: head for head in matlab.list_arrays(path)}
    assert set(heads) == set(arrays) | set(others)
    expected = loadmat(path)
    for name in arrays:
        found = matlab.read_array(path, name)
        assert heads[name].shape == found.shape == expected[name].shape
        if name.startswith("cells"):
            assert all(map(np.array_equal, found.flat, expected[name].flat))
        else:
            assert np.array_equal(found, expected[name])
    for name in others:
        with refused("must hold real numbers"):
            matlab.read_array(path, name)
    with refused("must be in the file"):
        matlab.read_array(path, "missing")


def test_arrays_of_the_other_order_of_bytes(tmp_path):
    """Written by hand, as SciPy writes the order of the machine."""
    values = np.arange(72).reshape(3, 4, 6)
    content = struct.pack(">4I", 6, 8, 6, 0) + struct.pack(">2I3i4x", 5, 12, 3, 4, 6)
    content += struct.pack(">2H4s", 4, 1, b"meas")  # Length and type of a small element
    numbers = values.astype(">f8").tobytes(order="F")
    content += struct.pack(">2I", 9, len(numbers)) + numbers
    head = b"MATLAB 5.0 MAT-file".ljust(124, b" ") + b"\x01\x00MI"
    path = tmp_path / "a.mat"
    path.write_bytes(head + struct.pack(">2I", 14, len(content)) + content)
    assert np.array_equal(matlab.read_array(path, "meas"), values)
    assert np.array_equal(loadmat(path)["meas"], values)


# ---------------------------------------------------------------------------------- PTU and SDT


def test_ptu_of_many_pixels(tmp_path, little_memory):
    ptufile = pytest.importorskip("ptufile")
    path = tmp_path / "a.ptu"
    files.ptu(path)
    with ptufile.PtuFile(path) as ptu:
        tags = ptu.tags
    content = path.read_bytes()
    for name, side in (("ImgHdr_PixX", 4), ("ImgHdr_PixY", 3)):
        assert tags[name] == side
        place = content.index(name.encode().ljust(32, b"\0")) + 40
        content = content[:place] + struct.pack("<q", 40_000) + content[place + 8 :]
    path.write_bytes(content)
    refuse(path, "counts: takes .* GiB", **WALL)


@pytest.mark.parametrize("count", [10**9, 2**62])
def test_ptu_of_many_records(tmp_path, little_memory, count):
    pytest.importorskip("ptufile")
    path = tmp_path / "a.ptu"
    files.ptu(path)
    content = path.read_bytes()
    place = content.index(b"TTResult_NumberOfRecords".ljust(32, b"\0")) + 40
    path.write_bytes(content[:place] + struct.pack("<q", count) + content[place + 8 :])
    refuse(path, "records = .* in the file, which is cut short", **WALL)


def packed_sdt(path: Path, zeros: int, claimed: int) -> None:
    """The file of `files.sdt`, with one compressed block that claims a length."""
    files.sdt(path, blocks=1)
    content = path.read_bytes()
    at = content.rindex(files.COUNTS.astype("<u2").tobytes()) - 22
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data_block", files.COUNTS.astype("<u2").tobytes() + bytes(zeros))
    packed = stream.getvalue()
    end = at + 22 + len(packed)
    head = struct.pack("<BBIIHhII", 0, 0, at + 22, end, 0x1011, 0, 0, claimed)
    path.write_bytes(content[:at] + head + packed)


def test_sdt_with_compressed_blocks(tmp_path):
    pytest.importorskip("sdtfile")
    packed_sdt(tmp_path / "a", 0, files.COUNTS.size * 2)
    capture = load_capture(tmp_path / "a", **files.SIZE)
    assert np.array_equal(capture["transient"][..., 0], files.COUNTS)


@pytest.mark.parametrize("claimed", [files.COUNTS.size * 2, 2**32 - 2])
def test_compressed_sdt_bombs(tmp_path, little_memory, monkeypatch, claimed):
    pytest.importorskip("sdtfile")
    tracemalloc.stop()  # Of what this test itself packs
    packed_sdt(tmp_path / "a", 400 << 20, claimed)
    assert (tmp_path / "a").stat().st_size < 1 << 20
    tracemalloc.start()
    lower(monkeypatch, free_memory=1 << 30)
    refuse(tmp_path / "a", "blocks: takes", "bytes of a block", **files.SIZE)


@pytest.mark.parametrize("blocks", [2, 32_767])
def test_sdt_blocks_that_repeat(tmp_path, little_memory, blocks):
    """A block that names itself as the next one was read again for each claimed block."""
    pytest.importorskip("sdtfile")
    path = tmp_path / "a"
    files.sdt(path, blocks=1)
    content = bytearray(path.read_bytes())
    content[18:20] = struct.pack("<h", blocks)
    at = content.rindex(files.COUNTS.astype("<u2").tobytes()) - 22
    content[at + 6 : at + 10] = struct.pack("<I", at)
    content[34:38] = struct.pack("<I", 2**32 - 1)  # The number of blocks where it is large
    path.write_bytes(content)
    refuse(path, "blocks = ", **files.SIZE)
