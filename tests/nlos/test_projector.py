"""Laser spots of some width: their pattern, its power, and what they light around the corner."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.support import agree, film, load, over_seeds, rendered, with_sampler
from oracles import films as oracles
from oracles.nlos import (
    Grid,
    Rectangle,
    Setup,
    confocal,
    estimates,
    load_nlos,
    masses,
    relay_wall,
    three_bounces,
    total,
)

from tofrender.scenes import cornell_box

SEEDS = range(16)
PLACE = (-0.3, 0.2, 1.4)
FOV = 1.0
PATCH = Rectangle.turned((0.35, 0.3, 1.1), 30, 240, half=(0.2, 0.2))


def pointed(target=(0.1, -0.1, 0.0)) -> mi.ScalarTransform4f:
    return mi.ScalarTransform4f().look_at(list(PLACE), list(target), [0, 1, 0])


def projector(**options) -> dict:
    """One fixed to a place, with a pulse of no width unless one is asked for."""
    fixed = {"is_confocal": False, "frame": pointed()}
    return {"type": "confocal_projector", "fov": FOV} | fixed | options


def spots(positions, sigmas, powers) -> dict:
    arrays = {"positions": positions, "sigmas": sigmas, "intensities": powers}
    return {f"spot_{k}": mi.TensorXf(np.array(v, np.float32)) for k, v in arrays.items()}


def lit_by(pattern: dict, hidden: dict | None = None, the_film=None, **options) -> dict:
    described = confocal(Setup(sensor=PLACE), hidden or {}, the_film or film(8, 8), **options)
    integrator = {k: v for k, v in described["integrator"].items() if k != "power"}
    return described | {"integrator": integrator | {"confocal_projector": pattern}}


def intensity(points, positions, sigmas, powers, frame=None) -> np.ndarray:
    """I(w) towards points (..., 3), by the formula: one number for each point."""
    matrix = np.array((frame or pointed()).matrix)
    local = (np.asarray(points) - matrix[:3, 3]) @ matrix[:3, :3]
    at = local[..., :2] / local[..., 2:] / math.tan(FOV / 2)
    cos = local[..., 2] / np.linalg.norm(local, axis=-1)
    inside = (np.abs(at) <= 1).all(axis=-1) & (cos > 0)
    result = 0.0
    for centre, sigma, power in zip(positions, sigmas, powers, strict=True):
        square = ((at - centre) ** 2).sum(axis=-1)
        result += power / (2 * math.pi * sigma**2) * np.exp(-square / (2 * sigma**2))
    return inside * result / (math.tan(FOV / 2) ** 2 * np.abs(cos) ** 3)


def direct(points, value: np.ndarray, albedo: float = 0.8) -> np.ndarray:
    """Radiance of points of the wall under an intensity from PLACE."""
    away = np.asarray(PLACE) - points
    r = np.linalg.norm(away, axis=-1)
    return albedo / math.pi * value * away[..., 2] / r**3


# --------------------------------------------------------------------------------- direct light


PATTERNS = {
    "one spot": ([(0.0, 0.0)], [0.3], [2.0]),
    "beside the axis": ([(0.5, -0.25)], [0.2], [1.0]),
    "several": ([(0.5, -0.25), (-0.6, 0.1), (0.0, 0.7)], [0.2, 0.1, 0.3], [1.0, 3.0, 0.5]),
}


@pytest.mark.parametrize("name", PATTERNS)
def test_direct_light(name):
    """Each point of the wall reflects ρ / π I(w) cos / d², without noise."""
    pattern = PATTERNS[name]
    described = lit_by(projector(**spots(*pattern)), filter_bounces=1)
    steady, transient = rendered(load_nlos(described), spp=4)
    points = Grid(8, 8).points()
    expected = direct(points, intensity(points, *pattern))
    assert expected.max() > 10 * np.median(expected)
    assert steady[..., 0] == pytest.approx(expected, rel=1e-4, abs=1e-5 * expected.max())
    assert transient[..., 0].sum(axis=2) == pytest.approx(steady[..., 0], rel=1e-3, abs=1e-6)


def test_grid():
    """Rows and columns are in the middle of equal cells, each spot with the whole power."""
    pattern = projector(grid_rows=2, grid_cols=3, grid_sigma=0.05, grid_intensity=1.5)
    steady, _ = rendered(load_nlos(lit_by(pattern, filter_bounces=1)), spp=4)
    positions = [(x, y) for y in (-0.5, 0.5) for x in (-2 / 3, 0, 2 / 3)]
    points = Grid(8, 8).points()
    expected = direct(points, intensity(points, positions, [0.05] * 6, [1.5] * 6))
    assert steady[..., 0] == pytest.approx(expected, rel=1e-4, abs=1e-5 * expected.max())


def test_colours():
    colours = [(1.0, 0.5, 0.25), (0.0, 2.0, 1.0)]
    where = [(0.3, 0.0), (-0.3, 0.0)]
    pattern = projector(**spots(where, [0.2, 0.2], colours))
    steady, _ = rendered(load_nlos(lit_by(pattern, filter_bounces=1)), spp=4)
    points = Grid(8, 8).points()
    for c in range(3):
        value = intensity(points, where, [0.2, 0.2], [colour[c] for colour in colours])
        expected = direct(points, value)
        assert steady[..., c] == pytest.approx(expected, rel=1e-4, abs=1e-5 * expected.max())


def test_lists_as_text():
    as_text = projector(
        spot_positions="0.5, -0.25  -0.6 0.1", spot_sigmas="0.2 0.1", spot_intensities="1, 3"
    )
    as_arrays = projector(**spots([(0.5, -0.25), (-0.6, 0.1)], [0.2, 0.1], [1.0, 3.0]))
    one, other = (
        rendered(load_nlos(lit_by(p, filter_bounces=1)), spp=1)[0] for p in (as_text, as_arrays)
    )
    assert one.max() > 0
    np.testing.assert_array_equal(one, other)


def test_confocal_spot_is_where_the_camera_looks():
    """On its own axis each beam has the radiant intensity Φ / (2 π σ² tan²(fov / 2))."""
    pattern = {"type": "confocal_projector", "fov": 0.4, "grid_sigma": 0.1, "grid_intensity": 3.0}
    steady, _ = rendered(load_nlos(lit_by(pattern, filter_bounces=1)), spp=4)
    value = 3.0 / (2 * math.pi * 0.1**2 * math.tan(0.2) ** 2)
    expected = direct(Grid(8, 8).points(), np.full((8, 8), value))
    assert steady[..., 0] == pytest.approx(expected, rel=1e-4)


def test_spot_sigma_is_an_angle():
    """Φ / (2 π σ²) on the axis of a beam of a small σ [rad]."""
    setup = Setup(sensor=PLACE, power=3.0)
    described = confocal(setup, {}, film(8, 8), spot_sigma=0.004, filter_bounces=1)
    steady, _ = rendered(load_nlos(described), spp=4)
    expected = direct(Grid(8, 8).points(), np.full((8, 8), 3.0 / (2 * math.pi * 0.004**2)))
    assert steady[..., 0] == pytest.approx(expected, rel=2e-3)


# ------------------------------------------------------------------------------------- sampling


@pytest.mark.statistical
@pytest.mark.parametrize("name", PATTERNS)
@pytest.mark.parametrize("tries", [1, 8])
def test_samples_follow_the_pattern(name, tries):
    """Their weights add up to the power that the intensity integrates to, also in each cell."""
    pattern = PATTERNS[name]
    made = mi.load_dict(projector(**spots(*pattern), max_rejection_samples=tries))
    matrix = np.array(pointed().matrix)
    lanes, cells = 1 << 14, np.linspace(-1, 1, 5)

    def estimate(seed):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, lanes)
        axes = made.axes(None, None)
        direction, power = made.sample_beam(axes, sampler, mi.Bool(True))
        local = np.array(direction).T @ matrix[:3, :3]
        at = local[:, :2] / local[:, 2:] / math.tan(FOV / 2)
        weight = np.broadcast_to(np.array(power)[0], lanes) / lanes
        return np.histogram2d(*at.T, (cells, cells), weights=weight)[0]

    fine = 400
    middle = (2 * np.arange(fine) + 1) / fine - 1
    x, y = np.meshgrid(middle, middle, indexing="ij")
    density = sum(
        p / (2 * math.pi * s**2) * np.exp(-((x - c[0]) ** 2 + (y - c[1]) ** 2) / (2 * s**2))
        for c, s, p in zip(*pattern, strict=True)
    )
    expected = density.reshape(4, fine // 4, 4, fine // 4).sum(axis=(1, 3)) * (2 / fine) ** 2
    samples = over_seeds(estimate, SEEDS)
    there = expected > 1e-3 * expected.sum()
    assert there.sum() > 2
    assert agree(samples[:, there], expected[there], rounding=1e-3)
    assert samples[:, ~there].sum() < 0.01 * samples.sum()
    assert agree(samples.sum(axis=(1, 2)), np.array(expected.sum()), rounding=1e-3)


# ------------------------------------------------------------------------------ around the corner


@pytest.mark.statistical
@pytest.mark.parametrize("sigma", [0.0, 1e-3])
def test_a_narrow_spot_is_a_point(sigma):
    setup = Setup(sensor=PLACE, power=2.0)
    described = confocal(setup, {"hidden": PATCH.shape()}, film(2, 2), spot_sigma=sigma)
    expected = np.array(
        [[total(setup, PATCH.nodes(), 0.7, p, p) for p in row] for row in Grid(2, 2).points()]
    )
    samples = over_seeds(estimates(described, 1024), SEEDS)
    assert agree(samples, expected, rounding=2e-3)


def bitmap_projector(pattern, size: int = 512) -> dict:
    """Mitsuba's projector, whose intensity is π times the picture over cos³."""
    middle = (2 * np.arange(size) + 1) / size - 1
    x, y = np.meshgrid(middle, middle)
    picture = sum(
        p / (2 * math.pi * s**2) * np.exp(-((x - c[0]) ** 2 + (y - c[1]) ** 2) / (2 * s**2))
        for c, s, p in zip(*pattern, strict=True)
    )
    # Its columns go to the right and its rows down, as seen from behind: against local x and y
    picture = picture[::-1, ::-1] / (math.pi * math.tan(FOV / 2) ** 2)
    texture = {
        "type": "bitmap",
        "raw": True,
        "data": mi.TensorXf(np.repeat(picture[..., None], 3, axis=2).astype(np.float32)),
    }
    fov = math.degrees(FOV)
    return {"type": "projector", "irradiance": texture, "fov": fov, "to_world": pointed()}


