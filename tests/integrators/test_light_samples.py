"""Several light points for a vertex: the same means as one, whatever scene and number."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES as GALLERY
from helpers.support import (
    agree,
    area_light,
    beam,
    camera,
    diffuse,
    film,
    follow,
    grey,
    load,
    over_seeds,
    plane,
    rendered,
    rotate,
    scene,
    translate,
    with_integrator,
    with_sampler,
)
from oracles import films as oracles

import tofrender
from tofrender.films.recording import recording
from tofrender.paths.endpoints import ConnectionsOnly, SceneLights, scene_lights
from tofrender.scenes import cornell_box, cornell_box_flash, cornell_box_glass, cornell_box_mirror
from tofrender.scenes.fingerprint import fingerprint
from tofrender.scenes.loading import load_plugin

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")

SEEDS = range(24)
ALBEDO = 0.5


def one_lamp(position, size: float, radiance: float) -> dict:
    """A small square lamp that shines downwards."""
    to_world = translate(*position) @ rotate((1, 0, 0), 90) @ mi.ScalarTransform4f().scale(size)
    return {"type": "rectangle", "to_world": to_world, "emitter": area_light(radiance)}


def box(builder=cornell_box, light: bool = True, **parts) -> dict:
    size = {"width": 4, "height": 4, "temporal_bins": 24, "bin_width_opl": 0.25, "max_depth": 4}
    described = with_sampler(builder(**size)) | parts
    if not light:
        del described["light"]
    return described


def sixteen_lamps() -> dict:
    places = [(0.5 * i - 0.75, 0.99, 0.5 * j - 0.75) for i in range(4) for j in range(4)]
    lamps = {f"lamp-{k}": one_lamp(place, 0.03, 100.0) for k, place in enumerate(places)}
    return box(light=False, **lamps)


def environment() -> dict:
    described = box(light=False, sky={"type": "constant", "radiance": grey(1.0)})
    del described["ceiling"]
    return described


def half_hidden() -> dict:
    """A plate under one half of the lamp."""
    to_world = translate(0.25, 0.5, 0.01) @ rotate((1, 0, 0), 90)
    plate = {"type": "rectangle", "to_world": to_world @ mi.ScalarTransform4f().scale(0.25)}
    return box(plate=plate | {"bsdf": {"type": "twosided", "bsdf": diffuse(ALBEDO)}})


def rough() -> dict:
    metal = {"type": "twosided", "bsdf": {"type": "roughconductor", "alpha": 0.2}}
    described = box()
    described["back"] = described["back"] | {"bsdf": metal}
    described["floor"] = described["floor"] | {"bsdf": metal}
    return described


SCENES = {
    "area": box,
    "sixteen lamps": sixteen_lamps,
    "environment": environment,
    "point": lambda: box(cornell_box_flash),
    "half hidden": half_hidden,
    "rough conductor": rough,
    "glass": lambda: box(cornell_box_glass),
}


# ----------------------------------------------------------------------------- every scene


@pytest.mark.statistical
@pytest.mark.parametrize("name", GALLERY)
@pytest.mark.parametrize("n", [4, 8])
def test_every_scene_has_the_bins_of_one_point(name, n):
    """Twenty groups of bins, all pixels together."""

    def bins(points: int, seeds) -> np.ndarray:
        loaded = load(with_integrator(GALLERY[name](), light_samples=points))
        found = over_seeds(lambda seed: rendered(loaded, 16, seed)[1].sum(axis=(0, 1, 3)), seeds)
        groups = np.linspace(0, found.shape[1], 20, endpoint=False, dtype=int)
        return np.add.reduceat(found, groups, axis=1)

    assert agree(bins(n, range(12)), bins(1, range(1000, 1012)), rounding=1e-4)


# -------------------------------------------------------------------------- what auto takes


def taken(described: dict, kind: str | None = None) -> tuple[int, int]:
    """Light points of a path's first vertex, and of all others."""
    loaded = load(described)
    tracer, sensor = loaded.integrator(), loaded.sensors()[0]
    the_film = sensor.film() if kind is None else mi.load_dict({"type": kind, "width": 4})
    plan = tracer.plan(loaded, sensor).resolving(recording(the_film, tracer.exposure()).width_opl)
    points = plan.endpoint.points
    return points.first[0], points.further[0]


