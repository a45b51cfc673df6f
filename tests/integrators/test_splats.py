"""Splats: light that lands on any pixel, from any thread, and is no sample of that pixel.

Under a spot whose whole light meets the floor within the picture, each of n paths from it adds the
same to the film's mean, ρ Φ / (π A H² n), whatever the place (`light_path_oracles.Caustic`). The
mean then has almost no noise, and no splat can be lost or counted twice unseen.
"""

import math
import signal

import mitsuba as mi
import numpy as np
import pytest
from helpers.light_paths import (
    ALBEDO,
    LIGHT_TRACER,
    SEEDS,
    TRACERS,
    by,
    lamp,
    looking_down,
    spot,
    through,
)
from helpers.limits import lower
from helpers.parts import area_light, diffuse, plane, translate
from helpers.support import (
    agree,
    camera,
    film,
    load,
    over_seeds,
    rendered,
    scene,
    with_film,
    with_sampler,
)
from oracles.light_paths import View, window_area

import tofrender
from tofrender.runtime.settings import SAMPLERS

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


def test_filters_keep_the_brightness_at_all_edges():
    """A lamp of radiance 2 fills the view. All rows and columns have the same radiance."""
    width, height = 9, 4
    lamp = plane(translate(0, 0, -1), size=0.7, emitter=area_light(2.0), bsdf=diffuse(0))
    the_film = film(width=width, height=height, bins=1, bin_width=8.0)
    the_film["rfilter"] = {"type": "gaussian"}
    view = camera((0, 0, 0), (0, 0, -1), the_film, up=(0, 1, 0), fov=60, fov_axis="larger")
    tracer = {"type": LIGHT_TRACER, "temporal_filter": "box"}
    steady, transient = rendered(scene({"lamp": lamp}, view, **tracer), 4096)
    for picture in (steady, transient[:, :, 0]):
        assert picture.mean(axis=(0, 2)) == pytest.approx(np.full(width, 2.0), rel=0.05)
        assert picture.mean(axis=(1, 2)) == pytest.approx(np.full(height, 2.0), rel=0.05)


def test_a_million_paths_in_one_pixel_are_not_low():
    """Added to one number in single precision, they lose 0.4 %."""
    assert has_all(*rendered(under_the_spot(width=1), spp=1 << 20))


def test_many_steps(monkeypatch):
    """Each adds its splats; so does what is put aside after many samples."""
    lower(monkeypatch, step_samples=64 * 100, max_added=256)
    assert has_all(*rendered(under_the_spot(), spp=1000))


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
    lower(monkeypatch, step_samples=PATHS)
    monkeypatch.setattr(tofrender.TransientHDRFilm, "prepare", interrupted)
    with pytest.warns(UserWarning, match="interrupted: returning"):
        part = tofrender.render(described, spp=(1 << 24) // size**2, progress=False)
    assert part.attrs["complete"] == 0
    assert part.attrs["spp"] * size**2 < 1 << 23
    assert has_all(part.steady.values, part.transient.values, tolerance=2 * NOISE)


@pytest.mark.parametrize("technique", TRACERS)
@pytest.mark.parametrize("kind", ["point", "area"])
def test_a_card_right_under_the_camera_hides_all(technique, kind):
    """What light meets, and the lamp that the lens connects to itself."""
    glows = plane(translate(0, 0, 1), size=0.5, emitter=area_light(1.0), bsdf=diffuse(0))
    lit = lamp((0.1, 0, 1)) if kind == "point" else {"lamp": glows}
    card = plane(translate(0, 0, 1.8), size=0.5, bsdf=diffuse(0))
    for parts, hidden in ((lit, False), (lit | {"card": card}, True)):
        described = looking_down(View(2.0), parts, np.linspace(0, 8, 9))
        steady, transient = rendered(through(described, technique), 64)
        assert (steady.max() == 0, transient.max() == 0) == (hidden, hidden)
