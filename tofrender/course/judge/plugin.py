"""pytest plugin of the assignments: `pytest -p tofrender.course.judge.plugin`.

It reads `rubric.toml` beside the tests, makes a marker of each problem, and offers the fixture
`submission`. `pytest --help` lists the options.
"""

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import pytest

from .. import rubric
from ..assignments import Assignment
from . import expect, inputs, wire
from .client import Limits, NoAnswer, Worker, shortened
from .processes import MACHINE_FAILED, MachineFailure

RUBRIC = pytest.StashKey[rubric.Rubric]()
WORKERS = pytest.StashKey["Workers"]()
SECRET = pytest.StashKey[int]()
SUBMISSION = pytest.StashKey["Submission"]()
REPORTS = pytest.StashKey[list[pytest.TestReport]]()  # of set-up, test and tear-down
MAX_DELIVERED = 1 << 30  # bytes of the arrays in a file that was handed in


class Workers:
    """Workers of a submission: one for all problems that forbid the same features."""

    def __init__(self, make: Callable[[tuple[str, ...]], Worker]) -> None:
        self._make = make
        self._by_forbids: dict[tuple[str, ...], Worker] = {}

    def of(self, problem: rubric.Problem | None) -> Worker:
        """Worker for a problem."""
        forbids = problem.forbids if problem else ()
        if forbids not in self._by_forbids:
            self._by_forbids[forbids] = self._make(forbids)
        return self._by_forbids[forbids]

    def close(self) -> None:
        """End them."""
        for worker in self._by_forbids.values():
            worker.close()


class Submission:
    """The fixture `submission`: asks the judged submission for answers."""

    def __init__(self, request: pytest.FixtureRequest) -> None:
        config = request.config
        self._folder = _folder(config)
        self.assignment, self.problem = Assignment(config.rootpath), _problem(request.node)
        self._worker = config.stash[WORKERS].of(self.problem)
        self._name = request.node.name
        self._seed = int(config.getoption("--seed") or 0) + 1_000_003 * getattr(request, "param", 0)
        self._seed += inputs.seed_of(config.stash[RUBRIC].term)
        if request.path.match(rubric.STAFF_TEST):
            self._seed += config.stash[SECRET]
        self._seed %= rubric.MAX_SEED + 1  # handouts promise 32 bits, and tests count on from it
        self.is_seeded = False  # whether the test has used its seed
        self.uses: set[str] = set()  # names of the submission that the probes have used
        self.fraction = 0.0  # fraction of the points that the test gives although it fails

    def award(self, fraction: float) -> None:
        """Give a fraction of the test's points, even if the test fails after this."""
        self.fraction = min(1.0, max(0.0, float(fraction)))

    @property
    def seed(self) -> int:
        """Seed from which a test derives its own; unknown before the staff's tests run."""
        self.is_seeded = True
        return self._seed

    @property
    def random(self) -> np.random.Generator:
        """Random numbers of a test; others in each test and under each seed."""
        return np.random.default_rng([self.seed, *self._name.encode()])

    def ask(self, probe: str, **arguments: Any) -> Any:
        """Answer of a probe in `tests/probes.py`, else `NoAnswer`; arguments as for `wire`."""
        timeout_s = self.problem.timeout_s if self.problem else 60.0
        try:
            answer = self._worker.ask(probe, arguments, timeout_s)
        except MachineFailure as failure:
            pytest.exit(str(failure), MACHINE_FAILED)
        self.uses |= self._worker.used
        return answer

    def path(self, name: str) -> Path:
        """Path of a file that was handed in; `Failure` if it is missing."""
        __tracebackhide__ = True
        if self._folder is None:
            pytest.skip(f"{name} is a file, which the package itself does not hand in")
        path = self._folder / name
        expect.true(path.is_file(), f"{name} is missing", hint="the notebook writes it")
        return path

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """Arrays of an npz file that was handed in; `Failure` if it holds something else."""
        path = self.path(name)
        try:
            with wire.open_untrusted(path, MAX_DELIVERED) as file:
                return wire.arrays_of(file, MAX_DELIVERED)
        except (OSError, ValueError, EOFError, AttributeError, KeyError, BadZipFile) as error:
            raise expect.Failure(f"{name} is not an npz file of arrays: {error}") from None
        except Exception as error:  # zlib's own and others, which have no common base
            raise expect.Failure(f"{name} is damaged: {error}") from None


