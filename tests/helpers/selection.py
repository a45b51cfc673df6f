"""Which tests run: those of `make test`, by their durations, or a shard of all, `--shard 3/8`.

With `--changed COMMIT`, `make test` also runs the whole tests of the packages that changed since
that commit, and of the packages that import them, or a part of these tests, see WHOLE_S.

No plugin of pytest replaces this module:

- pytest-split divides the collected cases into groups of equal duration, as `--shard` does. It
  stores a duration for each of the thousands of cases instead of each test function, measured by
  the clock, which varies on a busy machine. Its groups cut files apart, so that two groups compute
  the same module fixtures. It cannot choose a part of the cases within a time, as `--brief` does.
- pytest-testmon selects the tests that executed a changed line. This requires the coverage database
  of a run of all tests, which takes over an hour and must be kept from run to run.
- pytest-impacted selects the tests that import a changed module. Nearly all tests import
  `tofrender`, which loads its modules on demand, so imports do not distinguish tests. `--changed`
  uses the packages of the import contract instead.
- pytest-xdist distributes tests over processes. Its groups do not select tests.
"""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Collection
from typing import Any

import pytest

from helpers import affected, durations

FAST_S = 0.1  # A test whose cases compute longer than this together gets the mark `slow`
CASES_S = 0.5  # `make test` runs as many cases of a test as fit into this time, and at least one

CASE_S = 1.0
"""A test whose cases compute longer is left to `make test-all`; if `essential`, all but a case."""

WHOLE_S = 900.0
"""Processor time of the whole tests of changed packages [s] at most: 7.5 minutes on two cores."""

LEFT = pytest.StashKey[str]()


class Test:
    """The cases of a test function, and what they compute."""

    __test__ = False

    def __init__(
        self,
        cases: list[pytest.Item],
        case_s: float,
        fixtures_s: float,
        brief_case_s: float | None = None,
    ) -> None:
        self.cases, self.case_s, self.fixtures_s = cases, case_s, fixtures_s
        self.brief_case_s = case_s if brief_case_s is None else brief_case_s
        self.file = durations.split(cases[0].nodeid)[0]
        self.package = affected.package_of(self.file)

    @property
    def all_s(self) -> float:
        """Processor time of all cases and of the test's part of shared fixtures [s]."""
        return self.fixtures_s + self.case_s * len(self.cases)

    def brief(self) -> list[pytest.Item]:
        """The cases that `make test` runs."""
        essential = any(case.get_closest_marker("essential") for case in self.cases)
        if self.fixtures_s + self.case_s > CASE_S and not essential:
            return []
        fit = int(CASES_S / self.brief_case_s) if self.brief_case_s else len(self.cases)
        return covering(self.cases, max(fit, 1))


def covering(cases: list[pytest.Item], count: int) -> list[pytest.Item]:
    """Choose so many cases, each of which has the parameters' values that occurred least before."""
    if count >= len(cases):
        return cases
    values = [set(case.callspec.indices.items()) for case in cases]
    seen: Counter[Any] = Counter()
    chosen: list[int] = []
    for _ in range(count):
        left = [k for k in range(len(cases)) if k not in chosen]
        chosen.append(min(left, key=lambda k: (sum(seen[value] for value in values[k]), k)))
        seen.update(values[chosen[-1]])
    return [cases[k] for k in sorted(chosen)]


def tests(items: list[pytest.Item], stored: dict[str, dict[str, float]]) -> list[Test]:
    """The test functions of a collection, with their stored durations."""
    cases: dict[tuple[str, str], list[pytest.Item]] = defaultdict(list)
    for item in items:
        cases[durations.split(item.nodeid)].append(item)
    users: Counter[tuple[str, str]] = Counter()
    fixtures = {}
    for (file, test), its in cases.items():
        known = stored.get(file, {})
        names = [f"@{name}" for name in getattr(its[0], "fixturenames", ())]
        fixtures[file, test] = [name for name in names if name in known]
        users.update((file, name) for name in fixtures[file, test])
    found = []
    for (file, test), its in cases.items():
        shared = sum(stored[file][name] / users[file, name] for name in fixtures[file, test])
        known = stored.get(file, {})
        brief_case_s = known.get(durations.BRIEF.format(test))
        found.append(Test(its, known.get(test, 0.0), shared, brief_case_s))
    return found


