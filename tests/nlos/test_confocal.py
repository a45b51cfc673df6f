"""Three bounces around the corner by closed form. The formulas are in `nlos_oracles`."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.support import agree, camera, diffuse, film, over_seeds, rendered
from oracles import films as oracles
from oracles.nlos import (
    Grid,
    Groove,
    Nodes,
    Rectangle,
    Setup,
    confocal,
    estimates,
    load_nlos,
    masses,
    plane_masses,
    single,
    sphere_masses,
    sphere_nodes,
    three_bounces,
    total,
)

SEEDS = range(16)
GRID = Grid(2, 2)
LASER = (-0.8, -0.5, 0.6)
LIT = (-0.3, 0.25, 0.0)


def totals(setup: Setup, hidden: Nodes, albedo: float = 0.7, lit=None, **more) -> np.ndarray:
    """What the four points of GRID see; each lights itself unless `lit` is given."""
    return np.array(
        [
            [total(setup, hidden, albedo, p if lit is None else lit, p, **more) for p in row]
            for row in GRID.points()
        ]
    )


def small_film(**more) -> dict:
    return film(2, 2, **more)


def found(description: dict, spp: int = 512, seeds=SEEDS) -> np.ndarray:
    """Steady pictures over seeds."""
    return over_seeds(estimates(description, spp), seeds)


# --------------------------------------------------------------------------------- f1: patches

PATCHES = {
    "parallel": Rectangle.turned((0.1, 0.2, 1.0), 0, 0),
    "tilted": Rectangle.turned((0.2, -0.1, 0.9), 35, 0),
    "tilted to the side": Rectangle.turned((-0.4, 0.5, 1.1), 50, 120, half=(0.15, 0.05)),
    "grazing": Rectangle.turned((0.9, -0.8, 0.5), 60, -40),
}


def facing(patch: Rectangle) -> Rectangle:
    """The side towards which the middle of the wall is."""
    return patch if np.dot(patch.normal, patch.centre) < 0 else patch.flipped()


@pytest.mark.statistical
@pytest.mark.parametrize("name", PATCHES)
def test_confocal_patch(name):
    setup, patch = Setup(power=2.5), facing(PATCHES[name])
    expected = totals(setup, patch.nodes())
    assert agree(found(confocal(setup, {"hidden": patch.shape()}, small_film())), expected)


@pytest.mark.statistical
@pytest.mark.parametrize("name", PATCHES)
def test_single_patch(name):
    setup, patch = Setup(power=2.5, laser=LASER), facing(PATCHES[name])
    expected = totals(setup, patch.nodes(), lit=LIT)
    assert agree(found(single(setup, {"hidden": patch.shape()}, LIT, small_film())), expected)


def test_small_patch_is_f1():
    """The formula of the table is what the integral comes to for a small patch."""
    setup, patch = Setup(power=2.0), facing(Rectangle.turned((0.3, 0.1, 1.2), 40, 30, (1e-3, 1e-3)))
    r = float(np.linalg.norm(patch.centre))
    cos_h, cos_w = abs(np.dot(patch.normal, patch.centre)) / r, patch.centre[2] / r
    f1 = 2.0 * 0.8**2 * 0.7 * patch.area * cos_w**2 * cos_h**2 / (math.pi**3 * r**4)
    assert total(setup, patch.nodes(), 0.7, (0, 0, 0), (0, 0, 0)) == pytest.approx(f1, rel=1e-5)
    steady, _ = rendered(load_nlos(confocal(setup, {"hidden": patch.shape()})), spp=1 << 14)
    assert steady[0, 0, 0] == pytest.approx(f1, rel=0.03)


@pytest.mark.statistical
@pytest.mark.parametrize("legs", [True, False])
@pytest.mark.parametrize("mode", ["confocal", "single"])
def test_patch_in_time(mode, legs):
    """Bins of 2 cm, all four points together."""
    setup, patch = Setup(legs=legs, laser=None if mode == "confocal" else LASER), PATCHES["tilted"]
    patch = facing(patch)
    nodes = patch.nodes()
    every = [
        three_bounces(setup, nodes, 0.7, p if mode == "confocal" else LIT, p)
        for p in GRID.points().reshape(-1, 3)
    ]
    start = min(opl.min() for opl, _ in every) - 0.05
    bins = math.ceil((max(opl.max() for opl, _ in every) + 0.05 - start) / 0.02)
    edges = start + 0.02 * np.arange(bins + 1)
    expected = sum(masses(edges, *each) for each in every)
    assert expected.sum() == pytest.approx(
        totals(setup, patch.nodes(), lit=None if (mode == "confocal") else LIT).sum(), rel=1e-4
    )
    window = small_film(bins=bins, start=start, bin_width=0.02)
    hidden = {"hidden": patch.shape()}
    described = (
        confocal(setup, hidden, window)
        if mode == "confocal"
        else single(setup, hidden, LIT, window)
    )
    samples = over_seeds(estimates(described, 1024, "transient"), SEEDS).sum(axis=(1, 2))
    assert agree(samples, expected, rounding=2e-3)
    assert not agree(np.roll(samples, 1, axis=1), expected, rounding=2e-3)
    assert not agree(1.05 * samples, expected, rounding=2e-3)


def test_power_scales():
    patch = {"hidden": PATCHES["tilted"].shape()}
    one, five = (
        rendered(load_nlos(confocal(Setup(power=p), patch, small_film())), spp=64) for p in (1, 5)
    )
    assert one[0].max() > 0
    assert five[0] == pytest.approx(5 * one[0], rel=1e-5)
    assert five[1] == pytest.approx(5 * one[1], rel=1e-5)


def test_pulse():
    """A patch of 2 mm at one distance: the pulse's own shape."""
    setup, patch = Setup(), Rectangle.turned((0.0, 0.0, 1.0), 0, 0, half=(1e-3, 1e-3))
    opl = setup.length((0, 0, 0), (0, 0, 0)) + 2
    start = opl - 0.3
    window = film(bins=30, start=start, bin_width=0.02)
    described = confocal(setup, {"hidden": patch.shape()}, window, pulse_width_opl=0.05)
    steady, transient = rendered(load_nlos(described), spp=4096)
    edges = start + 0.02 * np.arange(31)
    expected = steady[0, 0, 0] * oracles.gaussian_masses(edges, opl, 0.05)
    assert transient[0, 0, :, 0] == pytest.approx(expected, abs=3e-3 * expected.max())


