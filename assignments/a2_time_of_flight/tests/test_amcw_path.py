"""Correlation images and phasors."""

import math

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_amcw_path

OVER = formulas.OVER
RADIANCE, OPL = (float(v) for v in formulas.lamp(formulas.X, 0.0, OVER["origin"]))
RAMP = (0.5, -0.4)


def ramp(opl, at_zero=RAMP[0], slope=RAMP[1]):
    """A modulation that shows errors of all lengths alike."""
    return at_zero + slope * opl


def test_one_path(submission):
    """A point light, a surface, one path: its radiance times the modulation."""
    ramps = [(1.0, 0.0), RAMP, (0.0, 1.0)]
    came = submission.ask(
        "amcw_along_ray", scene="lamp", view=OVER, ramps=ramps, max_depth=2, **OVER
    )
    expect.close(
        came,
        [RADIANCE * ramp(OPL, *each) for each in ramps],
        "correlation along a ray",
        rtol=2e-3,
        hint="radiance times self.modulation.eval(opl), opl from the sensor to the light",
        x=range(3),
        x_label="case (modulations 1, 0.5 - 0.4 opl, opl)",
    )


def test_emitters_that_rays_run_into(submission):
    """A light is seen directly, and in a mirror, where no connection can find it."""
    eye = (0.2, 0.1, 1.0)
    for what, target, depth, opl in (
        ("a light", (0.2, 0.1, 3.0), 1, 2.0),
        ("a light in a mirror", (0.2, 0.1, 0.0), 2, 4.0),
    ):
        ramps = [(1.0, 0.0), RAMP]
        came = submission.ask(
            "amcw_along_ray",
            scene="light_and_mirror",
            view=OVER,
            origin=eye,
            target=target,
            ramps=ramps,
            max_depth=depth,
        )
        wanted = [2 * ramp(opl, *each) for each in ramps]
        hint = "emitters that the ray runs into count too, with the modulation at their length"
        expect.close(
            came,
            wanted,
            f"{what}, max_depth = {depth}",
            rtol=2e-3,
            hint=hint,
            x=range(2),
            x_label="case (modulations 1, 0.5 - 0.4 opl)",
        )


def test_lengths_start_at_the_camera(submission):
    """A camera's rays start at its near plane; lengths do not."""
    came = submission.ask(
        "amcw_image",
        scene="lamp",
        view=OVER | {"near_clip": 0.5},
        ramp=RAMP,
        spp=16,
        seed=submission.seed,
    )
    expect.shape(came, (16, 1, 1, 3), "images of render_single_amcw, 16 seeds")
    expect.estimate(
        came[:, 0, 0, 0],
        RADIANCE * ramp(OPL),
        "correlation, near_clip = 0.5",
        rounding=5e-3,
        hint="si.t is short by near_clip / cos: measure from the sensor (CameraSample.origin)",
    )


def test_image(submission):
    """Each pixel sees its own path lengths."""
    size = (3, 2)
    camera = OVER["origin"]
    came = submission.ask(
        "amcw_image",
        scene="lamp",
        view=OVER | {"fov": 60.0, "size": size},
        ramp=RAMP,
        spp=256,
        seed=submission.seed,
    )
    hint = "rows are y, columns are x"
    expect.shape(came, (16, 2, 3, 3), "images of render_single_amcw, 16 seeds", hint=hint)

    def value(x, y):
        light, opl = formulas.lamp(x, y, camera)
        return light * ramp(opl)

    wanted = formulas.over_pixels(value, camera, 60.0, *size)
    expect.estimate(came[..., 0], wanted, "correlation image", rounding=5e-3, hint=hint)


def test_area_light(submission):
    """A disk light over a plane: connections and hits share its energy."""
    h = 0.8
    radius = 1.0
    radiance = 2.0
    away = 1.2
    eye = (0.0, math.sqrt(away**2 - 0.4**2), 0.4)
    came = submission.ask(
        "amcw_image",
        scene="lit_by_disk",
        view={"origin": eye, "target": (0.0, 0.0, 0.0), "up": (0, 0, 1)},
        ramp=RAMP,
        spp=1024,
        seed=submission.seed,
        h=h,
        radius=radius,
        radiance=radiance,
    )
    wanted = formulas.disk_average(lambda r: ramp(r + away), h, radius, radiance)
    expect.estimate(
        came[:, 0, 0, 0],
        0.5 / math.pi * wanted,
        "correlation under a disk light",
        rounding=3e-3,
        hint="each emission once: MIS weights of connection and hit add up to 1",
    )


@pytest.mark.parametrize("max_depth", [2, 4])
def test_depth(submission, max_depth):
    """In a sphere every bounce has the same known energy, which a modulation of 1 counts."""
    options = {"radius": 1.0, "albedo": 0.8, "intensity": 3.0}
    came = submission.ask(
        "amcw_image",
        scene="inside_sphere",
        view={"origin": (0, 0, 0), "target": (0, 0, 1), "fov": 40.0},
        ramp=(1.0, 0.0),
        spp=64,
        seed=submission.seed,
        max_depth=max_depth,
        **options,
    )
    expect.estimate(
        came[:, 0, 0, 0],
        formulas.sphere_totals(max_depth - 1, *options.values()),
        f"light of all bounces, max_depth = {max_depth}",
        rounding=3e-3,
        hint="max_depth counts segments, the camera's included; max_iterations ends no loop",
    )


@pytest.mark.parametrize("frequency_mhz", [10, 47, 75])
def test_phasor(submission, frequency_mhz):
    """I, Q, amplitude, phase and depth of a single path."""
    came = submission.ask(
        "amcw_phasor",
        scene="lamp",
        view=OVER,
        frequency_hz=1e6 * frequency_mhz,
        spp=64,
        seed=submission.seed,
    )
    wanted = formulas.one_path(RADIANCE, OPL, 1e6 * frequency_mhz)
    for (name, value), image in zip(wanted.items(), came, strict=True):
        expect.shape(image, (1, 1, 3), name)
        unit = {"phase": 1.0, "depth": wanted["depth"]}.get(name, RADIANCE)
        expect.close(
            image,
            np.full((1, 1, 3), value),
            f"{name} at {frequency_mhz} MHz",
            rtol=0,
            atol=5e-3 * unit,
            hint="Q is plus sine: phase_offset = -π/2. Depth is c (phase mod 2π) / (4π f)",
        )
