"""Notebooks of assignments: one source for the notebook with stubs and the solved one.

The source is a percent script. Its line `# %% [solution] pulse.py` becomes a cell that starts with
`%%solution pulse.py` (see `student.cells`) and contains the text of that file. Below this cell, a
second cell `%%test pulse.py` runs the tests of the file.
"""

import re
import subprocess
import tempfile
from pathlib import Path

from ..runtime.child_processes import safe_environment

NOTEBOOK = "notebook.ipynb"
TEST = "%%test {}\n# options of pytest, one per line, for example: -k density"
"""Text of the cell below a solution cell."""
MARK = re.compile(r"\[solution\] (\S+)")


def write(source: str, files: Path, path: Path) -> None:
    """Write a notebook.

    Args:
        source: Text of the percent script.
        files: Folder of the files. Their text is copied into the solution cells.
        path: Path of the notebook.

    Raises:
        ValueError: A file of a solution cell does not exist.
    """
    import jupytext
    import nbformat
    from nbformat import v4

    cells = []
    for position, cell in enumerate(jupytext.reads(source, fmt="py:percent").cells):
        # Insert the text of a solution's file
        text = cell.source
        file = MARK.fullmatch(cell.metadata.get("title", ""))
        if file is not None:
            solution = files / file[1]
            if not solution.is_file():
                raise ValueError(f"notebook.py: [solution] {file[1]}: {solution} does not exist")
            text = f"%%solution {file[1]}\n{solution.read_text(encoding='utf-8').strip()}"

        # Ids by position make equal sources give equal notebooks
        make = v4.new_code_cell if cell.cell_type == "code" else v4.new_markdown_cell
        cells.append(make(text, id=f"cell-{position:02}"))
        if file is not None:
            cells.append(v4.new_code_cell(TEST.format(file[1]), id=f"test-{position:02}"))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    nbformat.write(v4.new_notebook(cells=cells, metadata={"kernelspec": kernel}), path)


def solution_files(source: str) -> list[str]:
    """Return the names of the files in the solution cells of a percent script."""
    return re.findall(r"^# %% \[solution\] (\S+)[ \t]*$", source, re.MULTILINE)


def execute(path: Path, *, timeout_s: float = 600.0, **environment: str) -> None:
    """Run a notebook in its folder, and save it with the outputs of its cells.

    Args:
        path: Path of the notebook.
        timeout_s: Longest time of one cell [s].
        **environment: Additional environment variables of the kernel.

    Raises:
        RuntimeError: A cell failed. The message contains the last lines of its traceback.
    """
    import nbclient
    import nbformat
    from nbclient.exceptions import CellExecutionError

    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as scratch:
        folders = dict.fromkeys(("IPYTHONDIR", "JUPYTER_RUNTIME_DIR"), scratch)
        variables = safe_environment(**folders, **environment)
        client = nbclient.NotebookClient(
            notebook, timeout=timeout_s, resources={"metadata": {"path": str(path.parent)}}
        )
        try:
            # The output of the cells goes into the notebook; the kernel's own output is dropped
            client.execute(env=variables, stderr=subprocess.DEVNULL)
        except (CellExecutionError, TimeoutError, RuntimeError) as error:
            color = re.compile(r"\x1b\[[\d;]*m")
            lines = [line for line in color.sub("", str(error)).splitlines() if line.strip()]
            raise RuntimeError(f"{path.name}: " + "\n".join(lines[-12:])) from None
        finally:
            nbformat.write(notebook, path)
