"""The scene at one instant, and at many."""

import math

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a2_time_gated

OVER = formulas.OVER
RADIANCE, OPL = (float(v) for v in formulas.lamp(formulas.X, 0.0, OVER["origin"]))


def along_ray(submission, times, pulse, scene="lamp", max_depth=2, **ray):
    ray = {"origin": OVER["origin"], "target": OVER["target"]} | ray
    return np.array(
        submission.ask(
            "gate_along_ray",
            scene=scene,
            view=OVER,
            times=times,
            pulse=pulse,
            max_depth=max_depth,
            **ray,
        )
    )


def test_one_path_through_the_gate(submission):
    """A point light, a surface, one path: the gate sees the pulse around its length."""
    offsets = np.array([-0.3, -0.1, 0.0, 0.05, 0.1, 0.3])
    came = along_ray(submission, OPL + offsets, ("hat", 0.2))
    expect.close(
        came,
        RADIANCE * formulas.hat(offsets, 0.2),
        "radiance per meter along a ray, gates around the arrival",
        rtol=2e-3,
        atol=1e-4 * RADIANCE,
        hint="weight is p(target_time - opl); opl is the way to the surface and on to the light",
        x=offsets,
        x_label="target_time - opl [m]",
    )


def test_pulse_comes_after_its_front(submission):
    """A pulse that decays is seen late, not early: p(target_time - opl), not p(opl - target)."""
    offsets = np.array([-0.2, -0.05, 0.05, 0.2])
    came = along_ray(submission, OPL + offsets, ("decay", 0.1))
    expect.close(
        came,
        RADIANCE * formulas.decay(offsets, 0.1),
        "radiance per meter with a pulse that starts at 0 and decays",
        rtol=2e-3,
        hint="which sign has the offset? use self.pulse, whatever it is",
        x=offsets,
        x_label="target_time - opl [m]",
    )


def test_lengths_start_at_the_camera(submission):
    """A camera's rays start at its near plane; lengths do not."""
    view = OVER | {"near_clip": 0.5}
    came = submission.ask(
        "gate_image",
        scene="lamp",
        view=view,
        time=OPL,
        pulse=("hat", 0.2),
        spp=16,
        seed=submission.seed,
    )
    expect.shape(came, (16, 1, 1, 3), "images of render_at_time, 16 seeds")
    expect.estimate(
        came[:, 0, 0, 0],
        RADIANCE * float(formulas.hat(0, 0.2)),
        "gate at the arrival, near_clip = 0.5",
        rounding=5e-3,
        hint="si.t is short by near_clip / cos: measure from the sensor (CameraSample.origin)",
    )


def test_emitters_that_rays_run_into(submission):
    """A light is seen directly, and in a mirror, where no connection can find it."""
    up = {"origin": (0.2, 0.1, 1.0), "target": (0.2, 0.1, 3.0)}
    down = {"origin": (0.2, 0.1, 1.0), "target": (0.2, 0.1, 0.0)}
    for what, ray, depth, opl in (
        ("a light", up, 1, 2.0),
        ("a light in a mirror", down, 2, 4.0),
    ):
        times = opl + np.array([-0.1, 0.0, 0.1])
        came = along_ray(submission, times, ("hat", 0.2), "light_and_mirror", depth, **ray)
        expect.close(
            came,
            2.0 * formulas.hat(times - opl, 0.2),
            f"{what}, max_depth = {depth}",
            rtol=5e-3,
            hint="emitters that the ray runs into count too, with MIS weight 1 after a mirror",
            x=times - opl,
            x_label="target_time - opl [m]",
        )


def test_area_light(submission):
    """A disk light over a plane: connections and hits share its energy, over time."""
    h = 0.8
    radius = 1.0
    radiance = 2.0
    away = 1.2
    eye = (0.0, math.sqrt(away**2 - 0.4**2), 0.4)
    bins = (60, 0.5, 0.05)
    came = submission.ask(
        "gates",
        scene="lit_by_disk",
        view={"origin": eye, "target": (0.0, 0.0, 0.0), "up": (0, 0, 1)},
        bins=bins,
        pulse=("hat", 0.2),
        spp=256,
        seed=submission.seed,
        max_depth=2,
        h=h,
        radius=radius,
        radiance=radiance,
    )
    expect.shape(came, (16, 1, 1, 60, 3), "cubes of render_transient, 16 seeds")
    hint = (
        "each emission once: MIS weights of connection and hit add up to 1; or the times of the "
        "gates"
    )
    expect.estimate(
        came[:, 0, 0, :, 0].sum(axis=1) * bins[2],
        0.5 / math.pi * formulas.disk_total(h, radius, radiance),
        "sum over gates times their spacing",
        rounding=2e-3,
        hint=hint,
    )
    times = bins[1] + bins[2] * (np.arange(60) + 0.5)
    wanted = [
        formulas.disk_average(
            lambda r, t=t: formulas.hat(t - away - r, 0.2), h, radius, radiance, 200
        )
        for t in times
    ]
    some = slice(26, 38, 3)
    expect.estimate(
        came[:, 0, 0, some, 0],
        0.5 / math.pi * np.array(wanted)[some],
        "radiance per meter",
        rounding=5e-3,
        hint=hint,
        x=times[some],
        x_label="target_time [m]",
    )