@pytest.mark.statistical
def test_perspective_camera():
    """Laser and sensor are the camera, which sees 20 micrometres of the wall."""
    setup, patch = Setup(sensor=(0.4, 0.3, 1.3)), facing(PATCHES["tilted"])
    described = confocal(setup, {"hidden": patch.shape()})
    wall = {k: v for k, v in described["relay_wall"].items() if k != "sensor"}
    window = film(bins=400, bin_width=0.02)
    eye = camera(setup.sensor, (0.1, -0.2, 0), window, fov=0.001)
    described |= {"relay_wall": wall, "sensor": eye}
    expected = total(setup, patch.nodes(), 0.7, (0.1, -0.2, 0), (0.1, -0.2, 0))
    samples = over_seeds(estimates(described, 1024, "transient"), SEEDS)[:, 0, 0]
    assert agree(samples.sum(axis=1), np.array(expected), rounding=1e-4)
    opl, _ = three_bounces(setup, patch.nodes(), 0.7, (0.1, -0.2, 0), (0.1, -0.2, 0))
    there = np.flatnonzero(samples.sum(axis=0))
    assert int(opl.min() / 0.02) - 1 <= there.min() <= there.max() <= int(opl.max() / 0.02) + 1


# ------------------------------------------------------------------------- f2, spheres, grooves


@pytest.mark.statistical
@pytest.mark.parametrize("half_width", [12, 200])
def test_infinite_plane(half_width):
    """A parallel plane of 24 m, of which the wall's material and area sampling find the middle."""
    setup, distance = Setup(legs=False, power=3.0), 0.8
    edges = 2 * (distance + np.arange(21) * 0.05 - 0.02)
    hidden = Rectangle.turned((0, 0, distance), 0, 0, half=(half_width, half_width)).shape(
        {"type": "twosided", "side": diffuse(0.7)}
    )
    # The device stands between wall and plane, where the plane hides nothing from it
    setup.sensor = (-0.3, 0.2, 0.5)
    window = film(bins=20, start=edges[0], bin_width=0.1)
    described = confocal(setup, {"hidden": hidden}, window)
    expected = plane_masses(edges / 2, setup, 0.7, distance)
    samples = over_seeds(estimates(described, 4096, "transient"), SEEDS)[:, 0, 0]
    assert agree(samples, expected)
    whole = 3.0 * 0.8**2 * 0.7 / (3 * math.pi**2 * distance**2)
    assert agree(over_seeds(estimates(described, 8192), SEEDS)[:, 0, 0], np.array(whole))


