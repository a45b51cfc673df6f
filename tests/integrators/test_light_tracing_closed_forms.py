"""Paths against closed forms: how much light arrives, and when, strategy by strategy.

A strategy "s,t" joins s vertices from a light to t from the lens. Alone and without a weight, each
that can find a path gives all of its light. The formulas are in `oracles`.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import mitsuba as mi
import numpy as np
import pytest
from helpers.light_paths import (
    ALBEDO,
    BDPT,
    GLASS,
    LIGHT_TRACER,
    PATH,
    TRACERS,
    arrivals,
    arrives,
    ball,
    by,
    facing_down,
    floor,
    lamp,
    looking_down,
    spot,
    through,
)
from helpers.parts import area_light, diffuse, gray, plane, point_light, rotate, translate, unit
from helpers.support import agree, camera, film, load, over_seeds, refused, rendered, scene
from oracles import films as oracles
from oracles.light_paths import (
    Caustic,
    Light,
    View,
    ball_in_a_lens,
    out_of_glass,
    through_a_ball,
    through_a_slab,
    under_a_ball,
    under_a_disk,
    under_a_point,
    under_a_rectangle,
    under_a_sky,
    under_a_sun,
    window_area,
)

import tofrender
from tofrender.integrators.two_strategies import TransientTwoStrategies

SEEDS = range(32)


class Case(NamedTuple):
    """A floor under some light: the view, parts of the scene, and the exact film mean."""

    view: View
    parts: Callable[[], dict]
    exact: Callable[[View], Light]


TO_SUN = unit((0.3, -0.5, 0.8))
SPHERE = oracles.enclosing_sphere((-1, -1, 0), (1, 1, 2.5))
"""Around a floor of 2 m x 2 m and a camera 2.5 m over it."""


def sun() -> dict:
    light = {"type": "directional", "direction": (-TO_SUN).tolist(), "irradiance": gray(2.0)}
    return {"lamp": light} | floor(1.0)


def sky() -> dict:
    return {"lamp": {"type": "constant", "radiance": gray(2.0)}} | floor(1.0)


def rectangle(shift: float) -> Case:
    return Case(
        View(2.5, shift=shift),
        lambda: facing_down("rectangle", 3.0, 0.2, 10.0),
        lambda view: under_a_rectangle(view, (0.2, 0.2), 3.0, 10.0, ALBEDO),
    )


CASES = {
    "point": Case(
        View(2.0),
        lambda: lamp((0.5, 0, 3)),
        lambda view: under_a_point(view, (0.5, 0, 3), 1.0, ALBEDO),
    ),
    "rectangle": rectangle(0.0),
    "offset .1": rectangle(0.1),
    "offset .3": rectangle(0.3),
    "disk": Case(
        View(0.9, fov=60),
        lambda: facing_down("disk", 1.0, 1.5, 4.0),
        lambda view: under_a_disk(view, 1.5, 1.0, 4.0, ALBEDO),
    ),
    "ball": Case(
        View(1.0, fov=70),
        lambda: {"lamp": ball((0, 0, 1.6), 0.5, emitter=area_light(3.0))},
        lambda view: under_a_ball(view, 0.5, 1.6, 3.0, ALBEDO),
    ),
    "sky": Case(View(2.5), sky, lambda view: under_a_sky(view, 2.0, ALBEDO, *SPHERE)),
    "sun": Case(View(2.5), sun, lambda view: under_a_sun(view, TO_SUN, 2.0, ALBEDO, *SPHERE)),
}


@functools.cache
def exact(name: str) -> tuple[Light, np.ndarray]:
    """The film's mean, and edges of 64 bins that hold it."""
    light = CASES[name].exact(CASES[name].view)
    low, high = light.opl.min(), light.opl.max()
    margin = 0.01 * (high - low)
    return light, np.linspace(low - margin, high + margin, 65)


def described(name: str, technique: str, **more: Any) -> dict:
    case = CASES[name]
    return through(looking_down(case.view, case.parts(), exact(name)[1], **more), technique)


@functools.cache
def samples(name: str, technique: str, spp: int) -> np.ndarray:
    return arrivals(described(name, technique), spp, SEEDS)


