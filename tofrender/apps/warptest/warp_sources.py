"""Sources of a subject's functions: this package, or a user's file in a separate process."""

from __future__ import annotations

import json
import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ...course.judge.client import NoAnswer, SubmissionLimits, Worker
from ...runtime import checks
from ...runtime.editions import LeftOut
from ...sampling.chi_square import Case
from ...sampling.domains import to_numpy
from .subjects import SUBJECTS, Subject, labeled

MEMORY = 4 << 30  # Memory that a user's module may use [bytes]
ANSWER_S = 20.0  # Longest time of a call of a user's function [s]
MAX_SOURCE = 1 << 20  # Largest file that is searched for names [bytes]

_DEFINITION = re.compile(r"^(?:def|class)\s+([A-Za-z_]\w*)", re.MULTILINE)


class PackageWarps:
    """The warps of this package."""

    def names(self) -> list[str]:
        """Return the names of the subjects. A student edition may contain fewer subjects."""
        return [name for name, subject in SUBJECTS.items() if not is_left_out(subject)]

    def case(self, name: str, given: Mapping[str, Any]) -> Case:
        """Return the sampling function and the density of a subject, for a test.

        Args:
            name: Name of the subject (warp, shape or light) in `SUBJECTS`.
            given: Values of its parameters, by name.

        Raises:
            LeftOut: This student edition does not contain the subject.
        """
        from ... import sampling

        subject = SUBJECTS[name]
        values = subject.values(given)
        sample, pdf = subject.make(lambda each: getattr(sampling, each), **values)
        return Case(sample, pdf, subject.domain, labeled(name, values))


def is_left_out(subject: Subject) -> bool:
    """Return whether this package is a student edition that does not contain the subject."""
    from ... import sampling

    try:
        for name in subject.names:
            getattr(sampling, name)
    except LeftOut:
        return True
    return False


