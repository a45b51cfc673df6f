"""a3.caustics: light that mirrors and glass have sent."""

import formulas
import numpy as np
import pytest
from test_light_tracer import check_bins, render

from tofrender.course.judge import expect
from tofrender.course.judge.factors import Ratio

pytestmark = pytest.mark.a3_caustics

number = formulas.inputs.number
SLAB = {"bottom": 0.5, "top": 0.8, "intensity": 1.0}
SLAB["light"] = number("lamp above the slab", 1.8, low=1.7, high=2.0)
SLAB["index"] = number("index of the slab", 1.5, low=1.4, high=1.6)
WATER = {"depth": 0.5, "intensity": 1.0}
WATER["light"] = number("lamp above the water", 1.5, low=1.4, high=1.7)
WATER["index"] = number("index of the water", 1.33, low=1.3, high=1.45)
BESIDE = (0.3, 0.1, number("lamp beside the mirror", 0.8, low=0.7, high=0.9))
BELOW = {"origin": (0, 0, 0.45), "target": (0, 0, 0), "fov": 120.0, "size": (4, 4)}


def test_through_a_slab(submission):
    """A point light through a slab of glass, on a floor."""
    bins = (10, 2.2, 0.2)
    view = BELOW | {"bins": bins}
    part, opl = formulas.through_slab(formulas.View(**view), **SLAB)
    steady, transient = render(
        submission, "under_slab", view, integrator={"max_depth": 4}, spp=4096, **SLAB
    )
    hint = "no connection ends on glass: only smooth vertices connect; the next ones go on"
    expect.estimate(steady.mean((1, 2)), part.sum(), "film's mean", rounding=3e-3, hint=hint)
    means = steady[..., 0].mean((1, 2))
    hint = "as many paths of light as there are lanes"
    expect.noise(means, 0.038 * part.sum(), "the film's mean", hint=hint)
    hint = "in glass, light takes index times as long"
    check_bins(transient, part, opl, bins, hint)


def test_into_water(submission):
    """A point light over water, and a camera in the water that looks at its floor."""
    part = formulas.into_water(formulas.View(**BELOW), **WATER)
    steady, _ = render(
        submission, "under_water", BELOW, integrator={"max_depth": 3}, spp=4096, **WATER
    )
    hint = "radiance is compressed at refraction, light's power is not: TransportMode.Importance"
    squared = WATER["index"] ** 2
    ratios = {"n²": Ratio(squared, hint), "1/n²": Ratio(1 / squared, hint)}
    expect.estimate(
        *(steady.mean((1, 2)), part.sum(), "film's mean"), rounding=3e-3, hint=hint, ratios=ratios
    )


def test_off_a_mirror(submission):
    """A point light next to a mirror, which acts as a second light behind it."""
    bins = (10, 2.0, 0.3)
    options = {"origin": (0, 0, 1), "target": (0, 0, 0), "size": (4, 4), "bins": bins}
    view = formulas.View(**options)
    lights = [BESIDE, (2 - BESIDE[0], *BESIDE[1:])]
    found = [formulas.under_point(view, view.pixels(32), at, 1.0)[:2] for at in lights]
    steady, transient = render(
        submission, "beside_mirror", options, x=1.0, light=BESIDE, intensity=1.0, spp=8192,
        integrator={"max_depth": 3},
    )  # fmt: skip
    direct, _ = render(
        submission, "beside_mirror", options, x=1.0, light=BESIDE, intensity=1.0, spp=8192,
        integrator={"max_depth": 2},
    )  # fmt: skip
    hint = "a mirror is no vertex that connects, and is a segment more"
    each = [radiance.mean() for radiance, _ in found]
    expect.estimate(direct.mean((1, 2)), each[0], "film's mean, depth 2", rounding=3e-3, hint=hint)
    expect.estimate(
        steady.mean((1, 2)), sum(each), "film's mean, depth 3", rounding=3e-3, hint=hint
    )
    part = np.concatenate([r.ravel() / r.size for r, _ in found])
    opl = np.concatenate([o.ravel() for _, o in found])
    check_bins(transient, part, opl, bins, hint)