TRIED = [
    *[("point", how, spp) for how, spp in (("1,2", 16), ("2,1", 1024), (LIGHT_TRACER, 2048))],
    *[("rectangle", how, spp) for how, spp in (("0,3", 2048), ("1,2", 16), ("2,1", 512))],
    *[(f"offset {shift}", "2,1", 512) for shift in (".1", ".3")],
    *[("disk", how, spp) for how, spp in (("0,3", 64), ("2,1", 512))],
    *[("ball", how, spp) for how, spp in (("0,3", 512), (LIGHT_TRACER, 1024))],
    *[("sky", how, spp) for how, spp in (("0,3", 64), ("1,2", 64), ("2,1", 512))],
    *[("sun", how, spp) for how, spp in (("1,2", 16), (LIGHT_TRACER, 512))],
    *[(name, PATH, 64) for name in CASES],
    *[(name, BDPT, 64) for name in CASES],
]
"""About 0.3 % of noise in the mean."""


@pytest.mark.statistical
@pytest.mark.parametrize(("name", "technique", "spp"), TRIED)
def test_each_has_all_light(name, technique, spp):
    light, edges = exact(name)
    masses, found = light.masses(edges), samples(name, technique, spp)
    assert arrives(found, masses, edges)
    if (name, technique) in (("rectangle", "2,1"), ("disk", "0,3")):
        for wrong in (1.03 * found, found / 1.03, np.roll(found, 1, axis=1), found * np.nan):
            assert not arrives(wrong, masses, edges)
    if (name, technique) == ("offset .3", BDPT):  # A window that ignores the principal point
        centered = CASES["rectangle"].exact(CASES["rectangle"].view).masses(edges)
        assert not arrives(centered + found - found.mean(axis=0), masses, edges)


BOUNCE = 0.8
"""Albedo of the sphere of radius 1, with a lamp and a camera of 90 degrees at its center."""


def in_sphere(technique: str, max_depth: int, edges=None, size: int = 4, **more: Any) -> dict:
    edges = np.linspace(0, 32, 33) if edges is None else edges
    window = film(size, size, edges.size - 1, float(edges[0]), float(edges[1] - edges[0]))
    shell = {"type": "sphere", "flip_normals": True, "bsdf": diffuse(BOUNCE)}
    parts = {"shell": shell, "lamp": point_light((0, 0, 0), 1.0)}
    view = camera((0, 0, 0), (0, 0, 1), window, fov=90, near_clip=0.01)
    return scene(parts, view) | {"integrator": by(technique, max_depth, rr_depth=100, **more)}


def bounce(n: int) -> float:
    return oracles.sphere_bounce_total(n, 1.0, BOUNCE, 1.0)


CONNECTED = [(s, n + 3 - s, n) for n in (0, 1, 2) for s in range(1, n + 2)]
"""Strategies of the n-th bounce whose connection ends on a surface that the camera's path found."""


@pytest.mark.parametrize(("s", "t", "n"), CONNECTED)
def test_connections_in_a_sphere_have_no_noise(s, t, n):
    """The product of material and geometry is the same between any two points."""
    steady, transient = rendered(load(in_sphere(f"{s},{t}", n + 2)), spp=64)
    expected = np.full((4, 4, 3), bounce(n))
    assert steady == pytest.approx(expected, rel=5e-4)
    assert transient.sum(axis=2) == pytest.approx(expected, rel=5e-4)
    if n == 0:
        assert transient[:, :, 1:3].sum() == pytest.approx(expected.sum(), rel=5e-4)


@pytest.mark.parametrize(("mis", "max_depth"), [("power", 2), ("power", 5), ("balance", 5)])
def test_weights_in_a_sphere_sum_to_one(mis, max_depth):
    """Without connections to the lens there is no noise, so that the weights alone can be wrong."""
    described = in_sphere(BDPT, max_depth, mis=mis, camera_connections=False)
    steady, _ = rendered(load(described), spp=64)
    expected = sum(bounce(n) for n in range(max_depth - 1))
    assert steady == pytest.approx(np.full((4, 4, 3), expected), rel=5e-4)


def share(n: int, power: int) -> float:
    """Mean over the film of the weight of a strategy that does not end on the lens.

    With p_w = 1 / (A cos³), what the camera finds first has the density p_w, and all else, like
    what the light finds first, 1 / (4 π): n + 1 strategies have p_w, the one to the lens 1 / (4 π)
    in its place.
    """
    ticks = 2 * (np.arange(400) + 0.5) / 400 - 1
    u, v = np.meshgrid(ticks, ticks)
    window = (1 + u**2 + v**2) ** 1.5 / window_area(90)
    mine, lens = window**power, (1 / (4 * math.pi)) ** power
    return float(np.mean(mine / ((n + 1) * mine + lens)))


