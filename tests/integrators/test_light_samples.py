"""Several light points for a vertex: the same means as one, whatever scene and number."""

import functools

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gallery import SCENES as GALLERY
from helpers.light_paths import cornell_light_over_floor, disk_over_receiver
from helpers.parts import area_light, diffuse, gray, plane, rotate, translate
from helpers.support import (
    agree,
    load,
    over_seeds,
    refused,
    rendered,
    with_integrator,
    with_sampler,
)

import tofrender
from tofrender.films.recording import recording
from tofrender.paths.endpoints import ConnectionsOnly, SceneLights, scene_lights
from tofrender.paths.endpoints.scene_lights import LatticeConnection
from tofrender.scenes import cornell_box, cornell_box_flash, cornell_box_glass, cornell_box_mirror
from tofrender.scenes.fingerprint import fingerprint
from tofrender.scenes.loading import load_plugin

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")

SEEDS = range(24)


def one_lamp(position, size: float, radiance: float) -> dict:
    """A small square lamp that shines downwards."""
    to_world = translate(*position) @ rotate((1, 0, 0), 90) @ mi.ScalarTransform4f().scale(size)
    return {"type": "rectangle", "to_world": to_world, "emitter": area_light(radiance)}


def box(light: bool = True, **parts) -> dict:
    size = {"width": 4, "height": 4, "temporal_bins": 24, "bin_width_opl": 0.25, "max_depth": 4}
    described = with_sampler(cornell_box(**size)) | parts
    if not light:
        del described["light"]
    return described


def sixteen_lamps() -> dict:
    places = [(0.5 * i - 0.75, 0.99, 0.5 * j - 0.75) for i in range(4) for j in range(4)]
    lamps = {f"lamp-{k}": one_lamp(place, 0.03, 100.0) for k, place in enumerate(places)}
    return box(light=False, **lamps)


def environment() -> dict:
    described = box(light=False, sky={"type": "constant", "radiance": gray(1.0)})
    del described["ceiling"]
    return described


@pytest.mark.statistical
@pytest.mark.parametrize("name", GALLERY)
def test_every_scene_has_the_bins_of_one_point(name):
    """Twenty groups of bins, all pixels together."""

    def bins(points: int, seeds) -> np.ndarray:
        loaded = load(with_integrator(GALLERY[name](), light_samples=points))
        found = over_seeds(lambda seed: rendered(loaded, 16, seed)[1].sum(axis=(0, 1, 3)), seeds)
        groups = np.linspace(0, found.shape[1], 20, endpoint=False, dtype=int)
        return np.add.reduceat(found, groups, axis=1)

    assert agree(bins(8, range(12)), bins(1, range(1000, 1012)), rounding=1e-4)


@pytest.mark.statistical
@pytest.mark.parametrize("describe", [box, sixteen_lamps, environment])
def test_bins_and_energy_are_those_of_one_point(describe):
    """Whole pictures, bin by bin where there is light to speak of, and pixel by pixel."""
    described = describe()

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


def taken(described: dict, kind: str | None = None) -> tuple[int, int]:
    """Light points of a path's first vertex, and of all others."""
    loaded = load(described)
    tracer, sensor = loaded.integrator(), loaded.sensors()[0]
    the_film = sensor.film() if kind is None else mi.load_dict({"type": kind, "width": 4})
    plan = tracer.plan(loaded, sensor).for_bin_width(
        recording(the_film, tracer.exposure()).width_opl
    )
    lattice = plan.endpoint.further
    return (1, 1) if lattice is None else (lattice.first[0], lattice.later[0])


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
        (cornell_box_glass, 0.02, {}, (8, 4)),
        (cornell_box_mirror, 0.02, {}, (8, 4)),
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


def test_auto_of_other_integrators_and_films():
    described = cornell_box(width=4, height=4)
    assert taken(described, "tofrender_phasor_hdr_film") == (1, 1)  # There are no bins
    for kind in ("path_tracer_mis", "path_tracer_nee"):
        assert taken(described | {"integrator": {"type": kind}}) == (8, 4)


def test_auto_is_the_number_that_it_takes():
    described = with_sampler(cornell_box(width=4, height=4))
    pictures = [rendered(with_integrator(described, light_samples=n))[1] for n in ("auto", 8, 4, 1)]
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-5, atol=1e-7)
    assert abs(pictures[0] - pictures[2]).max() > 0.01
    assert abs(pictures[0] - pictures[3]).max() > 0.01


def points(n: int, kind: type = SceneLights, blocked: bool = False) -> tuple:
    """Connections to n points of the disk, whose half with y > 0 may be hidden."""
    wall = plane(translate(0, 1e-3, 0) @ rotate((1, 0, 0), 90), bsdf=diffuse(0.0))
    parts = {"wall": wall} if blocked else {}
    lights = functools.partial(kind, light_samples=n)
    estimate, expected, _ = disk_over_receiver(parts=parts, slots=20, lights=lights)
    return over_seeds(estimate, SEEDS), expected / 2 if blocked else expected


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("n", "kind", "blocked"),
    [
        *[(n, SceneLights, blocked) for n in (2, 8, 13) for blocked in (False, True)],
        (8, ConnectionsOnly, False),
    ],
)
def test_disk_light(n, kind, blocked):
    assert agree(*points(n, kind, blocked))


