"""Speed of this machine, which scales the time limits of rubrics."""

import math
import time
from functools import cache

import numpy as np

NOMINAL_S = (
    0.04  # processor time of `_work` on a machine where the rubrics' times were measured [s]
)
MOST = 10.0  # largest factor
REPEATS = 3


@cache
def slowness() -> float:
    """Return the factor by which this machine is slower than the machine of the rubrics.

    The factor is the processor time of a fixed piece of work, in Python and NumPy, divided by its
    nominal time. It is at least 1, so that a fast machine does not shorten time limits, and at
    most 10. The fastest of three measurements counts.
    """
    seconds = []
    for _ in range(REPEATS):
        begin = time.process_time()
        _work()
        seconds.append(time.process_time() - begin)
    return min(MOST, max(1.0, min(seconds) / NOMINAL_S))


def _work() -> float:
    """Run the fixed work: a loop in Python, and sums and exponentials of arrays."""
    total = 0.0
    for k in range(200_000):
        total += math.sqrt(k)
    values = np.linspace(0.0, 1.0, 500_000)
    for _ in range(6):
        values = np.exp(-values) * values
    return total + float(values.sum())
