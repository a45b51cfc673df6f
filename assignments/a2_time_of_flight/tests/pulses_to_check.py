"""Correct and wrong pulses for the test that students write, in the student's process."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from worlds import Decay, Hat

__all__ = ["Decay", "Hat", "Late", "Loud"]


class Loud(Hat):
    """Twice the energy."""

    def eval(self, t):
        return 2 * super().eval(t)


class Late(Decay):
    """Wrong samples: uniform between 0 and three times the width."""

    def sample(self, xi):
        return 3 * self.width_opl * xi, mi.Float(1) + dr.zeros(mi.Float, dr.width(xi))
