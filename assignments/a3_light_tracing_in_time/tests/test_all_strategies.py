"""a3.all_strategies: paths from both ends, connected in all ways."""

import formulas
import numpy as np
import pytest
from path_traced import ROOM, reference
from test_caustics import SLAB
from test_light_tracer import check_bins, render

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_all_strategies
NAME = "TransientBDPT"
PANEL = {"half": 0.4, "height": 1.2}
PANEL["radiance"] = formulas.inputs.number("radiance of the panel", 3.0, low=2.0, high=5.0)
GRAY = formulas.inputs.number("albedo around", 0.8, low=0.7, high=0.85)
OVER = {"origin": (0, 0, 0.8), "target": (0, 0, 0), "size": (4, 4), "fov": 70.0}
STRATEGIES = ("0,3", "1,2", "2,1")


def sphere(submission, view, max_depth, spp=256, **options):
    """(steady, bins) means over the film, first channel, of a sphere."""
    steady, transient = render(
        submission, "inside_sphere", view, name=NAME, radius=1.0, albedo=GRAY, intensity=1.0,
        integrator={"max_depth": max_depth} | options, spp=spp,
    )  # fmt: skip
    return steady.mean((1, 2))[..., 0], transient.mean((1, 2))[..., 0]


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_each_alone(submission, strategy):
    """Direct light of a panel by each strategy alone, and when it arrives."""
    view = OVER | {"bins": (8, 1.9, 0.2)}
    part, opl, _ = formulas.under_panel(formulas.View(**view), **PANEL)
    steady, transient = render(
        submission, "under_panel", view, name=NAME, **PANEL,
        integrator={"max_depth": 2, "strategy": strategy, "mis": "none"},
    )  # fmt: skip
    hint = "alone and with mis 'none', each strategy has all light"
    what = f"film's mean, strategy ({strategy})"
    expect.estimate(steady.mean((1, 2)), part.sum(), what, rounding=2e-3, hint=hint)
    hint = "the length of a path is the same whatever finds it"
    check_bins(transient, part, opl, (8, 1.9, 0.2), hint)


@pytest.mark.parametrize("strategy", ["1,3", "2,2", "3,1", "2,3"])
def test_connections_of_vertices(submission, strategy):
    """Two and three reflections in a sphere, by each strategy alone."""
    bins = (10, 1.99, 0.4)
    view = {"origin": (0, 0, 0), "target": (0, 0, 1), "size": (4, 4), "bins": bins}
    s, t = map(int, strategy.split(","))
    steady, transient = sphere(submission, view, s + t - 1, strategy=strategy, mis="none")
    wanted = formulas.sphere_bounce(s + t - 2, 1.0, GRAY, 1.0)
    hint = "f f' times both cosines / distance²: bsdf.eval has the cosine; so many of one length"
    expect.estimate(steady, wanted, f"film's mean, strategy ({strategy})", rounding=1e-3, hint=hint)
    if s + t == 4:
        edges = bins[1] + bins[2] * np.arange(bins[0] + 1) - 2
        masses = wanted * formulas.chord_masses(edges, 1.0)
        hint = "from the light to the vertex, to the other one, and on to the lens"
        expect.estimate(transient, masses, "radiance per bin", rounding=2e-3, hint=hint)


@pytest.mark.parametrize("mis", ["balance", "power"])
def test_shares(submission, mis):
    """Weighted part of each strategy in the direct light of a panel."""
    exponent = {"balance": 1, "power": 2}[mis]
    part, _, densities = formulas.under_panel(formulas.View(**OVER), **PANEL)
    total = sum(p**exponent for p in densities)
    for strategy, p in zip(STRATEGIES, densities, strict=True):
        steady, _ = render(
            submission, "under_panel", OVER, name=NAME, **PANEL,
            integrator={"max_depth": 2, "strategy": strategy, "mis": mis},
        )  # fmt: skip
        what = f"film's mean, strategy ({strategy}), mis {mis!r}"
        hint = "p^β over the sum of p^β of all strategies that find the path"
        wanted = (part * p**exponent / total).sum()
        expect.estimate(steady.mean((1, 2)), wanted, what, rounding=3e-3, hint=hint)


@pytest.mark.parametrize("mis", ["balance", "power"])
def test_shares_add_up(submission, mis):
    """All strategies together: each path's shares add up to 1."""
    view = {"origin": (0, 0, 0), "target": (0, 0, 1), "size": (4, 4)}
    for max_depth in (3, 4):
        chosen = {"mis": mis} if mis == "balance" else {}  # "power" is the default
        steady, _ = sphere(submission, view, max_depth, spp=128, **chosen)
        wanted = sum(formulas.sphere_bounce(n, 1.0, GRAY, 1.0) for n in range(1, max_depth))
        what = f"film's mean, max_depth {max_depth}, mis {mis!r}"
        hint = "the shares of a path's strategies add up to 1"
        expect.estimate(steady, wanted, what, rounding=2e-3, hint=hint)
        hint = "in a sphere, connections have no noise; only (s, 1) has some, and a small share"
        most = {"balance": 0.005, "power": 0.0015}[mis] * wanted
        expect.noise(steady, most, what, hint=hint)


def test_agrees_with_a_path_tracer(submission):
    """A room with a mirror, a glossy block, and a lamp that is seen."""
    wanted, bins = reference("mirror")
    steady, transient = render(
        submission, "room", ROOM, name=NAME, spp=1024, integrator={"max_depth": 4}, seeds=8
    )
    hint = "strategies that would connect to a mirror get no share; a seen lamp is (0, 2)"
    expect.same(steady.mean((1, 2)), wanted, "film's mean", rounding=5e-3, hint=hint)
    hint = "the same light at the same time"
    came = transient.mean((1, 2))[:, :, 1]
    expect.same(came, bins[:, :, 1], "green per bin", rounding=1e-2, hint=hint)


def test_through_glass(submission):
    """A point light through a slab of glass: only (4, 1) finds it, and has it in full."""
    view = {"origin": (0, 0, 0.45), "target": (0, 0, 0), "fov": 120.0, "size": (4, 4)}
    part, _ = formulas.through_slab(formulas.View(**view), **SLAB)
    steady, _ = render(
        submission, "under_slab", view, name=NAME, integrator={"max_depth": 4}, spp=1024, **SLAB
    )
    hint = "a strategy that would connect to glass finds nothing: it gets no share"
    expect.estimate(steady.mean((1, 2)), part.sum(), "film's mean", rounding=3e-3, hint=hint)


def test_seen_lamp(submission):
    """A panel that fills the picture: its radiance, once."""
    upwards = {"origin": (0, 0, 0.5), "target": (0, 0, 1), "size": (3, 3), "fov": 10.0}
    steady, _ = render(
        submission, "under_panel", upwards, name=NAME, **PANEL, integrator={"max_depth": 3}
    )
    hint = "(0, 2) has all of its light, or shares it with (1, 1)"
    expect.estimate(steady.mean((1, 2)), PANEL["radiance"], "film's mean", rounding=2e-3, hint=hint)
