"""Splats: light that lands on any pixel, from any thread, and is no sample of that pixel.

Under a spot whose whole light meets the floor within the picture, each of n paths from it adds the
same to the film's mean, ρ Φ / (π A H² n), whatever the place (`light_path_oracles.Caustic`). The
mean then has almost no noise, and no splat can be lost or counted twice unseen.

Mistakes that tracers of light invite are put into the package, and must be noticed. Their scenes
are chosen so that one render tells: films that must be dark, and means that are known.
"""

import functools
import math
import signal
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.light_paths import (
    ALBEDO,
    GLASS,
    LIGHT_TRACER,
    SEEDS,
    TRACERS,
    by,
    lamp,
    looking_down,
    spot,
    through,
)
from helpers.support import (
    agree,
    area_light,
    camera,
    diffuse,
    film,
    load,
    over_seeds,
    plane,
    rendered,
    rotate,
    scene,
    translate,
    with_film,
    with_sampler,
)
from oracles.light_paths import View, out_of_glass, under_a_point, window_area

import tofrender
from tofrender.films.splats import Splats, footprint
from tofrender.integrators import passes
from tofrender.paths.lens import Lens
from tofrender.paths.scattering import Materials
from tofrender.paths.space import Vacuum
from tofrender.scenes.settings import SAMPLERS

CUTOFF = 20.0
VIEW = View(1.0, fov=100)
EDGES = np.linspace(2.5, 4.1, 9)
PATHS = 1 << 16
NOISE = 6e-4
"""Of the mean of 2^16 paths: what rounding may add, and the rim, where one of a thousand goes."""

ALONE = [LIGHT_TRACER, "2,1"]


def mean(aspect: float = 1.0) -> float:
    """The film's, whose other side is shorter by the aspect; the rim has half of its light."""
    power = 2 * math.pi * (1 - math.cos(math.radians(CUTOFF - 0.005)))
    return ALBEDO / math.pi * power / (window_area(VIEW.fov) / aspect * VIEW.height**2)


def under_the_spot(technique: str = LIGHT_TRACER, width: int = 8, height: int = 0, **more) -> dict:
    lit = {"lamp": spot((0, 0, 2), (0, 0, 0), CUTOFF - 0.01, CUTOFF)}
    described = looking_down(VIEW, lit, EDGES, fov_axis="larger")
    size = {"width": width, "height": height or width}
    return with_film(described, **size | more) | {"integrator": by(technique)}


def has_all(*pictures, expected: float | None = None, tolerance: float = NOISE) -> bool:
    """Whether each picture's mean is what it must be; bins are added up."""
    expected = mean() if expected is None else expected
    found = [np.sum(each, axis=2) if np.ndim(each) == 4 else each for each in pictures]
    return all(abs(np.mean(each, dtype=float) / expected - 1) < tolerance for each in found)


# ----------------------------------------------------------------------------- nothing is lost

ONE_BIN = {"temporal_bins": 1, "bin_width_opl": 8.0}