def shard(found: list[Test], index: int, count: int) -> list[Test]:
    """One of `count` parts of some tests that take about equally long; files stay whole."""
    seconds: Counter[str] = Counter()
    for test in found:
        seconds[test.file] += test.all_s + 0.01 * len(test.cases)
    sums, parts = [0.0] * count, {}
    for file, spent in sorted(seconds.items(), key=lambda each: (-each[1], each[0])):
        parts[file] = sums.index(min(sums))
        sums[parts[file]] += spent
    return [test for test in found if parts[test.file] == index - 1]


def in_time(found: list[Test], limit_s: float, turn: int) -> list[Test]:
    """Return all of some tests, or a part of them if all exceed a limit; each turn has its part."""
    count = max(1, math.ceil(sum(test.all_s for test in found) / limit_s))
    return shard(found, turn % count + 1, count)


def whole(
    found: list[Test], changed: Collection[str], importing: Collection[str], turn: int
) -> list[Test]:
    """Return the tests of changed and of importing packages, as many as fit into WHOLE_S."""
    own = [test for test in found if test.package in changed]
    others = [test for test in found if test.package in importing]
    chosen = in_time(own, WHOLE_S, turn)
    left_s = WHOLE_S - sum(test.all_s for test in chosen)
    return chosen + in_time(others, max(left_s, WHOLE_S / 4), turn)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --brief, --changed, --turn, --shard and --all-inputs."""
    for name, text in (
        ("--brief", "leave long tests, and further cases of slow ones, to make test-all"),
        ("--all-inputs", "try all of tests/inputs, not a sample"),
    ):
        parser.addoption(name, action="store_true", help=text)
    text = "with --brief: run all tests of packages that changed since a commit, and of importers"
    parser.addoption("--changed", metavar="COMMIT", help=text)
    text = "choose the part of what --changed selects, if that is too long for one run"
    parser.addoption("--turn", type=int, default=0, metavar="NUMBER", help=text)
    text = "run the K-th of N parts of about equal length"
    parser.addoption("--shard", type=_shard, metavar="K/N", help=text)


def _shard(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)/(\d+)", text)
    if not found or not 1 <= int(found[1]) <= int(found[2]):
        raise pytest.UsageError(f"--shard {text}: must be K/N with K from 1 to N, such as 3/8")
    return int(found[1]), int(found[2])


def pytest_configure(config: pytest.Config) -> None:
    """Look up which packages --changed selects; workers get them from the main process."""
    commit = config.getoption("changed")
    if commit is None:
        config.stash[affected.WHOLE] = ([], [])
    elif hasattr(config, "workerinput"):
        config.stash[affected.WHOLE] = config.workerinput["whole"]  # pyright: ignore
    else:
        try:
            touched = affected.touched(commit)
        except ValueError as error:
            raise pytest.UsageError(f"--changed: {error}") from None
        config.stash[affected.WHOLE] = (sorted(touched), sorted(affected.importers(touched)))


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Tell a worker which packages --changed selects."""
    node.workerinput["whole"] = node.config.stash[affected.WHOLE]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark slow tests, then deselect what this run leaves out."""
    found = tests(items, durations.load())
    for test in found:
        if test.all_s > FAST_S:
            for case in test.cases:
                case.add_marker(pytest.mark.slow)
    kept = set(items)
    if config.getoption("shard"):
        kept = {case for test in shard(found, *config.getoption("shard")) for case in test.cases}
    elif config.getoption("brief"):
        briefs = {test: test.brief() for test in found}
        in_whole = whole(found, *config.stash[affected.WHOLE], config.getoption("turn"))
        briefs |= {test: test.cases for test in in_whole}
        kept = {case for brief in briefs.values() for case in brief}
        line = (
            f"left to make test-all: {len(items) - len(kept)} of {len(items)} cases, "
            f"among them {list(briefs.values()).count([])} of {len(found)} tests whole"
        )
        if hasattr(config, "workeroutput"):
            config.workeroutput["left"] = line  # pyright: ignore
        config.stash[LEFT] = line
    if len(kept) < len(items):
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = [item for item in items if item in kept]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Hear from a worker what was left."""
    if "left" in getattr(node, "workeroutput", {}):
        node.config.stash[LEFT] = node.workeroutput["left"]


def pytest_report_header(config: pytest.Config) -> str | None:
    """Name the packages whose tests run whole."""
    if config.getoption("changed") is None:
        return None
    changed, importing = config.stash[affected.WHOLE]
    return f"whole tests of {', '.join(changed)}; and of importers: {', '.join(importing)}"


def pytest_unconfigure(config: pytest.Config) -> None:
    """Say what was left, in the last line."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if reporter and LEFT in config.stash and not hasattr(config, "workeroutput"):
        reporter.write_line(config.stash[LEFT])