@pytest.mark.parametrize(
    ("technique", "n", "mis", "power"), [("1,2", 0, "balance", 1), ("2,2", 1, "power", 2)]
)
def test_shares_against_connections_to_the_lens(technique, n, mis, power):
    steady, _ = rendered(load(in_sphere(technique, n + 2, size=8, mis=mis)), spp=256)
    expected = bounce(n) * share(n, power)
    assert steady.mean() == pytest.approx(expected, rel=2e-3)
    assert abs(share(n, 3 - power) / share(n, power) - 1) > 0.01


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("technique", "bounces", "spp"),
    [
        ("2,2", [1], 64),
        ("2,3", [2], 64),
        ("3,1", [1], 512),
        ("4,1", [2], 512),
        (LIGHT_TRACER, range(4), 256),
        (BDPT, range(4), 32),
        (PATH, range(4), 32),
    ],
)
def test_arrival_times_in_a_sphere(technique, bounces, spp):
    """Bounce n after 2 R and n chords; on average, after 2 + 4 n / 3."""
    depth = max(bounces) + 2
    edges = np.linspace(1.95, 2.05 + 2 * max(bounces), 49)
    masses = sum(bounce(n) * oracles.sphere_bounce_masses(n, edges, 1.0) for n in bounces)
    assert masses.sum() == pytest.approx(sum(bounce(n) for n in bounces), rel=1e-5)
    if len(bounces) == 1:
        mean = masses @ (0.5 * (edges[1:] + edges[:-1])) / masses.sum()
        assert mean == pytest.approx(2 + 4 / 3 * bounces[0], abs=0.01)
    found = arrivals(in_sphere(technique, depth, edges), spp, SEEDS)
    assert arrives(found, masses, edges)
    assert not arrives(np.roll(found, 1, axis=1), masses, edges)


GLOBE = {"y": (0.5, -0.3, 2.0), "radius": 0.1, "radiance": 3.0, "lens": 0.2, "fov": 40.0}


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("technique", "spp"), [("1,1", 64), ("0,2", 2048), (LIGHT_TRACER, 64), (BDPT, 64)]
)
def test_a_ball_out_of_focus(technique, spp):
    light = ball_in_a_lens(**GLOBE)
    edges = np.linspace(light.opl.min() - 0.01, light.opl.max() + 0.01, 33)
    window = film(8, 8, 32, float(edges[0]), float(edges[1] - edges[0]))
    x, y, z = GLOBE["y"]
    globe = ball((x, y, -z), GLOBE["radius"], emitter=area_light(GLOBE["radiance"]))
    lens = {"aperture_radius": GLOBE["lens"], "focus_distance": 3.0, "fov": GLOBE["fov"]}
    view = camera((0, 0, 0), (0, 0, -1), window, kind="thinlens", **lens)
    found = arrivals(through(scene({"globe": globe}, view, max_depth=2), technique), spp, SEEDS)
    assert arrives(found, light.masses(edges), edges)
    assert not arrives(1.05 * found, light.masses(edges), edges)
    assert not arrives(np.roll(found, 1, axis=1), light.masses(edges), edges)


class Glass(NamedTuple):
    """A spot over glass over the floor: view, parts, the caustic, and the longest path."""

    view: View
    parts: Callable[[], dict]
    caustic: Caustic
    max_depth: int
    edges: np.ndarray


def pane(height: float, thickness: float) -> dict:
    size = mi.ScalarTransform4f().scale([5, 5, 0.5 * thickness])
    where = translate(0, 0, height + 0.5 * thickness)
    return {"type": "cube", "to_world": where @ size, "bsdf": GLASS}


def facing_glass(height: float) -> dict:
    """All space over this height is glass."""
    return plane(translate(0, 0, height) @ rotate((1, 0, 0), 180), bsdf=GLASS)


CAUSTICS = {
    "slab": Glass(
        View(0.4, fov=136),
        lambda: {"pane": pane(0.5, 0.3), "lamp": spot((0, 0, 1.8), (0, 0, 0), 30, 30.01)},
        through_a_slab(1.5, 0.3, 1.5, math.radians(30)),
        4,
        np.linspace(1.95, 2.25, 61),
    ),
    "ball": Glass(
        View(0.9, fov=96),
        lambda: {
            "ball": ball((0, 0, 1.5), 0.5, bsdf=GLASS),
            "lamp": spot((0, 0, 4.5), (0, 0, 0), 11, 12),
        },
        through_a_ball(1.5, 0.5, 3.0, 1.5),
        4,
        np.linspace(5.0, 7.0, 81),
    ),
    "lamp in glass": Glass(
        View(0.5, fov=122),
        lambda: {"face": facing_glass(0.6), "lamp": spot((0, 0, 1.4), (0, 0, 0), 25, 25.01)},
        out_of_glass(1.5, 0.8, 0.6, math.radians(25)),
        3,
        np.linspace(1.78, 2.15, 75),
    ),
}
"""Through a slab and a ball, radiance and importance scale alike; out of glass, they do not."""


