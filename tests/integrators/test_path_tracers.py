"""The course's path tracers: all in expectation what Mitsuba's `path` is, also in time, and noise.

`mats` runs into lights, `nee` connects to them, `mis` does both: by "reuse" of the material's ray,
or by "one_sample" of a mixture. Each is noisy where the theory says, both together nowhere.
"""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES
from helpers.parts import area_light, diffuse, gray, plane, point_light, translate
from helpers.support import (
    agree,
    camera,
    film,
    largest,
    load,
    path_image,
    refused,
    rendered,
    scene,
    with_film,
)
from helpers.tracers import (
    ALBEDO,
    COURSE,
    DARK,
    GLOW,
    TRACERS,
    all_equal,
    course,
    furnace,
    paths,
    picture,
    steady,
    through_pixels,
    traced,
    view,
)
from oracles import films as oracles

import tofrender
from tofrender.runtime import plugins
from tofrender.scenes import BUILT_IN


@pytest.mark.usefixtures("mitsubas_steps")
@pytest.mark.parametrize("name", [*SCENES, *COURSE])
def test_reuse_is_mitsubas_path(name):
    if name in SCENES:
        reference = path_image(SCENES[name](), seed=1)
        found = picture(steady(traced(SCENES[name](), "reuse")), seed=1)
    else:
        reference = picture(course(name, integrator="path"), seed=1)
        found = picture(course(name, integrator="path_tracer_mis"), seed=1)
    assert reference.max() > 0.05
    # Mitsuba computes the density of a sphere of 1/70 of the distance with an error of 4e-4
    tolerance = 1e-3 if name == "sphere_light_small" else 1e-5
    assert largest(found, reference) < tolerance


@pytest.mark.usefixtures("mitsubas_steps")
@pytest.mark.parametrize(
    ("bounces", "options"),
    [
        *[(bounces, {"rr_depth": 1}) for bounces in (1, -1)],
        *[(bounces, {"hide_emitters": True}) for bounces in (0, 2)],
    ],
)
def test_bounces_roulette_and_hidden_emitters_are_mitsubas(bounces, options):
    described = steady(SCENES["many lights"]())
    ours = traced(described, "reuse", max_bounces=bounces, **options)
    depth = bounces + 1 if bounces >= 0 else -1
    reference = path_image(described, seed=2, max_depth=depth, **options)
    assert np.abs(picture(ours, seed=2) - reference).max() <= 1e-5 * reference.max()
    assert (reference.max() == 0) == (bounces == 0)


@pytest.mark.parametrize("tracer", TRACERS)
def test_without_a_bounce_there_are_only_lights(tracer):
    described = steady(SCENES["cornell"]())
    lights = path_image(described, max_depth=1)
    assert 0 < (lights.max(axis=2) > 0).mean() < 0.2
    assert largest(picture(traced(described, tracer, max_bounces=0)), lights) < 1e-5
    assert picture(traced(described, tracer, max_bounces=0, hide_emitters=True)).max() == 0


@pytest.mark.parametrize("tracer", TRACERS)
def test_depth_is_one_more_than_bounces(tracer):
    described = steady(traced(SCENES["glass"](), tracer, max_bounces=2))
    by_depth = described | {"integrator": TRACERS[tracer] | {"max_depth": 3}}
    assert largest(picture(by_depth), picture(described)) < 1e-6
    fewer = described | {"integrator": TRACERS[tracer] | {"max_depth": 2}}
    assert largest(picture(fewer), picture(described)) > 0.01


def test_the_techniques_differ():
    lit = SCENES["constant environment"]
    pictures = [picture(steady(traced(lit(), tracer))) for tracer in TRACERS]
    for i, first in enumerate(pictures):
        assert all(largest(first, second) > 0.01 for second in pictures[:i])
    default = lit() | {"integrator": {"type": "path_tracer_mis", "max_bounces": 11}}
    assert largest(picture(steady(default)), pictures[2]) < 1e-6


