"""Confocal light around a corner."""

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_confocal

DEVICE = (-0.3, -0.2, 0.9)
LIT = (0.1, 0.1, 0.0)
WALL = formulas.inputs.number("albedo of the wall", 0.8, low=0.7, high=0.85)
HIDDEN = formulas.inputs.number("albedo behind the corner", 0.6, low=0.5, high=0.7)
POWER = formulas.inputs.number("power of the laser", 2.5, low=2, high=4)
PATCH = formulas.patch((0.6, 0.1, 0.6), tilt=15, azimuth=20, half=(0.3, 0.2), cells=400)
SMALL = {"view": {"origin": DEVICE, "target": LIT}, "scene": "around_corner"}


def bins_of(length, width=0.04):
    start = length.min() - 2.5 * width
    return int((length.max() - start) / width) + 3, start, width


def render(submission, bins, spp=16384, **options):
    """(steady (seeds,), bins (seeds, T)) of a single pixel's first channel."""
    options = SMALL | options
    if options["scene"] == "around_corner":
        options["wall_albedo"] = WALL
    view = options.pop("view") | {"bins": bins}
    steady, transient = submission.ask(
        "confocal", view=view, spp=spp, seed=submission.seed, **options
    )
    return steady[:, 0, 0, 0], transient[:, 0, 0, :, 0]


def three(patch):
    points, towards, area, _ = patch
    return formulas.three_bounces(points, towards, area, LIT, LIT, DEVICE, POWER, WALL, HIDDEN)


def test_tilted_patch(submission):
    """A hidden patch that does not face the wall: each cosine and each material counts once."""
    length, light = three(PATCH)
    steady, _ = render(
        submission,
        bins_of(length),
        hidden=[(PATCH[3], HIDDEN)],
        integrator={"max_depth": 3, "power": POWER},
    )
    expect.estimate(
        steady,
        light.sum(),
        "light of a tilted patch",
        rounding=3e-3,
        hint="Φ ρ_w² ρ_h A cos_w² cos_h² / (π³ r⁴): the wall's material at both ends, the cosines "
        "that bsdf.eval holds not twice, the lit point's own cosine too; 1/0.8 too bright: the "
        "wall's material is there once",
    )


def test_arrival_times(submission):
    """Light of the patch arrives at 2 d + 2 r; how much it is, others ask."""
    length, light = three(PATCH)
    bins = bins_of(length)
    _, transient = render(
        submission,
        bins,
        hidden=[(PATCH[3], HIDDEN)],
        integrator={"max_depth": 3, "power": POWER},
    )
    edges = bins[1] + bins[2] * np.arange(bins[0] + 1)
    hint = "2 d from the device to the wall and back, 2 r from the wall to the patch and back"
    total = transient.sum(axis=1, keepdims=True)
    expect.true(total.min() > 0, "light of the patch in the window: none came", hint=hint)
    expect.estimate(
        transient / total,
        formulas.binned(edges, length, light) / light.sum(),
        "part of the light in each bin",
        rounding=2e-2,
        hint=hint,
        x=edges[:-1] + bins[2] / 2,
        x_label="opl [m]",
    )


def test_large_plane(submission):
    """A plane parallel to the wall: 2 Φ ρ_w² ρ_h D⁴ / (π² r⁷) at 2 d + 2 r."""
    distance = 0.8
    device = (-0.3, 0.2, 0.5)
    d = float(np.linalg.norm(device))
    matrix = np.diag([40.0, -40.0, -1.0, 1.0])
    matrix[2, 3] = distance
    bins = (10, 2 * d + 2 * distance - 0.06, 0.1)
    _, transient = render(
        submission,
        bins,
        view={"origin": device, "target": (0, 0, 0)},
        wall_size=40.0,
        hidden=[(matrix, HIDDEN)],
        integrator={"max_depth": 3, "power": POWER},
    )
    edges = bins[1] + bins[2] * np.arange(bins[0] + 1)
    expect.estimate(
        transient,
        formulas.plane_masses((edges - 2 * d) / 2, distance, POWER, WALL, HIDDEN),
        "radiance per bin",
        rounding=5e-3,
        hint="both cosines at the wall, both at the plane; lengths 2 d + 2 r",
        x=edges[:-1] + bins[2] / 2,
        x_label="opl [m]",
    )


@pytest.mark.parametrize("max_depth", [2, 3, 5])
def test_depth(submission, max_depth):
    """Inside a sphere that is the relay wall, each further vertex multiplies by the albedo."""
    radius = 1.0
    albedo = 0.7
    steady, transient = render(
        submission,
        (40, 0.0, 1.0),
        spp=256,
        scene="inside_sphere",
        view={"origin": (0, 0, 0), "target": (0, 0, 1), "fov": 40.0},
        radius=radius,
        albedo=albedo,
        intensity=1.0,
        integrator={"max_depth": max_depth, "power": POWER},
    )
    wanted = sum(
        formulas.confocal_sphere(n, radius, albedo, POWER) for n in range(3, max_depth + 1)
    )
    hint = (
        "if test_tilted_patch fails too, mend that first; max_depth segments from the camera to "
        "the lit point: 3 is camera, p, another point, p"
    )
    what = f"light in a sphere, max_depth = {max_depth}"
    if max_depth < 3:
        expect.close(steady, np.zeros(16), what, hint=hint)
    else:
        expect.estimate(steady, wanted, what, rounding=3e-3, hint=hint)
        expect.estimate(transient.sum(axis=1), wanted, what + ", bins", rounding=3e-3, hint=hint)


@pytest.mark.parametrize("use_nlos_only", [False, True])
def test_filter(submission, use_nlos_only):
    """Wall and floor light each other; the filter keeps only what met the hidden patch."""
    _, light = three(PATCH)
    y = -0.5
    half = 0.6
    albedo = 0.6
    x, z = formulas.patch((0.0, half, y), tilt=0, azimuth=0, half=(half, half))[0][:, :2].T
    points = np.stack([x, np.full(x.shape, y), z], axis=1)
    upwards = np.array([0.0, 1.0, 0.0])
    area = 4 * half**2 / x.size
    _, floor_light = formulas.three_bounces(
        points, upwards, area, LIT, LIT, DEVICE, POWER, WALL, albedo
    )
    bins = (60, 1.0, 0.1)
    steady, transient = render(
        submission,
        bins,
        hidden=[(PATCH[3], HIDDEN)],
        floor=(y, half, albedo),
        integrator={
            "max_depth": 3,
            "power": POWER,
            "relay_wall": "relay_wall, floor",
            "use_nlos_only": use_nlos_only,
        },
    )
    wanted = light.sum() + (0 if use_nlos_only else floor_light.sum())
    hint = (
        "if test_tilted_patch fails too, mend that first; count a path from the moment that any "
        "vertex so far was off the wall: the hidden vertex itself is not on it; too bright by 2.2: "
        "is the filter applied at all?"
    )
    what = f"light with use_nlos_only = {use_nlos_only}"
    expect.estimate(steady, wanted, what, rounding=5e-3, hint=hint)
    expect.estimate(transient.sum(axis=1), wanted, what + ", bins", rounding=5e-3, hint=hint)
