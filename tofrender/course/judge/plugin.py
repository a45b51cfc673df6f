"""The pytest plugin of the assignments: `pytest -p tofrender.course.judge.plugin`.

It reads `rubric.toml` beside the tests, makes a marker of each problem, and offers the fixture
`submission`. Each failed test says in a few lines what was expected and what came.

| option | meaning |
|---|---|
| `--submission=DIR` | what is judged; by default the ini file's `submission`, else the package |
| `--seed N` | seed from which the tests derive theirs |
| `--secret FILE` | holds the seed of the staff's tests; read and removed before any runs |
| `--seeds N` | repeat every test under N seeds |
| `--report FILE` | append a JSON line a test, as it ends |
| `--collected FILE` | write which tests there are, with their markers |
| `--edition DIR` | folder whose `tofrender` the submission sees |
| `--memory-gib N`, `--confine`, `--uid N` | limits of the submission's processes |
| `--pictures DIR` | where pictures of failures go; by default to the student's `failures/` |
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import pytest

from .. import rubric
from ..assignments import STAFF_TEST, Assignment
from . import expect, inputs, wire
from .client import Limits, NoAnswer, Worker, shortened

RUBRIC = pytest.StashKey[rubric.Rubric]()
WORKER = pytest.StashKey[Worker]()
SECRET = pytest.StashKey[int]()
ASKED = pytest.StashKey["Submission"]()
MAX_DELIVERED = 1 << 30
"""Most bytes of the arrays in a file that was handed in."""


class Submission:
    """What a test asks: the fixture `submission`.

    Attributes:
        assignment: Whose test it is.
        problem: The problem that the test judges, None if it is of none.
        is_seeded: Whether the test has asked for its seed.
        uses: The submission's names that the probes have used.
        share: Share of the test's points that it gives although it fails.
    """

    def __init__(
        self,
        worker: Worker,
        folder: Path | None,
        assignment: Assignment,
        problem: rubric.Problem | None,
        seed: int,
        name: str = "",
    ) -> None:
        self._worker, self._folder, self._seed, self._name = worker, folder, seed, name
        self.assignment, self.problem = assignment, problem
        self._timeout_s = problem.timeout_s if problem else 60.0
        self.is_seeded, self.uses, self.share = False, set[str](), 0.0

    def award(self, share: float) -> None:
        """Give a share of the test's points, from 0 to 1, even if the test fails after this."""
        self.share = min(1.0, max(0.0, float(share)))

    @property
    def seed(self) -> int:
        """Seed from which a test derives its own; nobody knows it before the staff's tests run."""
        self.is_seeded = True
        return self._seed

    @property
    def random(self) -> np.random.Generator:
        """Draws what a test asks for; another one in each test and under each seed."""
        return np.random.default_rng([self.seed, *self._name.encode()])

    def ask(self, probe: str, **arguments: Any) -> Any:
        """What a probe of `tests/probes.py` returns for this submission.

        Args:
            probe: The probe's name.
            arguments: Its arguments: numbers, texts, arrays, or lists and dicts of them.

        Raises:
            NoAnswer: The submission failed; says how.
        """
        __tracebackhide__ = True
        answer = self._worker.ask(probe, arguments, self._timeout_s)
        self.uses |= self._worker.used
        return answer

    def path(self, name: str) -> Path:
        """A file that was handed in.

        Raises:
            Failure: It is missing.
        """
        __tracebackhide__ = True
        if self._folder is None:
            pytest.skip(f"{name} is a file, which the package itself does not hand in")
        path = self._folder / name
        expect.true(path.is_file(), f"{name} is missing", hint="the notebook writes it")
        return path

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """The arrays of an npz file that was handed in.

        Raises:
            Failure: It is missing, or holds something else.
        """
        __tracebackhide__ = True
        path = self.path(name)
        try:
            with wire.opened(path, MAX_DELIVERED) as file:
                return wire.arrays_of(file, MAX_DELIVERED)
        except (OSError, ValueError, EOFError, AttributeError, KeyError, BadZipFile) as error:
            raise expect.Failure(f"{name} is not an npz file of arrays: {error}") from None
        except Exception as error:  # zlib's own and others, which have no common base
            raise expect.Failure(f"{name} is damaged: {error}") from None


