"""Laser spots with a width: their pattern, its power, and the light around the corner."""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.confocal import FOV, PLACE, lit_by, pointed, projector, spots, totals
from helpers.support import agree, film, load, over_seeds, rendered, with_sampler
from oracles import films as oracles, nlos

from tofrender.scenes import cornell_box

SEEDS = range(16)
PATCH = nlos.Rectangle.turned((0.35, 0.3, 1.1), 30, 240, half=(0.2, 0.2))


def gaussians(x, y, positions, sigmas, powers) -> np.ndarray:
    """Return the power per area of the pattern's square [-1, 1]²."""
    return sum(
        p / (2 * math.pi * s**2) * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * s**2))
        for (u, v), s, p in zip(positions, sigmas, powers, strict=True)
    )


def in_pattern(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where directions (..., 3) meet the pattern's square, and their cosines."""
    local = directions @ np.array(pointed().matrix)[:3, :3]
    at = local[..., :2] / local[..., 2:] / math.tan(FOV / 2)
    return at, local[..., 2] / np.linalg.norm(local, axis=-1)


def intensity(points, *pattern) -> np.ndarray:
    """Return I(w) towards points (..., 3) by the formula, one number for each point."""
    at, cos = in_pattern(points - np.asarray(PLACE))
    inside = (np.abs(at) <= 1).all(axis=-1) & (cos > 0)
    on_square = inside * gaussians(*np.moveaxis(at, -1, 0), *pattern)
    return on_square / (math.tan(FOV / 2) ** 2 * np.abs(cos) ** 3)


def direct(points, value: np.ndarray, albedo: float = 0.8) -> np.ndarray:
    """Return the radiance of points of the wall, for an intensity from PLACE."""
    away = np.asarray(PLACE) - points
    r = np.linalg.norm(away, axis=-1)
    return albedo / math.pi * value * away[..., 2] / r**3


WHERE = [(0.5, -0.25), (-0.6, 0.1), (0.0, 0.7)]
PATTERNS = {
    "one spot": ([(0.0, 0.0)], [0.3], [2.0]),
    "beside the axis": (WHERE[:1], [0.2], [1.0]),
    "several": (WHERE, [0.2, 0.1, 0.3], [1.0, 3.0, 0.5]),
}
COLORED = [(0.3, 0.0), (-0.3, 0.0)], [0.2, 0.2], [(1.0, 0.5, 0.25), (0.0, 2.0, 1.0)]
IN_WORDS = {"spot_positions": "0.5, -0.25  -0.6 0.1", "spot_sigmas": "0.2 0.1"}
IN_WORDS |= {"spot_intensities": "1, 3"}
GRID = {"grid_rows": 2, "grid_cols": 3, "grid_sigma": 0.05, "grid_intensity": 1.5}
ROWS = [(x, y) for y in (-0.5, 0.5) for x in (-2 / 3, 0, 2 / 3)]
"""In the middle of equal cells, each spot with the whole power."""

DIRECT = {name: (spots(*pattern), pattern) for name, pattern in PATTERNS.items()} | {
    "grid": (GRID, (ROWS, [0.05] * 6, [1.5] * 6)),
    "colors": (spots(*COLORED), COLORED),
    "text": (IN_WORDS, (WHERE[:2], [0.2, 0.1], [1.0, 3.0])),
}


@pytest.mark.parametrize("name", DIRECT)
def test_direct_light(name):
    """Each point of the wall reflects ρ / π I(w) cos / d², without noise."""
    options, (positions, sigmas, powers) = DIRECT[name]
    described = lit_by(projector(**options), filter_bounces=1)
    steady, transient = rendered(nlos.load_nlos(described), spp=4)
    points = nlos.Grid(8, 8).points()
    for channel in range(3):
        each = [np.broadcast_to(power, 3)[channel] for power in powers]
        expected = direct(points, intensity(points, positions, sigmas, each))
        assert expected.max() > 4 * np.median(expected)
        close = {"rel": 1e-4, "abs": 1e-5 * expected.max()}
        assert steady[..., channel] == pytest.approx(expected, **close)
    assert transient.sum(axis=2) == pytest.approx(steady[..., :3], rel=1e-3, abs=1e-6)


def test_confocal_spots_are_where_the_camera_looks():
    """On its axis, each beam has the radiant intensity Φ / (2 π σ²), for a small σ in rad."""
    beam = {"type": "confocal_projector", "fov": 0.4, "grid_sigma": 0.1, "grid_intensity": 3.0}
    by_angle = nlos.confocal(
        nlos.Setup(sensor=PLACE, power=3.0), {}, film(8, 8), spot_sigma=0.004, filter_bounces=1
    )
    for described, σ, within in (
        (lit_by(beam, filter_bounces=1), 0.1 * math.tan(0.2), 1e-4),
        (by_angle, 0.004, 2e-3),
    ):
        steady, _ = rendered(nlos.load_nlos(described), spp=4)
        expected = direct(nlos.Grid(8, 8).points(), np.full((8, 8), 3.0 / (2 * math.pi * σ**2)))
        assert steady[..., 0] == pytest.approx(expected, rel=within)


@pytest.mark.statistical
@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize("tries", [1, 8])
def test_samples_follow_the_pattern(name, tries):
    """Weights add up to the integral of the intensity, also in each cell."""
    pattern = PATTERNS[name]
    made = mi.load_dict(projector(**spots(*pattern), max_rejection_samples=tries))
    lanes, cells = 1 << 14, np.linspace(-1, 1, 5)

    def estimate(seed):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, lanes)
        direction, power = made.sample_beam(made.axes(None, None), sampler, mi.Bool(True))
        assert dr.allclose(dr.norm(direction), 1, atol=1e-6)
        at, _ = in_pattern(np.array(direction).T)
        weight = np.broadcast_to(np.array(power)[0], lanes) / lanes
        return np.histogram2d(*at.T, (cells, cells), weights=weight)[0]

    fine = 400
    middle = (2 * np.arange(fine) + 1) / fine - 1
    density = gaussians(*np.meshgrid(middle, middle, indexing="ij"), *pattern)
    expected = density.reshape(4, fine // 4, 4, fine // 4).sum(axis=(1, 3)) * (2 / fine) ** 2
    samples = over_seeds(estimate, SEEDS)
    there = expected > 1e-3 * expected.sum()
    assert there.sum() > 2
    assert agree(samples[:, there], expected[there], rounding=1e-3)
    assert samples[:, ~there].sum() < 0.01 * samples.sum()
    assert agree(samples.sum(axis=(1, 2)), np.array(expected.sum()), rounding=1e-3)


@pytest.mark.statistical
def test_a_narrow_spot_is_a_point():
    setup = nlos.Setup(sensor=PLACE, power=2.0)
    described = nlos.confocal(setup, {"hidden": PATCH.shape()}, film(2, 2), spot_sigma=1e-3)
    expected = totals(setup, PATCH.nodes())
    assert agree(over_seeds(nlos.estimates(described, 1024), SEEDS), expected, rounding=2e-3)


@pytest.mark.statistical
def test_wide_spot_is_many_points():
    """Time-resolved light is the sum over points of the wall with the power I(w) cos / d² dA."""
    pattern, seen, setup = PATTERNS["beside the axis"], (0.5, 0.5, 0.0), nlos.Setup(sensor=PLACE)
    wall = nlos.Rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)).nodes(80, 80)
    away = np.asarray(PLACE) - wall.points
    r = np.linalg.norm(away, axis=1)
    powers = intensity(wall.points, *pattern) * away[:, 2] / r**3 * wall.areas
    lit = powers > 1e-6 * powers.sum()
    hidden = PATCH.nodes(20, 20)
    found = [nlos.three_bounces(setup, hidden, 0.7, p, seen) for p in wall.points[lit]]
    opl = np.concatenate([each[0] for each in found])
    light = np.concatenate([p * each[1] for p, each in zip(powers[lit], found, strict=True)])
    edges = 4.0 + 0.25 * np.arange(13)
    lamp = projector(**spots(*pattern), pulse_width_opl=1e-4)
    window = film(2, 2, bins=12, start=4.0, bin_width=0.25)
    described = lit_by(lamp, {"hidden": PATCH.shape()}, window, filter_bounces=3, max_depth=4)
    samples = over_seeds(nlos.estimates(described, 1024, "transient"), SEEDS)[:, 1, 1]
    expected = nlos.masses(edges, opl, light)
    there = expected > 0.01 * expected.sum()
    assert there.sum() > 3
    assert agree(samples[:, there], expected[there], rounding=5e-3)
    assert agree(samples.sum(axis=1), np.array(light.sum()), rounding=1e-3)