@pytest.fixture
def submission(request: pytest.FixtureRequest) -> Submission:
    """The judged submission."""
    expect.configure(test=request.node.name)  # after which pictures of a failure are called
    request.node.stash[SUBMISSION] = Submission(request)
    return request.node.stash[SUBMISSION]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the judge's options."""
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
    config.stash[RUBRIC] = assignment
    for problem in assignment.problems:
        config.addinivalue_line("markers", f"{problem.marker}: {problem.title}")
    secret, report, edition, pictures = (
        Path(path).resolve() if (path := config.getoption(option)) else None
        for option in ("--secret", "--report", "--edition", "--pictures")
    )
    config.stash[SECRET] = 0
    if secret is not None:  # not an argument, since all users can read a command's
        config.stash[SECRET] = int(secret.read_text(encoding="utf-8"))
        secret.unlink()
    memory = config.getoption("--memory-gib")
    limits = Limits(
        memory and int(memory * 2**30),
        bool(config.getoption("--confine")),
        config.getoption("--uid"),
        hidden=tuple(map(str, filter(None, (report, pictures)))),
    )
    config.stash[WORKERS] = Workers(partial(Worker, root, folder, edition, limits))
    if pictures is None and folder and config.getini("submission"):
        pictures = folder / "failures"
    expect.configure(comparisons=assignment.comparisons, pictures=pictures)


def pytest_unconfigure(config: pytest.Config) -> None:
    """End the workers."""
    if WORKERS in config.stash:
        config.stash[WORKERS].close()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Repeat each test under `--seeds` seeds."""
    seeds = int(metafunc.config.getoption("--seeds") or 1)
    if seeds > 1 and "submission" in metafunc.fixturenames:
        ids = [f"seed{k}" for k in range(seeds)]
        metafunc.parametrize("submission", range(seeds), indirect=True, ids=ids)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Write `--collected`: a list of markers for each test's id."""
    if target := session.config.getoption("--collected"):
        tests: dict[str, list[str]] = {}
        for item in session.items:
            tests.setdefault(rubric_id(item.nodeid), []).extend(m.name for m in item.iter_markers())
        Path(target).write_text(json.dumps(tests), encoding="utf-8")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo
) -> Iterator[None] | pytest.TestReport:
    """Show expected and actual values instead of a traceback, and to graded students no source."""
    report = yield
    item.stash[REPORTS].append(report)
    if call.excinfo is None or not report.failed:
        return report
    error = call.excinfo.value
    if isinstance(error, expect.Failure | NoAnswer):
        text = shortened(str(error))
    elif isinstance(error, OSError):
        pytest.exit(f"the judge cannot work: {error}", MACHINE_FAILED)
    elif item.config.getoption("--confine"):  # an answer of an unexpected type broke the test
        frames = call.excinfo.traceback
        lines = [frame.lineno + 1 for frame in frames if Path(frame.path) == item.path]
        where = f" in line {lines[-1]} of the test" if lines else ""
        kind = call.excinfo.typename
        text = f"the answer is of another kind than was asked for ({kind}{where})"
    else:
        return report
    submission = item.stash.get(SUBMISSION, None)
    if submission is not None and isinstance(error, expect.Failure):
        submission.award(max(submission.fraction, error.fraction))
    problem = _problem(item)
    where = f"problem {problem.id}, {problem.file}" if problem else ""
    about = (getattr(item, "function", item).__doc__ or "").strip().split("\n")[0]
    report.longrepr = "\n".join(filter(None, [where.rstrip(", "), about, text]))
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None] | object:
    """Append a line to the report when a test has ended."""
    reports = item.stash[REPORTS] = []
    result = yield
    target = item.config.getoption("--report")
    if target:
        bad = [r for r in reports if r.failed]
        skipped = any(r.skipped for r in reports)
        submission = item.stash.get(SUBMISSION, None)
        fraction = submission.fraction if bad and submission else float(not (bad or skipped))
        line = {
            "id": rubric_id(item.nodeid),
            "case": item.nodeid.partition("[")[2].rstrip("]"),
            "outcome": "failed" if bad else "skipped" if skipped else "passed",
            "text": shortened(str(bad[0].longrepr)) if bad else "",
            "share": fraction,
            "seconds": sum(r.duration for r in reports),
            "seeded": submission is not None and submission.is_seeded,
            "uses": sorted(submission.uses) if submission is not None else [],
        }
        with open(target, "a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
    return result


def rubric_id(nodeid: str) -> str:
    """Id of a test in the rubric: its file's name and its function's, without a case.

    Example:
        >>> rubric_id("tests/test_pulse.py::test_area[0.1-seed3]")
        'test_pulse.py::test_area'
    """
    path, _, function = nodeid.partition("::")
    return f"{Path(path).name}::{function.partition('[')[0]}"


def _problem(item: Any) -> rubric.Problem | None:
    """Problem that a test's marker names."""
    problems = item.config.stash[RUBRIC].problems
    return next((p for p in problems if item.get_closest_marker(p.marker)), None)


def _folder(config: pytest.Config) -> Path | None:
    """Folder that is judged, None for the package itself."""
    option, line = config.getoption("--submission"), config.getini("submission")
    if option:
        return (config.invocation_params.dir / option).resolve()
    return (config.rootpath / line).resolve() if line else None
