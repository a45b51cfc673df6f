"""Paths that the pixels of tiles share: the same light as without, and each mistake is found."""

from collections.abc import Callable

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, diffuse, rotate
from helpers.support import agree, load, over_seeds, rendered, with_film, with_integrator

import tofrender
from tofrender.films.recording import recording
from tofrender.integrators import passes, shared_paths
from tofrender.integrators.passes import SampleRange, best_sampler, steps
from tofrender.integrators.shared_paths import SharedPaths
from tofrender.paths.camera import Tile
from tofrender.runtime.checkpoints import SavedState
from tofrender.scenes import cornell_box, cornell_box_flash, cornell_box_fog, cornell_box_glass

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")
CROP = {"crop_width": 7, "crop_height": 5, "crop_offset_x": 2, "crop_offset_y": 3}
SEEDS, OTHER_SEEDS = range(12), range(1000, 1012)
SPP = 64


@pytest.fixture(autouse=True)
def _in_small_films(monkeypatch):
    """Share paths in films that are too small for sharing to be faster."""
    monkeypatch.setattr(passes, "FEW_SHARED_PATHS", 0)
    monkeypatch.setattr(passes, "FEW_SHARED_PIXELS", 0)


def box(build=cornell_box, **integrator) -> dict:
    """A crop of a box that is not square. A ball casts shadows between the pixels of a tile."""
    ball = {"type": "sphere", "center": [0.3, -0.2, 0.5], "radius": 0.3, "bsdf": diffuse(0.6)}
    size = {"width": 10, "height": 9, "temporal_bins": 24, "bin_width_opl": 0.25, "max_depth": 5}
    described = build(**size) | {"ball": ball}
    return with_integrator(with_film(described, **CROP), **integrator)


def two_lamps() -> dict:
    """A box with a second lamp, a sky behind an open side, and an index other than 1."""
    lamp = {"type": "sphere", "center": [-0.6, -0.6, 0.6], "radius": 0.1, "emitter": area_light(3)}
    sky = {"type": "constant", "radiance": {"type": "uniform", "value": 0.2}}
    described = box(camera_unwarp=True, pulse_width_opl=0.1)
    return described | {"lamp": lamp, "sky": sky}


def two_rooms() -> dict:
    """A box with a wall between its halves, so that pixels of a tile do not see each other."""
    wall = {"type": "rectangle", "to_world": rotate((0, 1, 0), 90)}
    return box(max_depth=4) | {"wall": wall | {"bsdf": {"type": "twosided", "of": diffuse(0.8)}}}


SCENES = {
    "box": box,
    "two rooms": two_rooms,
    "flash": lambda: box(cornell_box_flash),
    "two lamps": two_lamps,
}


def seen(described: dict, seeds, spp: int = SPP) -> np.ndarray:
    """Energy in groups of bins, and in rows and columns of pixels, shape (seeds, groups)."""
    loaded = load(described)

    def estimate(seed: int) -> np.ndarray:
        steady, transient = rendered(loaded, spp, seed)
        arrivals = transient.sum(axis=(0, 1, 3))
        groups = [part.sum() for part in np.array_split(arrivals, 6)]
        return np.array([*groups, *steady.sum(axis=(1, 2)), *steady.sum(axis=(0, 2))])

    return over_seeds(estimate, seeds)


def apart(described: dict, seeds) -> np.ndarray:
    """The same light without sharing."""
    return seen(with_integrator(described, shared_paths=False), seeds)


def technique(described: dict, tile=None) -> SharedPaths | None:
    loaded = load(described)
    sensor, integrator = loaded.sensors()[0], loaded.integrator()
    record = recording(sensor.film(), integrator.exposure())
    return SharedPaths.of(integrator.plan(loaded, sensor), sensor, record, tile)


@pytest.mark.statistical
@pytest.mark.parametrize("name", SCENES)
def test_the_same_light(name):
    described = SCENES[name]()
    assert technique(described) is not None
    assert agree(seen(described, SEEDS), apart(described, OTHER_SEEDS), rounding=1e-4)


@pytest.mark.parametrize(("x", "sees"), [(0.5, True), (-0.5, False)])
def test_a_density_contains_the_visibility(x, sees):
    """A point of the floor sees a point of the right wall only without the inner wall between."""
    found = technique(two_rooms())
    direction = mi.Vector3f(1, 0, 0)
    si = found.scene.ray_intersect(mi.Ray3f(mi.Point3f(0.9, 0, 0.9), direction))
    prefix = found._no_prefix()
    prefix.p = mi.Point3f(x, -1, 0.9)
    prefix.start = mi.Point3f(x, -0.999, 0.9)
    prefix.n = mi.Normal3f(0, 1, 0)
    prefix.active = mi.UInt32(1)
    link, density = found._link(prefix, si, direction, mi.Bool(True))
    assert (density[0] > 0) == sees
    assert (link.weight.x[0] > 0) == sees


@pytest.mark.statistical
@pytest.mark.parametrize("side", [1, 2, 3])
def test_tiles_of_any_size(side, monkeypatch):
    """Tiles of one pixel are ordinary paths."""
    expected = apart(box(), OTHER_SEEDS)
    _set_defaults(monkeypatch, side, 2)
    assert agree(seen(box(), SEEDS), expected, rounding=1e-4)


def _set_defaults(monkeypatch, side: int, every: int) -> None:
    monkeypatch.setattr(SharedPaths.__init__, "__defaults__", (side, every))


def pass_of(described: dict, spp: int) -> passes._SharedPass:
    """The pass of a scene, whose kernels are not launched."""
    found = technique(described)
    assert found is not None
    found.record.prepare(spp)
    return passes._SharedPass(shared=found, spp=spp, seed=1, samples=passes.WHOLE)


