"""pytest plugin of the assignments: `pytest -p tofrender.course.judge.plugin`.

The plugin reads `rubric.toml` in the folder of the assignment, adds a marker for each problem, and
provides the fixture `submission`. `pytest --help` lists its options.
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
from .client import NoAnswer, SubmissionLimits, Worker, shortened
from .processes import MACHINE_FAILED, MachineFailure
from .speed import slowness

RUBRIC = pytest.StashKey[rubric.Rubric]()
WORKERS = pytest.StashKey["Workers"]()
SECRET = pytest.StashKey[int]()
SUBMISSION = pytest.StashKey["Submission"]()
REPORTS = pytest.StashKey[list[pytest.TestReport]]()  # reports of set-up, test and tear-down
MAX_DELIVERED = 1 << 30  # largest size of the arrays in a file that was handed in [bytes]
SEED_STEP = 1_000_003  # distance of the seeds that `--seeds` tries


class Workers:
    """Workers of a submission. Problems that forbid the same features share a worker."""

    def __init__(self, make_worker: Callable[[tuple[str, ...]], Worker]) -> None:
        self._make_worker = make_worker
        self._worker_by_forbidden: dict[tuple[str, ...], Worker] = {}

    def of(self, problem: rubric.Problem | None) -> Worker:
        """Return the worker for a problem, and start it if necessary."""
        forbids = problem.forbids if problem else ()
        if forbids not in self._worker_by_forbidden:
            self._worker_by_forbidden[forbids] = self._make_worker(forbids)
        return self._worker_by_forbidden[forbids]

    def close(self) -> None:
        """End all workers."""
        for worker in self._worker_by_forbidden.values():
            worker.close()


class Submission:
    """Value of the fixture `submission`: asks the judged submission for answers."""

    def __init__(self, request: pytest.FixtureRequest) -> None:
        config = request.config
        self._folder = _folder(config)
        self.assignment = Assignment(config.rootpath)
        self.problem = _problem(request.node)
        self._worker = config.stash[WORKERS].of(self.problem)
        self._name = request.node.name

        # The seed depends on the options, the term and, in the staff's tests, a secret
        self._seed = int(config.getoption("--seed") or 0)
        self._seed += SEED_STEP * getattr(request, "param", 0)
        self._seed += inputs.seed_of(config.stash[RUBRIC].term)
        if request.path.match(rubric.STAFF_TEST):
            self._seed += config.stash[SECRET]

        # Handouts promise seeds of 32 bits; this bound leaves room for tests that add to the seed
        self._seed %= rubric.MAX_SEED + 1
        self.is_seeded = False  # whether the test has used its seed
        self.uses: set[str] = set()  # names of the submission that the probes have used
        self.fraction = 0.0  # fraction of the points that the test gives although it fails

    def award(self, fraction: float) -> None:
        """Give a fraction of the test's points, from 0 to 1, even if the test fails afterwards."""
        self.fraction = min(1.0, max(0.0, float(fraction)))

    @property
    def seed(self) -> int:
        """Seed of the test. Students cannot predict the seed of the staff's tests."""
        self.is_seeded = True
        return self._seed

    @property
    def random(self) -> np.random.Generator:
        """New generator of random numbers, which depends on the seed and the test's name."""
        return np.random.default_rng([self.seed, *self._name.encode()])

    def ask(self, probe: str, **arguments: Any) -> Any:
        """Call a probe with the submission, in the worker, and return its answer.

        Args:
            probe: Name of a function in `tests/probes.py`.
            **arguments: Arguments of the probe. These are plain values or arrays, see `wire`.

        Raises:
            NoAnswer: The submission failed; the message contains the reason.
        """
        timeout_s = self.problem.timeout_s if self.problem else 60.0
        timeout_s = round(timeout_s * slowness(), 1)
        try:
            answer = self._worker.ask(probe, arguments, timeout_s)
        except MachineFailure as failure:
            pytest.exit(str(failure), MACHINE_FAILED)
        self.uses |= self._worker.used
        return answer

    def path(self, name: str) -> Path:
        """Return the path of a file that was handed in; raise `Failure` if it is missing."""
        __tracebackhide__ = True
        if self._folder is None:
            pytest.skip(f"the package itself is judged, which does not hand in the file {name}")
        path = self._folder / name
        expect.true(path.is_file(), f"{name} is missing", hint="the notebook writes it")
        return path

    def arrays(self, name: str) -> dict[str, np.ndarray]:
        """Return the arrays of an npz file that was handed in, by name.

        Raises:
            Failure: The file is missing, damaged, or contains something other than arrays.
        """
        path = self.path(name)
        try:
            with wire.open_untrusted(path, MAX_DELIVERED) as file:
                return wire.arrays_of(file, MAX_DELIVERED)
        except (OSError, ValueError, EOFError, AttributeError, KeyError, BadZipFile) as error:
            raise expect.Failure(f"{name} is not an npz file of arrays: {error}") from None
        except Exception as error:  # such as zlib.error; these errors have no common base class
            raise expect.Failure(f"{name} is damaged: {error}") from None


