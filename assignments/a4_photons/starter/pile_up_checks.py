"""Problem a4.pile_up_checks: a test of pile-up and its correction."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import numpy as np


def check_pile_up(pile_up) -> None:
    """Raise an AssertionError if a solution of a4.pile_up breaks its contract; it may say how.

    Args:
        pile_up: A module with the functions `first_photon(rates)`, `coates(counts, cycles)` and
            `coates_variance(rates, cycles)`, whose contracts are in `pile_up.py`.
    """
    raise NotImplementedError("a4.pile_up_checks: check_pile_up")
