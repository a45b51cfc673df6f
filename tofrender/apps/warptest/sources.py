"""Where a subject's functions come from: this package, or a student's file in its own process."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import mitsuba as mi
import numpy as np

from ...course.judge.client import Limits, NoAnswer, Worker
from ...runtime import checks
from ...runtime.withheld import Withheld
from ...sampling.chi_square import Case
from ...sampling.domains import to_numpy
from .subjects import SUBJECTS, Subject, named

MEMORY = 4 << 30
"""Memory that a student's module may use [bytes]."""

ANSWER_S = 20.0
"""Longest time that one call of a student's function may take [s]."""

MAX_SOURCE = 1 << 20
"""Largest file that is searched for names [bytes]."""

_DEFINITION = re.compile(r"^(?:def|class)\s+([A-Za-z_]\w*)", re.MULTILINE)


class Source(Protocol):
    """Somebody's warps."""

    def case(self, name: str, values: Mapping[str, Any]) -> Case:
        """A subject with its parameters, for `chi_square_test`."""
        ...

    def names(self) -> list[str]:
        """The subjects that there are."""
        ...


class Library:
    """The warps of this package."""

    def case(self, name: str, values: Mapping[str, Any]) -> Case:
        """A subject with its parameters.

        Raises:
            Withheld: This is a student edition, and the subject is the student's to write.

        Example:
            >>> Library().case("beckmann", {"alpha": 0.3}).test(samples=20_000).passed
            True
        """
        from ... import sampling

        subject = SUBJECTS[name]
        sample, pdf = subject.make(lambda each: getattr(sampling, each), **values)
        return Case(sample, pdf, subject.domain, named(name, values))

    def names(self) -> list[str]:
        """The subjects that there are, fewer in a student edition."""
        return [name for name, subject in SUBJECTS.items() if not why_withheld(subject)]


def why_withheld(subject: Subject) -> str:
    """Why this package does not have a subject, "" if it has."""
    from ... import sampling

    try:
        for name in subject.names:
            getattr(sampling, name)
    except Withheld as reason:
        return str(reason)
    return ""


