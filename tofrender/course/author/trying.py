"""Tries solutions that are wrong on purpose, and runs the notebook of right ones."""

from __future__ import annotations

import shutil
from pathlib import Path

from .. import notebooks
from ..assignments import Assignment
from ..judge import running
from ..mutants import Mutant, affected, apply
from ..notebooks import NOTEBOOK


def judge(
    assignment: Assignment, mutant: Mutant, right: Path, folder: Path, edition: Path
) -> list[str]:
    """Run the tests on a mutant.

    Args:
        assignment: The whole assignment.
        mutant: The mutant.
        right: Folder of right solutions and what their notebook has written.
        folder: A new folder for the wrong ones.
        edition: The student edition.

    Returns:
        What is not as `mutants.toml` says, a line each.
    """
    shutil.copytree(right, folder)
    (folder / mutant.file).write_text(apply(assignment, mutant), encoding="utf-8")
    home = next((p for p in assignment.rubric.problems if p.id == mutant.problem), None)
    if home is not None and not home.file:  # its mistake is in what the notebook writes
        try:
            solve_notebook(assignment, folder, edition)
        except (RuntimeError, ValueError) as error:
            return [f"{mutant.id}: {error}"]
    tests = affected(assignment.rubric, mutant)
    try:
        outcomes = running.run(assignment.folder, tests=tests, submission=folder, edition=edition)
    except RuntimeError as error:
        return [f"{mutant.id}: {error}"]
    failed = {name for name, outcome in outcomes.items() if outcome.outcome != "passed"}
    failed |= set(tests) - outcomes.keys()
    reasons = [
        f"{mutant.id}: {name} passes, must fail ({mutant.why})"
        for name in sorted(set(mutant.fails) - failed)
    ]
    for name in sorted(failed - set(mutant.fails)):
        text = outcomes[name].texts if name in outcomes else ()
        reasons.append(f"{mutant.id}: {name} fails, must pass: {one_line(' '.join(text))}")
    texts = [text for name in failed if name in outcomes for text in outcomes[name].texts]
    if mutant.says not in "\n".join(texts):
        said = one_line(" ".join(texts)) or "nothing"
        reasons.append(f"{mutant.id}: no failure says {mutant.says!r}; they say {said}")
    return reasons


def solve_notebook(assignment: Assignment, folder: Path, package: Path) -> None:
    """Run the notebook in a folder of solutions, which gets what it writes.

    Args:
        assignment: The whole assignment.
        folder: Holds the solutions; its own `notebook.py`, if it has one, is what runs.
        package: Folder of the package that the notebook imports.

    Raises:
        RuntimeError: A cell failed.
    """
    own = folder / "notebook.py"
    path = own if own.is_file() else assignment.folder / "notebook.py"
    if path.is_file():
        notebooks.write(path.read_text(encoding="utf-8"), folder, folder / NOTEBOOK)
        notebooks.execute(folder / NOTEBOOK, PYTHONPATH=str(package))


def one_line(text: str, length: int = 300) -> str:
    """Text on one line, cut if it is longer."""
    line = " ".join(text.split())
    return line if len(line) <= length else f"{line[:length]} ..."
