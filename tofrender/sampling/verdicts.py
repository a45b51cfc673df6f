"""What a chi-square test found, in words and as a figure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from .domains import Domain

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Moment:
    """One mean over the valid samples against that over the density, or a known value.

    Attributes:
        name: "x" is the mean of x, "xy" that of x times y, and so on.
        sampled: Mean over the valid samples.
        expected: What it should be.
        z: Their difference in standard errors.
        p_value: Chance of a difference as large.
    """

    name: str
    sampled: float
    expected: float
    z: float
    p_value: float


@dataclass(frozen=True, eq=False)
class Verdict:
    """What the test found; `print(verdict)` says it, `verdict.figure()` shows it.

    Attributes:
        name: What was tested.
        passed: Whether nothing speaks against the sampler.
        reason: Everything that does, "" if it passed.
        p_value: Chance of a chi-square statistic as large as this; NaN if it has none.
        alpha: Smallest p-value that passes, for the statistic and for each moment: the caller's
            alpha, divided by Šidák over the tests and over the p-values within this one.
        chi2: Pearson's statistic.
        degrees_of_freedom: Its degrees of freedom.
        pdf_integral: Integral of the density over the domain.
        pdf_integral_error: Bound on its error.
        valid: Share of the samples that are valid.
        moments: Moments of samples and density.
        observed: Counts of samples, shape (rows, columns).
        expected: Expected counts.
        edges: Edges of the columns and of the rows.
        domain: The domain, which names the two coordinates.
    """

    name: str
    passed: bool
    reason: str
    p_value: float
    alpha: float
    chi2: float
    degrees_of_freedom: int
    pdf_integral: float
    pdf_integral_error: float
    valid: float
    moments: tuple[Moment, ...]
    observed: np.ndarray = field(repr=False)
    expected: np.ndarray = field(repr=False)
    edges: tuple[np.ndarray, np.ndarray] = field(repr=False)
    domain: Domain = field(repr=False)

    def __str__(self) -> str:
        """The verdict, what speaks against the sampler, and the figures behind it."""
        worst = max(self.moments, key=lambda moment: abs(moment.z))
        head = f"{self.name or 'sampler'}: " + (
            "passed" if self.passed else f"FAILED, {self.reason}"
        )
        return (
            f"{head}\n  chi-square {self.chi2:.1f}, {self.degrees_of_freedom} degrees of freedom, "
            f"p = {self.p_value:.3g} (must be {self.alpha:.2g} or more)\n"
            f"  integral of the pdf {self.pdf_integral:.5f} +- {self.pdf_integral_error:.5f}, "
            f"valid samples {self.valid:.5f}, "
            f"worst moment {worst.name}: {worst.z:+.1f} standard errors"
        )

    def figure(self) -> Figure:
        """Observed and expected density and their difference, as a figure outside of pyplot."""
        from .figures import verdict_figure

        return verdict_figure(self)