@pytest.mark.statistical
@pytest.mark.parametrize("name", SCENES)
def test_gallery_in_expectation(name):
    """Roulette starts earlier than in the reference, whose lights are hidden alike."""
    described = SCENES[name]()
    loaded = load(described)
    limits = {"max_depth": 12, "hide_emitters": True}
    reference = view(loaded, {"type": "path", **limits}, 1 << 17, 1)
    finds = {"nee", "one_sample"} if name in (*DARK, "many lights") else {*TRACERS} - {"reuse"}
    found = {
        tracer: view(loaded, TRACERS[tracer] | limits | {"rr_depth": 3}, 1 << 17, 2 + seed)
        for seed, tracer in enumerate(sorted(finds))
    }
    assert all_equal(found, reference)
    assert not all_equal(found | {"nee": 1.3 * found["nee"]}, reference)


@pytest.mark.parametrize("name", DARK)
def test_no_ray_runs_into_a_light_without_size(name):
    assert view(load(SCENES[name]()), TRACERS["mats"] | {"max_bounces": 5}, 1 << 12, 1).max() == 0


@pytest.mark.statistical
@pytest.mark.parametrize("name", COURSE)
def test_course_in_expectation(name):
    """All four, also with mirror and glass in the small box: its light is large enough for `mats`.

    Some lights are so small that 200 of two million rays of `mats` run into them; so one mean over
    the picture.
    """
    loaded = load(course(name))
    few, depth = (1 << 17, 6) if "box" in name else (1 << 18, 2)
    many = 1 << (21 if name in ("veach", "sphere_light_small") else 19)
    limits = {"max_depth": depth, "hide_emitters": True}
    reference = view(loaded, {"type": "path", **limits}, few, 1).mean(axis=1)
    found = {
        tracer: view(loaded, TRACERS[tracer] | limits, count, 2).mean(axis=1)
        for tracer, count in (("mats", many), ("nee", few), ("reuse", few), ("one_sample", few))
    }
    assert all_equal(found, reference)
    wrong = (1.5 if name == "veach" else 1.1) * found["one_sample"]
    assert not all_equal({"one_sample": wrong}, reference)


MATERIALS = {
    "diffuse": diffuse(0.7),
    "mirror": {"type": "conductor", "material": "none"},
    "glass": {"type": "dielectric"},
    "thin glass": {"type": "thindielectric"},
    "plastic": {"type": "plastic", "diffuse_reflectance": gray(0.5)},
    "rough plastic": {"type": "roughplastic", "alpha": 0.1},
    "rough conductor": {"type": "roughconductor", "alpha": 0.2},
    "rough glass": {"type": "roughdielectric", "alpha": 0.4},
    "mask": {"type": "mask", "opacity": 0.4, "nested": diffuse(0.8)},
    "blend": {
        "type": "blendbsdf",
        "weight": 0.5,
        "smooth": {"type": "conductor", "material": "none"},
        "rough": diffuse(0.6),
    },
    "two-sided": {"type": "twosided", "nested": diffuse(0.4)},
}


def tiles(lights: dict) -> mi.Scene:
    """A row of plates, one of each material, between a lamp that they mirror and one behind them.

    The camera's rays come from y = 1.2 to y = 0, so mirrors reflect them to y = -1.2.
    """
    middle, half = 2 * (len(MATERIALS) - 1), 2 * len(MATERIALS)
    strip = mi.ScalarTransform4f().scale([half, 0.6, 1])
    above = mi.ScalarTransform4f().translate([middle, -1.2, 2]).rotate([1, 0, 0], 180)
    behind = mi.ScalarTransform4f().translate([middle, -1.2, -2])
    parts = {
        "above": plane(above @ strip, 1.0, bsdf=diffuse(0.0), emitter=area_light(3.0)),
        "behind": plane(behind @ strip, 1.0, bsdf=diffuse(0.0), emitter=area_light(2.0)),
        **lights,
    }
    for i, bsdf in enumerate(MATERIALS.values()):
        parts[f"tile{i}"] = plane(translate(4 * i, 0, 0), size=1.0, bsdf=bsdf)
    return load(scene(parts, camera((0, 0, 9), (0, 0, 0), film())))


