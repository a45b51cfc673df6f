"""The command line with films on disk, workers and error bars: the same files, come what may."""

import signal
import subprocess
import sys
import sysconfig
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from helpers.bad_inputs import listing
from helpers.commands import done, refused
from helpers.films_in_parts import check_same, differences, end, in_tiles, names, render, script
from helpers.hidden_scenes import small_capture
from helpers.limits import lower

import tofrender
from tofrender.cli.checkpoints import AGAIN, film_path
from tofrender.runtime import atomic, memory

TINY = ["--size", "12x9", "--bins", "40", "--bin-width", "0.3", "--spp", "16", "--no-video"]
SETTINGS = {"width": 12, "height": 9, "temporal_bins": 40, "bin_width_opl": 0.3}
"""Of `render`, what TINY says."""


@pytest.fixture(scope="module")
def whole():
    return render("cornell_box", settings=SETTINGS, spp=16)


_SCHEDULER = """
import distributed
if __name__ == "__main__":
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0"
    ) as cluster:
        print(cluster.scheduler_address, flush=True)
        input()
"""


@contextmanager
def scheduler_of_workers():
    """A user's own scheduler, in a process that may be ended, and its address."""
    process = script(_SCHEDULER, stdin=subprocess.PIPE)
    try:
        yield process, process.stdout.readline().strip()
    finally:
        end(process)


@pytest.fixture(scope="module")
def address():
    """The scheduler of two workers."""
    with scheduler_of_workers() as (_, address):
        yield address


@pytest.fixture
def out(tmp_path, monkeypatch) -> Path:
    """A folder's name; tiles have two rows."""
    in_tiles(monkeypatch, 2)
    return tmp_path / "box"


def short_of_memory(monkeypatch) -> None:
    """Let the film of TINY not fit, but a tile of two rows."""
    lower(monkeypatch, available_memory=memory.RESERVE + 40000)


def check(folder: Path, whole, *within: float) -> None:
    """A folder holds a render, whatever its files are."""
    if (folder / "transient.zarr").exists():
        check_same(tofrender.load_zarr(folder / "transient.zarr"), whole, *within)
        return
    if (folder / "transient.npz").exists():
        check_same(tofrender.load_npz(folder / "transient.npz"), whole)
        return
    file = folder / "stack.exr"
    found = tofrender.load_exr_stack(file if file.exists() else folder)
    light = float(whole.transient.max())
    np.testing.assert_allclose(found["transient"], whole["transient"], atol=1e-5 * light)
    assert found.attrs["spp"] == whole.attrs["spp"]


@pytest.mark.parametrize(
    ("format", "short"),
    [("frames", True), ("multipart", True), ("npz", True), ("zarr", True), ("zarr", False)],
)
def test_formats(capsys, out, monkeypatch, whole, format, short):
    """Of a film too large for memory there is a note, and the files are the same."""
    if short:
        short_of_memory(monkeypatch)
    _, err = done(capsys, "render", "cornell_box", "--out", out, *TINY, "--format", format)
    if format != "zarr":
        assert err.startswith("note: film of 12 x 9 pixels x 40 bins: takes ")
        assert "the film is rendered in tiles on the disk\n" in err
        assert err.count("\n") == 2  # And the plan
    else:
        assert names(out) == {"transient.zarr", "steady.exr", "summary.png"}
    assert names(out.parent) == {"box"}
    monkeypatch.undo()
    check(out, whole)


@pytest.mark.parametrize("format", ["frames", "zarr"])
def test_by_workers_of_a_scheduler(capsys, out, address, whole, format):
    options = ["--format", format, "--scheduler", address]
    done(capsys, "render", "cornell_box", "--out", out, *TINY, *options)
    assert names(out.parent) == {"box"}
    check(out, whole)


SCRIPT = [str(Path(sysconfig.get_path("scripts")) / "tofrender")]
MODULE = [sys.executable, "-W", "error", "-m", "tofrender"]
BOXES = """
records = 2
scene = "cornell_box"
outputs = { steady = true }
render = { width = 6, height = 5, spp = 2 }
"""
WALL = ["capture", "nlos_z", "--grid", "3x2", "--spp", "4"]


