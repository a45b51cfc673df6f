"""Path tracing into the bins of a film: drawn scenes, pulses, windows and pictures."""

from itertools import pairwise

import formulas
import numpy as np
import pytest
import tracers_staff
from pictures_staff import drawn_view, expect_pictures

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_transient_path

NAME = "TransientPath"
RADIANCE, OPL = (float(v) for v in formulas.lamp(formulas.X, 0.0, formulas.OVER["origin"]))


def test_any_lights(submission):
    """Several lamps over a floor, and rays without light."""
    tracers_staff.lights(submission, NAME)


def test_any_material(submission):
    """A panel over plates of several materials."""
    tracers_staff.surfaces(submission, NAME)


def test_long_paths(submission):
    """Many bounces in a colored sphere."""
    tracers_staff.bounces(submission, NAME)


def test_any_pulse(submission):
    """Pulses that are not symmetric, wide or narrow, and windows that cut them."""
    random = submission.random
    first = random.uniform(-0.5, 0.2)
    last = first + random.uniform(0.3, 0.8)
    width = random.uniform(0.05, 0.12)
    sigma = float(random.uniform(0.02, 0.15))
    wide = ("slope", first, last), lambda t: formulas.slope_cdf(t, first, last)
    narrow = ("slope", -0.006, 0.004), lambda t: formulas.slope_cdf(t, -0.006, 0.004)
    gauss = sigma, lambda t: formulas.gaussian_cdf(t, sigma)
    for (pulse, cdf), start, number in (
        (wide, OPL + first - 2.3 * width, 6),
        (wide, OPL + first + random.uniform(0.3, 0.7) * (last - first), 20),
        (narrow, OPL + random.uniform(-0.003, 0.002) - 3 * width, 6),
        (gauss, OPL - 2.4 * sigma, 12),
        ((None, lambda t: np.asarray(t > 0, float)), OPL - 2.5 * width, 6),
    ):
        steady, transient = submission.ask(
            "film",
            scene="lamp",
            view=formulas.OVER | {"bins": (number, float(start), float(width))},
            pulse=pulse,
            spp=4096,
            seed=submission.seed,
        )
        edges = start + width * np.arange(number + 1)
        wanted = RADIANCE * np.diff(cdf(edges - OPL))
        came = transient[:, 0, 0, :, 0]
        what = f"radiance per bin, pulse {pulse}"
        expect.close(came.mean(0), wanted, what, rtol=0, atol=0.03 * RADIANCE)
        some = wanted > 1e-3 * RADIANCE
        expect.estimate(
            came[:, some],
            wanted[some],
            what,
            rounding=6e-3,
            hint="cdf(b - opl) - cdf(a - opl) for the bin from a to b; what is outside of the "
            "window is lost, and goes to no other bin",
            x=(edges[:-1] + width / 2)[some],
            x_label="opl [m]",
        )
        expect.noise(came / RADIANCE, 0.015, what + ", over the radiance", hint="all of the pulse")
        expect.close(steady[:, 0, 0, 0], RADIANCE, "steady image, which has no pulse", rtol=3e-3)


def test_lanes_of_a_pulse(submission):
    """A contribution goes into the film, of lanes that have one and of no others."""
    random = submission.random
    first = random.uniform(-0.5, 0.2)
    number = 4000
    active = random.random(number) < 0.5
    opl = random.uniform(1.0, 4.0, number)
    pulse = ("slope", first, first + random.uniform(0.1, 0.8))
    came = submission.ask("spread_lanes", pulse=pulse, opl=opl, active=active)
    if came is not None:
        hint = "hand `active` on to put"
        others = came[~active]
        what = "light of lanes that have no contribution"
        expect.close(others, np.zeros(others.shape), what, atol=1e-6, hint=hint)
        expect.true(came[active].max() > 0, "light of lanes that have one: none came", hint=hint)


def test_pictures(submission):
    """Films of any size, in color."""
    random = submission.random
    view, colors, value = drawn_view(random)
    first = float(random.uniform(-0.4, 0.1))
    pulse = ("slope", first, first + float(random.uniform(0.4, 0.9)))
    bins = (int(random.integers(5, 9)), 3.0 + float(random.uniform(0, 0.3)), 0.25)
    steady, transient = submission.ask(
        "film",
        scene="lamp",
        view=view | {"bins": bins},
        pulse=pulse,
        spp=1024,
        seed=submission.seed,
        colors=colors,
    )
    edges = bins[1] + bins[2] * np.arange(bins[0] + 1)

    def between(a, b):
        def weight(light, opl):
            cdf = [formulas.slope_cdf(t - opl, *pulse[1:]) for t in (a, b)]
            return light * (cdf[1] - cdf[0])

        return value(weight)

    wanted = np.stack([between(a, b) for a, b in pairwise(edges)], axis=2)
    for values, right, what in (
        (transient, wanted, "bins"),
        (steady, value(lambda light, opl: light), "steady image"),
    ):
        came = {"values": values, "again": values[0]}
        expect_pictures(came, right, what, 0.03, is_single=False)
