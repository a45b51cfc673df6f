"""Processor time of each test: measured, stored in `tests/durations.json`, and watched in CI.

pytest's own `--durations` and the file of pytest-split measure by the clock, which varies by a
factor on a busy machine, and do not include child processes that run at the same time. They also
have no separate time for fixtures that several tests share. See `selection` for their use.
"""

import json
import os
from collections import defaultdict
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import pytest

from helpers import affected

FILE = Path(__file__).parents[1] / "durations.json"
"""Seconds of a case of each test function by file.

Fixtures for a module have an @. What a case takes in `make test`, where other tests may not have
compiled its kernels before, has the key of BRIEF.
"""

BRIEF = "brief {}"

STORED_S = 0.05  # Less, for all cases of a test together, is not stored and counts as 0

LIMIT_S = 12.0
"""What `make test` runs may take this long, as several threads and compilation add to it."""


def processor_s() -> float:
    """Time of all processors [s], with that of children that have ended.

    It hardly differs on a busy machine, unlike time by the clock.
    """
    return sum(os.times()[:4])


def split(nodeid: str) -> tuple[str, str]:
    """The file and the name of the test function of a node id.

    >>> split("tests/films/test_film.py::test_bins[3-4]")
    ('tests/films/test_film.py', 'test_bins')
    """
    file, _, test = nodeid.partition("[")[0].partition("::")
    return file, test


def load() -> dict[str, dict[str, float]]:
    """The stored durations, file by file."""
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.is_file() else {}


class Durations:
    """Measures what each test computes, with its own fixtures, in the process that runs it."""

    def __init__(self, strict: bool = False, whole: Collection[str] = ()) -> None:
        self.strict = strict
        self.whole = whole  # Packages of which all cases run, so that a test may take longer
        self.cases: dict[tuple[str, str], list[float]] = defaultdict(list)
        self.fixtures: dict[tuple[str, str], float] = {}
        self.own, self.shared = 0.0, {}

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef) -> Iterator[None]:
        """Measure a fixture: one for a single test belongs to that, one for many to none."""
        before = processor_s()
        try:
            return (yield)
        finally:
            spent = processor_s() - before
            if fixturedef.scope == "function":
                self.own += spent
            else:
                self.shared[fixturedef.argname] = spent

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Measure a test."""
        before = processor_s()
        try:
            return (yield)
        finally:
            spent = self.own + processor_s() - before
            item.user_properties += [("processor_s", spent), ("fixtures_s", self.shared)]
            self.own, self.shared = 0.0, {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Collect the measurements in the process that reports."""
        found: dict[str, Any] = dict(report.user_properties)
        if report.when == "call" and "processor_s" in found:
            file, test = split(report.nodeid)
            self.cases[file, test].append(found["processor_s"])
            for name, spent in found["fixtures_s"].items():
                self.fixtures[file, f"@{name}"] = max(
                    spent, self.fixtures.get((file, f"@{name}"), 0)
                )

    def too_slow(self) -> dict[str, float]:
        """Seconds of the tests that took longer than a test of `make test` may."""
        sums = {
            f"{file}::{test}": sum(cases)
            for (file, test), cases in self.cases.items()
            if affected.package_of(file) not in self.whole
        }
        return {test: spent for test, spent in sums.items() if self.strict and spent > LIMIT_S}

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail if a test was too slow."""
        if self.too_slow() and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Name the tests that were too slow, a line each."""
        for test, spent in self.too_slow().items():
            line = f"{test}: computed for {spent:.1f} s, more than {LIMIT_S:g} s: make durations"
            terminalreporter.write_line(line, red=True)


class Store(Durations):
    """Writes the measurements of the files that ran to `tests/durations.json`."""

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Write the file: a line for each test file."""
        if hasattr(session.config, "workerinput"):
            return
        stored = load()
        brief = session.config.getoption("brief")
        for file in {file for file, _ in self.cases}:
            stored[file] = stored.get(file, {}) if brief else {}
        for (file, test), cases in self.cases.items():
            key = BRIEF.format(test) if brief else test
            stored[file].pop(key, None)
            if sum(cases) >= STORED_S:
                stored[file][key] = float(f"{sum(cases) / len(cases):.2g}")
        for (file, name), spent in self.fixtures.items():
            if spent >= STORED_S:
                stored[file][name] = float(f"{spent:.2g}")
        rows = [
            f"{json.dumps(file)}: {json.dumps(stored[file], sort_keys=True)}"
            for file in sorted(stored)
            if stored[file] and (FILE.parents[1] / file).is_file()
        ]
        FILE.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --store-durations and --strict-durations."""
    parser.addoption(
        "--store-durations",
        action="store_true",
        help=f"write the processor time of each test that runs to tests/{FILE.name}",
    )
    parser.addoption(
        "--strict-durations",
        action="store_true",
        default=os.environ.get("CI", "") not in ("", "0", "false"),
        help=f"with --brief, fail if a test computes over {LIMIT_S:g} s (default under CI)",
    )


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    """Measure, if asked to."""
    if config.getoption("store_durations"):
        config.pluginmanager.register(Store(), "durations")
    elif config.getoption("strict_durations") and config.getoption("brief"):
        touched, importing = config.stash[affected.WHOLE]
        whole = [*touched, *importing]
        config.pluginmanager.register(Durations(strict=True, whole=whole), "durations")