class Module:
    """A student's file, or folder of files, which runs in a process of its own.

    That process has the judge's protection: it writes nowhere but in a scratch folder, has no
    network where the system can refuse it, and is ended when it takes too long or too much. It is
    started again when a file has changed. All calls must come from one thread, which ends last.

    Args:
        path: A Python file, or a folder of them.

    Raises:
        ValueError: There is no such file, or it defines nothing that can be shown; one line.
    """

    def __init__(self, path: Any) -> None:
        self.path = checks.path("module", path).resolve()
        if not self.path.exists():
            raise ValueError(f"module = {path}: must be a Python file or a folder that exists")
        if self.path.is_file() and self.path.suffix != ".py":
            raise ValueError(f"module = {path}: must be a file that ends in .py, or a folder")
        for file in self._files():
            if os.fsencode(file.name) != file.name.encode(errors="replace"):
                raise ValueError(f"module = {file.name!r}: must be the name of a file in UTF-8")
        self._scratch = tempfile.TemporaryDirectory(prefix="tofrender-warptest-")
        self._worker: Worker | None = None
        self._seen: dict[str, tuple[int, int]] = {}
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
        """The subjects whose sampler is defined."""
        return [
            name
            for name, subject in SUBJECTS.items()
            if subject.names and subject.names[0] in self.defined
        ]

    def file_of(self, name: str) -> str:
        """The file that defines a subject's sampler, "" if none does."""
        return self.defined.get(SUBJECTS[name].names[0], "") if SUBJECTS[name].names else ""

    def case(self, name: str, values: Mapping[str, Any]) -> Case:
        """A subject with its parameters; its functions raise `NoAnswer` when theirs fail.

        Raises:
            ValueError: No file defines what it needs; one line.
        """
        subject = SUBJECTS[name]
        for each in subject.names:
            if each not in self.defined:
                raise ValueError(f"{each}: no file of {self.path.name} defines it")
        asked = {"subject": name, "values": dict(values)}
        count = 0

        def sample(numbers: mi.Point2f) -> Any:
            nonlocal count
            count = max(len(np.asarray(each)) for each in (numbers.x, numbers.y))
            points, *more = self._ask("sample", asked | {"numbers": _rows(numbers, count)})
            kind = mi.Point2f if subject.dimensions == 2 else mi.Vector3f
            result = kind(*(mi.Float(np.ascontiguousarray(row)) for row in points))
            return (result, *(mi.Float(each) for each in more)) if more else result

        def pdf(points: Any) -> mi.Float:
            lanes = max(len(np.asarray(each)) for each in points)
            return mi.Float(self._ask("density", asked | {"points": _rows(points, lanes)}))

        file = self.file_of(name)
        return Case(sample, pdf, subject.domain, f"{named(name, values)} of {file}")

    def refresh(self) -> bool:
        """Look at the files again; True if any has changed, and the next call starts anew."""
        seen = {}
        for path in self._files():
            status = path.stat()
            seen[path.name] = (status.st_mtime_ns, status.st_size)
        if seen == self._seen:
            return False
        self._seen = seen
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
        """The files that count, the one that was named first."""
        others = sorted(path for path in self.folder.glob("*.py") if path.is_file())
        return [self.path] if self.path.is_file() else others

    def _end(self) -> None:
        if self._worker is not None:
            self._worker.close()
            self._worker = None

    def _ask(self, probe: str, arguments: dict[str, Any]) -> Any:
        if self._worker is None:
            self._worker = Worker(self._questions(), self.folder, limits=Limits(MEMORY, True))
        try:
            return self._worker.ask(probe, arguments, ANSWER_S)
        except NoAnswer as error:
            raise NoAnswer(self._with_place(str(error))) from None

    def _with_place(self, said: str) -> str:
        """What was said of a stub, with its line."""
        name = said.rpartition(": ")[2].partition(".")[0]
        if not said.startswith("not written yet") or name not in self.defined:
            return said
        lines = (self.folder / self.defined[name]).read_text(encoding="utf-8").splitlines()
        for number, line in enumerate(lines, 1):
            if re.match(rf"(def|class)\s+{name}\b", line):
                return f"{said}\n  {self.defined[name]}, line {number}: {line}"
        return said

    def _questions(self) -> Path:
        """An assignment's folder, with these files' names and the warp tester's probes."""
        folder = Path(self._scratch.name)
        (folder / "tests").mkdir(exist_ok=True)
        names = f"from {__package__}.probes import density, sample\n"
        (folder / "tests" / "probes.py").write_text(names, encoding="utf-8")
        files: dict[str, list[str]] = {}
        wanted = {name for subject in SUBJECTS.values() for name in subject.names}
        for name in sorted(wanted & self.defined.keys()):
            files.setdefault(self.defined[name], []).append(name)
        lines = ['[assignment]\nid = "w"\ntitle = "Warps"\n']
        for number, (file, defined) in enumerate(files.items()):
            lines.append(f'[[problem]]\nid = "w.{number}"\ntitle = ""\nfile = {_toml(file)}')
            lines.append(f"names = {defined!r}\nother_points = 1.0\n")
        (folder / "rubric.toml").write_text("\n".join(lines), encoding="utf-8")
        return folder


def find_module(folder: Path) -> Module | None:
    """The student's files of a folder, None if it has none that can be shown."""
    try:
        return Module(folder)
    except ValueError:
        return None


def _rows(points: Any, count: int) -> np.ndarray:
    return to_numpy(points, count).astype(np.float32)


def _toml(text: str) -> str:
    """A text as TOML writes it; JSON's form is one."""
    import json

    return json.dumps(text, ensure_ascii=False)
