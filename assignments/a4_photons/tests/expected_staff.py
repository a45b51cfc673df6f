"""Write expected.npz, with what the public tests expect: `python tests/expected_staff.py`.

Run the script again when inputs of the tests have changed. `tofrender new-term a4` runs it. The
closed forms stay with the staff, because they solve the problems.
"""

from __future__ import annotations

from pathlib import Path

import formulas_staff as formulas
import numpy as np
import test_bound
import test_dead_time
import test_depth_map
import test_itof
import test_jitter
import test_pile_up


def pile_up():
    """Probabilities, counts, their correction and its variance."""
    cycles = test_pile_up.CYCLES
    found = {}
    for name, rates in (("", test_pile_up.RATES), ("several_", test_pile_up.SEVERAL)):
        p = formulas.first_photon(rates)
        counts = np.rint(p * cycles).astype(np.int64)
        found |= {f"{name}first_photon": p, f"{name}counts": counts}
        found[f"{name}coates"] = formulas.coates(counts, cycles)
        found[f"{name}variance"] = formulas.coates_variance(rates, cycles)
    return found


def dead_time():
    """Detections and their second moments."""
    rates = test_dead_time.RATES
    dead = test_dead_time.DEAD
    return {
        "non_paralysable": [formulas.by_patterns(row, dead)[0] for row in rates],
        "paralysable": [formulas.by_patterns(row, dead, True)[0] for row in rates],
        "free_running": [formulas.free_running(row, dead) for row in rates],
        "means": [formulas.by_patterns(rates[0], d)[0] for d in (0, dead, rates.shape[1])],
        "second_moments": formulas.by_patterns(rates[0], dead)[1],
    }


def jitter():
    """Stamps of detections."""
    t = test_jitter
    return {
        "stamps": formulas.jittered(t.DETECTIONS, t.MASSES, False),
        "late_stamps": formulas.jittered(t.DETECTIONS, t.LATE, False),
        "stamps_of_a_cycle": formulas.jittered(t.CYCLE, t.MASSES, True),
    }


def depth():
    """Bounds."""
    t = test_depth_map
    own = (test_depth_map.SIGMA, 0.0, test_depth_map.WIDTH)
    return {
        "bounds": [
            formulas.depth_bound(test_bound.SIGNALS, b, test_bound.SIGMA, 0.0, 0.02)
            for b in test_bound.BACKGROUNDS
        ],
        "bound_of_noise": formulas.depth_bound(np.array(250.0), t.BACKGROUND / 10, *own),
        "bounds_of_pixels": formulas.depth_bound(t.SIGNALS, np.array(t.BACKGROUND), *own),
    }


def itof():
    """Taps, deviations, errors."""
    t = test_itof
    found = {}
    for taps in (3, 4, 5, 8):
        electrons = formulas.expected_taps(6000.0, 2000.0, t.PHASES, t.CONTRAST, taps)
        found[f"taps_{taps}"] = electrons
        deviation = formulas.phase_deviation(t.SIGNALS, 2000.0, t.CONTRAST, taps, 15.0)
        found[f"deviation_{taps}"] = deviation
    wave = formulas.expected_taps(1e4, 0.0, t.PHASES, t.CONTRAST, 4, t.HARMONICS)
    found["taps_with_harmonics"] = wave
    found["multipath"] = formulas.multipath_phase_error(t.RATIOS, t.DIFFERENCES)
    return found


if __name__ == "__main__":
    parts = pile_up() | dead_time() | jitter() | depth() | itof()
    np.savez_compressed(Path(__file__).with_name("expected.npz"), **parts)
