"""Process that runs a submission: it loads the student's files and answers questions.

    python -m tofrender.course.judge.worker CONFIGURATION.json

A question consists of the name of a probe and its arguments. A probe is a function in the
assignment's `tests/probes.py` that gets the student's objects and returns data. The worker reads
the numbers of the questions from standard input. Questions and answers are files (see `wire`).
"""

import importlib
import importlib.util
import inspect
import json
import os
import re
import sys
import traceback
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any

from .. import rubric as rubrics
from . import forbidden, sandbox, wire

MAX_TEXT = 4000  # longest text of a reason that is sent [characters]
MAX_READ = 100_000  # part of an exception's text that is searched for a traceback [characters]


class Refused(Exception):
    """The student did not write a name, or wrote it in the wrong file; the text is one line."""


class SubmittedNames:
    """Attributes are the names that a submission defines. Files are loaded on first use.

    Without a folder, the names come from the package itself.
    """

    def __init__(self, rubric: rubrics.Rubric, folder: Path | None) -> None:
        self._rubric = rubric
        self._folder = folder
        self.used: set[str] = set()  # names that were looked up since the last question

    def __getattr__(self, name: str) -> Any:
        # Which problem asks for this name?
        problem = self._rubric.problem_by_name.get(name)
        if problem is None:
            raise AttributeError(f"theirs.{name}: no problem of the rubric has this name")
        self.used.add(name)
        if self._folder is None:
            return getattr(importlib.import_module(problem.reference), name)

        # Load the student's file
        module = self._load(problem)
        if not hasattr(module, name):
            raise Refused(f"{problem.file} does not define {name}")
        value = getattr(module, name)

        # A class or function must be written in the submission, not imported from elsewhere
        if inspect.isclass(value) or inspect.isfunction(value):
            home = value.__module__
            file = getattr(sys.modules.get(home), "__file__", None) or home
            if Path(file).parent != self._folder:
                raise Refused(f"{name} is defined in {home}; must be written in {problem.file}")
        return value

    def _load(self, problem: rubrics.Problem) -> ModuleType:
        """Load the module of a problem's file, or return it if another file imported it."""
        assert self._folder is not None
        path = self._folder / problem.file
        if not path.is_file():
            raise Refused(f"{problem.file} is missing (problem {problem.id})")
        loaded = sys.modules.get(path.stem)
        if loaded is not None and getattr(loaded, "__file__", None) == str(path):
            return loaded
        return load_file(path)


def load_file(path: Path) -> ModuleType:
    """Import a file from any folder as a module with the file's name."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    loader = spec and spec.loader
    if spec is None or loader is None:
        raise ImportError(f"{path.name} is not a file of Python code")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    try:
        loader.exec_module(module)
    except BaseException:
        sys.modules.pop(path.stem, None)
        raise
    return module


def main(configuration: str) -> None:
    """Answer questions until standard input ends.

    Each line of standard input is the number of a question. The question is read from NUMBER.npz in
    the folder of questions. The answer, or the error, is written to NUMBER.npz in the folder of
    answers. Answer 0 reports that the worker is ready.

    Args:
        configuration: Path of the JSON file that `client.Worker` wrote.
    """
    settings = json.loads(Path(configuration).read_text(encoding="utf-8"))
    questions = Path(settings["questions"])
    answers = Path(settings["answers"])

    # Keep standard input for the worker; the submission reads an empty file
    numbers = os.fdopen(os.dup(0))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)

    import drjit as dr

    from ...runtime import backend, plugins

    # Start Mitsuba, without the native integrators if they are forbidden
    rubric = rubrics.read(settings["rubric"])
    folder = Path(settings["submission"]) if settings["submission"] else None
    words = {*rubric.forbids, *settings["forbids"]} if folder else set()
    if "integrators" in words:
        plugins.leave_out(forbidden.NATIVE_INTEGRATORS)
    backend.activate("llvm_ad_rgb" if settings["variant"] is None else settings["variant"])

    # Load the probes, then remove everything that the submission may not use
    probes = _load_apart(Path(settings["probes"]))
    names = SubmittedNames(rubric, folder)
    if folder:
        sys.path.insert(0, str(folder))
        forbidden.remove(words)
        if settings.get("readable"):
            sandbox.hide([*settings["readable"], "/proc/self"])

    # Report that the worker is ready, then answer questions
    wire.write(answers / "0.npz", {"ready": True})
    for number in map(int, numbers):
        probe, arguments = wire.read(questions / f"{number}.npz")
        try:
            names.used.clear()
            answer = getattr(probes, probe)(names, **arguments)
            dr.eval(answer)  # one launch computes all arrays
            reply = {"answer": answer, "uses": sorted(names.used)}
            wire.write(answers / f"{number}.npz", reply, _to_numpy)
        except BaseException as error:  # also if the submission raises SystemExit
            wire.write(answers / f"{number}.npz", {"error": _explained(error, folder)})


def _load_apart(path: Path) -> ModuleType:
    """Import a file and its neighbors so that the submission may use the same module names."""
    sys.path.insert(0, str(path.parent))
    before = set(sys.modules)
    try:
        return load_file(path)
    finally:
        sys.path.remove(str(path.parent))
        for name in set(sys.modules) - before:
            file = getattr(sys.modules[name], "__file__", None)
            if file and Path(file).is_relative_to(path.parent):
                del sys.modules[name]


def _explained(error: BaseException, folder: Path | None) -> str:
    """Return the text of `explain`, even if reading the submission's exception raises an error."""
    try:
        return explain(error, folder)[:MAX_TEXT]
    except BaseException as other:
        return f"{type(error).__name__}, whose text cannot be read ({type(other).__name__})"


