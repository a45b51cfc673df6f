"""The scene at one instant, and at many: drawn scenes, pulses and pictures."""

import formulas
import numpy as np
import pytest
import tracers_staff
from pictures_staff import drawn_view, expect_pictures

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_time_gated

NAME = "TimeGatedTransientPath"


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
    """The pulse that is set, or a Gaussian of the width that is asked for, 0.03 m by default."""
    random = submission.random
    view = formulas.OVER
    light, opl = formulas.lamp(formulas.X, 0.0, view["origin"])
    width = float(random.uniform(0.01, 0.3))
    first = float(random.uniform(-0.5, 0.3))
    last = first + float(random.uniform(0.1, 0.6))
    for pulse, options, density, most in (
        (None, {}, lambda t: formulas.gaussian(t, 0.03), 0.1),
        (None, {"pulse_width_opl": width}, lambda t: formulas.gaussian(t, width), 3 * width),
        (("slope", first, last), {}, lambda t: formulas.slope(t, first, last), 0.0),
    ):
        offsets = random.uniform(-most, most, 6) if most else random.uniform(first + 0.01, last, 6)
        offsets = np.append(offsets, first - 0.01 if pulse else -6 * most)
        came = submission.ask(
            "gate_profile", view=view, times=opl + offsets, pulse=pulse, options=options
        )
        wanted = light * density(offsets)
        expect.close(
            came,
            wanted,
            f"radiance per meter along a ray, pulse {pulse or 'Gaussian'}, {options or 'defaults'}",
            rtol=3e-3,
            atol=3e-3 * wanted.max(),
            hint="self.pulse.eval(target_time - opl), whatever the pulse is",
        )


def test_pictures(submission):
    """Pictures of any size, in color, of one gate and of many, with a pulse of any shape."""
    random = submission.random
    view, colors, value = drawn_view(random)
    first = float(random.uniform(-1.4, -1.0))  # Nearly all of it comes before its center
    pulse = ("slope", first, first + float(random.uniform(0.9, 1.2)))
    gates = (int(random.integers(5, 9)), 2.0 + float(random.uniform(0, 0.3)), 0.15)
    time = float(random.uniform(2.6, 3.2))
    came = submission.ask(
        "gate_pictures",
        view=view,
        colors=colors,
        pulse=pulse,
        gates=gates,
        time=time,
        spp=1024,
        seed=submission.seed,
    )
    times = gates[1] + gates[2] * (np.arange(gates[0]) + 0.5)

    def at(t):
        return lambda light, opl: light * formulas.slope(t - opl, *pulse[1:])

    expect_pictures(came["one"], value(at(time)), "picture of render_at_time", 0.016)
    wanted = np.stack([value(at(t)) for t in times], axis=2)
    hint = "a path at opl reaches gates from opl + support[0] to opl + support[1]: both ends count"
    expect_pictures(came["many"], wanted, "cube of render_transient", 0.016, hint=hint)
