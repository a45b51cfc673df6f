"""a3.light_tracer: light that finds the camera."""

import math

import formulas
import numpy as np
import pytest

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_light_tracer
NAME = "TransientLightTracer"

number = formulas.inputs.number
ASLANT = {"origin": (0.3, -1.2, 2.0), "target": (0.2, 0.1, 0.0), "size": (6, 4), "fov": 50.0}
LIGHT = (0.5, 0.2, number("height of the lamp", 1.2, low=1.1, high=1.3))
COLOR = (1.0, 2.0, number("blue of the lamp", 4.0, low=3.0, high=5.0))
HALF = number("half of the panel above", 0.2, low=0.15, high=0.3)
INTENSITY = number("intensity in the sphere", 3.0, low=2.0, high=4.0)
ALBEDO = number("albedo of the sphere", 0.8, low=0.7, high=0.85)

RATIOS = {
    "π": "bsdf.eval has the albedo over π already",
    "1/π": "bsdf.eval has the albedo over π already",
    "4π": "emitted.weight has the density of directions already",
    "1/4π": "emitted.weight is radiance, cosine and one over the density: not only radiance",
}


def render(submission, scene, view, spp=256, name=NAME, seed=None, **options):
    """(steady, bins), seeds in front."""
    bins = view.get("bins", (1,))[0]
    seed = submission.seed if seed is None else seed
    steady, transient = submission.ask(
        "render", name=name, scene=scene, view=view, spp=spp, seed=seed, **options
    )
    width, height = view.get("size", (8, 8))
    expect.shape(transient, (len(steady), height, width, bins, 3), "bins, seeds first")
    return steady, transient


def expected_noise(means):
    """Standard deviation of a film's mean, of parts (radiance, by camera, by light) of it.

    A path that lands at a point carries radiance x by_camera / by_light.
    """
    square = sum((r * r * c / light).mean() for r, c, light in means)
    return square - sum(r.mean() for r, _, _ in means) ** 2


def check_picture(steady, wanted, what, rounding, hint):
    """Pixel by pixel, and the film's mean, which has less noise."""
    expect.estimate(steady, wanted, what, rounding=rounding, hint=hint)
    whole = what.replace("picture", "film's mean")
    expect.estimate(steady.mean((1, 2)), wanted.mean((0, 1)), whole, rounding=rounding, hint=hint)


def check_noise(steady, variance, paths):
    """As little noise as one connection for each path of light leaves."""
    hint = "as many paths of light as there are lanes, each of them connected"
    most = 2.2 * math.sqrt(variance / paths)
    expect.noise(steady[..., 0].mean((1, 2)), most, "the film's mean", hint=hint)


def in_the_way(submission, name=NAME, near_clip=1e-3, lamp=(-0.2, 0.1, 0.4), spp=16384, **tracer):
    """Squares between floor and camera, between floor and lamp, and before the near plane."""
    view = {"origin": (0, 0, 2), "target": (0, 0, 0), "size": (2, 2), "near_clip": near_clip}
    # One hides the right half of the floor from the camera, one all of it from a lamp
    blockers = [(3.0, 0.0, 0.5, 3.0), (-0.8, 0.0, 0.98, 0.3)]
    if near_clip > 0.1:
        blockers.append((0.0, 0.0, 2 - near_clip / 2, 1.0))
    lights = [[(-0.8, 0.0, 1.0), (1, 1, 1)], [lamp, (1, 1, 1)]]
    steady, _ = render(
        submission, "floor", view, name=name, lights=lights, blockers=blockers, spp=spp,
        integrator={"max_depth": 2} | tracer,
    )  # fmt: skip
    seen = formulas.View(**view)
    wanted = formulas.under_point(seen, seen.pixels(32), lamp, 1.0)[0].mean(-1)
    hidden = seen.direction(*np.meshgrid([0.5, 1.5], [0.5, 1.5]))[..., 0] > 0
    hint = "scene.ray_test(si.spawn_ray_to(arrival.near)): something is between floor and lens"
    if near_clip > 0.1:
        hint = (
            "what is between floor and lamp, or floor and near, hides it; what is before does not"
        )
    wanted = np.where(hidden, 0, wanted)
    expect.estimate(steady[..., 0], wanted, "picture", rounding=5e-3, hint=hint)


def check_bins(transient, part, opl, bins, hint):
    """Compare the bins of the film's mean that have much light; bins outside must be empty."""
    edges = bins[1] + bins[2] * np.arange(bins[0] + 1)
    wanted = np.histogram(opl, edges, weights=part)[0]
    came = transient.mean((1, 2))[..., 0]
    much = wanted > 0.02 * wanted.sum()
    there = np.asarray(opl)[np.asarray(part) > 0]
    axis = {"x": (edges[:-1] + bins[2] / 2)[much], "x_label": "opl [m]"}
    expect.estimate(
        came[:, much], wanted[much], "radiance per bin", rounding=1e-2, hint=hint, **axis
    )
    margin = 1e-3 + 0.02 * np.ptp(there)  # the quadrature does not reach the very ends
    none = (edges[1:] < there.min() - margin) | (edges[:-1] > there.max() + margin)
    wrong = came[:, none].sum() / max(came.sum(), 1e-30)
    expect.close(
        wrong, 0, "part of the light that comes too early or too late", atol=1e-5, hint=hint
    )