def on_each_tile(loaded: mi.Scene, integrator: dict, count: int, seed: int) -> np.ndarray:
    """Paths that leave each tile's center, (batches, tiles)."""
    tile = mi.Float(4 * (np.arange(count) % len(MATERIALS)))
    ray = mi.Ray3f(mi.Point3f(tile, 1.2, 2.0), dr.normalize(mi.Vector3f(0 * tile, -1.2, -2.0)))
    found = paths(loaded, integrator | {"max_depth": 2}, ray, seed)
    return found.mean(axis=1).reshape(32, -1, len(MATERIALS)).mean(axis=1)


SMALL_LAMPS = {
    "bulb": point_light((2.0, 2.0, 3.0), 20.0),
    "spot": {
        "type": "spot",
        "intensity": gray(300.0),
        "cutoff_angle": 60.0,
        "to_world": mi.ScalarTransform4f().look_at([20, 2, 9], [20, 0, 0], [0, 1, 0]),
    },
    "sun": {"type": "directional", "direction": [0.3, 0.2, -1], "irradiance": gray(0.5)},
}
SKY = {"sky": {"type": "constant", "radiance": gray(0.2)}}


@pytest.mark.parametrize(
    ("lamp", "irradiance"),
    [("bulb", 20 * 3 / math.hypot(2, 2, 3) ** 3), ("sun", 0.5 / math.hypot(0.3, 0.2, 1))],
)
def test_one_sample_leaves_lamps_without_size_to_connections(lamp, irradiance):
    """Half of the paths connect, and each of them brings twice the light."""
    parts = {"floor": plane(size=10, bsdf=diffuse(0.4)), lamp: SMALL_LAMPS[lamp]}
    loaded = load(scene(parts, camera((0, 0, 9), (0, 0, 0), film())))
    ray = mi.Ray3f(mi.Point3f(dr.zeros(mi.Float, 256), 0, 1), mi.Vector3f(0, 0, -1))
    found = paths(loaded, TRACERS["one_sample"] | {"max_depth": 2}, ray, seed=1)
    lit = found > 0
    assert 0.3 < lit.mean() < 0.7
    assert found[lit] == pytest.approx(2 * 0.4 / math.pi * irradiance, rel=1e-3)


@pytest.mark.statistical
@pytest.mark.parametrize("lamps", [{}, SKY, SKY | SMALL_LAMPS], ids=["area", "sky", "all"])
def test_materials_in_expectation(lamps):
    loaded = tiles(lamps)
    count = len(MATERIALS) << 15
    reference = on_each_tile(loaded, {"type": "path"}, count, 1)
    dark = {"mats"} if "bulb" in lamps else set()
    found = {
        tracer: on_each_tile(loaded, TRACERS[tracer], count, 2) for tracer in {*TRACERS} - dark
    }
    assert all_equal(found, reference)
    for tile in range(len(MATERIALS)):
        wrong = np.where(np.arange(len(MATERIALS)) == tile, 1.2, 1.0) * found["one_sample"]
        assert not all_equal({"one_sample": wrong}, reference)


@pytest.mark.statistical
@pytest.mark.parametrize("tracer", TRACERS)
def test_furnace_without_limit(tracer):
    """All pixels are alike: each is an estimate of its own."""
    found = picture(steady(furnace(tracer, -1, rr_depth=3)), spp=1 << 14)[..., 0].ravel()
    assert agree(found, np.array(GLOW / (1 - ALBEDO)), rounding=5e-3)
    assert not agree(1.05 * found, np.array(GLOW / (1 - ALBEDO)), rounding=5e-3)


