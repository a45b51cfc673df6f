"""Path tracing into the bins of a film."""

import math

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_transient_path

OVER = formulas.OVER
RADIANCE, OPL = (float(v) for v in formulas.lamp(formulas.X, 0.0, OVER["origin"]))
INSTANT = ("none", 0.0)


def film(submission, scene, view, bins, pulse=INSTANT, spp=16, **options):
    """(steady (seeds,), bins (seeds, T)) of the first channel of a single pixel."""
    steady, transient = submission.ask(
        "film",
        scene=scene,
        view=view | {"bins": bins},
        pulse=pulse,
        spp=spp,
        seed=submission.seed,
        **options,
    )
    number = steady.shape[0]
    expect.shape(transient, (number, 1, 1, bins[0], 3), "bins of the film, seeds first")
    return steady[:, 0, 0, 0], transient[:, 0, 0, :, 0]


@pytest.mark.parametrize(("near_clip", "within"), [(1e-4, 0.25), (0.5, 0.75)])
def test_one_path_lands_in_its_bin(submission, near_clip, within):
    """A point light, a surface, one path: all light in one bin, and none elsewhere."""
    width = 0.02
    start = OPL - (10 + within) * width
    view = OVER | {"near_clip": near_clip}
    steady, transient = film(submission, "lamp", view, (30, start, width), seeds=2)
    hint = (
        "opl from the sensor's origin (not si.t, which starts at the near plane) to the surface "
        "and on to the light; no half bins"
    )
    came = int(np.argmax(transient[0]))
    expect.true(transient[0].max() > 0, "light in the window: none came", hint=hint)
    expect.true(came == 10, f"bin of the path's length: expected 10, came {came}", hint=hint)
    wanted = np.zeros(30)
    wanted[10] = RADIANCE
    for values in transient:
        expect.close(
            values,
            wanted,
            "radiance per bin",
            rtol=2e-3,
            hint="no bin width factor",
            x=start + width * (np.arange(30) + 0.5),
            x_label="opl [m]",
        )
    expect.close(steady, RADIANCE, "steady image", rtol=2e-3)


def test_pulse_is_spread_over_the_bins(submission):
    """Each bin gets the part of the pulse that lies in it."""
    width = 0.05
    half = 0.15
    number = 16
    start = OPL - 7.8 * width
    _, transient = film(
        submission, "lamp", OVER, (number, start, width), pulse=("hat", half), spp=4096
    )
    edges = start + width * np.arange(number + 1)
    wanted = RADIANCE * np.diff(formulas.hat_cdf(edges - OPL, half))
    expect.estimate(
        transient,
        wanted,
        "radiance per bin",
        rounding=3e-3,
        hint="cdf(b - opl) - cdf(a - opl) of the pulse for the bin from a to b, or one random "
        "offset for each contribution",
        x=edges[:-1] + width / 2,
        x_label="opl [m]",
    )


def test_pulse_comes_after_its_front(submission):
    """A pulse that decays fills later bins, not earlier bins."""
    width = 0.1
    start = OPL - 4 * width
    _, transient = film(
        submission, "lamp", OVER, (12, start - 0.02, width), pulse=("decay", 0.2), spp=4096
    )
    edges = start - 0.02 + width * np.arange(13)
    wanted = -np.diff(np.exp(-np.maximum(edges - OPL, 0) / 0.2))
    expect.estimate(
        transient[:, :10],
        RADIANCE * wanted[:10],
        "radiance per bin, with a pulse that starts at 0 and decays",
        rounding=5e-3,
        hint="light that is emitted late arrives late: opl + t. Use self.pulse, whatever it is",
    )


def test_emitters_that_rays_run_into(submission):
    """A light is seen directly, and in a mirror, where no connection can find it."""
    for what, z, depth, wanted_bin in (("a light", 3.0, 1, 4), ("in a mirror", 0.0, 2, 24)):
        view = {"origin": (0.2, 0.1, 1.0), "target": (0.2, 0.1, z)}
        _, transient = film(
            submission, "light_and_mirror", view, (30, 1.55, 0.1), max_depth=depth, seeds=2
        )
        wanted = np.zeros(30)
        wanted[wanted_bin] = 2.0
        hint = "deposit emitters that the ray runs into, with MIS weight 1 after a mirror"
        what = f"radiance per bin, {what}"
        axis = {"x": 1.55 + 0.1 * (np.arange(30) + 0.5), "x_label": "opl [m]"}
        expect.close(transient[0], wanted, what, rtol=2e-3, hint=hint, **axis)


