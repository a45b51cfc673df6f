"""The notebook of an assignment: one source for the stubs' form and the solved one.

In the source, a percent script, `# %% [solution] pulse.py` stands for a cell that starts with
`%%solution pulse.py` (see `student.cells`) and has that file's text. Below it comes one that runs
its tests, `%%test pulse.py`.
"""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nbformat import NotebookNode

NOTEBOOK = "notebook.ipynb"
TEST = "%%test {}\n# options of pytest, a line each, like: -k density"
"""The cell below a solution's."""
MARK = re.compile(r"\[solution\] (\S+)")


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
        if file is not None:
            cells.append(v4.new_code_cell(TEST.format(file[1]), id=f"test-{position:02}"))
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
            # the kernel's own words go nowhere, those of its cells into the notebook
            client.execute(env=variables, stderr=subprocess.DEVNULL)
        except (CellExecutionError, TimeoutError, RuntimeError) as error:
            colour = re.compile(r"\x1b\[[\d;]*m")
            lines = [line for line in colour.sub("", str(error)).splitlines() if line.strip()]
            raise RuntimeError(f"{path.name}: " + "\n".join(lines[-12:])) from None
        finally:
            nbformat.write(notebook, path)
