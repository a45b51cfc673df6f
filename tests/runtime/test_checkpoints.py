"""The file that long work keeps: whole, its own, as often as asked, and never a wrong one."""

import errno
import os
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.support import refused

from tofrender.runtime.atomic import sibling
from tofrender.runtime.checkpoints import Checkpoint

WORK = {"scene": "box", "seed": 3, "at": 0.1, "places": [1, 2], "what": None}
ALWAYS = 1e-9


def arrays(value: float = 1.0) -> dict[str, np.ndarray]:
    light, places = np.full((2, 3), value, np.float32), np.arange(5, dtype=np.uint32)
    return {"light": light, "places": places, "count": np.array(7), "none": np.zeros((0, 4))}


def made(path: Path, **options) -> Checkpoint:
    return Checkpoint(path, **{"seconds": ALWAYS, "tell": lambda line: None} | options)


def saved(path: Path, done: int = 16, of: int = 64, value: float = 1.0) -> Path:
    path.unlink(missing_ok=True)
    checkpoint = made(path)
    assert checkpoint.begin(WORK, of, "samples") is None
    checkpoint.save(done, of, arrays(value))
    return path


def begun(path: Path, recipe=WORK, of: int = 64, **options):
    return made(path, **options).begin(recipe, of, "samples")


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "work.npz"


def names(folder: Path) -> list[str]:
    return sorted(os.listdir(folder))


def check_kept(kept, done: int = 16, value: float = 1.0) -> None:
    assert (kept.done, kept.of) == (done, 64)
    expected = arrays(value)
    assert kept.arrays.keys() == expected.keys()
    for name, array in expected.items():
        found = kept.arrays[name]
        assert (found.dtype, found.shape) == (array.dtype, array.shape)
        assert found.tobytes() == array.tobytes()


def test_what_was_saved_last_is_found(path):
    checkpoint = made(path)
    assert checkpoint.begin(WORK, 64, "samples") is None
    assert names(path.parent) == []
    for done in (8, 16, 24):
        checkpoint.save(done, 64, arrays(done))
        check_kept(begun(path), done, done)
        assert names(path.parent) == [path.name]


@pytest.mark.parametrize("wrong", [np.ones(6), np.ones((2, 3)), np.ones((1, 2, 3), np.float32)])
def test_an_array_of_another_shape_or_type_is_damage(path, wrong):
    with np.load(saved(path)) as archive:
        np.savez(path, **{**archive, "light": wrong})
    assert outcome(made(path)) == "anew"


def test_without_resume_it_starts_anew(path):
    """And what was there stays until something takes its place."""
    saved(path, done=32)
    checkpoint = made(path, resume=False)
    assert checkpoint.begin(WORK | {"seed": 4}, 64, "samples") is None
    assert begun(path).done == 32
    checkpoint.save(8, 64, arrays())
    assert begun(path, WORK | {"seed": 4}).done == 8


def test_remove(path):
    """With what a killed process has left of it."""
    checkpoint = made(saved(path))
    sibling(path, "-0123abcd.npz").touch()
    checkpoint.remove()
    assert names(path.parent) == []
    checkpoint.remove()  # Nothing is there to remove


@pytest.fixture
def now(monkeypatch) -> list[float]:
    """The time, which only the test changes."""
    now = [100.0]
    for clock in ("monotonic", "perf_counter", "time"):
        monkeypatch.setattr(time, clock, lambda: now[0])
    return now


def test_it_is_due_after_its_seconds(path, now):
    checkpoint = made(path, seconds=30)
    checkpoint.begin(WORK, 64, "samples")
    for _ in range(2):
        due = [checkpoint.due]
        for later in (29, 2):
            now[0] += later
            due.append(checkpoint.due)
        assert due == [False, False, True]
        checkpoint.save(16, 64, arrays())


def test_slow_savings_are_rare(path, monkeypatch, now):
    """At most 2 % of the time goes into them."""
    savez = np.savez

    def slowly(*arguments, **options):
        now[0] += 0.05
        return savez(*arguments, **options)

    monkeypatch.setattr(np, "savez", slowly)
    checkpoint = made(path)
    checkpoint.begin(WORK, 64, "samples")
    checkpoint.save(1, 64, arrays())
    due = []
    for later in (2.4, 0.2):
        now[0] += later
        due.append(checkpoint.due)
    assert due == [False, True]


@pytest.mark.parametrize(
    ("recipe", "text"),
    [
        (WORK | {"seed": 4}, "seed = 3 instead of 4"),
        (WORK | {"scene": "bunny"}, "scene = 'box' instead of 'bunny'"),
        (WORK | {"at": float(np.nextafter(0.1, 1))}, r"at = 0\.1 instead of 0\.1000000000"),
        (WORK | {"places": [1, 3]}, "places"),
        (WORK | {"what": 1}, "what"),
        (WORK | {"more": 1}, "more"),
        ({name: value for name, value in WORK.items() if name != "seed"}, "seed"),
    ],
)
def test_other_work_is_refused(path, recipe, text):
    saved(path)
    before = path.read_bytes()
    refused(f"{path}.*{text}", begun, path, recipe)
    refused("contains 16 samples; must be at most 8", begun, path, of=8)
    assert path.read_bytes() == before
    assert begun(path, WORK | {"places": (1, 2)}).done == 16  # JSON has no tuples


