"""The notebook of an assignment: one source for the stubs' form and the solved one.

    %load_ext tofrender.course.notebooks

A cell that starts with `%%solution pulse.py` is that file: running the cell writes it, and what
has been imported from it is imported anew. A file that an editor has changed since is kept as a
numbered backup. In the source, a percent script, `# %% [solution] pulse.py` stands for the cell.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nbformat import NotebookNode

RECORD = ".tofrender-cells.json"
"""File beside the notebook: what the cells last wrote, as a hash of each file."""

MARK = re.compile(r"\[solution\] (\S+)")
FILE_NAME = re.compile(r"[A-Za-z_]\w*\.py")


# ----------------------------------------------------------------------------- from the source


def build(source: str, files: Path) -> NotebookNode:
    """The notebook of a percent script.

    Args:
        source: The script's text.
        files: Folder with the content of the solution cells: stubs, or solutions.

    Returns:
        A notebook without outputs.

    Raises:
        ValueError: A solution cell's file does not exist.
    """
    import jupytext
    from nbformat import v4

    cells = []
    for position, cell in enumerate(jupytext.reads(source, fmt="py:percent").cells):
        text = cell.source
        file = MARK.fullmatch(cell.metadata.get("title", ""))
        if file is not None:
            path = files / file[1]
            if not path.is_file():
                raise ValueError(f"notebook.py: [solution] {file[1]}: {path} does not exist")
            text = f"%%solution {file[1]}\n{path.read_text(encoding='utf-8').strip()}"
        make = v4.new_code_cell if cell.cell_type == "code" else v4.new_markdown_cell
        cells.append(make(text, id=f"cell-{position:02}"))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})


def solution_files(source: str) -> list[str]:
    """The files that the solution cells of a percent script hold."""
    return re.findall(r"^# %% \[solution\] (\S+)[ \t]*$", source, re.MULTILINE)


def write(source: str, files: Path, path: Path) -> None:
    """Write the notebook of a percent script; arguments as for `build`."""
    import nbformat

    nbformat.write(build(source, files), path)


def execute(path: Path, *, timeout_s: float = 600.0, **environment: str) -> None:
    """Run a notebook from start to end in its folder, and keep the outputs in it.

    Args:
        path: The notebook.
        timeout_s: Longest time of a cell [s].
        environment: Variables for its process.

    Raises:
        RuntimeError: A cell failed; the last lines of its error.
    """
    import tempfile

    import nbclient
    import nbformat
    from nbclient.exceptions import CellExecutionError

    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as scratch:
        folders = dict.fromkeys(("IPYTHONDIR", "JUPYTER_RUNTIME_DIR"), scratch)
        variables = os.environ | folders | environment
        client = nbclient.NotebookClient(
            notebook, timeout=timeout_s, resources={"metadata": {"path": str(path.parent)}}
        )
        try:
            client.execute(
                env=variables, stderr=subprocess.DEVNULL
            )  # what the kernel says, not its cells
        except (CellExecutionError, TimeoutError, RuntimeError) as error:
            colour = re.compile(r"\x1b\[[\d;]*m")
            lines = [line for line in colour.sub("", str(error)).splitlines() if line.strip()]
            raise RuntimeError(f"{path.name}: " + "\n".join(lines[-12:])) from None
        finally:
            nbformat.write(notebook, path)


# --------------------------------------------------------------------------------- in a kernel


def load_ipython_extension(shell: Any) -> None:
    """Offer `%%solution FILE`."""

    def solution(line: str, cell: str) -> None:
        """Write the cell to FILE, and import anew what was imported from it."""
        if not FILE_NAME.fullmatch(line.strip()):
            raise ValueError(f"%%solution {line}: must be followed by a file name like pulse.py")
        path = Path.cwd() / line.strip()
        print(save(path, cell))
        refresh(path, shell.user_ns)

    folder = Path.cwd()
    if not (folder / "rubric.toml").is_file():
        print(f"note: the cells' files go to {folder}, which has no rubric.toml")
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    shell.register_magic_function(solution, "cell")


def save(path: Path, cell: str) -> str:
    """Write a cell's text to its file; nothing that others wrote there is lost.

    A cell that has not changed since it was written leaves a file alone that has: an editor is as
    good a place to work in, and running the whole notebook must not bring the stubs back.

    Returns:
        What was done, for the student.
    """
    text = cell.rstrip() + "\n"
    record = path.with_name(RECORD)
    written = _read_record(record)
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
    _replace(path, text)
    written[path.name] = _hash(text.encode())
    _replace(record, json.dumps(written, indent=1, sort_keys=True) + "\n")
    return said


def remember(folder: Path, names: list[str]) -> None:
    """Take a folder's files for those that the cells last wrote."""
    hashes = {name: _hash((folder / name).read_bytes()) for name in sorted(names)}
    _replace(folder / RECORD, json.dumps(hashes, indent=1) + "\n")


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
        if _folder_of(module) == path.parent and name != "__main__"
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


def _folder_of(module: Any) -> Path | None:
    file = getattr(module, "__file__", None)
    return Path(file).parent if file else None


def _backup_name(path: Path) -> Path:
    """The first free of pulse.py.1, pulse.py.2 ...; no pattern for Python files takes them."""
    number = 1
    while (backup := path.with_name(f"{path.name}.{number}")).exists():
        number += 1
    return backup


def _read_record(path: Path) -> dict[str, str]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _replace(path: Path, text: str) -> None:
    temporary = path.with_name(f"{path.name}.part")
    temporary.write_text(text, encoding="utf-8", newline="\n")
    os.replace(temporary, path)