@pytest.mark.parametrize(
    ("builder", "width", "more", "expected"),
    [
        (cornell_box, 0.0298, {}, (8, 4)),  # The lamp's diagonal is 0.597 m
        (cornell_box, 0.0299, {}, (4, 2)),
        (cornell_box, 0.119, {}, (4, 2)),
        (cornell_box, 0.120, {}, (1, 1)),
        (cornell_box, 0.02, {"temporal_filter": "gaussian", "gaussian_stddev": 0.1}, (4, 2)),
        (cornell_box, 0.02, {"pulse_width_opl": 0.01}, (4, 2)),  # 0.05 m more
        (cornell_box, 0.02, {"pulse_width_opl": 0.03}, (1, 1)),
        (cornell_box, 0.02, {"emitter_sampling": False}, (1, 1)),
        (cornell_box, 0.02, {"light_samples": 5}, (5, 3)),
        (cornell_box, 0.02, {"light_samples": 2}, (2, 1)),
        (cornell_box, 0.02, {"light_samples": 1}, (1, 1)),
        (cornell_box_flash, 0.001, {}, (1, 1)),
        (cornell_box_glass, 0.02, {}, (1, 1)),
        (cornell_box_mirror, 0.02, {}, (1, 1)),
        (cornell_box_mirror, 0.02, {"light_samples": 8}, (8, 4)),
    ],
)
def test_auto_goes_by_the_lights_extent_over_a_bin(builder, width, more, expected):
    described = builder(width=4, height=4, temporal_bins=300, bin_width_opl=width)
    assert taken(with_integrator(described, **more)) == expected


def test_auto_counts_all_lights_together_and_distant_ones_as_far_apart():
    bins = {"temporal_bins": 300, "bin_width_opl": 0.02}
    for described in (sixteen_lamps(), environment()):
        sensor = described["sensor"]
        fine = described | {"sensor": sensor | {"film": sensor["film"] | bins}}
        assert taken(fine) == (8, 4)
    sun = {"type": "directional", "direction": [0.0, -1.0, 0.0]}
    assert taken(box(light=False, sun=sun)) == (1, 1)


def test_auto_is_one_without_bins():
    assert taken(cornell_box(), "tofrender_phasor_hdr_film") == (1, 1)


@pytest.mark.parametrize("kind", ["path_tracer_mis", "path_tracer_nee"])
def test_path_tracers_take_several(kind):
    described = cornell_box(width=4, height=4)
    assert taken(described | {"integrator": {"type": kind}}) == (8, 4)


def test_auto_is_the_number_that_it_takes():
    described = with_sampler(cornell_box(width=4, height=4))
    pictures = [rendered(with_integrator(described, light_samples=n))[1] for n in ("auto", 8, 4, 1)]
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-5, atol=1e-7)
    assert abs(pictures[0] - pictures[2]).max() > 0.01
    assert abs(pictures[0] - pictures[3]).max() > 0.01


# ------------------------------------------------------------------------------ closed forms


def big_disk(lights, eye=(2.5, 0.0, 1.5), lanes: int = 1024, blocker: bool = False):
    """A receiver under a disk that material sampling finds as well (PHYSICS.md, b1)."""
    h, radius, radiance = 1.0, 1.5, 4.0
    parts = {
        "floor": plane(bsdf=diffuse(ALBEDO)),
        "disk": {
            "type": "disk",
            "emitter": area_light(radiance),
            "to_world": translate(0, 0, h)
            @ rotate((1, 0, 0), 180)
            @ mi.ScalarTransform4f().scale(radius),
        },
    }
    if blocker:  # Hides the half with y > 0
        parts["wall"] = plane(translate(0, 1e-3, 0) @ rotate((1, 0, 0), 90), bsdf=diffuse(0.0))
    loaded = load(scene(parts, camera(eye, (0, 0, 0), film())))
    edges = np.linspace(h, math.hypot(h, radius), 17)
    segment = math.hypot(*eye)

    def estimate(seed):
        ray = beam(eye, (0, 0, 0), lanes)
        return follow(loaded, ray, seed=seed, slots=20, lights=lights).histogram(edges + segment)

    expected = ALBEDO / math.pi * oracles.disk_light_masses(edges, h, radius, radiance)
    return estimate, expected / 2 if blocker else expected


