"""The process that runs a submission: it loads the student's files and answers questions.

    python -m tofrender.course.judge.worker CONFIGURATION.json

A question is the name of a probe and its arguments; the probe is a function of the assignment's
`tests/probes.py` that gets the student's objects and returns data. Questions come as numbers on
standard input, their content and the answers as files (see `wire`). Nothing that the submission
does here can change what the judge thinks of another answer.
"""

from __future__ import annotations

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
from . import forbidden, wire

MAX_TEXT = 4000
"""Characters of a reason that are sent."""
MAX_READ = 100_000
"""Characters of an exception's text in which the traceback inside is looked for."""


class NotTheirs(Exception):
    """A name is not what the student has to write; one line."""


class Theirs:
    """The names that a submission defines, each loaded from its problem's file when asked for.

    The reference's names are the package's own.
    """

    def __init__(self, rubric: rubrics.Rubric, folder: Path | None) -> None:
        self._rubric, self._folder = rubric, folder
        self.asked_for: set[str] = set()

    def __getattr__(self, name: str) -> Any:
        problem = self._rubric.home_of.get(name)
        if problem is None:
            raise AttributeError(f"theirs.{name}: no problem of the rubric has this name")
        self.asked_for.add(name)
        if self._folder is None:
            return getattr(importlib.import_module(problem.reference), name)
        module = self._load(problem)
        if not hasattr(module, name):
            raise NotTheirs(f"{problem.file} defines no {name}")
        value = getattr(module, name)
        self._check_origin(name, value, problem)
        return value

    def _load(self, problem: rubrics.Problem) -> ModuleType:
        """The module of a problem's file, which other files of the submission share."""
        assert self._folder is not None
        path = self._folder / problem.file
        if not path.is_file():
            raise NotTheirs(f"{problem.file} is missing (problem {problem.id})")
        used = forbidden.find(path, frozenset(self._rubric.forbids + problem.forbids))
        if used:
            raise NotTheirs(f"{used} is not allowed in this problem: write it yourself")
        known = sys.modules.get(path.stem)
        if known is not None and getattr(known, "__file__", None) == str(path):
            return known
        return load_file(path)

    def _check_origin(self, name: str, value: Any, problem: rubrics.Problem) -> None:
        """Refuse a class or function that was written elsewhere."""
        if not (inspect.isclass(value) or inspect.isfunction(value)):
            return
        home = getattr(sys.modules.get(value.__module__), "__file__", None) or value.__module__
        if Path(home).parent != self._folder:
            raise NotTheirs(
                f"{name} is defined in {value.__module__}; must be written in {problem.file}"
            )


def load_file(path: Path) -> ModuleType:
    """Import a file under its own name, from wherever it lies."""
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

    from ...runtime import backend

    backend.activate("llvm_ad_rgb" if settings["variant"] is None else settings["variant"])
    rubric = rubrics.read(settings["rubric"])
    folder = settings["submission"] and Path(settings["submission"])
    probes = _load_apart(Path(settings["probes"]))
    if folder:
        sys.path.insert(0, str(folder))
        if "warps" in rubric.forbids:
            forbidden.guard(folder)
    theirs = Theirs(rubric, folder or None)
    wire.write(answers / "0.npz", {"ready": True})
    for number in map(int, numbers):
        name, arguments = wire.read(questions / f"{number}.npz")
        try:
            theirs.asked_for.clear()
            answer = _plain(getattr(probes, name)(theirs, **arguments))
            reply = {"answer": answer, "uses": sorted(theirs.asked_for)}
            wire.write(answers / f"{number}.npz", reply)
        except BaseException as error:  # SystemExit and KeyboardInterrupt of the submission too
            wire.write(answers / f"{number}.npz", {"error": _explained(error, folder or None)})


def _load_apart(path: Path) -> ModuleType:
    """Import a file that may import its neighbours, and forget their names.

    So the files of a submission may have the same ones.
    """
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
    """What `explain` says, whatever the submission's exception does when it is looked at."""
    try:
        return explain(error, folder)[:MAX_TEXT]
    except BaseException as other:
        return f"{type(error).__name__}, whose text cannot be read ({type(other).__name__})"


def explain(error: BaseException, folder: Path | None) -> str:
    """What went wrong in the submission, with the student's own lines of the traceback.

    They are those of the first cause, or of what it became if that has none.
    """
    chain = _causes(error)
    error = chain[-1]
    if isinstance(error, NotTheirs):
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
        places = re.findall(r'  File "(.+)", line (\d+)', inner["frames"])
        frames = [traceback.FrameSummary(name, int(line), "") for name, line in places]
        tracebacks = [frames, *map(_frames, reversed(chain))]
        return _with_lines(f"{inner['kind']}: {inner['text']}", tracebacks, folder)
    head = f"{type(error).__name__}: {str(error)[:MAX_TEXT]}"
    if isinstance(error, SyntaxError):
        head = f"{type(error).__name__} in line {error.lineno}: {error.msg}"
    return _with_lines(head, map(_frames, reversed(chain)), folder)


def _causes(error: BaseException) -> list[BaseException]:
    """The error and what caused it, the first cause last. Dr.Jit wraps what a loop raises."""
    chain = [error]
    while (cause := chain[-1].__cause__) is not None and len(chain) < 20:
        chain.append(cause)
    return chain


def _frames(error: BaseException) -> list[traceback.FrameSummary]:
    """The end of a traceback, from which it was raised."""
    return list(traceback.extract_tb(error.__traceback__))[-1000:]


_RAISED_INSIDE = re.compile(
    r"^\n(?P<frames>(?:  .*\n)+)(?P<kind>[A-Za-z_][\w.]*): ?(?P<text>[\s\S]*)"
)


def _with_lines(
    head: str, tracebacks: Iterable[Iterable[traceback.FrameSummary]], folder: Path | None
) -> str:
    """A message, and below it the student's lines of the first traceback that has some."""
    for frames in tracebacks:
        lines = [
            f"  {Path(frame.filename).name}, line {frame.lineno}: {(frame.line or '')[:200]}"
            for frame in frames
            if folder is None or Path(frame.filename).is_relative_to(folder)
        ]
        if lines:
            return "\n".join([head, *lines[-8:]])
    return head


def _plain(value: Any) -> Any:
    """The value with NumPy arrays for Dr.Jit's, all of them evaluated together."""
    import drjit as dr

    dr.eval(value)
    return _to_numpy(value)


def _to_numpy(value: Any) -> Any:
    import drjit as dr
    import mitsuba as mi
    import numpy as np

    if isinstance(value, mi.Bitmap):
        return np.array(value)
    if dr.is_array_v(value):
        return np.array(value.numpy())
    if isinstance(value, dict):
        return {key: _to_numpy(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_to_numpy(item) for item in value]
    return value


if __name__ == "__main__":
    main(sys.argv[1])