def test_picture(submission):
    """A floor under a lamp, aslant, pixel by pixel and in color."""
    view = formulas.View(**ASLANT)
    radiance = formulas.under_point(view, view.pixels(), LIGHT, 1.0)[0].mean(-1)
    steady, transient = render(
        *(submission, "floor", ASLANT), lights=[[LIGHT, COLOR]], integrator={"max_depth": 2}
    )
    hint = "throughput x bsdf.eval (which has the cosine) x density / distance²"
    wanted = radiance[..., None] * COLOR
    expect.estimate(steady, wanted, "picture", rounding=2e-3, hint=hint, ratios=RATIOS)
    hint = "land() gets all light, also where a film has no bin for it"
    expect.estimate(transient.sum(3), wanted, "sum over bins", rounding=2e-3, hint=hint)


@pytest.mark.parametrize("near_clip", [1e-3, 0.5])
def test_arrival(submission, near_clip):
    """When the light arrives, mean of the film."""
    bins = (10, 2.9, 0.1)
    options = ASLANT | {"bins": bins, "near_clip": near_clip}
    view = formulas.View(**options)
    radiance, opl, _, _ = formulas.under_point(view, view.pixels(16), LIGHT, 1.0)
    _, transient = render(
        *(submission, "floor", options), lights=[[LIGHT, (1, 1, 1)]], integrator={"max_depth": 2}
    )
    hint = "from the light to the floor, and on to the lens: not to the near plane"
    check_bins(transient, radiance / radiance.size, opl, bins, hint)


def test_area_light(submission):
    """A square light over a floor, which the camera does not see."""
    bins = (8, 5.4, 0.1)
    view = {"origin": (0, 0, 2.5), "target": (0, 0, 0), "size": (4, 4), "bins": bins}
    part, opl, _ = formulas.under_panel(formulas.View(**view), HALF, 3.0, 10.0)
    steady, transient = render(
        submission, "under_panel", view, half=HALF, height=3.0, radiance=10.0, spp=8192,
        integrator={"max_depth": 2},
    )  # fmt: skip
    hint = "emitted.weight has radiance, cosine and densities already"
    expect.estimate(steady.mean((1, 2)), part.sum(), "film's mean", rounding=2e-3, hint=hint)
    check_bins(transient, part, opl, bins, hint)


@pytest.mark.parametrize("max_depth", [2, 3, 4])
def test_many_bounces(submission, max_depth):
    """In a sphere, where the light of each bounce and the arrival of two bounces are known."""
    bins = (12, 1.95, 0.2)
    view = {"origin": (0, 0, 0), "target": (0, 0, 1), "bins": bins}
    steady, transient = render(
        submission, "inside_sphere", view, radius=1.0, albedo=ALBEDO, intensity=INTENSITY,
        integrator={"max_depth": max_depth},
    )  # fmt: skip
    each = [formulas.sphere_bounce(n, 1.0, ALBEDO, INTENSITY) for n in range(1, max_depth)]
    hint = "max_depth counts all segments, the one to the lens included; every vertex connects"
    expect.estimate(
        steady.mean((1, 2)), sum(each), f"film's mean, max_depth {max_depth}", rounding=1e-3,
        hint=hint,
    )  # fmt: skip
    if max_depth == 3:
        edges = bins[1] + bins[2] * np.arange(bins[0] + 1) - 2
        wanted = each[1] * formulas.chord_masses(edges, 1.0)
        wanted[0] += each[0]
        came = transient.mean((1, 2))[..., 0]
        hint = "each segment adds its length"
        expect.estimate(came, wanted, "radiance per bin", rounding=2e-3, hint=hint)


def test_what_is_in_the_way(submission):
    """Squares between floor and camera, and between floor and lamp."""
    in_the_way(submission)


def test_noise(submission):
    """As little noise as one connection for each path of light leaves."""
    options = {"origin": (0, 0, 2), "target": (0, 0, 0)}
    view = formulas.View(**options)
    radiance, _, by_camera, by_light = formulas.under_point(view, view.pixels(), LIGHT, 1.0)
    steady, _ = render(
        *(submission, "floor", options), lights=[[LIGHT, (1, 1, 1)]], integrator={"max_depth": 2}
    )
    check_noise(steady, expected_noise([(radiance, by_camera, by_light)]), 64 * 256)
