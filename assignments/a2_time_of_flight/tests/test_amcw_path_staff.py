"""Correlation images and phasors: drawn scenes, frequencies and pictures."""

import math

import formulas
import numpy as np
import pytest
import tracers_staff
from pictures_staff import drawn_view, expect_pictures
from scenes_staff import diffuse, point, sphere, square

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_amcw_path

NAME = "AMCWTransientPath"


def test_any_lights(submission):
    """Several lamps over a floor, and rays without light."""
    tracers_staff.lights(submission, NAME)


def test_any_material(submission):
    """A panel over plates of several materials."""
    tracers_staff.surfaces(submission, NAME)


def test_long_paths(submission):
    """Many bounces in a colored sphere."""
    tracers_staff.bounces(submission, NAME)


def test_pictures(submission):
    """Pictures of any size, in color, by a modulation of any slope."""
    random = submission.random
    view, colors, value = drawn_view(random)
    ramp = random.uniform(0.2, 1.0), random.uniform(0.1, 0.5)
    came = submission.ask(
        "amcw_pictures", view=view, colors=colors, ramp=ramp, spp=1024, seed=submission.seed
    )
    wanted = value(lambda light, opl: light * (ramp[0] + ramp[1] * opl))
    expect_pictures(came, wanted, "picture of render_single_amcw", 0.008)


def test_phasor_of_one_sample(submission):
    """I and Q of the same path: one sample, lit by a flash, has one length and its light."""
    random = submission.random
    height, intensity, albedo = random.uniform(1.0, 2.0), *random.uniform(0.3, 0.9, (2, 3))
    eye = (0.0, 0.0, float(height))
    parts = {"floor": square((0, 0, 0), 20.0, diffuse(albedo)), "flash": point(eye, intensity)}
    came = submission.ask(
        "amcw_phasors",
        parts=parts,
        view={"origin": eye, "target": (0, 0, 0), "fov": 60.0, "size": (3, 2)},
        frequency_hz=float(random.uniform(1e7, 2.2e7)),
        spp=1,
        seed=submission.seed,
    )
    for name, values in zip(("I", "Q", "amplitude", "phase", "depth"), came, strict=True):
        expect.shape(values, (16, 2, 3, 3), f"{name}, 16 seeds")
    hint = "I and Q from the same random numbers: two renders with one seed, or one trace"
    lit = came[2] > 0
    expect.true(lit.mean() > 0.2, "light at 1 spp, under 16 seeds: (almost) none came", hint=hint)
    wanted = np.broadcast_to(albedo / math.pi * intensity * height, lit.shape)[lit]
    I, Q, amplitude, phase, depth = (values[lit] for values in came)  # noqa: E741
    farthest = height * math.sqrt(1 + math.tan(math.radians(30)) ** 2 * (1 + 4 / 9)) + 0.01
    what = f"depth of one sample: from {height:.3f} m to {farthest:.3f} m"
    inside = depth.min() > height - 0.01 and depth.max() < farthest
    expect.true(inside, f"{what}; came {depth.min():.3f} m to {depth.max():.3f} m", hint=hint)
    share = amplitude / (wanted / depth**3)
    middle = np.median(share)  # above 1 if some samples are dark
    expect.true(middle > 0.99, f"amplitude of one sample: its light; came {middle:.3f} times that")
    what = "amplitude over that of a path of this depth, at 1 spp, over the median"
    expect.close(share / middle, np.ones(depth.shape), what, rtol=5e-3, hint=hint)
    what = "I + iQ over amplitude x exp(i phase)"
    expect.close(I / amplitude, np.cos(phase), what, rtol=0, atol=2e-3)
    expect.close(Q / amplitude, np.sin(phase), what, rtol=0, atol=2e-3)
    differ = np.ptp(came[4], axis=0).max() > 1e-3
    expect.true(differ, "depths under 16 seeds: several; came one", hint="use the seed")


def test_phasor_of_bounces(submission):
    """The phasor of all bounces in a sphere, eight segments deep."""
    random = submission.random
    radius = random.uniform(0.8, 1.6)
    albedo = random.permutation([0.9, 0.6, 0.3])
    intensity = random.uniform(1, 4, 3)
    frequency = float(random.uniform(1e7, 3e7))
    parts = {"ball": sphere(radius, albedo), "lamp": point((0, 0, 0), intensity)}
    I, Q, amplitude, phase, depth = submission.ask(  # noqa: E741
        "amcw_phasors",
        parts=parts,
        view={"origin": (0, 0, 0), "target": (0, 0, 1), "fov": 40.0, "size": (2, 1)},
        frequency_hz=frequency,
        spp=4096,
        seed=submission.seed,
    )
    k = 2 * math.pi * frequency / formulas.SPEED_OF_LIGHT
    r = 2 * radius * (np.arange(4000) + 0.5) / 4000
    chord = np.mean(np.exp(1j * k * r) * r) / radius
    wanted = sum(
        albedo**n * intensity / (math.pi * radius**2) * np.exp(2j * k * radius) * chord ** (n - 1)
        for n in range(1, 8)
    )
    hint = "P = Σ L exp(+i 2π f opl/c) over all bounces; max_depth is 8 by default"
    for name, values, part in (("I", I, wanted.real), ("Q", Q, wanted.imag)):
        part = np.broadcast_to(part, (1, 2, 3))
        expect.estimate(values, part, f"{name} of all bounces", rounding=3e-3, hint=hint)
    share = (I + 1j * Q) / np.abs(wanted)
    expect.noise(np.stack([share.real, share.imag], 1), 0.05, "phasor, over its amplitude")
    what = "amplitude and phase, against I and Q"
    expect.close(amplitude, np.hypot(I, Q), what, rtol=1e-3)
    expect.close(np.cos(phase - np.arctan2(Q, I)), np.ones(I.shape), what, rtol=1e-4)
    turns = np.mod(phase, 2 * math.pi) / (2 * math.pi)
    reach = formulas.SPEED_OF_LIGHT / 2 / frequency
    what = "depth over c/2f, against the phase's turns"
    expect.close(depth / reach, turns, what, rtol=0, atol=1e-3, hint="c (phase mod 2π) / (4π f)")