def test_tiles_shift(monkeypatch):
    """Each block of samples has a shift of its own, within the tile, for equal seeds the same."""
    shifts: list[tuple[int, ...]] = []

    def step(self, shift, count):
        shifts.append(tuple(int(each) for each in np.ravel(np.array(shift))))
        return 0

    monkeypatch.setattr(passes._SharedPass, "_step", step)
    for _ in range(2):
        pass_of(box(), spp=4096).sample(4096)
    half = len(shifts) // 2
    assert half == 4096 // shared_paths.EVERY // passes.MOST_IN_BLOCK
    assert shifts[:half] == shifts[half:]
    assert len(set(shifts)) > half // 3
    assert all(0 <= each < shared_paths.SIDE for shift in shifts for each in shift)


@pytest.mark.parametrize(("spp", "every", "lanes"), [(64, 4, 4), (8, 4, 2), (6, 2, 1), (5, 1, 1)])
def test_any_number_of_samples(spp, every, lanes):
    found = pass_of(box(), spp)
    assert (found.every, found.lanes, found.unit) == (every, lanes, every * lanes)


def _state_after_a_step(loaded, spp: int, saved: SavedState | None = None):
    """Render in steps, and return the first state, its samples, and the developed film."""
    sensor, integrator = loaded.sensors()[0], loaded.integrator()
    record = recording(sensor.film(), integrator.exposure())
    samples = SampleRange(saved=saved)
    plan = integrator.plan(loaded, sensor)
    first = None
    for done in steps(plan, record, sensor, best_sampler(spp), 3, samples):
        if first is None:
            first = (
                done,
                {name: np.array(each) for name, each in record.accumulation.state().items()},
            )
    steady, transient = record.film.take()
    return *first, np.array(steady), np.array(transient)


def test_a_checkpoint_goes_on(monkeypatch):
    """A render that continues from a checkpoint equals a render without a break."""
    monkeypatch.setattr(passes, "FIRST_SAMPLES", 1)
    monkeypatch.setattr(passes, "STEP_S", 0.0)
    loaded = load(box())
    done, state, steady, transient = _state_after_a_step(loaded, 512)
    assert 0 < done < 512
    saved = SavedState(done=done, of=512, seconds=0.0, arrays=state)
    _, _, again_steady, again_transient = _state_after_a_step(loaded, 512, saved)
    assert np.allclose(again_steady, steady, rtol=1e-4, atol=1e-6)
    assert np.allclose(again_transient, transient, rtol=1e-3, atol=1e-5)


GAUSSIAN = {"rfilter": {"type": "gaussian"}}
FALLS_BACK: dict[str, Callable[[], dict]] = {
    "off": lambda: box(shared_paths=False),
    "glass": lambda: box(cornell_box_glass),
    "fog": lambda: box(cornell_box_fog),
    "a rough surface": lambda: box() | {"floor": rough()},
    "a bump map": lambda: box() | {"ball": bumpy()},
    "roulette at the first vertex": lambda: box(rr_depth=1),
    "direct light": lambda: box(max_depth=2),
    "a filter": lambda: with_film(box(), **GAUSSIAN),
    "no connections": lambda: box(emitter_sampling=False, shared_paths=None),
}


def rough() -> dict:
    return {"type": "sphere", "radius": 0.2, "bsdf": {"type": "roughconductor"}}


def bumpy() -> dict:
    bumps = {"type": "bumpmap", "arbitrary": {"type": "checkerboard"}, "bsdf": diffuse(0.5)}
    return {"type": "sphere", "radius": 0.2, "bsdf": bumps}


@pytest.mark.parametrize("name", FALLS_BACK)
def test_scenes_without_sharing(name):
    described = FALLS_BACK[name]()
    integrator = {k: v for k, v in described["integrator"].items() if v is not None}
    assert technique(described | {"integrator": integrator}) is None


def test_tiles_of_a_film_do_not_share():
    whole = load(box()).sensors()[0].film()
    assert technique(box(), tile=Tile(0, 0, whole)) is None


def test_denoised_renders_do_not_share(monkeypatch):
    """The filter of `denoise` expects independent noise in neighboring pixels."""
    monkeypatch.setattr(passes._SharedPass, "_step", lambda *_: pytest.fail("shares paths"))
    tofrender.render(load(box()), spp=8, denoise=True, progress=False)


@pytest.mark.parametrize(("name", "bound"), [("PATHS", 7 * 5 * 16 + 1), ("PIXELS", 7 * 5 + 1)])
def test_small_films_are_not_shared(name, bound, monkeypatch):
    monkeypatch.setattr(passes, f"FEW_SHARED_{name}", bound)
    monkeypatch.setattr(passes._SharedPass, "_step", lambda *_: pytest.fail("shares paths"))
    rendered(box(), 16)


@pytest.mark.statistical
def test_less_noise_per_bin():
    size = {"width": 40, "height": 30, "temporal_bins": 60, "bin_width_opl": 0.1}

    def variance(**integrator) -> float:
        loaded = load(with_integrator(cornell_box(**size), **integrator))
        cubes = [rendered(loaded, SPP, seed)[1][10:] for seed in range(6)]
        return float(np.var(np.array(cubes, float), axis=0, ddof=1).mean())

    assert variance() < 0.8 * variance(shared_paths=False)


@pytest.mark.statistical
def test_standard_errors_are_those_of_shared_paths():
    loaded = load(box())
    found = [
        tofrender.render(loaded, spp=SPP, seed=seed, errors=True, progress=False)
        for seed in range(12)
    ]
    variance = np.var([each["transient"].values for each in found], axis=0, ddof=1).mean()
    estimate = np.mean([each["transient_error"].values ** 2 for each in found])
    assert 0.75 < estimate / variance < 1.35
