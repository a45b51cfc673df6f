"""Three bounces around the corner against closed forms from `nlos_oracles`."""

import math

import numpy as np
import pytest
from helpers.confocal import (
    GRID,
    LIT,
    MODES,
    SEEDS,
    facing,
    found,
    groove_shapes,
    setup_of,
    small_film,
    three_of,
    totals,
)
from helpers.parts import diffuse
from helpers.support import agree, film, over_seeds, rendered
from oracles import nlos


def in_time(described: dict, spp: int) -> np.ndarray:
    """Return bins of the first pixel for several seeds."""
    return over_seeds(nlos.estimates(described, spp, "transient"), SEEDS)[:, 0, 0]


PATCHES = {
    "parallel": nlos.Rectangle.turned((0.1, 0.2, 1.0), 0, 0),
    "tilted": nlos.Rectangle.turned((0.2, -0.1, 0.9), 35, 0),
    "tilted to the side": nlos.Rectangle.turned((-0.4, 0.5, 1.1), 50, 120, half=(0.15, 0.05)),
    "grazing": nlos.Rectangle.turned((0.9, -0.8, 0.5), 60, -40),
}


@pytest.mark.statistical
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("name", PATCHES)
def test_patch(name, mode):
    setup, patch = setup_of(mode, power=2.5), facing(PATCHES[name])
    expected = totals(setup, patch.nodes(), lit=MODES[mode])
    assert agree(found(three_of(mode, {"hidden": patch.shape()}, setup=setup)), expected)


def test_small_patch_is_f1():
    patch = facing(nlos.Rectangle.turned((0.3, 0.1, 1.2), 40, 30, (1e-3, 1e-3)))
    r = float(np.linalg.norm(patch.center))
    cos_h, cos_w = abs(np.dot(patch.normal, patch.center)) / r, patch.center[2] / r
    f1 = 2.0 * 0.8**2 * 0.7 * patch.area * cos_w**2 * cos_h**2 / (math.pi**3 * r**4)
    whole = nlos.total(nlos.Setup(power=2.0), patch.nodes(), 0.7, (0, 0, 0), (0, 0, 0))
    assert whole == pytest.approx(f1, rel=1e-5)


@pytest.mark.statistical
@pytest.mark.parametrize("legs", [True, False])
@pytest.mark.parametrize("mode", MODES)
def test_patch_in_time(mode, legs):
    setup, patch = setup_of(mode, legs=legs), facing(PATCHES["tilted"])
    points = GRID.points().reshape(-1, 3)
    every = [nlos.three_bounces(setup, patch.nodes(), 0.7, MODES[mode] or p, p) for p in points]
    start = min(opl.min() for opl, _ in every) - 0.05
    bins = math.ceil((max(opl.max() for opl, _ in every) + 0.05 - start) / 0.02)
    edges = start + 0.02 * np.arange(bins + 1)
    expected = sum(nlos.masses(edges, *each) for each in every)
    window = small_film(bins=bins, start=start, bin_width=0.02)
    described = three_of(mode, {"hidden": patch.shape()}, window, setup)
    samples = over_seeds(nlos.estimates(described, 1024, "transient"), SEEDS).sum(axis=(1, 2))
    assert agree(samples, expected, rounding=2e-3)
    assert not agree(np.roll(samples, 1, axis=1), expected, rounding=2e-3)
    assert not agree(1.05 * samples, expected, rounding=2e-3)


@pytest.mark.statistical
@pytest.mark.parametrize("half_width", [12, 200])
def test_infinite_plane(half_width):
    """A parallel plane of 24 m: its middle is found by the wall's BSDF and by area sampling."""
    setup, distance = nlos.Setup(legs=False, power=3.0), 0.8
    edges = 2 * (distance + np.arange(21) * 0.05 - 0.02)
    far = nlos.Rectangle.turned((0, 0, distance), 0, 0, half=(half_width, half_width))
    hidden = far.shape({"type": "twosided", "side": diffuse(0.7)})
    # The device stands between wall and plane, where the plane hides nothing from it
    setup.sensor = (-0.3, 0.2, 0.5)
    window = film(bins=20, start=edges[0], bin_width=0.1)
    described = nlos.confocal(setup, {"hidden": hidden}, window)
    expected = nlos.plane_masses(edges / 2, setup, 0.7, distance)
    assert agree(in_time(described, 4096), expected)
    whole = 3.0 * 0.8**2 * 0.7 / (3 * math.pi**2 * distance**2)
    assert agree(found(described, 8192)[:, 0, 0], np.array(whole))


@pytest.mark.statistical
def test_sphere():
    setup, center, radius = nlos.Setup(legs=False, power=3.0), (0.5, 0.3, 0.9), 0.4
    ball = {"type": "sphere", "center": list(center), "radius": radius, "bsdf": diffuse(0.7)}
    edges = 2 * np.linspace(0.6, 1.1, 26)
    window = film(bins=25, start=edges[0], bin_width=0.04)
    expected = nlos.sphere_masses(edges / 2, setup, 0.7, (0, 0, 0), center, radius)
    by_nodes = nlos.total(setup, nlos.sphere_nodes(center, radius), 0.7, (0, 0, 0), (0, 0, 0))
    assert expected.sum() == pytest.approx(by_nodes, rel=1e-4)  # two ways to the same
    described = nlos.confocal(setup, {"hidden": ball}, window)
    assert agree(in_time(described, 4096), expected)


