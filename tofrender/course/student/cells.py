"""Notebook cells that write files (`%%solution pulse.py`) and test them (`%%test pulse.py`).

Running a `%%solution` cell writes the file and reloads the modules imported from it. If an editor
has changed the file in the meantime, a numbered backup is kept. A `%%test` cell runs the public
tests of the file's problems.
"""

import hashlib
import importlib
import itertools
import json
import re
import shlex
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from ...runtime.atomic import replacing
from .. import rubric as rubrics
from ..judge import running

RECORD = ".tofrender-cells.json"
"""File next to the notebook with a hash of each file, as a cell last wrote it."""

FILE_NAME = re.compile(r"[A-Za-z_]\w*\.py")


def load_ipython_extension(shell: Any) -> None:
    """Register the cell magics `%%solution FILE` and `%%test FILE` in IPython."""

    def solution(line: str, cell: str) -> None:
        """Write the cell to FILE, and reload the modules imported from it."""
        if not FILE_NAME.fullmatch(line.strip()):
            raise ValueError(f"%%solution {line}: write a file name such as pulse.py after it")
        path = Path.cwd() / line.strip()
        print(save(path, cell))
        refresh(path, shell.user_ns)

    def test(line: str, cell: str = "") -> None:
        """Run the public tests of FILE or of a problem. The lines below are options of pytest."""
        print(run_tests(Path.cwd(), line.strip(), cell))

    # Modules are imported from the folder of the notebook
    folder = Path.cwd()
    if not (folder / "rubric.toml").is_file():
        print(f"note: cells write to {folder}, which does not contain a rubric.toml")
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    shell.register_magic_function(solution, "cell")
    shell.register_magic_function(test, "line_cell")


def save(path: Path, cell: str) -> str:
    """Write a cell's text to its file, without losing changes that an editor made.

    If the file was changed by an editor and the cell was not, the file is kept. Students may work
    in an editor, and running the whole notebook must not bring the stubs back. If both were
    changed, the cell's text is written, and the editor's text is kept in a numbered backup.

    Returns:
        A message for the student about the result.
    """
    name = path.name
    new = (cell.rstrip() + "\n").encode()
    written = _read_record(path.parent)
    message = f"wrote {name}"
    if path.is_file():
        old = path.read_bytes()
        if old == new:
            message = f"{name} has the text of this cell already"

        # Was the file changed by someone else since a cell wrote it?
        elif _hash(old) != written.get(name):
            if written.get(name) == _hash(new):
                return (
                    f"{name} was changed outside of this cell and is kept; the cell's text has "
                    "not changed. (Delete the file to write the cell's text again.)"
                )
            numbered = (path.with_name(f"{name}.{number}") for number in itertools.count(1))
            backup = next(each for each in numbered if not each.exists())
            backup.write_bytes(old)
            message += (
                f". It had been changed outside of this cell; the old text is in {backup.name}"
            )

    # Write the cell's text, and remember it
    with replacing(path) as temporary:
        temporary.write_bytes(new)
    _write_record(path.parent, written | {name: _hash(new)})
    return message


def run_tests(folder: Path, name: str, options: str = "") -> str:
    """Run the public tests of a file's problems, and return the outcomes as text.

    Args:
        folder: The student's folder.
        name: A file such as pulse.py, or a problem such as a2.gaussian_pulse. An empty name runs
            all tests.
        options: Options of pytest, one per line. Lines that start with # are ignored.

    Raises:
        ValueError: The assignment does not contain this file or problem.
    """
    if not (folder / "tests").is_dir():
        return f"{folder} does not contain tests"

    # Choose the tests by the markers of their problems
    rubric = rubrics.read(folder)
    markers = [p.marker for p in rubric.problems if name in ("", p.file, p.id, p.marker)]
    if not markers:
        known = dict.fromkeys(p.file for p in rubric.problems if p.file)
        raise ValueError(f"%%test {name}: must be one of {', '.join(known)}, or a problem's id")
    words = [w for line in options.splitlines() if line[:1] != "#" for w in shlex.split(line)]
    pytest_options = ["-m", " or ".join(markers), *words]
    outcomes = running.run(folder, submission=folder, pytest_options=pytest_options)

    # Report each test, and at most two failures of it
    lines = []
    for test, outcome in outcomes.items():
        lines.append(f"{outcome.outcome}  {rubrics.name_of(test)}  {outcome.seconds:.1f} s")
        lines += [f"    {line}" for text in outcome.texts[:2] for line in text.splitlines()]
    return "\n".join(lines or ["no tests were chosen"])


def remember(folder: Path, names: list[str]) -> None:
    """Record that the cells wrote these files of a folder with their current text."""
    _write_record(folder, {name: _hash((folder / name).read_bytes()) for name in names})


def refresh(path: Path, namespace: dict[str, Any]) -> None:
    """Reload the modules of a file's folder after the file has changed.

    All modules of the folder are reloaded, because they import each other. If the file has not
    been imported, nothing is done.

    Args:
        path: The changed file.
        namespace: Variables of the notebook. Variables that refer to a reloaded module, or to a
            function or class of one, are set to the new object.
    """
    importlib.invalidate_caches()
    if path.stem not in sys.modules:
        return

    # Find the modules of the folder, and where each of their functions and classes was defined
    old = {
        name: module
        for name, module in sys.modules.items()
        if Path(getattr(module, "__file__", None) or "/").parent == path.parent
        and name != "__main__"
    }
    origins = {
        id(value): (name, attribute)
        for name, module in old.items()
        for attribute, value in vars(module).items()
        if getattr(value, "__module__", None) == name
    }

    # Import the modules again
    for name in old:
        del sys.modules[name]
    new = {name: importlib.import_module(name) for name in old}

    # Replace the old objects in the notebook's variables
    for variable, value in list(namespace.items()):
        if id(value) in origins:
            name, attribute = origins[id(value)]
            namespace[variable] = getattr(new[name], attribute, value)
        elif isinstance(value, ModuleType) and old.get(value.__name__) is value:
            namespace[variable] = new[value.__name__]


def _read_record(folder: Path) -> dict[str, str]:
    """Return the recorded hashes by file name; empty if the record is missing or damaged."""
    try:
        return dict(json.loads((folder / RECORD).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return {}


def _write_record(folder: Path, hashes: dict[str, str]) -> None:
    with replacing(folder / RECORD) as temporary:
        temporary.write_text(json.dumps(hashes, indent=1, sort_keys=True) + "\n")


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
