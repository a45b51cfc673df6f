"""Archives that would unpack to more than they say, or to what nobody asked for."""

import functools
import json
import tempfile
import zipfile

import numpy as np
import pytest
from helpers.limits import lower

import tofrender
from tofrender.cli.report import _load_volume
from tofrender.runtime import archives
from tofrender.runtime.checkpoints import Checkpoint

BOMB = np.zeros(1 << 21, np.uint8)  # 2 MiB, which zlib makes 2 KiB of


@pytest.fixture
def small_only(monkeypatch):
    """Reading as much as a bomb holds is an error of the test."""
    read = archives.npy.read_array

    def guarded(stream, **options):
        array = read(stream, **options)
        assert array.nbytes < BOMB.nbytes, "was unpacked"
        return array

    lower(monkeypatch, array_bytes=BOMB.nbytes // 2)
    monkeypatch.setattr(archives.npy, "read_array", guarded)


@functools.cache
def rendered() -> dict:
    """The arrays of a render's file."""
    scene = tofrender.cornell_box(width=4, height=4, temporal_bins=20, bin_width_opl=0.6)
    with tempfile.TemporaryDirectory() as folder:
        path = tofrender.save_npz(tofrender.render(scene, spp=4, progress=False), f"{folder}/a.npz")
        with np.load(path) as archive:
            return dict(archive)


PULSE = {"start_opl": 0.0, "bin_width_opl": 1.0}
AXES = {axis: np.arange(3.0) for axis in "zyx"}
BOMBS = {
    "shape of a render": (tofrender.load_npz, {"transient": BOMB}),
    "description": (tofrender.load_npz, {"tofrender": np.array("x" * len(BOMB))}),
    "pulse": (tofrender.SampledPulse.from_file, PULSE | {"values": BOMB}),
    "volume": (_load_volume, AXES | {"intensity": BOMB}),
    "axis of a volume": (_load_volume, AXES | {"intensity": BOMB, "z": BOMB}),
}


@pytest.mark.parametrize("name", BOMBS)
def test_shapes_are_compared_before_anything_is_unpacked(tmp_path, small_only, name):
    read, arrays = BOMBS[name]
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, **(rendered() if read is tofrender.load_npz else {}) | arrays)
    with pytest.raises(ValueError, match=r"\A.*(with shape|of .*MiB).*: must be .*\Z"):
        read(path)


def test_an_array_that_says_less_than_it_holds(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(4))
    with zipfile.ZipFile(path) as archive:
        content = archive.read("a.npy")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", content + b"more")
    with (
        zipfile.ZipFile(path) as archive,
        pytest.raises(ValueError, match=r"a: the file is damaged"),
    ):
        archives.read_array(archive, "a")


def test_a_compressed_checkpoint_is_not_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "kept.npz"
    about = {"recipe": {}, "done": 1, "of": 2, "seconds": 1.0, "arrays": ["a"]}
    np.savez_compressed(path, tofrender=np.array(json.dumps(about)), a=BOMB)
    monkeypatch.setattr(zipfile.ZipFile, "testzip", None)
    monkeypatch.setattr(np, "load", None)
    with pytest.warns(UserWarning, match="is damaged, starting anew"):
        assert Checkpoint(path).begin({}, 2, "units") is None
    assert Checkpoint(path).recipe() == {}