@pytest.mark.statistical
def test_groove():
    setup, groove = nlos.Setup(power=3.0), nlos.Groove(half_length=6.0)
    nodes = groove.faces()[0].nodes(3000, 100) + groove.faces()[1].nodes(3000, 100)
    expected = nlos.total(setup, nodes, 0.9, (0, 0, 0), (0, 0, 0))
    assert expected == pytest.approx(groove.long_total(setup), rel=1e-3)
    samples = found(nlos.confocal(setup, groove_shapes(groove), film()), 4096)[:, 0, 0]
    assert agree(samples, np.array(expected), rounding=1e-4)


@pytest.mark.statistical
def test_light_between_the_faces_of_a_groove():
    setup, groove = nlos.Setup(power=3.0), nlos.Groove()
    start = setup.length((0, 0, 0), (0, 0, 0)) + 1.95
    edges = start + 0.05 * np.arange(17)
    window = film(bins=16, start=start, bin_width=0.05)
    described = nlos.confocal(setup, groove_shapes(groove), window, filter_bounces=4)
    samples = in_time(described, 4096)
    four = (groove.four_bounces(setup, 50_000, seed) for seed in SEEDS)
    expected = np.stack([nlos.masses(edges, *each) for each in four])
    assert samples.sum() > 0
    assert agree(samples, expected)


def test_four_bounces_need_two_hidden_surfaces():
    ball = {"type": "sphere", "center": [0.5, 0.3, 0.9], "radius": 0.4, "bsdf": diffuse(0.7)}
    for hidden in (ball, PATCHES["tilted"].shape()):
        for bounces, there in ((2, False), (3, True), (4, False), (5, True)):
            described = nlos.confocal(nlos.Setup(), {"hidden": hidden}, filter_bounces=bounces)
            steady, transient = rendered(nlos.load_nlos(described), spp=4096)
            assert (steady.max() > 0) == (transient.max() > 0) == there, (hidden["type"], bounces)


FRONT = nlos.Rectangle((0.1, 0.0, 0.9), (-0.25, 0, 0), (0, 0.25, 0))


@pytest.mark.statistical
@pytest.mark.parametrize("mode", MODES)
def test_what_something_hides_does_not_count(mode):
    behind = nlos.Rectangle((0.1, 0.0, 0.95), (-0.1, 0, 0), (0, 0.1, 0), albedo=0.9)
    both = found(three_of(mode, {"front": FRONT.shape(), "behind": behind.shape()}))
    assert agree(both, totals(nlos.Setup(), FRONT.nodes(), lit=MODES[mode]))


@pytest.mark.statistical
@pytest.mark.parametrize("mode", MODES)
def test_two_sided_is_one_sided_turned(mode):
    away = FRONT.flipped()
    expected = totals(nlos.Setup(), FRONT.nodes(), lit=MODES[mode])
    two_sided = {"type": "twosided", "side": diffuse(0.7)}
    assert agree(found(three_of(mode, {"hidden": away.shape(two_sided)})), expected)
    steady, transient = rendered(nlos.load_nlos(three_of(mode, {"hidden": away.shape()})), spp=256)
    assert steady.max() == transient.max() == 0


def behind(plate: nlos.Rectangle, nodes: nlos.Nodes, *points) -> nlos.Nodes:
    """Return the nodes that all points see, although the plate occludes some nodes."""
    clear = np.ones(len(nodes.areas), bool)
    for point in points:
        d = nodes.points - point
        share = (np.asarray(plate.center) - point) @ plate.normal / (d @ plate.normal)
        at = point + share[:, None] * d - np.asarray(plate.center)
        inside = [np.abs(at @ np.asarray(a)) < np.dot(a, a) for a in (plate.u, plate.v)]
        clear &= ~((share > 0) & (share < 1) & inside[0] & inside[1])
    assert 0.1 < clear.mean() < 0.9
    return nlos.Nodes(nodes.points[clear], nodes.normals[clear], nodes.areas[clear])


BLACK = {"type": "twosided", "side": diffuse(0.0)}


@pytest.mark.statistical
def test_half_hidden():
    """A plate hides the lower half of the object from the middle of the wall."""
    plate = nlos.Rectangle((0.05, -0.15, 0.45), (0.2, 0, 0), (0, 0.15, 0.1))
    parts = {"hidden": FRONT.shape(), "plate": plate.shape(BLACK)}
    nodes = behind(plate, FRONT.nodes(1000, 1000), np.zeros(3))
    expected = nlos.total(nlos.Setup(), nodes, 0.7, (0, 0, 0), (0, 0, 0))
    samples = found(nlos.confocal(nlos.Setup(), parts, film()), 4096)[:, 0, 0]
    assert agree(samples, np.array(expected), rounding=2e-3)


@pytest.mark.statistical
def test_shadow_of_the_lit_point():
    plate = nlos.Rectangle((-0.18, 0.175, 0.27), (0.07, 0, 0), (0, 0.07, 0))
    nodes = FRONT.nodes(600, 600)
    expected = [
        [nlos.total(nlos.Setup(), behind(plate, nodes, LIT, p), 0.7, LIT, p) for p in row]
        for row in GRID.points()
    ]
    described = three_of("single", {"hidden": FRONT.shape(), "plate": plate.shape(BLACK)})
    assert agree(found(described, 1024), np.array(expected), rounding=2e-3)
