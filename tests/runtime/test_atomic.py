"""Files and folders appear whole or not at all, whenever their writer is killed."""

import errno
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest.mock import Mock

import pytest
from helpers.processes import ROOT
from helpers.refusals import refused

from tofrender.runtime import atomic
from tofrender.runtime.atomic import check_writable, locked, remove_leftovers, replacing, sibling

LONG = "x" * 250  # As long as names may be, or nearly: 255 bytes


def names(folder: Path) -> list[str]:
    return sorted(os.listdir(folder))


def write(path: Path, text: str, folder: bool = False) -> None:
    with replacing(path, folder=folder) as temporary:
        for name in ("a", "b") if folder else ("",):
            (temporary / name).write_text(text)


def read(path: Path) -> str:
    """What `write` has written, "" if it is not there; fails if it is not whole."""
    if not path.is_dir():
        return path.read_text() if path.exists() else ""
    parts = {each.name: each.read_text() for each in path.iterdir()}
    assert parts == dict.fromkeys("ab", parts["a"])
    return parts["a"]


def child(code: str, *arguments: object) -> subprocess.Popen:
    """A process that runs code with `atomic`."""
    imports = "import os, sys, time\nfrom pathlib import Path\n"
    code = f"{imports}from tofrender.runtime.atomic import *\n{code}"
    command = [sys.executable, "-c", code, *map(str, arguments)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    return subprocess.Popen(command, cwd=ROOT, text=True, **pipes)


@pytest.mark.parametrize("kind", ["file", "folder", "folder where none can be exchanged"])
@pytest.mark.parametrize("where", ["absolute", "relative"])
def test_it_takes_the_place(tmp_path, monkeypatch, kind, where):
    monkeypatch.chdir(tmp_path)
    if "none" in kind:
        monkeypatch.setattr(atomic, "_exchange", lambda *_: False)
    target = Path("film.exr") if where == "relative" else tmp_path / "new" / "film.exr"
    for text in ("one", "two"):
        write(target, text, kind != "file")
        assert read(target) == text
        assert names(target.parent) == ["film.exr"]


@pytest.mark.parametrize("folder", [False, True])
@pytest.mark.parametrize("earlier", [False, True])
@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_an_error_leaves_what_was_there(tmp_path, folder, earlier, error):
    target = tmp_path / "film"
    if earlier:
        write(target, "one", folder)

    def fail():
        with replacing(target, folder=folder) as temporary:
            (temporary / "a" if folder else temporary).write_text("half")
            raise error

    with pytest.raises(error):
        fail()
    assert read(target) == ("one" if earlier else "")
    assert names(tmp_path) == ["film"] * earlier


def test_a_file_keeps_its_suffix(tmp_path):
    with replacing(tmp_path / "film.exr") as temporary:
        assert temporary.suffix == ".exr"
        assert temporary.parent == tmp_path
        assert temporary.name.startswith(atomic.TEMPORARY_PREFIX)
        temporary.touch()


def test_a_link_is_followed(tmp_path):
    real = tmp_path / "elsewhere" / "film"
    real.parent.mkdir()
    real.write_text("one")
    link = tmp_path / "link"
    link.symlink_to(real)
    write(link, "two")
    assert link.is_symlink()
    assert real.read_text() == "two"


@pytest.mark.parametrize("folder", [False, True])
def test_names_as_long_as_may_be(tmp_path, folder):
    target = tmp_path / LONG
    with locked(target):
        for text in ("one", "two"):
            write(target, text, folder)
    assert read(target) == "two"
    assert names(tmp_path) == [LONG]


def test_a_file_has_the_mode_that_others_have(tmp_path):
    """A temporary's 0600 would lock out the group."""
    before = os.umask(0o022)
    try:
        write(tmp_path / "file", "one")
        write(tmp_path / "folder", "one", folder=True)
    finally:
        os.umask(before)
    modes = [(tmp_path / name).stat().st_mode & 0o777 for name in ("file", "folder")]
    assert modes == [0o644, 0o755]


@pytest.mark.parametrize("folder", [False, True])
def test_it_is_on_the_disk_before_it_takes_the_place(tmp_path, monkeypatch, folder):
    """What is renamed but not synced may be empty after a power cut; its parent's list too."""
    target, synced = tmp_path / "film", set()
    write(target, "one", folder)
    fsync = os.fsync

    def sync(descriptor):
        synced.add((os.fstat(descriptor).st_ino, read(target)))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", sync)
    write(target, "two", folder)
    files = [target / "a", target / "b", target] if folder else [target]
    assert {(each.stat().st_ino, "one") for each in files} <= synced
    assert (tmp_path.stat().st_ino, "two") in synced


_WATCH = """
path, parent = Path(sys.argv[1]), os.getppid()
bad = seen = 0
while not (path.parent / "stop").exists() and os.getppid() == parent:
    seen += 1
    try:
        bad += not path.is_dir() and len(path.read_text()) != 30000
    except FileNotFoundError:
        bad += 1
    if seen in (1, 20):
        print(seen, flush=True)
print(bad)
"""


@pytest.mark.parametrize("folder", [False, True])
def test_it_is_never_away(tmp_path, folder):
    target = tmp_path / "film"
    write(target, "000" * 10_000, folder)
    if folder:
        probe = [tmp_path / "probe", tmp_path / "other"]
        for each in probe:
            each.mkdir()
        if not atomic._exchange(*probe):
            pytest.skip("folders cannot be exchanged in one step here")
    watcher = child(_WATCH, target)
    assert watcher.stdout.readline() == "1\n"
    with ThreadPoolExecutor(1) as thread:
        seen = thread.submit(watcher.stdout.readline)
        count = 0
        while count < 200 or not seen.done():
            write(target, f"{count % 1000:03d}" * 10_000, folder)
            count += 1
    (tmp_path / "stop").touch()
    assert (seen.result(), watcher.communicate()[0]) == ("20\n", "0\n")


def test_a_disk_without_inodes(tmp_path, monkeypatch):
    """ENOSPC, though there is room: it is no matter of permissions."""
    full = Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    counts = list(os.statvfs(tmp_path))
    counts[5:8] = 4, 0, 0  # f_files, f_ffree, f_favail
    monkeypatch.setattr(atomic.tempfile, "mkdtemp", full)
    monkeypatch.setattr(os, "statvfs", lambda _: os.statvfs_result(counts))
    said = "^path = .*/film: the disk is too full; needs more, no inode is free for another file$"
    with refused(said, OSError) as error:
        check_writable(tmp_path / "film")
    assert error.value.errno == errno.ENOSPC


def test_threads_may_try_one_folder_at_once(tmp_path):
    with ThreadPoolExecutor(8) as threads:
        found = threads.map(check_writable, [tmp_path / f"{count}" for count in range(400)])
        assert list(found) == [None] * 400
    assert names(tmp_path) == []


_WRITE = """
path, folder = Path(sys.argv[1]), sys.argv[2] == "folder"
print("ready", flush=True)
count = 0
with locked(path):
    while True:
        count += 1
        with replacing(path, folder=folder) as temporary:
            for name in ("a", "b") if folder else ("",):
                (temporary / name).write_text(str(count) * 1000)
"""


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_killed_at_any_moment(tmp_path, kind):
    target = tmp_path / "film"
    write(target, "first", kind == "folder")
    for after in (0.003, 0.011, 0.023, 0.05):
        writer = child(_WRITE, target, kind)
        assert writer.stdout.readline() == "ready\n"
        time.sleep(after)
        writer.kill()
        writer.communicate()
        text = read(target)
        if text != "first":
            assert text == text[: len(text) // 1000] * 1000
        with locked(target):  # The dead hold no lock
            remove_leftovers(target)
        assert names(tmp_path) == ["film"]


_KILLED_BETWEEN = """
import tofrender.runtime.atomic as atomic
atomic._exchange = lambda *_: False
rename = os.rename
def killed(source, destination):
    rename(source, destination)
    os.kill(os.getpid(), 9)
os.rename = killed
with replacing(sys.argv[1], folder=True) as temporary:
    (temporary / "a").write_text("two")
"""


def test_killed_while_the_earlier_folder_is_aside(tmp_path):
    """As on systems that cannot exchange folders: it comes back."""
    target = tmp_path / "film"
    write(target, "one", folder=True)
    writer = child(_KILLED_BETWEEN, target)
    writer.communicate()
    assert writer.returncode == -signal.SIGKILL
    assert not target.exists()
    with locked(target):
        remove_leftovers(target)
    assert read(target) == "one"
    assert names(tmp_path) == ["film"]


def test_hidden_names(tmp_path, monkeypatch):
    path = sibling(tmp_path / "film", ".checkpoint.npz")
    assert path.parent == tmp_path
    assert path.name.startswith(".tofrender-")
    assert path.name.endswith(".checkpoint.npz")
    others = [sibling(tmp_path / n, ".checkpoint.npz") for n in ("film2", "fil", LONG, LONG + "y")]
    assert len({path, *others}) == 5
    assert all(len(each.name.encode()) <= 255 for each in others)
    # However a place is written, a second run must find the first one's checkpoint, and its lock
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "film")
    ways = ["film", "./film", tmp_path / "film", "film/", "sub/../film", "link"]
    assert {Path(sibling(way, ".checkpoint.npz")).resolve() for way in ways} == {path}


def test_leftovers_of_others_stay(tmp_path):
    write(tmp_path / "film", "one", folder=True)
    others = [sibling(tmp_path / name, ".checkpoint.npz") for name in ("film", "film2", "fil")]
    others += [tmp_path / ".hidden", tmp_path / "film.txt"]
    for each in others:
        each.write_text("x")
    with replacing(tmp_path / "film2", folder=True) as temporary:
        (temporary / "a").write_text("x")
        remove_leftovers(tmp_path / "film")
        assert (temporary / "a").exists()
    assert all(each.exists() for each in others)


_LEFT = """
writer = replacing(Path(sys.argv[1]), folder=sys.argv[2] == 'True')
temporary = writer.__enter__()
(temporary / 'a' if temporary.is_dir() else temporary).write_text('half')
print(temporary.name, flush=True)
os.kill(os.getpid(), 9)
"""


def test_leftovers_go(tmp_path):
    killed = [child(_LEFT, tmp_path / "film", folder) for folder in (False, True)]
    made = [each.communicate()[0].strip() for each in killed]
    assert names(tmp_path) == sorted(made)
    with locked(tmp_path / "film"):
        remove_leftovers(tmp_path / "film")
    assert names(tmp_path) == []


_HOLDS = "with locked(sys.argv[1]):\n    print('locked', flush=True)\n    sys.stdin.read()"


@pytest.mark.parametrize("killed", [False, True])
def test_one_writer_at_a_time(tmp_path, killed):
    path = tmp_path / "film"
    holder = child(_HOLDS, path)
    assert holder.stdout.readline() == "locked\n"
    try:
        # It does not wait for the holder, which waits for this process
        with refused(r"^--out = .*film", FileExistsError), locked(path, "--out"):
            pytest.fail("two have the lock")
        with locked(tmp_path / "other"):
            pass
    finally:
        if killed:
            holder.kill()
        holder.communicate("")
    with locked(path):  # The dead hold no lock
        pass
    assert names(tmp_path) == []


def test_a_lock_is_given_back_after_an_error(tmp_path):
    for _ in range(2):
        with pytest.raises(RuntimeError), locked(tmp_path / "film"):
            raise RuntimeError
    assert names(tmp_path) == []


def test_a_lock_that_its_holder_removes_meanwhile(tmp_path, monkeypatch):
    """Between opening its file and locking that: it would lock a file that nobody else sees."""
    path, flock, removed = tmp_path / "film", atomic.fcntl.flock, []

    def late(*arguments):
        if not removed:
            removed.append(os.unlink(sibling(path, ".lock")))
        return flock(*arguments)

    monkeypatch.setattr(atomic.fcntl, "flock", late)
    with locked(path):
        assert removed
        with pytest.raises(FileExistsError), locked(path):
            pytest.fail("two have the lock")
    assert names(tmp_path) == []


_MANY = """
path = Path(sys.argv[1])
count = path.parent / "count"
for _ in range(60):
    while True:
        try:
            with locked(path):
                before = int(count.read_text())
                time.sleep(0.0005)
                count.write_text(str(before + 1))
            break
        except FileExistsError:
            time.sleep(0.001)
"""


def test_locks_of_many(tmp_path):
    (tmp_path / "count").write_text("0")
    workers = [child(_MANY, tmp_path / "film") for _ in range(3)]
    for each in workers:
        each.communicate()
        assert each.returncode == 0
    assert (tmp_path / "count").read_text() == "180"
    assert names(tmp_path) == ["count"]