@pytest.fixture
def submission(request: pytest.FixtureRequest) -> Submission:
    """Return the judged submission."""
    expect.configure(test=request.node.name)  # for the file names of pictures
    request.node.stash[SUBMISSION] = Submission(request)
    return request.node.stash[SUBMISSION]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the judge's options."""
    group = parser.getgroup("tofrender", "judging a submission")
    group.addoption("--submission", metavar="DIR", help="folder of the files to judge")
    group.addoption("--seed", type=int, default=0, metavar="N", help="seed of the tests")
    group.addoption(
        "--secret", metavar="FILE", help="file with the seed of the staff's tests; it is removed"
    )
    group.addoption(
        "--seeds", type=int, default=1, metavar="N", help="repeat random tests with N seeds"
    )
    group.addoption("--report", metavar="FILE", help="append a JSON line for each test")
    group.addoption("--collected", metavar="FILE", help="write the tests and their markers as JSON")
    group.addoption(
        "--edition", metavar="DIR", help="folder with the package that the submission imports"
    )
    group.addoption("--memory-gib", type=float, metavar="N", help="memory of the submission in GiB")
    group.addoption(
        "--confine", action="store_true", help="let the submission write only to its scratch folder"
    )
    group.addoption(
        "--uid", type=int, metavar="N", help="user that runs the submission, with --confine"
    )
    group.addoption("--pictures", metavar="DIR", help="folder for pictures of failures")
    parser.addini("submission", "folder of the files to judge, relative to the ini file")


def pytest_configure(config: pytest.Config) -> None:
    """Read the rubric, register its markers, and prepare the workers."""
    # Find the assignment and the submission
    root = config.rootpath
    try:
        assignment = rubric.read(root)
    except (ValueError, FileNotFoundError) as error:
        raise pytest.UsageError(str(error)) from None
    folder = _folder(config)
    if folder is not None and not folder.is_dir():
        raise pytest.UsageError(f"--submission {folder}: the folder does not exist")

    # After `--submission DIR` without "=", pytest uses the pytest.ini in DIR
    if folder == root != config.invocation_params.dir:
        raise pytest.UsageError(
            f"--submission {folder}: pytest used this folder as the folder of the tests; "
            "write --submission=DIR"
        )
    config.stash[RUBRIC] = assignment
    for problem in assignment.problems:
        config.addinivalue_line("markers", f"{problem.marker}: {problem.title}")

    # Read the secret seed from a file, because all users can read the arguments of a command
    secret, report, edition, pictures = (
        Path(path).resolve() if (path := config.getoption(option)) else None
        for option in ("--secret", "--report", "--edition", "--pictures")
    )
    config.stash[SECRET] = 0
    if secret is not None:
        config.stash[SECRET] = int(secret.read_text(encoding="utf-8"))
        secret.unlink()

    # Prepare the workers
    memory = config.getoption("--memory-gib")
    limits = SubmissionLimits(
        memory_bytes=memory and int(memory * 2**30),
        confine=bool(config.getoption("--confine")),
        uid=config.getoption("--uid"),
        hidden=tuple(map(str, filter(None, (report, pictures)))),
    )
    config.stash[WORKERS] = Workers(partial(Worker, root, folder, edition, limits))

    # Prepare the comparisons; in a student's folder pictures go to `failures`
    if pictures is None and folder and config.getini("submission"):
        pictures = folder / "failures"
    expect.configure(comparisons=assignment.comparisons, pictures=pictures)