class Module:
    """Warps of a user's Python file, or folder of files, in a separate process.

    The process has the protection of the judge. It can write in a scratch folder only. The network
    is refused if the system supports that. The process is ended if it exceeds limits of time or
    memory, and restarted when a file has changed. All calls must come from one thread, which ends
    last.
    """

    def __init__(self, path: Any) -> None:
        # Check the files
        self.path = checks.path("module", path).resolve()
        if not self.path.exists():
            raise ValueError(f"module = {path}: must be a Python file or a folder that exists")
        if self.path.is_file() and self.path.suffix != ".py":
            raise ValueError(f"module = {path}: must be a file that ends in .py, or a folder")
        for file in self._files():
            if os.fsencode(file.name) != file.name.encode(errors="replace"):
                raise ValueError(f"module = {file.name!r}: must be the name of a file in UTF-8")

        # Find the functions that they define
        self._scratch = tempfile.TemporaryDirectory(prefix="tofrender-warptest-")
        self._worker: Worker | None = None
        self._states: dict[str, tuple[int, int]] = {}
        self.defined: dict[str, str] = {}
        self.refresh()
        if not self.names():
            self._scratch.cleanup()
            some = ", ".join(SUBJECTS["tent"].names)
            raise ValueError(f"module = {path}: must define functions of the course, like {some}")

    @property
    def folder(self) -> Path:
        """Folder of the files."""
        return self.path if self.path.is_dir() else self.path.parent

    def names(self) -> list[str]:
        """Return the names of the subjects whose sampling function the user's module defines."""
        return [name for name in SUBJECTS if self.file_of(name)]

    def file_of(self, name: str) -> str:
        """Return the name of the file that defines a subject's sampling function, or ""."""
        return self.defined.get(SUBJECTS[name].names[0], "") if SUBJECTS[name].names else ""

    def case(self, name: str, given: Mapping[str, Any]) -> Case:
        """Return the user's sampling function and density for a subject.

        Both functions raise `NoAnswer` if the user's functions fail.
        """
        # Are all functions defined?
        subject = SUBJECTS[name]
        values = subject.values(given)
        for each in subject.names:
            if each not in self.defined:
                raise ValueError(f"{each}: no file of {self.path.name} defines it")
        query = {"subject": name, "values": values}
        count = 0

        def sample(numbers: mi.Point2f) -> Any:
            nonlocal count
            count = max(len(np.asarray(each)) for each in (numbers.x, numbers.y))
            points, *more = self._ask("sample", query | {"numbers": _rows(numbers, count)})
            kind = mi.Point2f if subject.dimensions == 2 else mi.Vector3f
            result = kind(*(mi.Float(np.ascontiguousarray(row)) for row in points))
            return (result, *(mi.Float(each) for each in more)) if more else result

        def pdf(points: Any) -> mi.Float:
            lanes = max(len(np.asarray(each)) for each in points)
            return mi.Float(self._ask("density", query | {"points": _rows(points, lanes)}))

        label = f"{labeled(name, values)} of {self.file_of(name)}"
        return Case(sample, pdf, subject.domain, label)

    def refresh(self) -> bool:
        """Restart the process if a file has changed, and return whether a file has changed."""
        stats = {path.name: path.stat() for path in self._files()}
        states = {name: (each.st_mtime_ns, each.st_size) for name, each in stats.items()}
        if states == self._states:
            return False
        self._states = states
        self.defined = {}
        for path in self._files():
            if path.stat().st_size <= MAX_SOURCE:
                text = path.read_text(encoding="utf-8", errors="replace")
                for name in _DEFINITION.findall(text):
                    self.defined.setdefault(name, path.name)
        self._end()
        return True

    def close(self) -> None:
        """End the process and remove its scratch folder."""
        self._end()
        self._scratch.cleanup()

    def _files(self) -> list[Path]:
        """Return the Python files of the module."""
        others = sorted(path for path in self.folder.glob("*.py") if path.is_file())
        return [self.path] if self.path.is_file() else others

    def _end(self) -> None:
        if self._worker is not None:
            self._worker.close()
            self._worker = None

    def _ask(self, probe: str, arguments: dict[str, Any]) -> Any:
        if self._worker is None:
            self._worker = Worker(
                self._assignment(), self.folder, limits=SubmissionLimits(MEMORY, True)
            )
        try:
            return self._worker.ask(probe, arguments, ANSWER_S)
        except NoAnswer as error:
            raise NoAnswer(self._with_line(str(error))) from None

    def _with_line(self, message: str) -> str:
        """Add the line of a stub to the message about it."""
        name = message.rpartition(": ")[2].partition(".")[0]
        if not message.startswith("not written yet") or name not in self.defined:
            return message
        lines = (self.folder / self.defined[name]).read_text(encoding="utf-8").splitlines()
        for number, line in enumerate(lines, 1):
            if re.match(rf"(def|class)\s+{name}\b", line):
                return f"{message}\n  {self.defined[name]}, line {number}: {line}"
        return message

    def _assignment(self) -> Path:
        """Write an assignment with these files and the warp tester's probes for the judge."""
        # Write the probes
        folder = Path(self._scratch.name)
        (folder / "tests").mkdir(exist_ok=True)
        names = f"from {__package__}.probes import density, sample\n"
        (folder / "tests" / "probes.py").write_text(names, encoding="utf-8")

        # Write a problem for each file with functions
        files: dict[str, list[str]] = {}
        wanted = {name for subject in SUBJECTS.values() for name in subject.names}
        for name in sorted(wanted & self.defined.keys()):
            files.setdefault(self.defined[name], []).append(name)
        lines = ['[assignment]\nid = "w"\ntitle = "Warps"\n']
        for number, (file, defined) in enumerate(files.items()):
            toml = json.dumps(file, ensure_ascii=False)  # A JSON string is a TOML string
            lines.append(f'[[problem]]\nid = "w.{number}"\ntitle = ""\nfile = {toml}')
            lines.append(f"names = {defined!r}\nother_points = 1.0\n")
        (folder / "rubric.toml").write_text("\n".join(lines), encoding="utf-8")
        return folder


def find_module(folder: Path) -> Module | None:
    """Return the module of a folder, or None if the folder does not define a subject."""
    try:
        return Module(folder)
    except ValueError:
        return None


def _rows(points: Any, count: int) -> np.ndarray:
    return to_numpy(points, count).astype(np.float32)