def test_area_light(submission):
    """A disk light over a plane: its light arrives spread over time, each emission once."""
    h = 0.8
    radius = 1.0
    radiance = 2.0
    away = 1.2
    eye = (0.0, math.sqrt(away**2 - 0.4**2), 0.4)
    bins = (14, away + h - 0.13, 0.05)
    steady, transient = film(
        submission,
        "lit_by_disk",
        {"origin": eye, "target": (0.0, 0.0, 0.0), "up": (0, 0, 1)},
        bins,
        spp=2048,
        h=h,
        radius=radius,
        radiance=radiance,
    )
    edges = bins[1] + bins[2] * np.arange(bins[0] + 1)
    wanted = 0.5 / math.pi * formulas.disk_masses(edges - away, h, radius, radiance)
    hint = "each emission once: MIS weights of connection and hit add up to 1"
    expect.estimate(
        transient,
        wanted,
        "radiance per bin",
        rounding=5e-3,
        hint=hint,
        x=edges[:-1] + bins[2] / 2,
        x_label="opl [m]",
    )
    expect.estimate(steady, wanted.sum(), "steady image", rounding=3e-3, hint=hint)


@pytest.mark.parametrize("max_depth", [2, 3])
def test_bounces_in_a_sphere(submission, max_depth):
    """The first bounce arrives at twice the radius, the second after a random chord."""
    radius = 1.0
    albedo = 0.8
    intensity = 3.0
    bins = (12, 1.9, 0.2)
    steady, transient = film(
        submission,
        "inside_sphere",
        {"origin": (0, 0, 0), "target": (0, 0, 1), "fov": 40.0},
        bins,
        spp=1024,
        max_depth=max_depth,
        radius=radius,
        albedo=albedo,
        intensity=intensity,
    )
    edges = bins[1] + bins[2] * np.arange(bins[0] + 1) - 2 * radius
    wanted = np.zeros(bins[0])
    wanted[0] = formulas.sphere_totals(1, radius, albedo, intensity)
    if max_depth == 3:
        second = formulas.sphere_totals(2, radius, albedo, intensity) - wanted[0]
        wanted = wanted + second * np.diff(formulas.chord_cdf(edges, radius))
    hint = "max_depth counts segments, the camera's included; each adds its distance to opl"
    expect.estimate(
        transient,
        wanted,
        f"radiance per bin, max_depth = {max_depth}",
        rounding=3e-3,
        hint=hint,
        x=edges[:-1] + 2 * radius + bins[2] / 2,
        x_label="opl [m]",
    )
    expect.estimate(steady, wanted.sum(), "steady image", rounding=3e-3, hint=hint)


def test_light_outside_the_window(submission):
    """Bins hold what arrives within the window, the steady image holds all."""
    radius = 1.0
    albedo = 0.8
    intensity = 3.0
    steady, transient = film(
        submission,
        "inside_sphere",
        {"origin": (0, 0, 0), "target": (0, 0, 1), "fov": 40.0},
        (3, 2.5, 0.25),
        spp=1024,
        max_depth=3,
        radius=radius,
        albedo=albedo,
        intensity=intensity,
    )
    first = formulas.sphere_totals(1, radius, albedo, intensity)
    both = formulas.sphere_totals(2, radius, albedo, intensity)
    edges = 0.5 + 0.25 * np.arange(4)
    wanted = (both - first) * np.diff(formulas.chord_cdf(edges, radius))
    hint = "do not move light into the first or last bin; the steady image needs no bins"
    axis = {"x": edges[:-1] + 2.0 * radius + 0.125, "x_label": "opl [m]"}
    expect.estimate(transient, wanted, "radiance per bin", rounding=3e-3, hint=hint, **axis)
    expect.estimate(steady, both, "steady image", rounding=3e-3, hint=hint)
