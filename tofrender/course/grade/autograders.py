"""Autograders for platforms: a zip that sets itself up and grades submissions.

It holds the student edition and the staff's tests, so no solution of the assignment's code lies
where submissions run, but for that of a problem whose task is to test it.
"""

import re
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from ...runtime.atomic import replacing
from .. import edition, toml
from ..assignments import PACKAGE, SEED, Assignment
from ..student.folders import add_file
from .grading import MEMORY_GIB, TIME_LIMIT_S, judging_files, seed_of

SCRIPTS = PACKAGE.parent / ".ci" / "autograder"
PLATFORMS = {
    "gradescope": ("run_autograder",),
    "prairielearn": ("grade.sh", "Dockerfile", "info.json"),
    "classroom50": ("autograder.py",),
}
"""Scripts of each platform, besides setup.sh."""
SETUP, PINS = ".ci/setup", ".ci/requirements.txt"  # files of the checkout
BUILDING = ("hatchling", "editables")  # with which the set-up installs the edition
START_S = 60.0  # beyond a submission's limit until PrairieLearn ends its container [s]
PRAIRIELEARN_S = 600.0  # longest limit that PrairieLearn allows [s]


def write(
    assignment: Assignment,
    path: Path,
    platform: str = "gradescope",
    *,
    time_limit_s: float = TIME_LIMIT_S,
    memory_gib: float = MEMORY_GIB,
) -> list[str]:
    """Write the zip for a platform, whole or not at all; returns the names of the files in it.

    The platform's own time limit has to be longer than `time_limit_s`.
    """
    assignment.require_staff(platform)
    if platform == "prairielearn" and time_limit_s > PRAIRIELEARN_S - START_S:
        most = f"{PRAIRIELEARN_S - START_S:g}"
        text = f"must be {most} or less, since PrairieLearn ends containers after 600 s"
        raise ValueError(f"--time-limit = {time_limit_s:g}: {text}")
    folder = f"assignment/{assignment.name}"
    values = {
        "folder": folder,
        "time_limit_s": f"{time_limit_s:g}",
        "timeout_s": f"{time_limit_s + START_S:.0f}",
        "memory_gib": f"{memory_gib:g}",
    }
    with tempfile.TemporaryDirectory() as scratch, replacing(path) as temporary:
        edition.copy(assignment, Path(scratch))
        edition.make_installable(Path(scratch), assignment.rubric)
        with zipfile.ZipFile(temporary, "x", zipfile.ZIP_DEFLATED) as archive:
            for name in ("setup.sh", *PLATFORMS[platform]):
                text = (SCRIPTS / name).read_text(encoding="utf-8")
                text = re.sub(r"@(\w+)@", lambda found: values[found[1]], text)
                add_file(archive, name, text.encode(), 0o755)
            add_file(archive, f"course/{PINS}", _pins().encode())
            for name, file in _files(assignment, Path(scratch), folder):
                add_file(archive, name, file.read_bytes())
            if platform != "classroom50":  # which publishes what it gets
                seed = f"{seed_of(assignment)}\n".encode()
                add_file(archive, f"course/{folder}/{SEED}", seed, 0o600)
            return archive.namelist()


def _pins() -> str:
    """Lines of the checkout's pinned requirements that the edition and its tests need."""
    project = toml.read(PACKAGE.parent / "pyproject.toml")["project"]
    needs = [*project["dependencies"], *project["optional-dependencies"]["course"], *BUILDING]
    found = set()
    for text in needs:
        need = Requirement(text)
        name = canonicalize_name(need.name)
        if name not in found and "extra ==" not in str(need.marker):
            found.add(name)
            with suppress(metadata.PackageNotFoundError):  # one of other systems
                needs += metadata.requires(name) or []
    pins = re.split(r"^(?=\w)", (PACKAGE.parent / PINS).read_text(encoding="utf-8"), flags=re.M)
    return "".join(pin for pin in pins if canonicalize_name(pin.partition("==")[0]) in found)


def _files(assignment: Assignment, edition: Path, folder: str) -> Iterator[tuple[str, Path]]:
    """Names in the zip, and the files they come from."""
    yield f"course/{SETUP}", PACKAGE.parent / SETUP
    for file in sorted(edition.rglob("*")):
        if file.is_file():
            yield f"course/{file.relative_to(edition).as_posix()}", file
    given = [assignment.starter / name for name in assignment.provided_files]
    for file in (*judging_files(assignment), *given):
        yield f"course/{folder}/{file.relative_to(assignment.folder).as_posix()}", file