class Trap:
    def __reduce__(self):
        return (pytest.fail, ("a pickle was read",))


@pytest.mark.parametrize(
    "foreign",
    [
        *(b"", b"no archive", np.zeros(4), {"light": np.zeros(3)}, {"tofrender": np.array("[1]")}),
        {"tofrender": np.array([Trap()], dtype=object)},
    ],
)
def test_what_is_no_checkpoint_is_not_gone_on_with(path, foreign):
    if isinstance(foreign, bytes):
        path.write_bytes(foreign)
    elif isinstance(foreign, dict):
        np.savez(path, **foreign)
    else:
        with path.open("wb") as file:
            np.save(file, foreign)
    assert outcome(made(path)) == "anew"


def outcome(checkpoint: Checkpoint):
    """Kept work, or "anew" if the file is damaged and says so."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        kept = checkpoint.begin(WORK, 64, "samples")
    if kept is None:
        (said,) = caught
        assert said.category is UserWarning
        assert str(said.message) == f"{checkpoint.path}: is damaged, starting anew"
        return "anew"
    assert not caught
    return kept


def damaged_ones_found(path: Path, contents) -> int:
    """How many of a file's damaged contents are noticed; others must not matter."""
    noticed, checkpoint = 0, made(path)
    for content in contents:
        path.write_bytes(content)
        found = outcome(checkpoint)
        if found == "anew":
            noticed += 1
        else:
            check_kept(found)
    return noticed


def flipped(content: bytes, index: int, by: int) -> bytes:
    return content[:index] + bytes([content[index] ^ by]) + content[index + 1 :]


@pytest.mark.parametrize("bits", ["one", "any"])
def test_every_flipped_byte_is_noticed_or_does_not_matter(path, bits):
    content = saved(path).read_bytes()
    random = np.random.default_rng(1).integers(1, 256, len(content)).tolist()
    by = {"one": [0x01] * len(content), "any": random}[bits]
    places = range(0, len(content), {"one": 1, "any": 5}[bits])
    noticed = damaged_ones_found(path, (flipped(content, i, by[i]) for i in places))
    assert noticed > len(places) / 2


def test_half_an_array_is_no_array(path):
    """NumPy would read what the header says, and never come to the checksum."""
    checkpoint = made(path)
    checkpoint.begin(WORK, 64, "samples")
    checkpoint.save(16, 64, {"light": np.ones(50_000)})
    content = path.read_bytes()
    assert content.count(b"(50000,)") == 1
    path.write_bytes(content.replace(b"(50000,)", b"(40000,)"))
    assert outcome(checkpoint) == "anew"


def test_every_truncation_is_noticed(path):
    content = saved(path).read_bytes()
    lengths = [*range(0, len(content), 7), *range(len(content) - 30, len(content))]
    assert damaged_ones_found(path, (content[:n] for n in lengths)) == len(lengths)


def test_parts_of_two_files_are_no_file(path):
    """Blocks of an older file between those of a newer one, as a failing disk may leave them."""
    new, old = saved(path, value=1.0).read_bytes(), saved(path, value=2.0).read_bytes()
    mixed = [old[:n] + new[n - len(old) :] for n in range(700, len(old), 100)]
    found = damaged_ones_found(path, [each for each in mixed if each not in (new, old)])
    assert found >= 5


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO])
def test_no_room_is_a_warning(path, monkeypatch, number):
    saved(path, done=8)
    checkpoint = made(path)
    checkpoint.begin(WORK, 64, "samples")

    def full(*arguments, **options):
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        patch.setattr(os, "fsync", full)
        with pytest.warns(UserWarning, match=r"^no checkpoint was saved: ") as caught:
            checkpoint.save(16, 64, arrays(2.0))
        checkpoint.save(18, 64, arrays(2.0))  # Says no more, or it would be an error here
    assert "\n" not in str(caught[0].message)
    kept = begun(path)
    assert kept.done == 8
    assert kept.arrays["light"].min() == 1
    assert names(path.parent) == [path.name]
    checkpoint.save(24, 64, arrays())  # There is room again
    assert begun(path).done == 24
    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        with pytest.warns(UserWarning, match=r"^no checkpoint was saved: "):
            checkpoint.save(32, 64, arrays())


def test_bad_arguments(tmp_path):
    (tmp_path / "folder.npz").mkdir()
    refused("is a folder; must be the name", Checkpoint, tmp_path / "folder.npz", kind=OSError)
