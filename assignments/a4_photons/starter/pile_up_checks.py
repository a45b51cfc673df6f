"""Problem a4.pile_up_checks: a test of pile-up and its correction."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import numpy as np


def check_pile_up(pile_up) -> None:
    """Raise an AssertionError, with or without a message, if a solution breaks its contract.

    Args:
        pile_up: A module that solves a4.pile_up, with the functions `first_photon(rates)`,
            `coates(counts, cycles)` and `coates_variance(rates, cycles)`. Their contracts are in
            `pile_up.py`.
    """
    raise NotImplementedError("a4.pile_up_checks: check_pile_up")