def points(n: int, kind: type = SceneLights):
    return lambda loaded: kind(loaded, light_samples=n)


@pytest.mark.statistical
@pytest.mark.parametrize("n", [2, 8, 13])
@pytest.mark.parametrize("blocker", [False, True])
def test_disk_light(n, blocker):
    estimate, expected = big_disk(points(n), blocker=blocker)
    assert agree(over_seeds(estimate, SEEDS), expected)


@pytest.mark.statistical
def test_disk_light_by_connections_alone():
    estimate, expected = big_disk(points(8, ConnectionsOnly))
    assert agree(over_seeds(estimate, SEEDS), expected)


@pytest.mark.statistical
def test_rectangle_light_over_the_floor():
    """PHYSICS.md, b3, with much less noise than one point has."""
    x, eye = (-0.5, -1.0, 0.7), (0.0, 0.0, 3.9)
    loaded = load(cornell_box(width=4, height=4, max_depth=2))
    ranges = (-0.23 - x[0], 0.23 - x[0]), (0.01 - 0.19 - x[2], 0.01 + 0.19 - x[2])
    edges = np.linspace(1.95, 2.4, 19)
    segment = np.linalg.norm(np.subtract(x, eye))

    def samples(n):
        def estimate(seed):
            ray = beam(eye, x, 1024)
            found = follow(loaded, ray, seed=seed, slots=12, lights=points(n))
            return found.histogram(edges + segment)

        return over_seeds(estimate, SEEDS)

    masses = oracles.rectangle_light_masses(edges, 1.99, *ranges, radiance=18.387)
    eight, one = samples(8), samples(1)
    assert agree(eight, 0.885809 / math.pi * masses)
    assert eight.var(axis=0).sum() < one.var(axis=0).sum() / 4


class ZeroWhereHidden(SceneLights):
    """Takes a density of 0 for hits where a point of the light is hidden."""

    def hit(self, vertex, path):
        hit, point = super().hit(vertex, path), mi.Point2f(0.5, 0.1)
        ds, _ = self.scene.sample_emitter_direction(path.prev, point, True, path.active)
        hit.pdf = dr.select(ds.pdf > 0, hit.pdf, 0)
        return hit


class WithoutShift(SceneLights):
    """Connects to the same lattice from everywhere."""

    def connect(self, vertex, path, sampler, active):
        link = self.choose(vertex, mi.Point2f(0), active)
        link.rival = mi.Point2f(0)
        return link


class EachInFull(SceneLights):
    """Forgets to divide by the number of points."""

    def share_of_link(self, path, vertex, link, turn):
        n = mi.Float(self.points.count(path.depth))
        return n * super().share_of_link(path, vertex, link, turn)


class HitsAgainstOne(SceneLights):
    """Weighs hits as if there were one point."""

    def share_of_hit(self, path, vertex, hit):
        once = SceneLights(self.scene)
        return once.share_of_hit(path, vertex, hit)


class OneLessPoint(SceneLights):
    """Leaves the last point out."""

    def more_links(self, path, first):
        return super().more_links(path, first) - 1


@pytest.mark.statistical
@pytest.mark.parametrize(
    "kind", [ZeroWhereHidden, WithoutShift, EachInFull, HitsAgainstOne, OneLessPoint]
)
def test_planted_bugs_are_noticed(kind):
    estimate, expected = big_disk(points(8, kind), blocker=kind is ZeroWhereHidden)
    assert not agree(over_seeds(estimate, SEEDS), expected)


# -------------------------------------------------------------------------- against one point