@pytest.mark.statistical
def test_sphere():
    setup, centre, radius = Setup(legs=False, power=3.0), (0.5, 0.3, 0.9), 0.4
    ball = {"type": "sphere", "center": list(centre), "radius": radius, "bsdf": diffuse(0.7)}
    edges = 2 * np.linspace(0.6, 1.1, 26)
    window = film(bins=25, start=edges[0], bin_width=0.04)
    expected = sphere_masses(edges / 2, setup, 0.7, (0, 0, 0), centre, radius)
    by_nodes = total(setup, sphere_nodes(centre, radius), 0.7, (0, 0, 0), (0, 0, 0))
    assert expected.sum() == pytest.approx(by_nodes, rel=1e-4)  # two ways to the same
    described = confocal(setup, {"hidden": ball}, window)
    assert agree(over_seeds(estimates(described, 4096, "transient"), SEEDS)[:, 0, 0], expected)


def groove_shapes(groove: Groove) -> dict:
    left, right = groove.faces()
    return {"left": left.shape(), "right": right.shape()}


@pytest.mark.statistical
@pytest.mark.parametrize("half_length", [0.4, 6.0])
def test_groove(half_length):
    setup, groove = Setup(power=3.0), Groove(half_length=half_length)
    expected = sum(
        total(setup, face.nodes(3000, 100), 0.9, (0, 0, 0), (0, 0, 0)) for face in groove.faces()
    )
    if half_length > 5:
        assert expected == pytest.approx(groove.long_total(setup), rel=1e-3)
    samples = found(confocal(setup, groove_shapes(groove), film()), 4096)[:, 0, 0]
    assert agree(samples, np.array(expected), rounding=1e-4)


@pytest.mark.statistical
def test_light_between_the_faces_of_a_groove():
    """Four bounces: wall, one face, the other, wall."""
    setup, groove = Setup(power=3.0), Groove()
    start = setup.length((0, 0, 0), (0, 0, 0)) + 1.95
    edges = start + 0.05 * np.arange(17)
    window = film(bins=16, start=start, bin_width=0.05)
    described = confocal(setup, groove_shapes(groove), window, filter_bounces=4)
    samples = over_seeds(estimates(described, 4096, "transient"), SEEDS)[:, 0, 0]
    expected = over_seeds(lambda s: masses(edges, *groove.four_bounces(setup, 50_000, s)), SEEDS)
    assert samples.sum() > 0
    assert agree(samples, expected)


@pytest.mark.parametrize("name", ["patch", "sphere"])
def test_four_bounces_need_two_hidden_surfaces(name):
    """A flat wall and a convex object do not light themselves."""
    ball = {"type": "sphere", "center": [0.5, 0.3, 0.9], "radius": 0.4, "bsdf": diffuse(0.7)}
    hidden = ball if name == "sphere" else PATCHES["tilted"].shape()
    for bounces, there in ((2, False), (3, True), (4, False), (5, True)):
        described = confocal(Setup(), {"hidden": hidden}, filter_bounces=bounces)
        steady, transient = rendered(load_nlos(described), spp=4096)
        assert (steady.max() > 0) == (transient.max() > 0) == there, bounces


# --------------------------------------------------------------------------- sides and shadows

FRONT = Rectangle((0.1, 0.0, 0.9), (-0.25, 0, 0), (0, 0.25, 0))
MODES = ["confocal", "single"]


def three_of(mode: str, hidden: dict, the_film: dict | None = None, **options) -> dict:
    if mode == "confocal":
        return confocal(Setup(), hidden, the_film or small_film(), **options)
    return single(Setup(laser=LASER), hidden, LIT, the_film or small_film(), **options)