def octant(pixels: np.ndarray) -> np.ndarray:
    """Means over the eight symmetries of a square: (..., 8, 8) to (..., 10)."""
    both = pixels + np.swapaxes(pixels, -1, -2)
    both = both + both[..., ::-1, :]
    quarter = (both + both[..., ::-1])[..., :4, :4] / 8
    return quarter[..., *np.triu_indices(4)]


@functools.cache
def caustic(name: str, technique: str, spp: int = 512) -> tuple[np.ndarray, np.ndarray]:
    """Bins of the film's mean (seeds, bins) and pixels (seeds, 10), first orders alone."""
    it = CAUSTICS[name]
    looked = looking_down(it.view, it.parts(), it.edges, max_depth=it.max_depth)
    loaded = load(through(looked, technique, camera_unwarp=True))
    cubes = over_seeds(lambda seed: rendered(loaded, spp, seed)[1][..., 0], SEEDS)
    return cubes.mean(axis=(1, 2)), octant(cubes.sum(axis=3))


@pytest.mark.statistical
@pytest.mark.parametrize("technique", TRACERS)
@pytest.mark.parametrize("name", CAUSTICS)
def test_caustic(name, technique):
    """Where light meets the floor, and when."""
    it = CAUSTICS[name]
    bins, pixels = caustic(name, technique)
    masses = it.caustic.seen(it.view, ALBEDO).masses(it.edges)
    where = octant(it.caustic.pixels(it.view, ALBEDO, 8))
    assert arrives(bins, masses, it.edges)
    assert agree(pixels, where, rounding=3e-3)
    assert not arrives(1.03 * bins, masses, it.edges)
    assert not arrives(np.roll(bins, 1, axis=1), masses, it.edges)


@pytest.mark.statistical
def test_a_lamp_in_glass_is_as_far_as_its_index_says():
    """With the camera's segment: n d in the glass, whose index the light's path does not know."""
    it = CAUSTICS["lamp in glass"]
    light = it.caustic.seen(it.view, ALBEDO, unwarp=False)
    edges = np.linspace(light.opl.min() - 0.02, light.opl.max() + 0.02, 65)
    looked = looking_down(it.view, it.parts(), edges, max_depth=it.max_depth)
    found = arrivals(through(looked, LIGHT_TRACER), 256, SEEDS)
    assert arrives(found, light.masses(edges), edges)


TECHNIQUES = pytest.mark.parametrize(("technique", "spp"), [(LIGHT_TRACER, 256), (BDPT, 32)])
WIDTH_OPL = 0.06


def pulse_masses(light: Light, edges: np.ndarray, width: float) -> np.ndarray:
    """Bins of a Gaussian pulse, by lengths that are rounded to a thousandth of all."""
    fine = np.linspace(light.opl.min(), light.opl.max() + 1e-6, 1001)
    centers = 0.5 * (fine[1:] + fine[:-1])
    passed = oracles.gaussian_cdf(edges[:, None] - centers, width)
    return np.diff(passed, axis=0) @ light.masses(fine)


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("technique", "spp", "options"),
    [
        (LIGHT_TRACER, 256, {"pulse_width_opl": WIDTH_OPL}),
        (BDPT, 32, {"pulse_width_opl": WIDTH_OPL}),
        (LIGHT_TRACER, 256, {"temporal_filter": "gaussian", "gaussian_stddev": 3.0}),
    ],
)
def test_a_pulse(technique, spp, options):
    light, _ = exact("disk")
    edges = np.linspace(1.5, 3.5, 101)
    width = options.get("pulse_width_opl", 3.0 * 0.02)
    case = CASES["disk"]
    looked = through(looking_down(case.view, case.parts(), edges), technique, **options)
    masses = pulse_masses(light, edges, width)
    found = arrivals(looked, spp, SEEDS)
    assert arrives(found, masses, edges)
    assert not arrives(found, pulse_masses(light, edges, 1.5 * width), edges)