@pytest.fixture
def submission(request: pytest.FixtureRequest) -> Submission:
    """The submission that is judged."""
    config = request.config
    seed = int(config.getoption("--seed") or 0) + getattr(request, "param", 0) * 1_000_003
    seed += inputs.seed_of(config.stash[RUBRIC].term)
    if request.path.match(STAFF_TEST):
        seed += config.stash[SECRET]
    assignment, problem, name = (
        Assignment(config.rootpath),
        _problem(request.node),
        request.node.name,
    )
    asked = Submission(config.stash[WORKER], _folder(config), assignment, problem, seed, name)
    request.node.stash[ASKED] = asked
    return asked


# ------------------------------------------------------------------------------ pytest's hooks


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the table above."""
    group = parser.getgroup("tofrender", "judging a submission")
    group.addoption("--submission", metavar="DIR", help="folder of the files to judge")
    group.addoption("--seed", type=int, default=0, metavar="N", help="seed of the tests")
    group.addoption("--secret", metavar="FILE", help="seed of the staff's tests; is removed")
    group.addoption("--seeds", type=int, default=1, metavar="N", help="repeat under N seeds")
    group.addoption("--report", metavar="FILE", help="append a JSON line for each test")
    group.addoption("--collected", metavar="FILE", help="write the tests and their markers")
    group.addoption("--edition", metavar="DIR", help="package that the submission sees")
    group.addoption("--memory-gib", type=float, metavar="N", help="memory of the submission")
    group.addoption("--confine", action="store_true", help="let it write in its scratch only")
    group.addoption("--uid", type=int, metavar="N", help="user that it is then")
    group.addoption("--pictures", metavar="DIR", help="folder for pictures of failures")
    parser.addini("submission", "folder of the files to judge, from the ini file's folder")


def pytest_configure(config: pytest.Config) -> None:
    """Read the rubric; make its markers and the worker."""
    root = config.rootpath
    try:
        assignment = rubric.read(root)
    except (ValueError, FileNotFoundError) as error:
        raise pytest.UsageError(str(error)) from None
    folder = _folder(config)
    if folder is not None and not folder.is_dir():
        raise pytest.UsageError(f"--submission {folder}: no such folder")
    if folder == root != config.invocation_params.dir:  # pytest.ini of the submission was found
        raise pytest.UsageError(
            f"--submission {folder}: pytest has taken it for the folder of the tests; "
            "write --submission=DIR"
        )
    config.stash[RUBRIC], config.stash[SECRET] = assignment, _taken(config.getoption("--secret"))
    for problem in assignment.problems:
        config.addinivalue_line("markers", f"{problem.marker}: {problem.title}")
    pictures = folder / "failures" if config.getini("submission") and folder else None
    drawn = config.getoption("--pictures")
    if drawn:
        pictures = Path(drawn).resolve()
    expect.configure(comparisons=assignment.comparisons, pictures=pictures)
    memory, edition = config.getoption("--memory-gib"), config.getoption("--edition")
    written = (config.getoption("--report"), drawn)
    limits = Limits(
        memory and int(memory * 2**30),
        bool(config.getoption("--confine")),
        config.getoption("--uid"),
        hidden=tuple(str(Path(path).resolve()) for path in written if path),
    )
    config.stash[WORKER] = Worker(root, folder, edition and Path(edition).resolve(), limits)


def pytest_unconfigure(config: pytest.Config) -> None:
    """End the worker."""
    if WORKER in config.stash:
        config.stash[WORKER].close()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Repeat each test under the seeds that were asked for."""
    seeds = int(metafunc.config.getoption("--seeds") or 1)
    if seeds > 1 and "submission" in metafunc.fixturenames:
        ids = [f"seed{k}" for k in range(seeds)]
        metafunc.parametrize("submission", range(seeds), indirect=True, ids=ids)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Write what `--collected` asks for: a list of markers for each test's id."""
    target = session.config.getoption("--collected")
    if target:
        tests: dict[str, set[str]] = {}
        for item in session.items:
            marks = {mark.name for mark in item.iter_markers()}
            tests.setdefault(rubric_id(item.nodeid), set()).update(marks)
        text = json.dumps({name: sorted(marks) for name, marks in tests.items()})
        Path(target).write_text(text, encoding="utf-8")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Name the pictures of a failure after the test."""
    expect.configure(test=item.name)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo
) -> Iterator[None] | pytest.TestReport:
    """Show what was expected and what came instead of a traceback.

    When students are graded, nothing shows the source of a test: neither what an answer of another
    kind than expected brings about.
    """
    report = yield
    if call.excinfo is None or not report.failed:
        return report
    said = call.excinfo.errisinstance((expect.Failure, NoAnswer))
    if said or item.config.getoption("--confine"):
        asked = item.stash.get(ASKED, None)
        if asked is not None and isinstance(call.excinfo.value, expect.Failure):
            asked.award(max(asked.share, call.excinfo.value.share))
        text = shortened(str(call.excinfo.value)) if said else _unread(item, call.excinfo)
        problem = _problem(item)
        where = f"problem {problem.id}, {problem.file}" if problem else ""
        about = (getattr(item, "function", item).__doc__ or "").strip().split("\n")[0]
        report.longrepr = "\n".join(filter(None, [where.rstrip(", "), about, text]))
    return report


def _unread(item: pytest.Item, error: pytest.ExceptionInfo) -> str:
    """What a student reads when a test could make nothing of the answer."""
    lines = [entry.lineno + 1 for entry in error.traceback if Path(entry.path) == item.path]
    where = f" in line {lines[-1]} of the test" if lines else ""
    return f"the answer is of another kind than was asked for ({error.typename}{where})"


_reports: list[pytest.TestReport] = []  # of the test that runs


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Collect what `--report` writes."""
    _reports.append(report)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None] | object:
    """Append a line to the report when a test has ended."""
    _reports.clear()
    result = yield
    target = item.config.getoption("--report")
    if target:
        bad = [r for r in _reports if r.failed]
        skipped = any(r.skipped for r in _reports)
        asked = item.stash.get(ASKED, None)
        line = {
            "id": rubric_id(item.nodeid),
            "case": item.nodeid.partition("[")[2].rstrip("]"),
            "outcome": "failed" if bad else "skipped" if skipped else "passed",
            "text": shortened(str(bad[0].longrepr)) if bad else "",
            "share": asked.share if bad and asked is not None else float(not (bad or skipped)),
            "seconds": sum(r.duration for r in _reports),
            "seeded": asked is not None and asked.is_seeded,
            "uses": sorted(asked.uses) if asked is not None else [],
        }
        with open(target, "a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
    return result


def rubric_id(nodeid: str) -> str:
    """A test's id in the rubric: its file's name and its function's, without a case.

    Example:
        >>> rubric_id("tests/test_pulse.py::test_area[0.1-seed3]")
        'test_pulse.py::test_area'
    """
    path, _, function = nodeid.partition("::")
    return f"{Path(path).name}::{function.partition('[')[0]}"


def _taken(path: str | None) -> int:
    """The number in a file, which is gone then: a command's arguments can be read by all."""
    if path is None:
        return 0
    text = Path(path).read_text(encoding="utf-8")
    Path(path).unlink()
    return int(text)


def _problem(item: Any) -> rubric.Problem | None:
    """The problem that a test's marker names."""
    problems = item.config.stash[RUBRIC].problems
    return next((p for p in problems if item.get_closest_marker(p.marker)), None)


def _folder(config: pytest.Config) -> Path | None:
    """The folder that is judged, None for the package itself."""
    option, line = config.getoption("--submission"), config.getini("submission")
    if option:
        return (config.invocation_params.dir / option).resolve()
    return (config.rootpath / line).resolve() if line else None
