"""The modulation of a correlation sensor, of any frequency."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_amcw_pulse


def test_any_wave(submission):
    """Several waves side by side, one without an offset."""
    random = submission.random
    frequencies = np.exp(random.uniform(np.log(2e6), np.log(2e8), 3))
    offsets = [None, *random.uniform(-6, 6, 2)]
    opl = np.sort(random.uniform(0, 50, 500))
    each = list(zip(map(float, frequencies), offsets, strict=True))
    came = submission.ask("modulations", each=each, opl=opl)
    for (frequency, offset), wave in zip(each, came, strict=True):
        phase = 0.0 if offset is None else offset
        what = f"at {frequency / 1e6:.4g} MHz, phase_offset = {phase:.3f}"
        wanted = np.cos(2 * np.pi * frequency * opl / formulas.SPEED_OF_LIGHT + phase)
        expect.close(
            wave["values"],
            wanted,
            f"m(opl) {what}",
            rtol=0,
            atol=1e-3,
            hint="cos(ω opl/c + phase_offset), c = 299 792 458 m/s, radians",
            x=opl,
            x_label="opl [m]",
        )
        expect.close(wave["omega"], 2 * np.pi * frequency, f"omega {what}", rtol=1e-5)
        expect.close(wave["frequency_hz"], frequency, f"frequency_hz {what}", rtol=1e-5)
        expect.close(wave["phase_offset"], phase, f"phase_offset {what}", rtol=1e-5)


def test_any_range(submission):
    """Half a wavelength of the modulation."""
    frequencies = np.exp(submission.random.uniform(np.log(1e6), np.log(5e8), 3))
    came = submission.ask(
        "modulations", each=[(float(f), None) for f in frequencies], opl=np.ones(2)
    )
    wanted = formulas.SPEED_OF_LIGHT / 2 / frequencies
    expect.close([w["range"] for w in came], wanted, "unambiguous range [m]", rtol=1e-5)