def ordinary(pattern, integrator: dict, the_film: dict, hidden: dict) -> dict:
    wall = relay_wall(Setup(sensor=PLACE), the_film)
    lamp = {"lamp": bitmap_projector(pattern)}
    return {"type": "scene", "integrator": integrator, "relay_wall": wall} | lamp | hidden


def test_bitmap_projector_has_the_pattern():
    pattern = PATTERNS["beside the axis"]
    steady = film(8, 8) | {"type": "hdrfilm", "component_format": "float32"}
    steady = {k: v for k, v in steady.items() if "opl" not in k and "bins" not in k}
    described = ordinary(pattern, {"type": "path", "max_depth": 2}, steady, {})
    points = Grid(8, 8).points()
    expected = direct(points, intensity(points, *pattern))
    image = np.array(mi.render(load_nlos(described), spp=4))[..., 0]
    assert image == pytest.approx(expected, rel=1e-2, abs=1e-3 * expected.max())


def wide(pattern, bounces: int, the_film: dict) -> dict:
    lamp = projector(**spots(*pattern), pulse_width_opl=1e-4)
    options = {"filter_bounces": bounces, "max_depth": 4}
    return lit_by(lamp, {"hidden": PATCH.shape()}, the_film, **options)


@pytest.mark.statistical
def test_wide_spot_is_many_points():
    """The sum over the wall's points, each lit with the power I(w) cos / d² dA, in time."""
    pattern, seen, setup = PATTERNS["beside the axis"], (0.5, 0.5, 0.0), Setup(sensor=PLACE)
    wall = Rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)).nodes(80, 80)
    away = np.asarray(PLACE) - wall.points
    r = np.linalg.norm(away, axis=1)
    powers = intensity(wall.points, *pattern) * away[:, 2] / r**3 * wall.areas
    lit = powers > 1e-6 * powers.sum()
    hidden = PATCH.nodes(20, 20)
    found = [three_bounces(setup, hidden, 0.7, p, seen) for p in wall.points[lit]]
    opl = np.concatenate([each[0] for each in found])
    light = np.concatenate([p * each[1] for p, each in zip(powers[lit], found, strict=True)])
    edges = 4.0 + 0.25 * np.arange(13)
    described = wide(pattern, 3, film(2, 2, bins=12, start=4.0, bin_width=0.25))
    samples = over_seeds(estimates(described, 1024, "transient"), SEEDS)[:, 1, 1]
    expected = masses(edges, opl, light)
    there = expected > 0.01 * expected.sum()
    assert there.sum() > 3
    assert agree(samples[:, there], expected[there], rounding=5e-3)
    assert agree(samples.sum(axis=1), np.array(light.sum()), rounding=1e-3)


