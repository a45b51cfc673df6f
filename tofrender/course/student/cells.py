"""Notebook cells that are files, `%%solution pulse.py`, and test them, `%%test pulse.py`.

Running the first writes the file, and reloads the modules imported from it. A file that an editor
has changed since is kept as a numbered backup. The second runs the public tests of its problems.
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
"""File beside the notebook: hashes of the files as cells last wrote them."""

FILE_NAME = re.compile(r"[A-Za-z_]\w*\.py")


def load_ipython_extension(shell: Any) -> None:
    """Offer `%%solution FILE` and `%%test FILE`."""

    def solution(line: str, cell: str) -> None:
        """Write the cell to FILE, and reload the modules imported from it."""
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
    """Write a cell's text to its file and return a message; nothing that others wrote is lost.

    A cell that has not changed since it was written leaves a file alone that has: an editor is as
    good a place to work in, and running the whole notebook must not bring the stubs back.
    """
    name, new = path.name, (cell.rstrip() + "\n").encode()
    written = _read_record(path.parent)
    message = f"wrote {name}"
    if path.is_file():
        old = path.read_bytes()
        if old == new:
            message = f"{name} is as this cell has it"
        elif _hash(old) != written.get(name):
            if written.get(name) == _hash(new):
                return (
                    f"{name} stays as it is: it was changed outside of this cell, which has "
                    "nothing new. (Delete the file to write the cell's text again.)"
                )
            numbered = (path.with_name(f"{name}.{number}") for number in itertools.count(1))
            backup = next(each for each in numbered if not each.exists())
            backup.write_bytes(old)
            message += ". It had been changed outside of this cell: "
            message += f"what it held is now in {backup.name}"
    with replacing(path) as temporary:
        temporary.write_bytes(new)
    _write_record(path.parent, written | {name: _hash(new)})
    return message


def run_tests(folder: Path, name: str, options: str = "") -> str:
    """Run the public tests of a file's problems, and return their outcomes as text.

    `name` is a file like pulse.py, or a problem like a2.gaussian_pulse; "" stands for all.
    `options` are those of pytest, a line each; lines that start with # are passed over.
    """
    if not (folder / "tests").is_dir():
        return f"{folder} has no tests"
    rubric = rubrics.read(folder)
    markers = [p.marker for p in rubric.problems if name in ("", p.file, p.id, p.marker)]
    if not markers:
        known = dict.fromkeys(p.file for p in rubric.problems if p.file)
        raise ValueError(f"%%test {name}: must be one of {', '.join(known)}, or a problem's id")
    words = [w for line in options.splitlines() if line[:1] != "#" for w in shlex.split(line)]
    outcomes = running.run(folder, submission=folder, more=["-m", " or ".join(markers), *words])
    lines = []
    for test, outcome in outcomes.items():
        lines.append(f"{outcome.outcome}  {rubrics.name_of(test)}  {outcome.seconds:.1f} s")
        lines += [f"    {line}" for text in outcome.texts[:2] for line in text.splitlines()]
    return "\n".join(lines or ["no tests were chosen"])


def remember(folder: Path, names: list[str]) -> None:
    """Record a folder's files as last written by the cells."""
    _write_record(folder, {name: _hash((folder / name).read_bytes()) for name in names})


def refresh(path: Path, namespace: dict[str, Any]) -> None:
    """Reload all modules of a file's folder if the file's was imported, since they use each other.

    Names of `namespace`, the notebook's variables, that came from them are bound to the new ones.
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


def _read_record(folder: Path) -> dict[str, str]:
    try:
        return dict(json.loads((folder / RECORD).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return {}


def _write_record(folder: Path, hashes: dict[str, str]) -> None:
    with replacing(folder / RECORD) as temporary:
        temporary.write_text(json.dumps(hashes, indent=1, sort_keys=True) + "\n")


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