@pytest.mark.parametrize(
    ("command", "arguments", "out"),
    [
        (SCRIPT, ["render", "cornell_box", *TINY, "--format", "zarr"], "box"),
        (MODULE, ["render", "cornell_box", *TINY, "--format", "zarr"], "box"),
        (SCRIPT, WALL, "z.h5"),
        (SCRIPT, ["reconstruct", "seen.h5", "--method", "bp"], "volume"),
        (SCRIPT, ["dataset", "boxes.toml"], "boxes.zarr"),
    ],
)
def test_by_own_workers(tmp_path, whole, command, arguments, out):
    """In a process of its own, as from a shell: workers start whatever that is called."""
    if arguments[0] == "reconstruct":
        seen = tofrender.nlos.capture("nlos_z", grid=(3, 2), spp=4, progress=False)
        tofrender.save_capture(seen, tmp_path / "seen.h5")
    (tmp_path / "boxes.toml").write_text(BOXES)
    options = ["--workers", "2", "--out", out]
    subprocess.run([*command, *arguments, *options], cwd=tmp_path, check=True)
    assert names(tmp_path) - {"boxes.toml", "seen.h5"} == {out}
    if arguments[0] == "render":
        check_same(tofrender.load_zarr(tmp_path / "box" / "transient.zarr"), whole)


@pytest.mark.parametrize("command", ["render", "capture", "reconstruct"])
def test_an_address_where_nobody_answers(capsys, monkeypatch, tmp_path, command):
    lower(monkeypatch, worker_answer_s=0.3)
    file = tofrender.save_capture(small_capture(), tmp_path / "z.h5")
    arguments = {
        "render": ["cornell_box", "--out", tmp_path / "box", *TINY],
        "capture": ["nlos_z", "--out", tmp_path / "c.h5", "--grid", "2x2", "--spp", "1"],
        "reconstruct": [file, "--method", "bp", "--out", tmp_path / "bp"],
    }[command]
    text = refused(capsys, command, *arguments, "--scheduler", "tcp://127.0.0.1:9")
    assert text.startswith("--scheduler = tcp://127.0.0.1:9: does not answer; must be ")
    assert names(tmp_path) == {"z.h5"}


_KILLED = """
import sys
import pytest
from helpers.films_in_parts import in_tiles
import tofrender
from tofrender.cli.app import main
from tofrender.rendering import stored_film
from tofrender.runtime import memory
if __name__ == "__main__":
    in_tiles(pytest.MonkeyPatch(), 2)
    if sys.argv[1] == "short":
        memory.available = lambda: memory.RESERVE + 40000
    put, puts = stored_film.StoredFilm.write, []
    def counted(self, *arguments):
        receipt = put(self, *arguments)
        puts.append(None)
        if len(puts) == 3:
            print("here", flush=True)
            input()
        return receipt
    stored_film.StoredFilm.write = counted
    sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize("kind", ["zarr", "short", "errors"])
def test_a_killed_run_goes_on(capsys, out, monkeypatch, whole, kind):
    options = {"zarr": ["--format", "zarr"], "errors": ["--format", "zarr", "--errors"]}
    arguments = ["render", "cornell_box", "--out", out, *TINY, *options.get(kind, [])]
    process = script(_KILLED, kind, *arguments, stdin=subprocess.PIPE)
    try:
        assert process.stdout.readline() == "here\n", process.stderr.read()
        text = refused(capsys, *arguments)
        assert "another process is writing it" in text
    finally:
        end(process)
    assert process.returncode == -signal.SIGKILL
    assert not out.exists()
    _, err = done(capsys, *arguments, "--resume")
    assert "resuming from 3 of 5 tiles" in err
    assert names(out.parent) == {"box"}
    if kind == "errors":
        whole = render("cornell_box", settings=SETTINGS, spp=16, errors=True)
    check(out, whole, *[1e-4] * (kind == "errors"))


_WAITS = """
import sys
import pytest
from helpers.films_in_parts import in_tiles
from tofrender.cli.app import main
from tofrender.rendering import workers
if __name__ == "__main__":
    in_tiles(pytest.MonkeyPatch(), 2)
    following, calls = workers._next, []
    def waiting(*arguments):
        calls.append(None)
        if len(calls) == 2:
            print("here", flush=True)
            input()
        return following(*arguments)
    workers._next = waiting
    sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    ("arguments", "unit"),
    [
        (["render", "cornell_box", *TINY], "tiles"),
        ([*WALL, "--mode", "exhaustive"], "laser points"),
    ],
)
def test_a_scheduler_that_is_lost(capsys, out, address, arguments, unit):
    """What is done is kept, one line says so, and --resume goes on with another scheduler."""
    arguments = [*arguments, "--out", out.with_suffix(".h5") if arguments[0] == "capture" else out]
    with scheduler_of_workers() as (scheduler, lost):
        process = script(_WAITS, *arguments, "--scheduler", lost, stdin=subprocess.PIPE)
        try:
            assert process.stdout.readline() == "here\n", process.stderr.read()
            end(scheduler)
            _, err = process.communicate("\n")
        finally:
            process.kill()
    assert process.returncode == 1
    said = err.splitlines()[-1]
    assert said.startswith("error: the scheduler of the workers is lost: interrupted after ")
    assert said.endswith(f" {unit}; {AGAIN}")
    assert "Traceback" not in err
    count = int(said.partition("after ")[2].split()[0])
    _, err = done(capsys, *arguments, "--scheduler", address, "--resume")
    assert int(err.partition("resuming from ")[2].split()[0]) >= count


