"""Plant each bug in a copy of the project, and see that its tests fail there.

`python -m tests.mutants [--only NAME] [--jobs N]`. The docstring of `planting.py` describes the
entries. With the bug at least one of its tests must fail; without, all pass. The tests are tried as
`make test` runs them, and if none fails, as `make test-all` does.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from .planting import ROOT, Bug, bugs, planted

QUICK = 0.8  # Fraction of the bugs that `make test` must find; `make test-all` must find all
LIMIT_S = 900  # A run of a bug's tests that takes longer has been hung by it, which finds it too


def copy(folder: Path) -> Path:
    """A copy of the project's files in git, changed ones as they are."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    for name in filter(None, names.stdout.decode().split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


def fails(folder: Path, tests: tuple[str, ...], *options: str) -> bool:
    """Whether a test fails; not whether pytest finds none or cannot load it."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider"]
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", "CI": ""}
    process = subprocess.Popen(
        ["nice", *command, *options, *tests],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        text=True,
    )
    try:
        said, _ = process.communicate(timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.communicate()
        return True
    if process.returncode not in (0, 1, 5):
        raise RuntimeError(f"pytest ended with {process.returncode}:\n{said[-2000:]}")
    return process.returncode == 1


def verdict(bug: Bug, folder: Path) -> str:
    """Which of "make test", "make test-all" and "nothing" finds a bug."""
    path = folder / bug.file
    path.write_text(planted(bug, folder), encoding="utf-8")
    try:
        in_tests = any(test.startswith("tests/") for test in bug.tests)
        if fails(folder, bug.tests, *(["--brief"] if in_tests else [])):  # Doctests are all brief
            return "make test"
        return "make test-all" if fails(folder, bug.tests) else "nothing"
    finally:
        shutil.copy2(ROOT / bug.file, path)


def main() -> int:
    """Try the bugs; return 0 if all are found, and enough of them by `make test`."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--only", metavar="TEXT", default="", help="bugs whose name has this text")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="so many at a time")
    options = parser.parse_args()
    chosen = [bug for bug in bugs() if options.only in bug.name]
    if not chosen:
        parser.error(f"--only {options.only}: no bug has such a name")
    found: dict[str, list[str]] = {"make test": [], "make test-all": [], "nothing": []}
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(options.jobs) as pool:
        copies: SimpleQueue[Path] = SimpleQueue()
        for k in range(options.jobs):
            copies.put(copy(Path(folder) / f"copy{k}"))

        def attempt(bug: Bug) -> None:
            its = copies.get()
            try:
                by = verdict(bug, its)
            finally:
                copies.put(its)
            found[by].append(bug.name)
            print(f"{bug.file}: {bug.name}: found by {by}", flush=True)

        list(pool.map(attempt, chosen))
    quick, all_of = len(found["make test"]), len(found["make test"]) + len(found["make test-all"])
    print(f"{len(chosen)} bugs: make test finds {quick}, make test-all {all_of}")
    return int(bool(found["nothing"]) or quick < QUICK * all_of)


if __name__ == "__main__":
    sys.exit(main())
