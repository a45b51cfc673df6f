"""An autograder for Gradescope: a zip that sets itself up and grades what is handed in.

It holds the student edition and the staff's tests, so no solution of the assignment's code lies
where submissions run, but for that of a problem whose task is to test it.
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

from ...runtime.atomic import replacing
from .. import edition
from ..assignments import PACKAGE, Assignment
from .grading import MEMORY_GIB, TIME_LIMIT_S, drawn_seed, judging_files

LONG_AGO = (1980, 1, 1, 0, 0, 0)
SETUP = """#!/usr/bin/env bash
# Run once, as root, when Gradescope makes the container.
set -euo pipefail
cd "${AUTOGRADER:-/autograder}/source/course"
if ! python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then
  apt-get update
  apt-get install -y --no-install-recommends python3.11 python3.11-venv
fi
sh .ci/setup
"""
RUN = """#!/usr/bin/env bash
# Run for each submission.
root=${{AUTOGRADER:-/autograder}}
cd "$root/source/course" || exit 1
export PYTHONPATH=$PWD
exec .venv/bin/python -m tofrender grade {folder} --submission "$root/submission" \\
  -o "$root/results/results.json" --time-limit {time_limit_s:g} --memory {memory_gib:g} \\
  --seed {seed}
"""
CHECKOUT = (".ci/setup", ".ci/requirements.txt", "pyproject.toml", "README.md", "LICENSE")
"""What of the checkout the set-up needs."""


def write(
    assignment: Assignment,
    path: Path,
    *,
    time_limit_s: float = TIME_LIMIT_S,
    memory_gib: float = MEMORY_GIB,
    seed: int = 0,
) -> list[str]:
    """Write the zip, whole or not at all.

    Args:
        assignment: The whole assignment.
        path: File to write.
        time_limit_s: Longest time for a submission [s]; Gradescope's own has to be longer.
        memory_gib: Most memory of a submission [GiB].
        seed: Seed of the staff's tests, the same for the whole class; as in `grading.opened`.

    Returns:
        Names of the files in it.

    Raises:
        ValueError: This is not the course's checkout; one line.
    """
    assignment.require_staff("gradescope")
    missing = [name for name in CHECKOUT if not (PACKAGE.parent / name).is_file()]
    if missing:
        raise ValueError(f"{PACKAGE.parent}: has no {missing[0]}; must be the course's checkout")
    folder = f"assignment/{assignment.name}"
    limits = {"time_limit_s": time_limit_s, "memory_gib": memory_gib}
    limits["seed"] = drawn_seed(assignment, seed)
    scripts = {"setup.sh": SETUP, "run_autograder": RUN.format(folder=folder, **limits)}
    with tempfile.TemporaryDirectory() as scratch, replacing(path) as temporary:
        edition.copy(assignment, Path(scratch))
        with zipfile.ZipFile(temporary, "x", zipfile.ZIP_DEFLATED) as archive:
            for name, text in scripts.items():
                _put(archive, name, text.encode(), 0o755)
            for name, file in _files(assignment, Path(scratch), folder):
                _put(archive, name, file.read_bytes(), 0o644)
            return archive.namelist()


def _files(assignment: Assignment, edition: Path, folder: str) -> Iterator[tuple[str, Path]]:
    """Names in the zip, and the files that they are."""
    for name in CHECKOUT:
        yield f"course/{name}", PACKAGE.parent / name
    for file in sorted([*(edition / "tofrender").rglob("*"), edition / "scenes" / "__init__.py"]):
        if file.is_file():
            yield f"course/{file.relative_to(edition).as_posix()}", file
    for file in judging_files(assignment):
        yield f"course/{folder}/{file.relative_to(assignment.folder).as_posix()}", file


def _put(archive: zipfile.ZipFile, name: str, content: bytes, mode: int) -> None:
    information = zipfile.ZipInfo(name, LONG_AGO)
    information.compress_type = zipfile.ZIP_DEFLATED
    information.create_system = 3
    information.external_attr = (0o100000 | mode) << 16
    archive.writestr(information, content)
