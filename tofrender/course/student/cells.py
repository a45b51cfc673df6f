"""The notebook's cells that are files, `%%solution pulse.py`, and test them, `%%test pulse.py`.

Running the first writes the file, and what has been imported from it is imported anew. A file that
an editor has changed since is kept as a numbered backup. The second runs the public tests of its
problems.
"""

from __future__ import annotations

import hashlib
import importlib
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
"""File beside the notebook: what the cells last wrote, as a hash of each file."""

FILE_NAME = re.compile(r"[A-Za-z_]\w*\.py")


def load_ipython_extension(shell: Any) -> None:
    """Offer `%%solution FILE` and `%%test FILE`."""

    def solution(line: str, cell: str) -> None:
        """Write the cell to FILE, and import anew what was imported from it."""
        if not FILE_NAME.fullmatch(line.strip()):
            raise ValueError(f"%%solution {line}: must be followed by a file name like pulse.py")
        path = Path.cwd() / line.strip()
        print(save(path, cell))
        refresh(path, shell.user_ns)

    def test(line: str, cell: str = "") -> None:
        """Run the public tests of FILE, or of a problem; below it, options of pytest."""
        print(run_tests(Path.cwd(), line.strip(), cell))

    folder = Path.cwd()
    if not (folder / "rubric.toml").is_file():
        print(f"note: the cells' files go to {folder}, which has no rubric.toml")
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    shell.register_magic_function(solution, "cell")
    shell.register_magic_function(test, "line_cell")


def save(path: Path, cell: str) -> str:
    """Write a cell's text to its file; nothing that others wrote there is lost.

    A cell that has not changed since it was written leaves a file alone that has: an editor is as
    good a place to work in, and running the whole notebook must not bring the stubs back.

    Returns:
        What was done, for the student.
    """
    text = cell.rstrip() + "\n"
    written = _read_record(path.parent)
    said = f"wrote {path.name}"
    if path.is_file():
        there = path.read_bytes()
        if there == text.encode():
            said = f"{path.name} is as this cell has it"
        elif _hash(there) != written.get(path.name):
            if written.get(path.name) == _hash(text.encode()):
                return (
                    f"{path.name} stays as it is: it was changed outside of this cell, which has "
                    "nothing new. (Delete the file to write the cell's text again.)"
                )
            backup = _backup_name(path)
            backup.write_bytes(there)
            said = (
                f"wrote {path.name}. It had been changed outside of this cell: "
                f"what it held is now in {backup.name}"
            )
    with replacing(path) as temporary:
        temporary.write_bytes(text.encode())
    _write_record(path.parent, written | {path.name: _hash(text.encode())})
    return said


def run_tests(folder: Path, name: str, options: str = "") -> str:
    """Run the public tests of a file's problems, and say what came.

    Args:
        folder: A student's folder.
        name: A file like pulse.py, or a problem like a2.gaussian_pulse; "" for all.
        options: Options of pytest, a line each; lines that start with # are passed over.

    Raises:
        ValueError: There is no such file or problem; one line.
    """
    if not (folder / "tests").is_dir():
        return f"{folder} has no tests"
    assignment = rubrics.read(folder)
    those = [p for p in assignment.problems if name in ("", p.file, p.id, p.marker)]
    if not those:
        known = dict.fromkeys(p.file for p in assignment.problems if p.file)
        raise ValueError(f"%%test {name}: must be one of {', '.join(known)}, or a problem's id")
    words = [w for line in options.splitlines() if line[:1] != "#" for w in shlex.split(line)]
    marked = ["-m", " or ".join(problem.marker for problem in those)]
    outcomes = running.run(folder, submission=folder, more=[*marked, *words])
    lines = []
    for test, outcome in outcomes.items():
        lines.append(f"{outcome.outcome}  {test.partition('::')[2]}  {outcome.seconds:.1f} s")
        lines += [f"    {line}" for text in outcome.texts[:2] for line in text.splitlines()]
    return "\n".join(lines or ["no tests were chosen"])


def remember(folder: Path, names: list[str]) -> None:
    """Take a folder's files for those that the cells last wrote."""
    _write_record(folder, {name: _hash((folder / name).read_bytes()) for name in names})


def refresh(path: Path, namespace: dict[str, Any]) -> None:
    """Import anew the modules of a file's folder if the file's was imported.

    All of them, since they use each other. Names of `namespace` that came from them are bound to
    what the new ones have.

    Args:
        path: A file that was written.
        namespace: The variables of the notebook.
    """
    importlib.invalidate_caches()
    if path.stem not in sys.modules:
        return
    old = {
        name: module
        for name, module in sys.modules.items()
        if Path(getattr(module, "__file__", None) or "/").parent == path.parent
        and name != "__main__"
    }
    came_from = {
        id(value): (name, attribute)
        for name, module in old.items()
        for attribute, value in vars(module).items()
        if getattr(value, "__module__", None) == name
    }
    for name in old:
        del sys.modules[name]
    new = {name: importlib.import_module(name) for name in old}
    for variable, value in list(namespace.items()):
        if id(value) in came_from:
            name, attribute = came_from[id(value)]
            namespace[variable] = getattr(new[name], attribute, value)
        elif isinstance(value, ModuleType) and old.get(value.__name__) is value:
            namespace[variable] = new[value.__name__]


def _backup_name(path: Path) -> Path:
    """The first free of pulse.py.1, pulse.py.2 ...; no pattern for Python files takes them."""
    number = 1
    while (backup := path.with_name(f"{path.name}.{number}")).exists():
        number += 1
    return backup


def _read_record(folder: Path) -> dict[str, str]:
    try:
        content = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _write_record(folder: Path, hashes: dict[str, str]) -> None:
    with replacing(folder / RECORD) as temporary:
        temporary.write_text(json.dumps(hashes, indent=1, sort_keys=True) + "\n")


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
