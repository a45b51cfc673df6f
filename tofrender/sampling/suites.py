"""A sampler and its density as one test case, and suites of cases that share one chance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import mitsuba as mi

from ..runtime import checks
from . import domains
from .chi_square import check_chance, chi_square_test
from .verdicts import Verdict


@dataclass(frozen=True)
class Case:
    """A sampler and its density, with the arguments of `chi_square_test` that belong to them.

    Attributes:
        sample: Uniform numbers to points, or (points, weights), or (points, weights, densities).
        pdf: Points to densities.
        domain: Domain of the points.
        name: Name in the verdict.
        sample_dimension: Uniform numbers per sample, 2 or 3.
        expected_moments: Known moments, if any.
    """

    sample: Callable[[Any], Any]
    pdf: Callable[[Any], mi.Float]
    domain: Any
    name: str = ""
    sample_dimension: int = 2
    expected_moments: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        """Check the arguments."""
        checks.function("sample", self.sample)
        checks.function("pdf", self.pdf)
        domains.find(self.domain)
        checks.instance("name", self.name, str, "text")
        checks.integer("sample_dimension", self.sample_dimension, 2, 3)
        checks.mapping("expected_moments", self.expected_moments)

    def test(self, **options: Any) -> Verdict:
        """Run `chi_square_test` with the keyword arguments given.

        Example:
            >>> import drjit as dr
            >>> even = lambda p: dr.full(mi.Float, 1, dr.width(p))
            >>> Case(lambda sample: sample, even, "square").test(samples=20_000).passed
            True
        """
        return chi_square_test(**vars(self), **options)


@dataclass(frozen=True)
class SuiteVerdict:
    """Verdicts of several tests that share one chance of a false alarm.

    Attributes:
        passed: Whether all passed.
        alpha: Chance that any of them fails though all samplers are right.
        verdicts: One for each case, in order.
    """

    passed: bool
    alpha: float
    verdicts: tuple[Verdict, ...]

    def __str__(self) -> str:
        """One line a case, and all of each that failed."""
        good = sum(verdict.passed for verdict in self.verdicts)
        head = f"{good} of {len(self.verdicts)} passed (chance of a false alarm {self.alpha:g})"
        lines = [
            f"{v.name or 'sampler'}: passed, p = {v.p_value:.3g}" if v.passed else str(v)
            for v in self.verdicts
        ]
        return "\n".join([head, *lines])


def chi_square_suite(cases: Iterable[Case], alpha: float = 1e-3, **options: Any) -> SuiteVerdict:
    """Test several samplers, with one chance of a false alarm for all (Šidák).

    Args:
        cases: At least one; each gets a seed of its own.
        alpha: Chance that any of them fails though all are right, between 0 and 1.
        **options: For `chi_square_test`: samples, resolution, seed.

    Raises:
        ValueError: There are no cases, or an option is bad.

    Example:
        >>> from tofrender.sampling import warp_case
        >>> cases = [warp_case("tent"), warp_case("beckmann", alpha=0.3)]
        >>> chi_square_suite(cases, samples=20_000).passed
        True
    """
    given = list(cases) if isinstance(cases, Iterable) else []
    if not given or not all(isinstance(each, Case) for each in given):
        raise ValueError(f"cases = {checks.shown(cases)}: must be at least one Case, no other")
    check_chance(alpha)
    first = checks.integer("seed", options.pop("seed", 0), 0, checks.MAX_SEED - len(given))
    verdicts = tuple(
        case.test(alpha=alpha, tests=len(given), seed=first + k, **options)
        for k, case in enumerate(given)
    )
    return SuiteVerdict(all(verdict.passed for verdict in verdicts), alpha, verdicts)