@pytest.mark.parametrize(
    ("variant", "technique", "size", "window"),
    [
        # In one pixel and one bin all threads meet; runs differ in how they do
        ("llvm_ad_rgb", LIGHT_TRACER, 1, ONE_BIN),
        ("llvm_ad_mono", "2,1", 1, ONE_BIN),
        ("llvm_ad_rgb", "2,1", 8, ONE_BIN),
        ("llvm_ad_mono", LIGHT_TRACER, 8, {}),
        ("llvm_ad_rgb", LIGHT_TRACER, 64, {}),
        ("llvm_ad_mono", "2,1", 64, {}),
    ],
)
def test_no_splat_is_lost(variant, technique, size, window):
    """Pixel by pixel, a splat is in the picture and in a bin, or in none."""
    mi.set_variant(variant)
    loaded = load(under_the_spot(technique, size, **window))
    for seed in range(6):
        steady, transient = rendered(loaded, PATHS // size**2, seed)
        assert has_all(steady, transient)
        assert transient.sum(axis=2) == pytest.approx(steady, rel=1e-4, abs=1e-4 * steady.max())
    assert size == 1 or steady.max() > 1.5 * mean()
    assert not has_all(0.999 * steady)


@pytest.mark.parametrize("size", [(10, 10), (31, 31), (26, 18), (18, 26)])
@pytest.mark.parametrize("spp", [1, 7, 24])
def test_odd_sizes_and_counts(size, spp):
    steady, transient = rendered(under_the_spot(LIGHT_TRACER, *size), spp=spp)
    rim = 0.1 / math.sqrt(spp * size[0] * size[1])
    expected = mean(max(size) / min(size))
    assert has_all(steady, transient, expected=expected, tolerance=NOISE + rim)


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_every_sampler(sampler):
    loaded = load(with_sampler(under_the_spot(), sampler))
    for spp in (1024, 900):
        assert has_all(*rendered(loaded, spp))


def test_a_million_paths_in_one_pixel_are_not_low():
    """Added to one number in single precision, they lose 0.4 %."""
    assert has_all(*rendered(under_the_spot(width=1), spp=1 << 20))


def test_many_steps(monkeypatch):
    """Each adds its splats; so does what is put aside after many samples."""
    monkeypatch.setattr(passes, "STEP_SAMPLES", 64 * 100)
    monkeypatch.setattr(passes, "MAX_ADDED", 256)
    assert has_all(*rendered(under_the_spot(), spp=1000))


def test_renders_start_from_an_empty_film():
    loaded = load(under_the_spot())
    first, second, third = (rendered(loaded, 1024, seed) for seed in (0, 1, 0))
    assert has_all(*first, *second, *third)
    assert not np.allclose(first[0], second[0], rtol=1e-3)
    assert third[0] == pytest.approx(first[0], rel=1e-4, abs=1e-6)


# ------------------------------------------------------------------------------ films and files


@pytest.mark.parametrize("technique", ALONE)
@pytest.mark.parametrize("kind", ["hdrfilm", "phasor_hdr_film"])
def test_every_film(technique, kind):
    """A steady picture, and phasors at a frequency that is nearly 0."""
    described = under_the_spot(technique)
    size = {"width": 8, "height": 8, "rfilter": {"type": "box"}}
    more = {"hdrfilm": {"component_format": "float32"}, "phasor_hdr_film": {"frequencies_hz": "1"}}
    eye = described["sensor"] | {"film": {"type": kind, **size, **more[kind]}}
    loaded = load(described | {"sensor": eye})
    result = mi.render(loaded, spp=1024)
    again = loaded.sensors()[0].film().develop()
    if kind == "hdrfilm":
        result, again = (result,), (again,)
    else:
        assert has_all(np.array(result[1])[:, :, 0, 0])
    assert has_all(np.array(result[0]))
    for one, other in zip(result, again, strict=True):
        assert np.array(one) == pytest.approx(np.array(other), rel=1e-5, abs=1e-6)


def test_operations_of_the_film():
    loaded = load(under_the_spot())
    steady, transient = rendered(loaded, spp=1024)
    the_film = loaded.sensors()[0].film()
    for k in (0, 3):
        assert np.array(the_film.time_slice(k)) == pytest.approx(transient[:, :, k], rel=1e-5)
    the_film.scale(3.0)
    scaled = [np.array(each, float) for each in the_film.develop()]
    assert has_all(*scaled, expected=3 * mean())
    assert scaled[0] == pytest.approx(3 * steady, rel=1e-5)
    taken = the_film.take()
    assert taken[0] == pytest.approx(scaled[0], rel=1e-6)
    assert taken[1] == pytest.approx(scaled[1], rel=1e-6)
    rendered(loaded, spp=16)
    the_film.clear()
    assert max(np.array(each).max() for each in the_film.develop()) == 0


# ------------------------------------------------------------------------------ crops and tiles

WIDTH, HEIGHT = 8, 6
TILES = [(0, 0, 5, 4), (5, 0, 3, 6), (0, 4, 5, 2)]


def tile(x: int, y: int, width: int, height: int) -> dict:
    window = {"crop_offset_x": x, "crop_offset_y": y, "crop_width": width, "crop_height": height}
    return under_the_spot(LIGHT_TRACER, WIDTH, HEIGHT, **window)


def developed(film) -> list[np.ndarray]:
    return [np.array(tensor, float) for tensor in film.develop()]


@pytest.mark.statistical
def test_tiles_are_the_whole():
    """In any order; a tile's splats count by its own number of paths."""
    whole, target = (load(under_the_spot(LIGHT_TRACER, WIDTH, HEIGHT)) for _ in range(2))
    scenes = [load(tile(*place)) for place in TILES]
    merged, films = target.sensors()[0].film(), [each.sensors()[0].film() for each in scenes]

    def of_tiles(seed):
        for each in scenes:
            mi.render(each, spp=64, seed=seed)
        return merge((0, 1, 2))

    def merge(order):
        merged.prepare([])
        for k in order:
            merged.merge_tile(films[k])
        return developed(merged)

    first, second = of_tiles(0), merge((2, 0, 1))
    for one, other in zip(first, second, strict=True):
        assert one == pytest.approx(other, rel=1e-6)
    for part, (x, y, width, height) in zip(films, TILES, strict=True):
        for one, own in zip(first, developed(part), strict=True):
            assert own.max() > 0
            assert one[y : y + height, x : x + width] == pytest.approx(own, rel=1e-5)

    found = over_seeds(lambda seed: of_tiles(seed)[0][..., 0], SEEDS)
    expected = over_seeds(lambda seed: rendered(whole, 256, seed)[0][..., 0], range(100, 116))
    assert agree(found, expected)
    assert not agree(1.5 * found, expected)


# --------------------------------------------------------- renders that stop, and that go on


@pytest.mark.parametrize("technique", ALONE)
@pytest.mark.parametrize("first", [256, 1000])
def test_resumed_renders_contain_splats(technique, first):
    described = under_the_spot(technique)
    start = tofrender.render(described, spp=first, progress=False)
    whole = tofrender.render(described, spp=2048, resume=start, progress=False)
    for dataset in (start, whole):
        assert has_all(dataset.steady.values, dataset.transient.values, tolerance=2 * NOISE)
        assert dataset.attrs["energy_outside_window"] == pytest.approx(0, abs=1e-5)
    assert whole.attrs["spp"] == 2048
    assert not np.allclose(whole.steady, start.steady, rtol=1e-4)


@pytest.mark.parametrize("technique", ALONE)
@pytest.mark.parametrize("size", [1, 8])
def test_a_film_that_is_partly_finished_contains_them(technique, size, monkeypatch):
    """Ctrl-C when the film is prepared: the first step is finished, the others are not begun."""
    prepare = tofrender.TransientHDRFilm.prepare

    def interrupted(self, aovs):
        channels = prepare(self, aovs)
        signal.raise_signal(signal.SIGINT)
        return channels

    described = under_the_spot(technique, size)
    monkeypatch.setattr(passes, "STEP_SAMPLES", PATHS)
    monkeypatch.setattr(tofrender.TransientHDRFilm, "prepare", interrupted)
    with pytest.warns(UserWarning, match="interrupted: returning"):
        part = tofrender.render(described, spp=(1 << 24) // size**2, progress=False)
    assert part.attrs["complete"] == 0
    assert part.attrs["spp"] * size**2 < 1 << 23
    assert has_all(part.steady.values, part.transient.values, tolerance=2 * NOISE)


# ---------------------------------------------------------------------------------- mistakes

SPP = 1024
"""Of 8 x 8 pixels: 2^16 paths."""

ALL_LENGTHS = np.linspace(0, 8, 9)


def in_the_window() -> tuple[dict, float]:
    return under_the_spot(), mean()


def means(described: dict, technique: str = LIGHT_TRACER, spp: int = SPP, **more) -> np.ndarray:
    """Of the picture, and of its bins, added up."""
    steady, transient = rendered(through(described, technique, **more), spp)
    return np.array([steady.mean(), transient.sum(axis=2).mean()])


def near(found: np.ndarray, expected: float, tolerance: float) -> bool:
    return bool((np.abs(found / expected - 1) < tolerance).all())


# --------------------------------------------------------------------------- refraction


def in_glass() -> tuple[dict, float]:
    """A spot in glass over a floor, and the film's mean: importance does not shrink by n²."""
    view = View(0.5, fov=122)
    face = plane(translate(0, 0, 0.6) @ rotate((1, 0, 0), 180), bsdf=GLASS)
    parts = {"face": face, "lamp": spot((0, 0, 1.4), (0, 0, 0), 25, 25.01)}
    described = looking_down(view, parts, ALL_LENGTHS, max_depth=3)
    return described, out_of_glass(1.5, 0.8, 0.6, math.radians(25)).seen(view, ALBEDO).total


def behind_a_rough_face(side: int) -> tuple[dict, float]:
    """A lamp in glass and the camera in air (1), or the other way round (-1); by a path tracer."""
    frosted = GLASS | {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.4}
    turned = rotate((0, 1, 0), 0 if side > 0 else 180)
    lit = plane(turned @ translate(0.2, 0.1, -1), size=0.8, emitter=area_light(1.0))
    eye = camera((0.5 * side, 0, 1.5 * side), (0, 0, 0), film(8, 8, 8, 0.0, 1.0), fov=50)
    described = scene({"face": plane(bsdf=frosted), "lamp": lit}, eye, max_depth=2)
    return described, float(rendered(described, 256)[0].mean())


def as_radiance(right: Callable) -> Callable:
    """Importance that is scattered as radiance is: eta squared where there is none."""

    def wrong(self, *args, **options):
        right(self, *args, **options)
        self.flux = self.radiance

    return wrong


def not_turned_round(right: Callable) -> Callable:
    """The BSDF of the light's own way, which has eta squared where the camera's has not."""

    def wrong(self, bsdf, si, wo, active):
        _, back = right(self, bsdf, si, wo, active)
        return bsdf.eval(self.radiance, si, wo, active), back

    return wrong


def wall_behind_rough_glass() -> tuple[dict, float]:
    """A wall whose light comes through a sheet of rough glass."""
    frosted = GLASS | {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3}
    lit = plane(translate(0, 0, -0.6), size=0.3, emitter=area_light(10.0), bsdf=diffuse(0))
    wall = plane(translate(0, 0, 1) @ rotate((1, 0, 0), 180), size=3.0, bsdf=diffuse(0.7))
    eye = camera((0.5, -1.0, 0.5), (0.2, 0, 1), film(8, 8, 8, 0.0, 1.0), up=(0, 0, 1), fov=60)
    parts = {"sheet": plane(bsdf=frosted), "wall": wall, "lamp": lit}
    described = scene(parts, eye, max_depth=3)
    return described, float(means(described, "transient_path", 4 * SPP)[0])


def failed_choices_count(right: Callable) -> Callable:
    """A facet that reflects light into the glass sends it on, as if it were refracted."""

    def wrong(self, vertex, link, sampler, active):
        turn, bounce = right(self, vertex, link, sampler, active)
        if self.importance:
            f = self.turn(vertex, bounce.ray.d, active & ~bounce.specular & (bounce.pdf > 0)).f
            again = dr.select(bounce.pdf > 0, f / bounce.pdf, 0)
            bounce.weight = dr.select(bounce.specular, bounce.weight, again)
        return turn, bounce

    return wrong


# ------------------------------------------------------------------------- shading normals


def on_a_tilted_floor() -> tuple[dict, float]:
    """A floor whose shading normals lean towards the light."""
    leaning = np.tile(np.array([0.7, 0.5, 0.95], np.float32), (2, 2, 1))
    texture = {"type": "bitmap", "raw": True, "data": mi.TensorXf(leaning)}
    tilted = {"type": "normalmap", "normalmap": texture, "nested": diffuse(ALBEDO)}
    parts = {"floor": plane(bsdf=load(tilted)), "lamp": spot((1, 0, 1.5), (0, 0, 0), 14.99, 15)}
    described = looking_down(VIEW, parts, ALL_LENGTHS)
    return described, float(means(described, "transient_path")[0])


def cosine_to_the(power: int) -> Callable:
    def wrongly(right: Callable) -> Callable:
        return lambda self, d: right(self, d) * dr.abs(dr.dot(d, self.axis)) ** (3 - power)

    return wrongly


def no_area(right: Callable) -> Callable:
    return lambda self, d: right(self, d) * self.area


def no_distance(right: Callable) -> Callable:
    return lambda self, *args: replace(right(self, *args), distance=mi.Float(1))


class Mistake(NamedTuple):
    """A scene with its mean and the tolerance of that, a wrong method, and what the mean becomes.

    Without a factor it is enough that the mean is off by more than 5 %.
    """

    scene: Callable[[], tuple[dict, float]]
    tolerance: float
    owner: type
    name: str
    wrong: Callable[[Callable], Callable]
    factor: float | None = None


DENSITY = functools.partial(Mistake, in_the_window, 1e-3, Lens, "density")
ADJOINT = Materials, "_adjoint", not_turned_round
MISTAKES = {
    "eta squared at smooth glass": Mistake(
        in_glass, 0.02, Materials, "__init__", as_radiance, 1.5**2
    ),
    "at rough glass": Mistake(lambda: behind_a_rough_face(1), 0.1, *ADJOINT, 1.5**2),
    "at rough glass, camera within": Mistake(
        lambda: behind_a_rough_face(-1), 0.1, *ADJOINT, 1.5**-2
    ),
    "failed choices": Mistake(
        wall_behind_rough_glass, 0.1, Materials, "scatter", failed_choices_count
    ),
    "shading normals count both ways alike": Mistake(on_a_tilted_floor, 0.03, *ADJOINT),
    **{f"cosine to the {power}": DENSITY(cosine_to_the(power)) for power in (0, 2, 4)},
    "no area": DENSITY(no_area),
    "no density": DENSITY(lambda right: lambda self, d: mi.Float(1)),
    "no distance": Mistake(in_the_window, 1e-3, Lens, "arrive", no_distance),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_noticed(name, monkeypatch):
    it = MISTAKES[name]
    described, expected = it.scene()
    assert near(means(described), expected, it.tolerance)
    monkeypatch.setattr(it.owner, it.name, it.wrong(getattr(it.owner, it.name)))
    found = means(described)
    if it.factor is None:
        assert not near(found, expected, max(0.05, 3 * it.tolerance))
    else:
        assert near(found, it.factor * expected, it.tolerance)


# ---------------------------------------------------------------------------- visibility


def under_a_card(parts: dict) -> dict:
    """A card right under the camera, over the whole window."""
    card = plane(translate(0, 0, 1.8), size=0.5, bsdf=diffuse(0))
    return looking_down(View(2.0), {"card": card} | parts, ALL_LENGTHS)


def seen_through(right: Callable) -> Callable:
    """Connections to the lens, which alone have a place on the film, that nothing stops."""

    def wrong(self, path, vertex, connection, sampler):
        if connection.position is not None:
            return mi.Float(1)
        return right(self, path, vertex, connection, sampler)

    return wrong


@pytest.mark.parametrize("technique", TRACERS)
def test_visibility_of_the_lens(technique, monkeypatch):
    described = under_a_card(lamp((0.1, 0, 1)))
    assert means(described, technique, 64).max() == 0
    monkeypatch.setattr(Vacuum, "transmittance", seen_through(Vacuum.transmittance))
    assert means(described, technique, 64).min() > 0


def test_visibility_of_a_lamp(monkeypatch):
    """Of the one that the lens connects to itself."""
    lit = plane(translate(0, 0, 1), size=0.5, emitter=area_light(1.0), bsdf=diffuse(0))
    described = under_a_card({"lamp": lit})
    assert means(described, spp=64).max() == 0
    monkeypatch.setattr(mi.Scene, "ray_test", lambda *_: mi.Bool(False))
    assert means(described, spp=64).min() > 0


# -------------------------------------------------------------------------------- splats

NARROW = View(1.0, fov=40)


def partly_seen() -> tuple[dict, float]:
    """A third of the spot's light lands in the picture."""
    lit = {"lamp": under_the_spot()["lamp"]}
    expected = under_a_point(NARROW, (0, 0, 2), 1.0, ALBEDO).total
    return looking_down(NARROW, lit, ALL_LENGTHS), expected


def counted(monkeypatch, factor: Callable[[np.ndarray], np.ndarray]) -> None:
    """Multiply splats by a function of how many have landed in each pixel."""
    init, add = Splats.__init__, Splats.add

    def with_count(self, film, count):
        init(self, film, count)
        height, width = self.cells.shape[:2]
        self.landed = dr.zeros(mi.UInt32, height * width)
        dr.eval(self.landed)
        tensor = self.cells.tensor

        def wrong(*args):
            landed = np.array(self.landed, float).reshape(height, width, 1, 1)
            return mi.TensorXf((np.array(tensor(*args)) * factor(landed)).astype(np.float32))

        self.cells.tensor = wrong

    def counting(self, position, values, first, active):
        add(self, position, values, first, active)
        [(x, y, _)] = footprint(self.film, position)
        height, width = self.cells.shape[:2]
        inside = active & (x >= 0) & (y >= 0) & (x < width) & (y < height)
        dr.scatter_add(self.landed, mi.UInt32(1), mi.UInt32(y * width + x), inside)

    monkeypatch.setattr(Splats, "__init__", with_count)
    monkeypatch.setattr(Splats, "add", counting)


COUNTS = {
    "divided by those that landed": lambda landed: 64 * SPP / landed.sum(),
    "samples of their pixel": lambda landed: SPP / (SPP + landed),
}


@pytest.mark.parametrize("mistake", COUNTS)
def test_splats_are_divided_by_all_paths(mistake, monkeypatch):
    described, expected = partly_seen()
    assert near(means(described), expected, 0.03)
    counted(monkeypatch, COUNTS[mistake])
    found = means(described)
    assert not near(found[:1], expected, 0.1)
    assert not near(found[1:], expected, 0.1)
