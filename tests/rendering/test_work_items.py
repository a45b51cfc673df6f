"""Work items of a render are the render, however it is cut: seams, ranges of samples, borders."""

import dataclasses

import mitsuba as mi
import numpy as np
import pytest
from helpers.films_in_parts import ROUNDING, box, crop
from helpers.support import agree, with_film, with_integrator

from tofrender.rendering.job import WorkItem, whole
from tofrender.rendering.renderer import make_job
from tofrender.rendering.settings import RenderSettings
from tofrender.rendering.tiling import sample_ranges, tile_size, tiles
from tofrender.rendering.work_items import render_item
from tofrender.runtime.memory import film_bytes

CUT = (4, 5)  # Rows and columns that divide neither 9 nor 12


def job_of(described, **options):
    return make_job(RenderSettings(described, **{"spp": 8} | options))


def put_together(job, size=CUT) -> dict[str, np.ndarray]:
    """All arrays of a render from its tiles, NaN where there is none."""
    found: dict[str, np.ndarray] = {}
    for tile in tiles(job, size):
        for name, values in render_item(job, tile, progress=False).arrays.items():
            shape = (*job.film.shape[:2], *values.shape[2:])
            array = found.setdefault(name, np.full(shape, np.nan, np.float32))
            tile.pixels(array)[...] = values
    return found


def check_tiles(described, size=CUT, **options) -> dict[str, np.ndarray]:
    job = job_of(described, **options)
    expected = render_item(job, whole(job), progress=False).arrays
    found = put_together(job, size)
    assert set(found) == set(expected)
    for name, values in expected.items():
        brightest = np.abs(values).max()
        assert values.std() > 0.05 * abs(values.mean()) > 0
        assert np.abs(found[name] - values).max() <= ROUNDING * brightest, name
    return expected


@pytest.mark.parametrize("size", [(1, 1), (1, 12), (2, 12), CUT, (9, 12)])
def test_tiles_cover_each_pixel_once(size):
    job = job_of(box())
    covered = np.zeros((9, 12), int)
    for tile in tiles(job, size):
        assert (tile.first, tile.count) == (0, 8)
        assert 1 <= tile.height <= size[0]
        assert 1 <= tile.width <= size[1]
        tile.pixels(covered)[...] += 1
    assert (covered == 1).all()


@pytest.mark.parametrize("shape", [(9, 12, 40, 3), (1, 1, 1, 1), (1, 700, 30, 1), (512, 1, 7, 3)])
@pytest.mark.parametrize("part", [1e-9, 0.001, 0.1, 0.5, 1.0, 7.0])
@pytest.mark.parametrize("workers", [1, 2, 9])
def test_tiles_are_no_larger_than_they_may_be(shape, part, workers):
    height, width, bins, channels = shape
    rows, columns = tile_size(shape, workers, part * film_bytes(*shape))
    assert 1 <= rows <= height
    assert 1 <= columns <= width
    size = film_bytes(rows, columns, bins, channels)
    assert size <= part * film_bytes(*shape) or (rows, columns) == (1, 1)
    count = -(-height // rows) * -(-width // columns)
    if workers == 1 and part >= 1:
        assert count == 1
    if workers > 1:
        assert count >= min(workers, height * width) or (rows, columns) == (1, 1)


@pytest.mark.parametrize(("spp", "workers"), [(8, 1), (8, 3), (64, 2), (1000, 3), (1, 4)])
def test_ranges_cover_each_sample_once(spp, workers):
    found = sample_ranges(job_of(box(), spp=spp), workers)
    assert found[0].first == 0
    ends = [piece.first + piece.count for piece in found]
    assert [piece.first for piece in found[1:]] == ends[:-1]
    assert ends[-1] == spp
    assert all((p.y, p.x, p.height, p.width) == (0, 0, 9, 12) and p.count > 0 for p in found)


@pytest.mark.parametrize("cropped", [{}, crop(3, 2, 7, 6)])
@pytest.mark.parametrize(
    ("rfilter", "border"), [("box", False), ("gaussian", False), ("gaussian", True)]
)
def test_tiles_are_the_whole(rfilter, border, cropped):
    """A filter takes from beyond the seams what the whole has there, from beyond the film too."""
    described = with_film(box(), rfilter={"type": rfilter}, sample_border=border, **cropped)
    expected = check_tiles(described, (4, 5) if not cropped else (3, 7), seed=77)
    assert expected["steady"].shape == ((6, 7, 3) if cropped else (9, 12, 3))


SMOOTH = {"temporal_filter": "gaussian", "gaussian_stddev": 0.8}


def below_the_lamp() -> dict:
    """Light that needs no bounce is found pixel by pixel, in whichever tile these are."""
    described = box(start_opl=0.0)
    to_world = mi.ScalarTransform4f().look_at([0, 0, 0], [0, 1, 0], [0, 0, 1])
    return described | {"sensor": described["sensor"] | {"to_world": to_world, "fov": 40}}


@pytest.mark.parametrize(
    ("described", "size", "options"),
    [
        (lambda: box(3, 2), (1, 1), {"spp": 11}),
        (lambda: with_integrator(box(), **SMOOTH), (5, 12), {}),
        (box, (5, 12), {"integrator": "path_tracer_nee"}),
        (below_the_lamp, (3, 4), {}),
    ],
)
def test_tiles_of_other_light(described, size, options):
    check_tiles(described(), size, **options)


@pytest.mark.statistical
@pytest.mark.parametrize("sampler", ["independent", "multijitter"])
def test_tiles_of_other_samplers(sampler):
    """Other points, the same light: per pixel and per bin over 16 seeds.

    False alarms: `support.agree` splits 1e-3 over the suite. Bins 30 % too bright, or two tiles
    that change places, are found.
    """
    job, cut, at_once = job_of(box(6, 4), spp=64, sampler=sampler), [], []
    for seed in range(16):
        settings = dataclasses.replace(job.settings, seed=seed)
        seeded = dataclasses.replace(job, settings=settings)
        cut.append(put_together(seeded, (2, 6)))
        at_once.append(render_item(seeded, whole(job), progress=False).arrays)
    steady, expected = (np.stack([each["steady"] for each in films]) for films in (cut, at_once))
    assert agree(steady, expected)
    assert not agree(np.roll(steady, 2, axis=1), expected)
    bins, expected = (
        np.stack([each["transient"].sum(axis=(0, 1, 3)) for each in films])
        for films in (cut, at_once)
    )
    assert agree(bins, expected)
    assert not agree(1.3 * bins, expected)


@pytest.mark.parametrize("sampler", ["independent", "multijitter", "padded_sobol"])
def test_no_two_tiles_have_the_same_points(sampler):
    job = job_of(box(), sampler=sampler)
    results = (render_item(job, WorkItem(0, x, 9, 4, 0, 8), progress=False) for x in (0, 8))
    left, right = (result.arrays["steady"] for result in results)
    assert np.abs(left - right[:, ::-1]).max() > 0.01 * left.max()  # The box is nearly symmetric
    assert np.abs(left - right).max() > 0.01 * left.max()