VARIANTS = [n for n in mi.variants() if n.startswith("llvm") and "polarized" not in n]


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("tracer", TRACERS)
def test_furnace_in_every_variant(variant, tracer):
    mi.set_variant(variant)
    expected = GLOW * (1 + ALBEDO + ALBEDO**2)
    _, transient = rendered(furnace(tracer, 2), spp=256)
    tolerance = 0.05 if "spectral" in variant else 5e-3
    assert transient.sum(axis=2).mean(axis=(0, 1)) == pytest.approx(expected, rel=tolerance)


@pytest.mark.parametrize("tracer", ["path_tracer_mats", "path_tracer_nee", "path_tracer_mis"])
@pytest.mark.parametrize("name", ["veach", "small_box"])
def test_load_scene_changes_the_tracer(name, tracer):
    bounces = BUILT_IN[name]()["integrator"]["max_bounces"]
    for changes, expected in (({}, bounces), ({"max_depth": 4}, 3)):
        loaded = tofrender.load_scene(name, integrator=tracer, width=8, height=6, **changes)
        found = loaded.integrator()
        assert plugins.PLUGINS[type(found).__name__][0] == tracer
        assert (found.max_bounces, found.max_depth) == (expected, expected + 1)


@pytest.mark.parametrize("tracer", TRACERS)
def test_render_in_time(tracer):
    described = course("small_box") | {"integrator": TRACERS[tracer] | {"max_bounces": 3}}
    window = {"temporal_bins": 30, "start_opl": 2.5, "bin_width_opl": 0.1}
    with pytest.warns(UserWarning, match="outside the window"):
        dataset = tofrender.render(
            tofrender.load_scene(described, spp=16, **window), progress=False
        )
    outside = dataset.attrs["energy_outside_window"]
    assert 0 < outside < 0.5
    inside = (1 - outside) * dataset["steady"].values.sum()
    assert dataset["transient"].values.sum() == pytest.approx(inside)


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"max_bounces": -2}, r"max_bounces = -2:"),
        ({"max_bounces": 1.5}, "max_bounces = 1.5:"),
        ({"max_bounces": "x"}, "max_bounces = 'x':"),
        ({"max_bounces": True}, "max_bounces = True:"),
        ({"max_bounces": 1, "max_depth": 2}, "max_depth = 2:"),
        ({"max_depth": 0}, r"max_depth = 0:"),
        ({"rr_depth": 0}, "rr_depth = 0:"),
        ({"emitter_sampling": False}, "emitter_sampling = False:"),
        ({"technique": "foo"}, "technique"),
        ({"bounces": 3}, "bounces"),
    ],
)
def test_bad_input_is_one_line(parameters, text):
    for tracer in TRACERS.values():
        described = course("small_box") | {"integrator": tracer | parameters}
        refused(text, tofrender.load_scene, described)


@pytest.mark.statistical
@pytest.mark.parametrize("tracer", TRACERS)
def test_furnace_in_time(tracer):
    """Bounce n carries Le rho^n and comes after the radius and n chords."""
    edges = 0.9 + 0.2 * np.arange(31)
    expected = sum(
        GLOW * ALBEDO**n * oracles.sphere_bounce_masses(n, edges + 1, 1.0) for n in range(4)
    )
    shown = expected > 0.01  # the longest ways are too rare to judge
    assert expected[shown].sum() > 0.99 * GLOW * (1 + ALBEDO + ALBEDO**2 + ALBEDO**3)
    loaded = load(furnace(tracer, 3, film(4, 4, bins=30, start=0.9, bin_width=0.2)))
    bins = rendered(loaded, 1 << 13)[1][..., 0].reshape(16, -1)
    assert agree(bins[:, shown], expected[shown], rounding=5e-3)
    assert not agree(np.roll(bins, 1, axis=1)[:, shown], expected[shown], rounding=5e-3)


