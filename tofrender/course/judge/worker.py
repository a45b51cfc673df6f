"""Process that runs a submission: it loads the student's files and answers questions.

    python -m tofrender.course.judge.worker CONFIGURATION.json

A question is the name of a probe and its arguments; the probe is a function of the assignment's
`tests/probes.py` that gets the student's objects and returns data. Questions come as numbers on
standard input, their content and the answers as files (see `wire`).
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

MAX_TEXT = 4000  # characters of a reason that are sent
MAX_READ = 100_000  # characters of an exception's text that are searched for the traceback inside


class Refused(Exception):
    """A name was not written by the student, or not as allowed; one line."""


class SubmittedNames:
    """Names that a submission, or without a folder the package, defines; loaded on first use."""

    def __init__(self, rubric: rubrics.Rubric, folder: Path | None) -> None:
        self._rubric, self._folder = rubric, folder
        self.used: set[str] = set()

    def __getattr__(self, name: str) -> Any:
        problem = self._rubric.problem_by_name.get(name)
        if problem is None:
            raise AttributeError(f"theirs.{name}: no problem of the rubric has this name")
        self.used.add(name)
        if self._folder is None:
            return getattr(importlib.import_module(problem.reference), name)
        module = self._load(problem)
        if not hasattr(module, name):
            raise Refused(f"{problem.file} defines no {name}")
        value = getattr(module, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            home = value.__module__
            file = getattr(sys.modules.get(home), "__file__", None) or home
            if Path(file).parent != self._folder:
                raise Refused(f"{name} is defined in {home}; must be written in {problem.file}")
        return value

    def _load(self, problem: rubrics.Problem) -> ModuleType:
        """Module of a problem's file, which other files of the submission share."""
        assert self._folder is not None
        path = self._folder / problem.file
        if not path.is_file():
            raise Refused(f"{problem.file} is missing (problem {problem.id})")
        loaded = sys.modules.get(path.stem)
        if loaded is not None and getattr(loaded, "__file__", None) == str(path):
            return loaded
        return load_file(path)


def load_file(path: Path) -> ModuleType:
    """Import a file under its own name, from any folder."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    loader = spec and spec.loader
    if spec is None or loader is None:
        raise ImportError(f"{path.name}: is not a file of Python code")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    try:
        loader.exec_module(module)
    except BaseException:
        sys.modules.pop(path.stem, None)
        raise
    return module


def main(configuration: str) -> None:
    """Answer questions until standard input ends."""
    settings = json.loads(Path(configuration).read_text(encoding="utf-8"))
    questions, answers = Path(settings["questions"]), Path(settings["answers"])
    numbers = os.fdopen(os.dup(0))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)

    import drjit as dr

    from ...runtime import backend, plugins

    rubric = rubrics.read(settings["rubric"])
    folder = Path(settings["submission"]) if settings["submission"] else None
    words = {*rubric.forbids, *settings["forbids"]} if folder else set()
    if "integrators" in words:
        plugins.leave_out(forbidden.NATIVE_INTEGRATORS)
    backend.activate("llvm_ad_rgb" if settings["variant"] is None else settings["variant"])
    probes = _load_apart(Path(settings["probes"]))
    names = SubmittedNames(rubric, folder)
    if folder:
        sys.path.insert(0, str(folder))
        forbidden.remove(words)
        if settings.get("readable"):
            sandbox.hide([*settings["readable"], "/proc/self"])
    wire.write(answers / "0.npz", {"ready": True})
    for number in map(int, numbers):
        probe, arguments = wire.read(questions / f"{number}.npz")
        try:
            names.used.clear()
            answer = getattr(probes, probe)(names, **arguments)
            dr.eval(answer)  # all arrays together
            reply = {"answer": answer, "uses": sorted(names.used)}
            wire.write(answers / f"{number}.npz", reply, _to_numpy)
        except BaseException as error:  # SystemExit and KeyboardInterrupt of the submission too
            wire.write(answers / f"{number}.npz", {"error": _explained(error, folder)})


def _load_apart(path: Path) -> ModuleType:
    """Import a file that may import its neighbours, whose names a submission's files may share."""
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
    """Result of `explain`, even if the submission's exception raises when it is read."""
    try:
        return explain(error, folder)[:MAX_TEXT]
    except BaseException as other:
        return f"{type(error).__name__}, whose text cannot be read ({type(other).__name__})"


def explain(error: BaseException, folder: Path | None) -> str:
    """Reason of a failure, with the student's own lines of the first traceback that has some."""
    chain = [error]  # Dr.Jit wraps errors raised in a loop
    while (cause := chain[0].__cause__) is not None and len(chain) < 20:
        chain.insert(0, cause)
    error = chain[0]
    frames = [list(traceback.extract_tb(each.__traceback__))[-1000:] for each in chain]
    if isinstance(error, Refused):
        return str(error)
    if isinstance(error, NotImplementedError):
        return f"not written yet: {error}" if str(error) else "not written yet"
    if isinstance(error, SystemExit):
        return f"the submission called sys.exit({error.code!r})"
    text = str(error)[-MAX_READ:]
    inner = _RAISED_INSIDE.search(text.rpartition("Traceback (most recent call last):")[2])
    if isinstance(error, RuntimeError) and inner:  # Mitsuba's, for what a plugin raises
        if inner["kind"] == "NotImplementedError":
            return f"not written yet: {inner['text']}"
        lines = re.findall(r'  File "(.+)", line (\d+)', inner["frames"])
        frames.insert(0, [traceback.FrameSummary(name, int(line), "") for name, line in lines])
        return _with_lines(f"{inner['kind']}: {inner['text']}", frames, folder)
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
    """Message, and below it the student's lines of the first traceback that has some."""
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
    import drjit as dr
    import mitsuba as mi
    import numpy as np

    if isinstance(part, mi.Bitmap):
        return np.array(part)
    return np.array(part.numpy()) if dr.is_array_v(part) else part


if __name__ == "__main__":
    main(sys.argv[1])