@pytest.mark.statistical
def test_wide_spots_are_an_ordinary_light():
    """All paths up to four bounces against Mitsuba's projector and path tracer."""
    pattern = PATTERNS["one spot"]
    ours = over_seeds(estimates(wide(pattern, -1, film(2, 2)), 512), SEEDS)
    steady = {"type": "hdrfilm", "width": 2, "height": 2, "component_format": "float32"}
    steady |= {"rfilter": {"type": "box"}}
    hidden = {"hidden": PATCH.shape()}

    def by_path(depth: int, spp: int, seeds=(0,)) -> np.ndarray:
        loaded = load_nlos(ordinary(pattern, {"type": "path", "max_depth": depth}, steady, hidden))
        return over_seeds(lambda s: np.array(mi.render(loaded, spp=spp, seed=s)[..., 0]), seeds)

    direct_light = rendered(load_nlos(wide(pattern, 1, film(2, 2))), 4)[0][..., 0]

    # Less the direct light, which is most of it and has no noise but the picture's texels
    samples = ours - direct_light
    references = by_path(5, 1 << 15, SEEDS).astype(float) - by_path(2, 4)
    assert (references.std(axis=0) / 4 < 0.05 * references.mean(axis=0)).all()
    assert agree(samples, references, rounding=1e-3)
    assert not agree(1.3 * samples, references, rounding=1e-3)