def pytest_unconfigure(config: pytest.Config) -> None:
    """End the workers."""
    if WORKERS in config.stash:
        config.stash[WORKERS].close()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Repeat each test that judges the submission with `--seeds` seeds."""
    seeds = int(metafunc.config.getoption("--seeds") or 1)
    if seeds > 1 and "submission" in metafunc.fixturenames:
        ids = [f"seed{k}" for k in range(seeds)]
        metafunc.parametrize("submission", range(seeds), indirect=True, ids=ids)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Write the file of `--collected`: the list of markers of each test, by the test's id."""
    if target := session.config.getoption("--collected"):
        tests: dict[str, list[str]] = {}
        for item in session.items:
            tests.setdefault(rubric_id(item.nodeid), []).extend(m.name for m in item.iter_markers())
        Path(target).write_text(json.dumps(tests), encoding="utf-8")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo
) -> Iterator[None] | pytest.TestReport:
    """Report a failure as text for the student, instead of a traceback.

    The text contains the problem, the first line of the test's docstring and the reason. Students
    whose submission is graded do not get the source of the test.
    """
    report = yield
    item.stash[REPORTS].append(report)
    if call.excinfo is None or not report.failed:
        return report

    # Find the reason
    error = call.excinfo.value
    if isinstance(error, expect.Failure | NoAnswer):
        text = shortened(str(error))
    elif isinstance(error, OSError):
        pytest.exit(f"the judge cannot work: {error}", MACHINE_FAILED)
    elif item.config.getoption("--confine"):
        # An answer of an unexpected type made the test itself fail
        frames = call.excinfo.traceback
        lines = [frame.lineno + 1 for frame in frames if Path(frame.path) == item.path]
        where = f" in line {lines[-1]} of the test" if lines else ""
        kind = call.excinfo.typename
        text = f"the answer does not have the expected type ({kind}{where})"
    else:
        return report

    # A failure may give a fraction of the points
    submission = item.stash.get(SUBMISSION, None)
    if submission is not None and isinstance(error, expect.Failure):
        submission.award(max(submission.fraction, error.fraction))

    # Compose the text
    problem = _problem(item)
    where = f"problem {problem.id}, {problem.file}" if problem else ""
    about = (getattr(item, "function", item).__doc__ or "").strip().split("\n")[0]
    report.longrepr = "\n".join(filter(None, [where.rstrip(", "), about, text]))
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None] | object:
    """Append a line to the file of `--report` when a test has ended."""
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
    """Return the id of a test in the rubric, which is the same for all cases of the test.

    Example:
        >>> rubric_id("tests/test_pulse.py::test_area[0.1-seed3]")
        'test_pulse.py::test_area'
    """
    path, _, function = nodeid.partition("::")
    return f"{Path(path).name}::{function.partition('[')[0]}"


def _problem(item: Any) -> rubric.Problem | None:
    """Return the problem that a test's marker names, None without such a marker."""
    problems = item.config.stash[RUBRIC].problems
    return next((p for p in problems if item.get_closest_marker(p.marker)), None)


def _folder(config: pytest.Config) -> Path | None:
    """Return the folder that is judged, None for the package itself."""
    option = config.getoption("--submission")
    if option:
        return (config.invocation_params.dir / option).resolve()
    setting = config.getini("submission")
    return (config.rootpath / setting).resolve() if setting else None