def explain(error: BaseException, folder: Path | None) -> str:
    """Return the reason of a failure as text for the student.

    Args:
        error: Exception that the submission raised.
        folder: Folder of the submission. The text quotes lines of its files only. Without a
            folder, the text quotes lines of all files.
    """
    # Find the first cause, because Dr.Jit wraps errors that are raised in a loop
    chain = [error]
    while (cause := chain[0].__cause__) is not None and len(chain) < 20:
        chain.insert(0, cause)
    error = chain[0]
    frames = [list(traceback.extract_tb(each.__traceback__))[-1000:] for each in chain]

    # Errors that are explained without a traceback
    if isinstance(error, Refused):
        return str(error)
    if isinstance(error, NotImplementedError):
        return f"not written yet: {error}" if str(error) else "not written yet"
    if isinstance(error, SystemExit):
        return f"the submission called sys.exit({error.code!r})"

    # Mitsuba raises a RuntimeError whose text contains the traceback of a plugin's exception
    text = str(error)[-MAX_READ:]
    inner = _RAISED_INSIDE.search(text.rpartition("Traceback (most recent call last):")[2])
    if isinstance(error, RuntimeError) and inner:
        if inner["kind"] == "NotImplementedError":
            return f"not written yet: {inner['text']}"
        lines = re.findall(r'  File "(.+)", line (\d+)', inner["frames"])
        frames.insert(0, [traceback.FrameSummary(name, int(line), "") for name, line in lines])
        return _with_lines(f"{inner['kind']}: {inner['text']}", frames, folder)

    # Other errors
    head = f"{type(error).__name__}: {str(error)[:MAX_TEXT]}"
    if isinstance(error, SyntaxError):
        head = f"{type(error).__name__} in line {error.lineno}: {error.msg}"
    return _with_lines(head, frames, folder)


_RAISED_INSIDE = re.compile(
    r"^\n(?P<frames>(?:  .*\n)+)(?P<kind>[A-Za-z_][\w.]*): ?(?P<text>[\s\S]*)"
)


def _with_lines(
    head: str, tracebacks: Iterable[Iterable[traceback.FrameSummary]], folder: Path | None
) -> str:
    """Append the student's lines to a message.

    The lines come from the first traceback that contains files of the submission.
    """
    for frames in tracebacks:
        lines = [
            f"  {Path(frame.filename).name}, line {frame.lineno}: {(frame.line or '')[:200]}"
            for frame in frames
            if folder is None or Path(frame.filename).is_relative_to(folder)
        ]
        if lines:
            return "\n".join([head, *lines[-8:]])
    return head


def _to_numpy(part: Any) -> Any:
    """Convert bitmaps and Dr.Jit arrays to NumPy arrays, and return other values unchanged."""
    import drjit as dr
    import mitsuba as mi
    import numpy as np

    if isinstance(part, mi.Bitmap):
        return np.array(part)
    return np.array(part.numpy()) if dr.is_array_v(part) else part


if __name__ == "__main__":
    main(sys.argv[1])