@pytest.mark.statistical
@TECHNIQUES
def test_phasors(technique, spp):
    """P = Σ L exp(+i k opl), by the same paths as the picture."""
    light, _ = exact("disk")
    frequencies = (30e6, 150e6)
    window = {"width": 4, "height": 4, "frequencies_hz": ", ".join(map(str, frequencies))}
    looked = described("disk", technique)
    looked["sensor"] = looked["sensor"] | {"film": {"type": "phasor_hdr_film", **window}}
    loaded = load(looked)

    def estimate(seed):
        steady, phasors = (np.array(each, float) for each in mi.render(loaded, spp=spp, seed=seed))
        return np.append(phasors[..., 0].mean(axis=(0, 1)).ravel(), steady[..., 0].mean())

    expected = [light.phasor(f) for f in frequencies]
    expected = np.array([part for z in expected for part in (z.real, z.imag)] + [light.total])
    found = over_seeds(estimate, SEEDS)
    assert agree(found, expected, rounding=1e-3)
    assert not agree(1.1 * found, expected, rounding=1e-3)
    assert not agree(found * [1, -1, 1, -1, 1], expected, rounding=1e-3)


@pytest.mark.statistical
@TECHNIQUES
def test_gates(technique, spp):
    """One gate, and all of them: L p(t - opl), a radiance per meter."""
    light, _ = exact("disk")
    loaded = load(described("disk", technique, size=4))
    sensor = loaded.sensors()[0]
    options = by(technique, pulse_width_opl=WIDTH_OPL)
    tracer = mi.load_dict(options, parallel=False)
    config = {"temporal_bins": 12, "start_opl": 1.7, "bin_width_opl": 0.1}
    targets = 1.75 + 0.1 * np.arange(12)

    def estimate(seed):
        cube = tofrender.render_transient(loaded, tracer, sensor, config, spp=spp, seed=seed)
        one = tofrender.render_at_time(loaded, tracer, sensor, 2.25, spp=spp, seed=seed)
        assert one.shape == (4, 4, 3)
        return np.append(cube[..., 0].mean(axis=(0, 1), dtype=float), one[..., 0].mean())

    expected = np.array([light.gate(t, WIDTH_OPL) for t in (*targets, 2.25)])
    found = over_seeds(estimate, range(16))
    assert agree(found, expected, rounding=1e-3)
    assert not agree(np.roll(found, 1, axis=1), expected, rounding=1e-3)
    assert not agree(found * 0.1, expected, rounding=1e-3)


@pytest.mark.parametrize("kind", TRACERS)
def test_a_window_of_its_own(kind):
    """The window is found by paths of the same kind: no other path sees a caustic."""
    it, options = CAUSTICS["slab"], {"window": "auto", "bins": 50, "progress": False}
    looked = looking_down(it.view, it.parts(), it.edges, max_depth=it.max_depth)
    tracer = {"type": kind, "max_depth": it.max_depth, "camera_unwarp": True}
    dataset = tofrender.render(looked, integrator=tracer, spp=256, **options)
    assert dataset.attrs["max_depth"] == it.max_depth
    assert dataset.attrs["start_opl"] == pytest.approx(1.95, abs=0.02)
    assert dataset.attrs["energy_outside_window"] < 0.002
    stop = dataset.attrs["start_opl"] + 50 * dataset.attrs["bin_width_opl"]
    assert stop == pytest.approx(it.caustic.opl.max(), abs=0.03)


@pytest.mark.parametrize("end", ["both", "camera", "light"])
def test_shares_of_two_strategies(end):
    """What both find is shared by the squares of their densities."""
    view, (at, _, height) = CASES["point"].view, (0.5, 0, 3)
    x, y, *_ = view.points(1 << 16)
    d = np.sqrt((x - at) ** 2 + y**2 + height**2)
    radiance = ALBEDO / np.pi * height / d**3
    by_camera = 1 / (window_area(40.0) * view.height**2)
    by_light = height / d / (4 * np.pi * d**2)
    total = by_camera**2 + by_light**2
    share = {"both": 1.0, "camera": by_camera**2 / total, "light": by_light**2 / total}[end]
    props = mi.Properties()
    props["max_depth"], props["end"] = 2, end
    tracer, loaded = TransientTwoStrategies(props), load(described("point", LIGHT_TRACER))
    found = [np.array(tracer.render(loaded, seed=k, spp=512)[0]).mean() for k in range(8)]
    came, error = float(np.mean(found)), float(np.std(found, ddof=1) / 8**0.5)
    assert abs(came - (radiance * share).mean()) < 5 * error + 1e-4 * came


def test_an_end_of_two_strategies_must_be_known():
    props = mi.Properties()
    props["end"] = "middle"
    refused("end = 'middle':", TransientTwoStrategies, props)
