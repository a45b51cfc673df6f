"""A test that is slow and does not say so fails the session, where durations are strict."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import pytest

SLOW_S = 0.5
"""From here on a test needs the mark `slow`, all its cases together, on a quiet machine."""

NOISE = 12.0
"""What several threads and the kernels that a first test compiles may make of that."""

LIMIT_S = SLOW_S * NOISE


SPENT = "processor_s"


def processor_s() -> float:
    """Time of all processors [s], with that of children that have ended.

    It is the same on a busy machine, where the clock says more.
    """
    return sum(os.times()[:4])


class Durations:
    """Adds up what the cases of each test computed, and fails the session over those too slow."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    def too_slow(self) -> dict[str, float]:
        """Seconds of the tests that need the mark and do not have it."""
        return {test: s for test, s in self.seconds.items() if s > LIMIT_S}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Measure a test's own time, in the process that runs it; fixtures' is nobody's."""
        before = processor_s()
        try:
            return (yield)
        finally:
            item.user_properties.append((SPENT, processor_s() - before))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Count it."""
        if report.when == "call" and "slow" not in report.keywords:
            spent = dict(report.user_properties).get(SPENT, 0.0)
            self.seconds[report.nodeid.partition("[")[0]] += float(str(spent))

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail."""
        if self.too_slow() and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Name them, a line each."""
        for test, seconds in self.too_slow().items():
            line = f"{test}: computed for {seconds:.1f} s; must be marked slow, or take {SLOW_S} s"
            terminalreporter.write_line(line, red=True)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --strict-durations."""
    parser.addoption(
        "--strict-durations",
        action="store_true",
        default=os.environ.get("CI", "") not in ("", "0", "false"),
        help=f"fail if a test without the mark slow computes over {LIMIT_S:g} s (default under CI)",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Watch, if asked to."""
    if config.getoption("strict_durations"):
        config.pluginmanager.register(Durations(), "durations")