@pytest.mark.usefixtures("mitsubas_steps")
@pytest.mark.parametrize(
    ("name", "tracer"),
    [*zip(2 * ["glass", "environment map"], TRACERS, strict=True), ("environment map", "reuse")],
)
def test_bins_hold_the_picture(tracer, name):
    """Both windows add up to the picture of a film without time."""
    described = traced(SCENES[name](), tracer)
    whole = picture(steady(described), seed=3)
    parts = []
    for start, bins in [(0.0, 450), (9.0, 1500)]:
        window = {"start_opl": start, "temporal_bins": bins, "bin_width_opl": 0.02}
        total, part = rendered(with_film(described, **window), seed=3)
        assert largest(total, whole) < 1e-5
        parts.append(part.sum(axis=2))
    assert all(part.max() > 0 for part in parts)
    assert largest(sum(parts), whole) < 1e-5


HEIGHT, POWER = 2.8, 260.0


def below_the_light(size: str, tracer: str, edges: np.ndarray) -> np.ndarray:
    """What the floor right below a sphere light of the course reflects, for 64 seeds at once.

    All pixels look at the same point, from a distance of 1.5 m.
    """
    described = course(f"sphere_light_{size}", integrator=TRACERS[tracer]["type"])
    described["integrator"] = described["integrator"] | TRACERS[tracer]
    window = film(8, 8, bins=edges.size - 1, start=edges[0] + 1.5, bin_width=edges[1] - edges[0])
    described["sensor"] = camera((0.9, 1.2, 0), (0, 0, 0), window, fov=1e-3)
    return rendered(described, spp=4096)[1][..., 0].reshape(64, -1)


@pytest.mark.statistical
@pytest.mark.parametrize("tracer", TRACERS)
def test_lights_of_equal_power_differ_in_time_alone(tracer):
    """Nearest points come first: of radius r at height h, the pole at h - r.

    What comes from the distance t arrives under the cosine (t² + h² - r²) / (2 t h), by the law of
    cosines, and this falls as t grows: E(t) = pi Le (1 - cos²(t)), until sqrt(h² - r²).
    """
    edges, total = 1.76 + np.arange(49) / 32, 0.75 / math.pi * POWER / (4 * math.pi * HEIGHT**2)
    first = {}
    for size, r in (("small", 0.03), ("medium", 0.3), ("large", 0.9)):
        if (size, tracer) == ("small", "mats"):
            continue  # one ray in 9000 finds it
        t = np.clip(edges, HEIGHT - r, math.sqrt(HEIGHT**2 - r**2))
        cosine = (t**2 + HEIGHT**2 - r**2) / (2 * t * HEIGHT)
        expected = 0.75 * POWER / (4 * math.pi**2 * r**2) * np.diff(1 - cosine**2)
        assert expected.sum() == pytest.approx(total)
        bins = below_the_light(size, tracer, edges)
        steady_light = bins.sum(axis=1, keepdims=True)
        assert agree(np.hstack([bins, steady_light]), np.append(expected, total))
        first[size] = edges[np.flatnonzero(bins.any(axis=0))[0]]
        assert first[size] <= HEIGHT - r < first[size] + 1 / 32
    assert first["large"] < first["medium"] - 0.5


@pytest.mark.statistical
@pytest.mark.parametrize("name", COURSE)
def test_both_together_are_never_much_worse_than_the_better(name):
    """At most twice the variance of a path; with one sample, twice the second moment.

    The latter is exact for direct light: F² / ((p1 + p2) / 2) is at most 2 F² / p1. One sample of
    two, where the other finds nothing, has a variance of mean² even if the first is perfect.
    """
    loaded = load(course(name, width=24, height=18))
    limits = {"max_bounces": 8 if "box" in name else 1, "hide_emitters": True}
    found = [through_pixels(loaded, TRACERS[tracer] | limits, 256, 5) for tracer in TRACERS]
    mats, nee, reuse, _ = (values.var(axis=0).mean() for values in found)
    assert reuse <= 2 * min(mats, nee)
    mats, nee, _, mixed = ((values**2).mean() for values in found)
    if "box" not in name:
        assert mixed <= 2.1 * min(mats, nee)  # a twentieth for noise
