"""Notebooks of assignments, from one source for the stubs' form and the solved one.

In the source, a percent script, `# %% [solution] pulse.py` stands for a cell that starts with
`%%solution pulse.py` (see `student.cells`) and has that file's text. Below it comes one that runs
its tests, `%%test pulse.py`.
"""

import re
import subprocess
import tempfile
from pathlib import Path

from ..runtime.child_processes import safe_environment

NOTEBOOK = "notebook.ipynb"
TEST = "%%test {}\n# options of pytest, a line each, like: -k density"
"""Cell below a solution's."""
MARK = re.compile(r"\[solution\] (\S+)")


def write(source: str, files: Path, path: Path) -> None:
    """Write the notebook of a percent script; `files` has the content of solution cells."""
    import jupytext
    import nbformat
    from nbformat import v4

    cells = []
    for position, cell in enumerate(jupytext.reads(source, fmt="py:percent").cells):
        text = cell.source
        file = MARK.fullmatch(cell.metadata.get("title", ""))
        if file is not None:
            solution = files / file[1]
            if not solution.is_file():
                raise ValueError(f"notebook.py: [solution] {file[1]}: {solution} does not exist")
            text = f"%%solution {file[1]}\n{solution.read_text(encoding='utf-8').strip()}"
        make = v4.new_code_cell if cell.cell_type == "code" else v4.new_markdown_cell
        cells.append(make(text, id=f"cell-{position:02}"))
        if file is not None:
            cells.append(v4.new_code_cell(TEST.format(file[1]), id=f"test-{position:02}"))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    nbformat.write(v4.new_notebook(cells=cells, metadata={"kernelspec": kernel}), path)


def solution_files(source: str) -> list[str]:
    """Files that the solution cells of a percent script hold."""
    return re.findall(r"^# %% \[solution\] (\S+)[ \t]*$", source, re.MULTILINE)


def execute(path: Path, *, timeout_s: float = 600.0, **environment: str) -> None:
    """Run a notebook in its folder and keep the outputs; RuntimeError if a cell fails."""
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
            # Output of the kernel itself is dropped, that of its cells goes into the notebook
            client.execute(env=variables, stderr=subprocess.DEVNULL)
        except (CellExecutionError, TimeoutError, RuntimeError) as error:
            colour = re.compile(r"\x1b\[[\d;]*m")
            lines = [line for line in colour.sub("", str(error)).splitlines() if line.strip()]
            raise RuntimeError(f"{path.name}: " + "\n".join(lines[-12:])) from None
        finally:
            nbformat.write(notebook, path)
