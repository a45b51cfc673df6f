"""A beam with a width, which lights a spot."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_area_spot

DEVICE = (0.0, -0.05, 0.33)
TARGET = (0.1, 0.1, 0.0)
WALL = 0.8
HIDDEN = 0.6
POWER = 2.5
PATCH = formulas.patch((0.35, 0.1, 0.4), tilt=10, azimuth=20, half=(0.15, 0.1), cells=30)


def render(submission, bins, sigma, spp=32768):
    steady, transient = submission.ask(
        "confocal",
        scene="around_corner",
        view={"origin": DEVICE, "target": TARGET, "bins": bins},
        spp=spp,
        seed=submission.seed,
        wall_albedo=WALL,
        hidden=[(PATCH[3], HIDDEN)],
        integrator={
            "max_depth": 3,
            "power": POWER,
            "use_nlos_only": True,
            "spot_sigma": sigma,
        },
    )
    return steady[:, 0, 0, 0], transient[:, 0, 0, :, 0]


def three(lit):
    points, towards, area, _ = PATCH
    return formulas.three_bounces(points, towards, area, lit, TARGET, DEVICE, POWER, WALL, HIDDEN)


def spread(sigma):
    """(length, light) of all spots of the beam together."""
    every = [(share, *three(spot)) for spot, share in formulas.spots(DEVICE, TARGET, sigma)]
    return (
        np.concatenate([length for _, length, _ in every]),
        np.concatenate([share * light for share, _, light in every]),
    )


def test_narrow_beam_is_a_point(submission):
    """A beam of a millimeter gives what the point gives, a very wide one does not."""
    wanted = three(TARGET)[1].sum()
    wide = render(submission, (40, 1.5, 0.1), 0.3)[0].mean()
    what = f"light with spot_sigma = 0.3: expected other than that of a point, {wanted:.4g}"
    hint = "is self.spot_sigma used, in radians?"
    expect.true(abs(wide / wanted - 1) > 0.025, f"{what}; came {wide:.4g}", hint=hint)
    steady, _ = render(submission, (40, 1.5, 0.1), 1e-3)
    hint = "the beam carries Φ in all: no division by the spot's area or by its density"
    expect.estimate(steady, wanted, "light with a narrow beam", rounding=3e-3, hint=hint)


def test_wide_beam(submission):
    """A wide beam lights the wall elsewhere, under other cosines."""
    _, light = spread(0.3)
    steady, _ = render(submission, (40, 1.5, 0.1), 0.3)
    hint = "directions (x, y, 1) with x and y normal, of standard deviation tan(spot_sigma)"
    expect.estimate(steady, light.sum(), "light with a wide beam", rounding=1e-2, hint=hint)


def test_wide_beam_in_time(submission):
    """Each point of the spot has its own way from the laser and to the hidden patch."""
    length, light = spread(0.3)
    bins = (4, 1.5, 0.1)
    _, transient = render(submission, bins, 0.3)
    edges = bins[1] + bins[2] * np.arange(bins[0] + 1)
    expect.estimate(
        transient,
        formulas.binned(edges, length, light),
        "radiance per bin",
        rounding=1e-2,
        hint="device to spot, spot to patch, patch to p, p to device",
        x=edges[:-1] + bins[2] / 2,
        x_label="opl [m]",
    )
