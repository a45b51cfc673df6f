"""Autograders for platforms: zip archives that install themselves and grade submissions.

An autograder contains the student edition and the staff's tests, but no solutions. The exception
is the solution that a student's test is applied to, if a problem asks for a test.
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
"""Scripts of each platform, in addition to `setup.sh`."""
# Files of the checkout
SETUP = ".ci/setup"
PINS = ".ci/requirements.txt"
BUILDING = ("hatchling", "editables")  # packages that the installation of the edition needs
START_S = 60.0  # time between a submission's limit and the end of PrairieLearn's container [s]
PRAIRIELEARN_S = 600.0  # longest time limit that PrairieLearn allows [s]


def write(
    assignment: Assignment,
    path: Path,
    platform: str = "gradescope",
    *,
    time_limit_s: float = TIME_LIMIT_S,
    memory_gib: float = MEMORY_GIB,
) -> list[str]:
    """Write the autograder for a platform. If this fails, no partial file is left.

    Args:
        assignment: Assignment of a checkout.
        path: Path of the zip archive.
        platform: One of `PLATFORMS`.
        time_limit_s: Time limit of a submission [s]. The limit of the platform must be longer.
        memory_gib: Memory limit of a submission [GiB].

    Returns:
        Names of the files in the archive.

    Raises:
        ValueError: The assignment lacks solutions, or the time limit is too long for the platform.
    """
    # Check the arguments
    assignment.require_staff(platform)
    if platform == "prairielearn" and time_limit_s > PRAIRIELEARN_S - START_S:
        most = f"{PRAIRIELEARN_S - START_S:g}"
        text = f"must be {most} or less, because PrairieLearn ends containers after 600 s"
        raise ValueError(f"--time-limit = {time_limit_s:g}: {text}")

    # Values of the placeholders @name@ in the scripts
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

        # Write scripts, pinned requirements, edition and tests
        with zipfile.ZipFile(temporary, "x", zipfile.ZIP_DEFLATED) as archive:
            for name in ("setup.sh", *PLATFORMS[platform]):
                text = (SCRIPTS / name).read_text(encoding="utf-8")
                text = re.sub(r"@(\w+)@", lambda found: values[found[1]], text)
                add_file(archive, name, text.encode(), 0o755)
            add_file(archive, f"course/{PINS}", _pins().encode())
            for name, file in _files(assignment, Path(scratch), folder):
                add_file(archive, name, file.read_bytes())

            # Classroom 50 publishes the archive, so it must not contain the secret seed
            if platform != "classroom50":
                seed = f"{seed_of(assignment)}\n".encode()
                add_file(archive, f"course/{folder}/{SEED}", seed, 0o600)
            return archive.namelist()


def _pins() -> str:
    """Return the lines of the pinned requirements that the edition and its tests need."""
    # Collect all direct and indirect requirements; the list grows while it is read
    project = toml.read(PACKAGE.parent / "pyproject.toml")["project"]
    needs = [*project["dependencies"], *project["optional-dependencies"]["course"], *BUILDING]
    found = set()
    for text in needs:
        need = Requirement(text)
        name = canonicalize_name(need.name)
        if name not in found and "extra ==" not in str(need.marker):
            found.add(name)
            with suppress(metadata.PackageNotFoundError):  # A package for other systems
                needs += metadata.requires(name) or []

    # Select their lines; a pin starts with a name and may continue on indented lines
    pins = re.split(r"^(?=\w)", (PACKAGE.parent / PINS).read_text(encoding="utf-8"), flags=re.M)
    return "".join(pin for pin in pins if canonicalize_name(pin.partition("==")[0]) in found)


def _files(assignment: Assignment, edition: Path, folder: str) -> Iterator[tuple[str, Path]]:
    """Yield the name in the archive and the path of each file, except scripts and pins."""
    yield f"course/{SETUP}", PACKAGE.parent / SETUP
    for file in sorted(edition.rglob("*")):
        if file.is_file():
            yield f"course/{file.relative_to(edition).as_posix()}", file
    provided = [assignment.starter / name for name in assignment.provided_files]
    for file in (*judging_files(assignment), *provided):
        yield f"course/{folder}/{file.relative_to(assignment.folder).as_posix()}", file