HISTOGRAM = {
    "pulse_type": "histogram",
    "pulse_values": mi.TensorXf([1.0, 0.0, 3.0, 2.0]),
    "pulse_start_opl": -0.15,
    "pulse_bin_width_opl": 0.1,
}


@pytest.mark.parametrize(
    ("pulse", "start", "width", "expected", "within"),
    [
        (
            {"pulse_width_opl": 0.08},
            *(-0.4, 0.02),
            oracles.gaussian_masses(-0.4 + 0.02 * np.arange(41), 0, 0.08),
            2e-4,
        ),
        (HISTOGRAM, -0.35, 0.1, np.array([0, 0, 1, 0, 3, 2, 0, 0]) / 6, 5e-3),
    ],
    ids=["Gaussian", "histogram"],
)
def test_pulses(pulse, start, width, expected, within):
    small = nlos.Rectangle.turned((0.0, 0.0, 1.0), 0, 0, half=(1e-3, 1e-3))
    window = film(bins=len(expected), start=start + 2 + 2 * math.hypot(*PLACE), bin_width=width)
    narrow = projector(grid_sigma=1e-3, frame=pointed((0, 0, 0)), **pulse)
    described = lit_by(narrow, {"hidden": small.shape()}, window)
    found = rendered(nlos.load_nlos(described), spp=1 << 14)[1][0, 0, :, 0]
    assert found / found.sum() == pytest.approx(expected / expected.sum(), abs=within)