# ------------------------------------------------------------------------------ pulses, nesting


def narrow(**options) -> dict:
    return projector(grid_sigma=1e-3, frame=pointed((0, 0, 0)), **options)


def bins_of(pattern: dict, start: float, width: float, count: int) -> np.ndarray:
    """What a patch of 2 mm makes of the pulse."""
    small = Rectangle.turned((0.0, 0.0, 1.0), 0, 0, half=(1e-3, 1e-3))
    window = film(bins=count, start=start, bin_width=width)
    described = lit_by(pattern, {"hidden": small.shape()}, window)
    return rendered(load_nlos(described), spp=1 << 14)[1][0, 0, :, 0]


def test_gaussian_pulse():
    opl = 2 + 2 * math.hypot(*PLACE)
    found = bins_of(narrow(pulse_width_opl=0.08), opl - 0.4, 0.02, 40)
    masses = oracles.gaussian_masses(opl - 0.4 + 0.02 * np.arange(41), opl, 0.08)
    assert found / found.sum() == pytest.approx(masses / masses.sum(), abs=2e-3 * masses.max())


def test_histogram_pulse():
    """Values in bins of 0.1 m from -0.15 m on: shares of the energy."""
    opl = 2 + 2 * math.hypot(*PLACE)
    shape = {
        "pulse_type": "histogram",
        "pulse_values": mi.TensorXf([1.0, 0.0, 3.0, 2.0]),
        "pulse_start_opl": -0.15,
        "pulse_bin_width_opl": 0.1,
    }
    found = bins_of(narrow(**shape), opl - 0.35, 0.1, 8)
    expected = np.array([0, 0, 1, 0, 3, 2, 0, 0]) / 6
    assert found / found.sum() == pytest.approx(expected, abs=5e-3)


def test_projector_nests_in_both_integrators():
    pattern = projector(**spots(*PATTERNS["several"]))
    named = lit_by(pattern, {"hidden": PATCH.shape()}, film(2, 2))
    plain = named | {"integrator": named["integrator"] | {"type": "transient_path"}}
    one, other = (load_nlos(d) for d in (named, plain))
    assert type(one.integrator()) is type(other.integrator())
    np.testing.assert_array_equal(rendered(one, 16)[1], rendered(other, 16)[1])


def test_a_projector_leaves_other_scenes_alone():
    """Dr.Jit calls what all living emitters make of a ray, the projector too."""
    there = mi.load_dict(projector(**spots(*PATTERNS["several"])))
    steady, _ = rendered(load(with_sampler(cornell_box(width=4, height=4))), spp=4)
    assert steady.max() > 0
    assert there is not None


def test_axes_follow_the_ray_as_a_fixed_frame_does():
    """A pattern is not mirrored between the two kinds: x and y are those of `look_at`."""
    confocal_one = mi.load_dict({"type": "confocal_projector"})
    matrix = np.array(pointed().matrix)
    found = confocal_one.axes(mi.Vector3f(matrix[:3, 2].tolist()), mi.Vector3f(0, 1, 0))
    for axis, expected in zip((found.s, found.t, found.n), matrix[:3, :3].T, strict=True):
        assert np.array(axis).ravel() == pytest.approx(expected, abs=1e-6)


def test_unit_vectors():
    """A beam's direction has length 1, in whatever frame."""
    made = mi.load_dict(projector(grid_sigma=0.5))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 1024)
    direction, _ = made.sample_beam(made.axes(None, None), sampler, mi.Bool(True))
    assert dr.allclose(dr.norm(direction), 1, atol=1e-6)


def test_kernels_stay_wherever_numpy_puts_arrays():
    """Dr.Jit makes others for memory that is aligned otherwise: a load would find none of its own.

    NumPy's memory is aligned by chance, once in four times: 1 % of mistakes stay unseen.
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
