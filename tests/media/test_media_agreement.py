"""Scenes in fog, smoke and milk: the energy of all bins is what Mitsuba's `volpath` sees.

Connections of `volpath` lose light where they pass a boundary shortly before a lamp or a surface:
the epsilons of its rays add up, and a part of the lamp hides behind itself. (A cube of fog that is
almost empty, 5 cm from the walls of the Cornell box, takes 1.3 % of the picture's light.) In the
scenes below, boundaries are far from all else.
"""

import mitsuba as mi
import numpy as np
import pytest
from helpers.fogs import DEPTH, SCENES, looked_at
from helpers.support import agree, load, over_seeds, steady_twin

pytestmark = pytest.mark.statistical
SEEDS = range(8)
SPP = 1024


ONE_SAMPLE = {"type": "path_tracer_mis", "technique": "one_sample"}


@pytest.mark.parametrize(
    ("name", "integrator"), [*((name, {}) for name in SCENES), ("cloud under a sky", ONE_SAMPLE)]
)
def test_energy_is_that_of_volpath(name, integrator):
    description = looked_at(SCENES[name], **integrator)
    ours, theirs = load(description), load(steady_twin(description))
    volpath = mi.load_dict({"type": "volpath", "max_depth": DEPTH, "rr_depth": 20})

    def mean(seed: int) -> np.ndarray:
        return np.array(mi.render(ours, spp=SPP, seed=seed)[0], float).mean((0, 1))

    def expected(seed: int) -> np.ndarray:
        image = mi.render(theirs, integrator=volpath, spp=SPP, seed=seed + 1000)
        return np.array(image, float).mean((0, 1))

    samples, reference = over_seeds(mean, SEEDS), over_seeds(expected, SEEDS)
    assert agree(samples, reference, rounding=2e-4)