@pytest.mark.statistical
def test_rectangle_light_over_the_floor():
    """PHYSICS.md, b3, with much less noise than one point has."""
    found = []
    for n in (8, 1):
        lights = functools.partial(SceneLights, light_samples=n)
        estimate, expected = cornell_light_over_floor(1024, slots=12, lights=lights)
        found.append(over_seeds(estimate, SEEDS))
    eight, one = found
    assert agree(eight, expected)
    assert agree(one, expected)
    assert eight.var(axis=0).sum() < one.var(axis=0).sum() / 4


class ZeroWhereHidden(SceneLights):
    """Takes a density of 0 for hits where a point of the light is hidden."""

    def hit(self, vertex, path):
        hit, point = self.emitted_radiance(vertex, path), mi.Point2f(0.5, 0.1)
        ds, _ = self.scene.sample_emitter_direction(path.prev, point, True, path.active)
        hit.pdf = dr.select(ds.pdf > 0, hit.pdf, 0)
        hit.mis_weight = self.hit_weight(path, vertex, hit)
        return hit


class WithoutShift(SceneLights):
    """Connects to the same lattice from everywhere."""

    def connect(self, vertex, path, sampler, active):
        connection = self.sample_emitter(vertex, mi.Point2f(0), active)
        return LatticeConnection(**vars(connection), shift=mi.Point2f(0))


class EachInFull(SceneLights):
    """Forgets to divide by the number of points."""

    def mis_weight(self, path, vertex, connection, bsdf_eval):
        return self._count(path.depth) * super().mis_weight(path, vertex, connection, bsdf_eval)


class HitsAgainstOne(SceneLights):
    """Weighs hits as if there were one point."""

    def hit_weight(self, path, vertex, hit):
        once = SceneLights(self.scene)
        return once.hit_weight(path, vertex, hit)


class OneLessPoint(SceneLights):
    """Leaves the last point out."""

    def _set_count(self, count):
        super()._set_count(count)
        if self.further is not None:
            self.further.count = lambda path: self.further.size(path.depth) - 2


@pytest.mark.statistical
@pytest.mark.parametrize(
    "kind", [ZeroWhereHidden, WithoutShift, EachInFull, HitsAgainstOne, OneLessPoint]
)
def test_planted_bugs_are_noticed(kind):
    assert not agree(*points(8, kind, blocked=kind is ZeroWhereHidden))


@pytest.mark.parametrize("value", [0, -1, 65, 2.5, True, "many", "8"])
def test_what_is_no_number_of_points_is_refused(value):
    text = f"light_samples = {value!r}: must be 'auto' or an integer from 1 to 64"
    given = {"type": "transient_path", "light_samples": value}
    refused(text, load_plugin, "integrator", given)


@pytest.mark.parametrize(
    "given",
    [
        {"type": "transient_path", "emitter_sampling": False},
        {"type": "path_tracer_mis", "technique": "one_sample"},
        *[
            {"type": kind}
            for kind in (
                *("path_tracer_mats", "ao", "amcw_transient_path", "time_gated_transient_path"),
                *("transient_bdpt", "transient_light_tracer", "transient_nlos_path"),
                "confocal_transient_path",
            )
        ],
    ],
    ids=lambda given: given["type"],
)
def test_integrators_with_one_connection_refuse_it(given):
    for value in (1, 8, "auto"):
        text = f"light_samples = {value!r}: must be left out"
        refused(text, load_plugin, "integrator", given | {"light_samples": value})


def small(**integrator) -> dict:
    return with_integrator(cornell_box(width=8, height=8), **integrator)


def test_a_resumed_render_is_a_whole_one():
    render = functools.partial(tofrender.render, progress=False)
    described = small(light_samples=3)
    whole, half = (render(described, spp=spp) for spp in (32, 16))
    again = render(described, spp=32, resume=half)
    np.testing.assert_allclose(again.transient, whole.transient, rtol=1e-4, atol=1e-6)
    text = "was rendered with fingerprint"
    refused(text, render, small(light_samples=8), spp=32, resume=half)


def test_the_fingerprint_and_the_text_have_it():
    loaded = load(small())
    tracers = [
        mi.load_dict({"type": "transient_path", "light_samples": n}, parallel=False)
        for n in ("auto", 1, 8)
    ]
    assert len({fingerprint(loaded, loaded.sensors()[0], tracer) for tracer in tracers}) == 3
    assert "light_samples = 8" in str(tracers[2])


@pytest.mark.parametrize("window", [(3.0, 13.0), "auto"])
def test_the_window_that_is_rendered_counts(window, monkeypatch):
    """Not that of the sensor's film; a window that is found is known after the plan is made."""
    widths = []
    monkeypatch.setattr(
        scene_lights, "points_that_pay", lambda scene, width, sphere: widths.append(width) or 8
    )
    found = tofrender.render(small(), spp=4, window=window, bins=50, progress=False)
    assert widths == [pytest.approx(found.attrs["bin_width_opl"])]
    assert found.attrs["bin_width_opl"] > 0.1