@pytest.mark.statistical
@pytest.mark.parametrize("mode", MODES)
def test_what_something_hides_does_not_count(mode):
    """Behind FRONT, in its shadow from every point of the wall."""
    behind = Rectangle((0.1, 0.0, 0.95), (-0.1, 0, 0), (0, 0.1, 0), albedo=0.9)
    alone = totals(Setup(), FRONT.nodes(), lit=None if mode == "confocal" else LIT)
    both = found(three_of(mode, {"front": FRONT.shape(), "behind": behind.shape()}))
    assert agree(both, alone)


@pytest.mark.statistical
@pytest.mark.parametrize("mode", MODES)
def test_two_sided_is_one_sided_turned(mode):
    away = FRONT.flipped()
    expected = totals(Setup(), FRONT.nodes(), lit=None if mode == "confocal" else LIT)
    two_sided = {"type": "twosided", "side": diffuse(0.7)}
    assert agree(found(three_of(mode, {"hidden": away.shape(two_sided)})), expected)
    steady, transient = rendered(load_nlos(three_of(mode, {"hidden": away.shape()})), spp=256)
    assert steady.max() == transient.max() == 0


@pytest.mark.parametrize("mode", MODES)
def test_occluder_blocks(mode):
    """A black plate between wall and object, beside the device's own rays."""
    plate = Rectangle((0.1, 0.0, 0.88), (-0.4, 0, 0), (0, 0.4, 0), albedo=0.0)
    parts = {"hidden": FRONT.shape(), "plate": plate.shape()}
    steady, transient = rendered(load_nlos(three_of(mode, parts)), spp=1024)
    assert steady.max() == transient.max() == 0


@pytest.mark.statistical
def test_half_hidden():
    """A plate between the wall's middle and the object hides the object's lower half from there."""
    plate = Rectangle((0.05, -0.15, 0.45), (0.2, 0, 0), (0, 0.15, 0.1), albedo=0.0)
    black = plate.shape({"type": "twosided", "side": diffuse(0.0)})
    described = confocal(Setup(), {"hidden": FRONT.shape(), "plate": black}, film())
    nodes = FRONT.nodes(1000, 1000)
    seen = ~crosses(plate, np.zeros(3), nodes.points)
    assert 0.3 < seen.mean() < 0.7
    nodes = Nodes(nodes.points[seen], nodes.normals[seen], nodes.areas[seen])
    expected = total(Setup(), nodes, 0.7, (0, 0, 0), (0, 0, 0))
    assert agree(found(described, 4096)[:, 0, 0], np.array(expected), rounding=2e-3)


@pytest.mark.statistical
def test_shadow_of_the_lit_point():
    """A small plate near the lit point, which the seen points look past."""
    plate = Rectangle((-0.18, 0.175, 0.27), (0.07, 0, 0), (0, 0.07, 0), albedo=0.0)
    black = plate.shape({"type": "twosided", "side": diffuse(0.0)})
    nodes = FRONT.nodes(600, 600)
    lit = ~crosses(plate, np.asarray(LIT), nodes.points)
    assert 0.1 < lit.mean() < 0.9
    expected = np.zeros((2, 2))
    for place, point in zip(np.ndindex(2, 2), GRID.points().reshape(-1, 3), strict=True):
        seen = lit & ~crosses(plate, point, nodes.points)
        kept = Nodes(nodes.points[seen], nodes.normals[seen], nodes.areas[seen])
        expected[place] = total(Setup(), kept, 0.7, LIT, point)
    described = three_of("single", {"hidden": FRONT.shape(), "plate": black})
    assert agree(found(described, 1024), expected, rounding=2e-3)


def crosses(plate: Rectangle, point, others: np.ndarray) -> np.ndarray:
    """Whether the plate is between a point and others."""
    d = others - point
    share = (np.asarray(plate.centre) - point) @ plate.normal / (d @ plate.normal)
    at = point + share[:, None] * d - np.asarray(plate.centre)
    inside = [np.abs(at @ np.asarray(a)) < np.dot(a, a) for a in (plate.u, plate.v)]
    return (share > 0) & (share < 1) & inside[0] & inside[1]