def finished(out: Path, **options) -> None:
    """What a run leaves that was killed while it wrote its files."""
    settings = SETTINGS | options.pop("settings", {})
    options = {"spp": 16} | options
    film = film_path(out)
    render("cornell_box", settings=settings, out=film, **options)


def test_a_run_killed_while_it_wrote_files_goes_on(capsys, out, whole):
    finished(out)
    done(capsys, "render", "cornell_box", "--out", out, *TINY, "--format", "zarr", "--resume")
    check_same(tofrender.load_zarr(out / "transient.zarr"), whole)
    assert names(out.parent) == {"box"}


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"spp": 8}, "--spp 8"),
        ({"seed": 4}, "seed = 4; must be 0"),
        ({"settings": {"width": 10}}, "fingerprint"),
        ({"errors": True}, "errors = True; must be False"),
    ],
)
def test_another_run_that_was_killed_then_is_refused(capsys, out, options, text):
    finished(out, **options)
    capsys.readouterr()
    arguments = ["render", "cornell_box", "--out", out, *TINY, "--format", "zarr", "--resume"]
    assert text in refused(capsys, *arguments)


def test_resume_of_nothing(capsys, out):
    arguments = ["render", "cornell_box", "--out", out, *TINY, "--format", "zarr", "--resume"]
    assert f"--resume: no run that writes {out} was stopped" in refused(capsys, *arguments)
    assert names(out.parent) == set()


@pytest.mark.parametrize("format", ["frames", "zarr"])
def test_merge(capsys, tmp_path, format):
    folders = [tmp_path / str(seed) for seed in range(3)]
    for seed, folder in enumerate(folders):
        options = ["--seed", seed, "--format", "zarr" if seed else "frames"]
        done(capsys, "render", "cornell_box", "--out", folder, *TINY, *options)
    before = [listing(folder) for folder in folders]
    arguments = ["merge", *folders, "--out", tmp_path / "all", "--format", format, "--no-video"]
    left = atomic.sibling(tmp_path / "all", "-0a1b2c3d")  # By one that was killed as it wrote
    (left / "frames").mkdir(parents=True)
    with atomic.locked(tmp_path / "all"):
        assert "another process is writing it" in refused(capsys, *arguments)
    assert left.is_dir()
    done(capsys, *arguments)
    renders = [render("cornell_box", settings=SETTINGS, spp=16, seed=seed) for seed in range(3)]
    expected = tofrender.merge(renders)
    assert [listing(folder) for folder in folders] == before
    assert names(tmp_path) == {"0", "1", "2", "all"}
    if format == "frames":
        check(tmp_path / "all", expected)
        return
    found = tofrender.load_zarr(tmp_path / "all" / "transient.zarr")
    assert max(differences(found, expected).values()) < 1e-5
    assert found.attrs["spp"] == 48
    assert found.attrs["seed"] == "0, 1, 2"


def test_merge_refuses_what_does_not_fit(capsys, tmp_path, whole):
    other = render("cornell_box", settings=SETTINGS | {"max_depth": 3}, spp=16, seed=1)
    for number, each in enumerate((whole, whole, other)):
        tofrender.save_exr_stack(each, tmp_path / str(number))
    folders = [tmp_path / str(number) for number in range(3)]
    out = ["--out", tmp_path / "all"]
    assert "seed = 0: is that of two renders" in refused(capsys, "merge", *folders[:2], *out)
    assert "max_depth = 3" in refused(capsys, "merge", folders[0], folders[2], *out)
    assert "must have two or more" in refused(capsys, "merge", folders[0], *out)
    among = ["--out", folders[0]]
    assert "is one of the joined folders" in refused(capsys, "merge", *folders[:2], *among)
    assert "does not contain a render" in refused(
        capsys, "merge", folders[0], tmp_path / "none", *out
    )
    assert names(tmp_path) == {"0", "1", "2"}