@pytest.mark.parametrize("max_depth", [1, 2, 4])
def test_depth(submission, max_depth):
    """In a sphere every bounce has the same known energy, so the depth can be counted."""
    radius = 1.0
    albedo = 0.8
    intensity = 3.0
    bins = (110, 0.5, 0.1)
    came = submission.ask(
        "gates",
        scene="inside_sphere",
        view={"origin": (0, 0, 0), "target": (0, 0, 1), "fov": 40.0},
        bins=bins,
        pulse=("hat", 0.3),
        spp=64,
        seed=submission.seed,
        max_depth=max_depth,
        radius=radius,
        albedo=albedo,
        intensity=intensity,
    )
    total = came[:, 0, 0, :, 0].sum(axis=1) * bins[2]
    wanted = formulas.sphere_totals(max_depth - 1, radius, albedo, intensity)
    what = f"light of all gates, max_depth = {max_depth}"
    hint = "max_depth counts segments, the camera's included; max_iterations ends no loop"
    if max_depth == 1:
        expect.close(total, np.zeros(16), what, atol=1e-6, hint=hint)
    else:
        expect.estimate(total, wanted, what, rounding=3e-3, hint=hint)


def test_many_gates(submission):
    """Pixels and gates are where they belong: (height, width, gates, channels)."""
    size = (3, 2)
    camera = OVER["origin"]
    bins = (8, 3.3, 0.1)
    view = OVER | {"fov": 60.0, "size": size}
    came = submission.ask(
        "gates",
        scene="lamp",
        view=view,
        bins=bins,
        pulse=("hat", 0.3),
        spp=256,
        seed=submission.seed,
        max_depth=2,
    )
    hint = "rows are y, columns are x; gate k is at start_opl + (k + 1/2) bin_width_opl"
    expect.shape(came, (16, 2, 3, 8, 3), "cubes of render_transient, 16 seeds", hint=hint)
    times = bins[1] + bins[2] * (np.arange(8) + 0.5)

    def value(x, y):
        light, opl = formulas.lamp(x, y, camera)
        return light * formulas.hat(times[:, None, None] - opl, 0.3)

    wanted = np.moveaxis(formulas.over_pixels(value, camera, 60.0, *size), 0, 2)
    some = [1, 4, 7]
    expect.estimate(
        came[..., some, 0], wanted[:, :, some], "radiance per meter", rounding=5e-3, hint=hint
    )


def test_same_paths_for_all_gates(submission):
    """One sample of one path: all gates see its light, at one length."""
    first = -4.0
    last = 6.0
    bins = (8, 3.2, 0.25)
    came = submission.ask(
        "gates",
        scene="lamp",
        view=OVER | {"fov": 60.0},
        bins=bins,
        pulse=("slope", first, last),
        spp=1,
        seed=submission.seed,
        max_depth=2,
    )[:, 0, 0, :, 0]
    times = bins[1] + bins[2] * (np.arange(8) + 0.5)
    hint = "hand each contribution to all gates within one trace"
    came = came[came.max(axis=1) > 0]
    expect.true(len(came) > 2, "light at 1 spp, under 16 seeds: (almost) none came", hint=hint)
    expect.true(came.min() > 0, "light of one sample: in all gates; some have none", hint=hint)
    # p(t - opl) = 2 (last - t + opl) / (last - first)², so two gates give light and length
    light = (came[:, 0] - came[:, -1]) / (times[-1] - times[0]) * (last - first) ** 2 / 2
    with np.errstate(all="ignore"):
        opl = came[:, 0] / light * (last - first) ** 2 / 2 - last + times[0]
        wanted = light[:, None] * formulas.slope(times - opl[:, None], first, last)
    what = "gates of one sample, as light x p(time - opl) with one light and one length"
    expect.close(came / came[:, :1], wanted / came[:, :1], what, rtol=2e-3, hint=hint)
    half = OVER["origin"][2] * math.tan(math.radians(30))
    x, y = np.meshgrid(formulas.X + half * np.linspace(-1, 1, 50), half * np.linspace(-1, 1, 50))
    lengths = formulas.lamp(x, y, OVER["origin"])[1]
    low = lengths.min() - 0.05
    high = lengths.max() + 0.05
    what = f"length that the gates of one sample tell: from {low:.2f} m to {high:.2f} m; came"
    inside = opl.min() > low and opl.max() < high
    expect.true(inside, f"{what} {opl.min():.2f} m to {opl.max():.2f} m", hint=hint)
    expect.true(np.ptp(opl) > 0.01, "lengths under other seeds: others; came the same", hint=hint)
