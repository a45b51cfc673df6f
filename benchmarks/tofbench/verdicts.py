"""Judge independent runs of a case, with a known false-alarm rate.

A case has readings, which are sums of bins or separate numbers. For each reading, t is the distance
of the mean from the exact value, divided by the standard error, with R - 1 degrees of freedom. A
renderer fails a case if one of the p-values is too small. The threshold is given by Sidak's formula
for all readings of all cases, so that a correct renderer fails anywhere with a probability of at
most ALPHA.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from scipy.stats import t as student

ALPHA = 1e-3
"""Probability that a correct renderer fails one or more cases."""

PART = 0.05
"""Neighboring bins are summed until they contain this fraction of the light."""


def grouped(expected: np.ndarray) -> np.ndarray:
    """Return readings of the bins of a pixel, as rows of weights.

    The first row is the sum. The other rows are ranges of dark bins, and groups of bins with the
    fraction `PART` of the light.
    """
    rows = [np.ones(expected.size)]
    row = np.zeros(expected.size)
    held = 0.0
    total = expected.sum()
    for k, value in enumerate(expected):
        # End the group between dark and bright bins
        if k and (value == 0) != (expected[k - 1] == 0) and row.any():
            rows.append(row)
            row = np.zeros(expected.size)
            held = 0.0

        # Add the bin to the group
        row[k] = 1
        held += value
        if held >= PART * total:
            rows.append(row)
            row = np.zeros(expected.size)
            held = 0.0
    return np.array([*rows, row] if row.any() else rows)


def readings_of(case) -> np.ndarray:
    """Return the weights of the readings of a case, (readings, numbers of the result)."""
    if case.readings is not None:
        return np.asarray(case.readings, float)
    expected = case.expected
    if case.bins["quantity"] not in ("bins", "steady"):
        return np.eye(expected.size)

    # Group the bins of each pixel
    pixels = expected.reshape(-1, expected.shape[-1])
    rows = []
    for k, pixel in enumerate(pixels):
        for row in grouped(pixel):
            rows.append(np.zeros(pixels.shape))
            rows[-1][k] = row
    return np.array(rows).reshape(len(rows), -1)


@dataclass
class Verdict:
    """Result of one renderer in one case.

    Attributes:
        status: passed, failed, not supported, or error.
        form: The compared quantity: the quantity of the case, steady, or delays.
        bias: The t with the largest absolute value of all readings.
        reading: Index, mean, standard error and exact value of this reading.
        energy: All light divided by the exact value, and the standard error.
        seconds: Processor time until the relative error is 1 %; 0 if each sample is exact.
        note: Reason for a missing verdict.
    """

    status: str
    form: str = ""
    bias: float | None = None
    reading: list[float] | None = None
    energy: list[float] | None = None
    seconds: float | None = None
    note: str = ""

    def as_dict(self) -> dict:
        """Return the attributes as a dict."""
        return asdict(self)


def threshold(count: int, alpha: float = ALPHA) -> float:
    """Return the smallest allowed p-value of each of `count` readings (Sidak)."""
    return -np.expm1(np.log1p(-alpha) / count)


def judge(case, runs: np.ndarray, cpu_s: float, allowed: float) -> Verdict:
    """Compare runs (R, height, width, numbers) with a case's expected values.

    Args:
        case: The case, in the form that was rendered.
        runs: The results.
        cpu_s: Processor time of one run [s].
        allowed: The smallest p-value that passes, see `threshold`.
    """
    # Has the result the right shape?
    form = case.bins["quantity"]
    expected = case.expected
    weights = readings_of(case)
    flat = runs.mean(axis=(1, 2)) if expected.ndim == 1 and runs.ndim == 4 else runs
    if flat.shape[1:] != expected.shape:
        note = f"result of shape {runs.shape[1:]}, expected {(*case.pixels, expected.shape[-1])}"
        return Verdict("failed", form, note=note)

    # Compute the readings of each run
    found = flat.reshape(len(flat), -1) @ weights.T
    exact = weights @ expected.ravel()
    if not np.isfinite(found).all():
        return Verdict("failed", form, note="not finite")
    if form == "delays":
        found = (found > 0.5).astype(float)

    # Compare with the exact values, with noise and rounding
    noise = found.var(axis=0, ddof=1) / len(found)
    error = case.error if case.error is None else weights**2 @ case.error.ravel() ** 2
    rounding = case.rounding * (np.abs(exact) + 0.1 * np.abs(weights @ np.abs(expected.ravel())))
    rounding = rounding + 0.1 * case.rounding * np.abs(exact).max()
    spread = np.sqrt(noise + (0 if error is None else error) + rounding**2)
    t = (found.mean(axis=0) - exact) / spread
    p = 2 * student.sf(np.abs(t), len(found) - 1)
    worst = int(np.argmax(np.abs(t)))

    # Describe the worst reading, the energy and the speed
    mean = found.mean(axis=0)
    norm = np.linalg.norm(exact)
    relative = float(np.sqrt((noise * len(found)).sum()) / norm) if norm else 0.0
    result = Verdict("passed" if p.min() >= allowed else "failed", form, float(t[worst]))
    result.reading = [worst, float(mean[worst]), float(noise[worst] ** 0.5), float(exact[worst])]
    if form in ("bins", "steady") and exact[0]:
        result.energy = [float(mean[0] / exact[0]), float(noise[0] ** 0.5 / abs(exact[0]))]
    if form != "delays":
        result.seconds = cpu_s * (relative / 0.01) ** 2
    return result