def test_projector_nests_in_both_integrators():
    pattern = projector(**spots(*PATTERNS["several"]))
    named = lit_by(pattern, {"hidden": PATCH.shape()}, film(2, 2))
    plain = named | {"integrator": named["integrator"] | {"type": "transient_path"}}
    one, other = (nlos.load_nlos(d) for d in (named, plain))
    assert type(one.integrator()) is type(other.integrator())
    np.testing.assert_array_equal(rendered(one, 16)[1], rendered(other, 16)[1])


def test_a_projector_leaves_other_scenes_alone():
    """Dr.Jit evaluates the methods of all emitters in memory for a ray, also of the projector."""
    there = mi.load_dict(projector(**spots(*PATTERNS["several"])))
    steady, _ = rendered(load(with_sampler(cornell_box(width=4, height=4))), spp=4)
    assert steady.max() > 0
    assert there is not None


def test_axes_follow_the_ray_as_a_fixed_frame_does():
    """The pattern is not mirrored in either kind of projector: x and y follow `look_at`."""
    confocal_one = mi.load_dict({"type": "confocal_projector"})
    matrix = np.array(pointed().matrix)
    found = confocal_one.axes(mi.Vector3f(matrix[:3, 2].tolist()), mi.Vector3f(0, 1, 0))
    for axis, expected in zip((found.s, found.t, found.n), matrix[:3, :3].T, strict=True):
        assert np.array(axis).ravel() == pytest.approx(expected, abs=1e-6)


def test_kernels_stay_wherever_numpy_puts_arrays():
    """For other alignments of memory, Dr.Jit would compile other kernels instead of reusing them.

    The alignment of NumPy's memory is random, correct once in four times. Therefore 1 % of mistakes
    are not detected.
    """
    kept, kernels = [], set()
    rng = np.random.default_rng(1)
    sampler = mi.load_dict({"type": "independent"})
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for _ in range(16):
            kept += [np.empty(int(size), np.uint8) for size in rng.integers(1, 300, 40)]
            light = mi.load_dict(projector(grid_sigma=0.5))
            sampler.seed(0, 64)
            frame = light.axes(None, None)
            dr.kernel_history_clear()
            dr.eval(light.sample_beam(frame, sampler, True))
            kernels.add(tuple(each["hash"] for each in dr.kernel_history() if "hash" in each))
    assert len(kernels) == 1