@pytest.mark.statistical
@pytest.mark.parametrize("name", SCENES)
def test_bins_and_energy_are_those_of_one_point(name):
    """Whole pictures, bin by bin where there is light to speak of, and pixel by pixel."""
    described = SCENES[name]()

    def samples(n, seeds):
        loaded = load(with_integrator(described, light_samples=n))

        def estimate(seed):
            steady, transient = rendered(loaded, 256, seed)
            return np.concatenate(
                [transient.sum(axis=(0, 1, 3)), steady.mean(axis=2).ravel(), [steady.sum()]]
            )

        return over_seeds(estimate, seeds)

    one = samples(1, range(100, 140))
    bins = one.mean(axis=0)[:24]
    lit = np.append(bins > 0.01 * bins.max(), np.ones(17, bool))
    assert lit.sum() > 25
    for n in (4, 8):
        several = samples(n, range(1000 * n, 1000 * n + 40))
        assert agree(several[:, lit], one[:, lit]), n
        assert not agree(1.1 * several[:, lit], one[:, lit])


# ------------------------------------------------------------------------------ the parameter


@pytest.mark.parametrize("value", [0, -1, 65, 2.5, True, "many", "8"])
def test_what_is_no_number_of_points_is_refused(value):
    with pytest.raises(ValueError, match="must be 'auto' or an integer from 1 to 64") as error:
        load_plugin("integrator", {"type": "transient_path", "light_samples": value})
    assert f"light_samples = {value!r}: " in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("value", [1, 8, "auto"])
@pytest.mark.parametrize(
    "given",
    [
        {"type": "transient_path", "emitter_sampling": False},
        {"type": "path_tracer_mats"},
        {"type": "path_tracer_mis", "technique": "one_sample"},
        {"type": "ao"},
        {"type": "amcw_transient_path"},
        {"type": "time_gated_transient_path"},
        {"type": "transient_bdpt"},
        {"type": "transient_light_tracer"},
        {"type": "transient_nlos_path"},
        {"type": "confocal_transient_path"},
    ],
    ids=lambda given: given["type"],
)
def test_integrators_with_one_connection_refuse_it(given, value):
    with pytest.raises(ValueError, match=f"light_samples = {value!r}: must be left out") as error:
        load_plugin("integrator", given | {"light_samples": value})
    assert "\n" not in str(error.value)


def test_it_is_said():
    tracer = mi.load_dict({"type": "transient_path", "light_samples": 8}, parallel=False)
    assert "light_samples = 8" in str(tracer)
    assert mi.load_dict({"type": "transient_path"}, parallel=False).light_samples == "auto"


# ----------------------------------------------------------------------------- resumed renders


def small(**integrator) -> dict:
    return with_integrator(cornell_box(width=8, height=8), **integrator)


@pytest.mark.parametrize("n", ["auto", 3])
def test_a_resumed_render_is_a_whole_one(n):
    whole, half = (
        tofrender.render(small(light_samples=n), spp=spp, progress=False) for spp in (32, 16)
    )
    again = tofrender.render(small(light_samples=n), spp=32, resume=half, progress=False)
    np.testing.assert_allclose(again.transient, whole.transient, rtol=1e-4, atol=1e-6)
    with pytest.raises(ValueError, match="was rendered with fingerprint"):
        tofrender.render(small(light_samples=8), spp=32, resume=half, progress=False)


def test_the_fingerprint_has_it():
    loaded = load(small())
    prints = {
        fingerprint(loaded, loaded.sensors()[0], mi.load_dict(given, parallel=False))
        for n in ("auto", 1, 8)
        for given in [{"type": "transient_path", "light_samples": n}]
    }
    assert len(prints) == 3


@pytest.mark.parametrize("window", [(3.0, 13.0), "auto"])
def test_the_window_that_is_rendered_counts(window, monkeypatch):
    """Not that of the sensor's film; a window that is found is known after the plan is made."""
    widths = []
    monkeypatch.setattr(
        scene_lights, "points_that_pay", lambda scene, width, sphere: widths.append(width) or 8
    )
    found = tofrender.render(small(), spp=4, window=window, temporal_bins=50, progress=False)
    assert widths == [pytest.approx(found.attrs["bin_width_opl"])]
    assert found.attrs["bin_width_opl"] > 0.1
