"""Lamps in view are found apart: the same light in the same bins, with less noise."""

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.films_in_parts import replace_launch
from helpers.limits import lower
from helpers.parts import area_light, diffuse, plane, rotate, translate
from helpers.support import (
    agree,
    camera,
    film,
    largest,
    load,
    over_seeds,
    rendered,
    scene,
    with_film,
    with_integrator,
)

import tofrender
from tofrender.bidirectional.lens import Lens
from tofrender.integrators import passes
from tofrender.integrators.extra_rays import VisibleEmitters

SEEDS, OTHER_SEEDS = range(16), range(1000, 1016)
SPP = 64


def lamp(radius: float = 0.1, z: float = -2.0, **emitter) -> dict:
    """A disk that faces a camera at the origin."""
    to_world = translate(0.07, 0.03, z) @ rotate((0, 1, 0), 40)
    shape = {"type": "disk", "to_world": to_world @ mi.ScalarTransform4f().scale(radius)}
    return shape | {"emitter": area_light(2.0) | emitter}


def textured() -> dict:
    pixels = mi.Bitmap(np.linspace(0.2, 3, 16, dtype=np.float32).reshape(4, 4, 1))
    image = {"type": "bitmap", "bitmap": pixels, "raw": True, "filter_type": "nearest"}
    return lamp(radiance=image)


def view(parts: dict, size: int = 12, **sensor) -> dict:
    """Parts before a camera at the origin; bins of 2 cm hold the lamp's light."""
    eye = camera((0, 0, 0), (0, 0, -1), film(size, size, 60, 1.86, 0.02), fov=30)
    wall = {"wall": plane(translate(0, 0, -2.2), size=1, bsdf=diffuse(0.5))}
    return scene(wall | parts, eye | sensor, max_depth=2)


def ball(radius: float) -> dict:
    glow = area_light(2.0)
    return {"type": "sphere", "center": [0.1, -0.1, -2], "radius": radius, "emitter": glow}


def glass_before(parts: dict) -> dict:
    glass = {"type": "sphere", "center": [0.07, 0.03, -1.2], "radius": 0.2}
    described = view(parts | {"glass": glass | {"bsdf": {"type": "dielectric"}}})
    return with_integrator(described, max_depth=4)


CROP = {"crop_width": 6, "crop_height": 5, "crop_offset_x": 6, "crop_offset_y": 4}
THIN = {"type": "thinlens", "aperture_radius": 0.05, "focus_distance": 1.0}
SKY = {"type": "constant", "radiance": {"type": "uniform", "value": 0.1}}

SCENES: dict[str, Callable[[], dict]] = {
    "disk": lambda: view({"lamp": lamp()}),
    "textured": lambda: view({"lamp": textured()}),
    "less than a pixel": lambda: view({"lamp": ball(0.01)}),
    "cut by the crop": lambda: with_film(view({"lamp": lamp()}), **CROP),
    "out of focus": lambda: view({"lamp": lamp(0.03)}, 24, **THIN),
    "shifted": lambda: view({"lamp": lamp(0.05)}, principal_point_offset_x=0.2),
    "two": lambda: view({"lamp": lamp(0.04), "ball": ball(0.05)}),
    "sky": lambda: view({"lamp": lamp(), "sky": SKY}),
    "half hidden": lambda: view(
        {"lamp": lamp(), "block": plane(translate(-0.97, 0, -1.5), size=1, bsdf=diffuse(0))}
    ),
    "filter": lambda: with_film(view({"lamp": lamp()}), rfilter={"type": "gaussian"}),
    "filter and border": lambda: with_film(
        view({"lamp": lamp()}), rfilter={"type": "tent"}, sample_border=True, **CROP
    ),
    "behind glass": lambda: glass_before({"lamp": lamp(0.02), "other": ball(0.03)}),
    "unwarped": lambda: with_integrator(
        with_film(view({"lamp": lamp()}), start_opl=0.0), camera_unwarp=True
    ),
    "pulse": lambda: with_integrator(view({"lamp": lamp()}), pulse_width_opl=0.03),
}


def all_in_one(monkeypatch) -> None:
    """Leave it all to the paths."""
    monkeypatch.setattr(passes.VisibleEmitters, "of", classmethod(lambda *_: None))


def found_apart(described: dict) -> VisibleEmitters | None:
    loaded = load(described)
    sensor = loaded.sensors()[0]
    return VisibleEmitters.of(loaded.integrator().plan(loaded, sensor), sensor, sensor.film())


def seen(described: dict, seeds) -> np.ndarray:
    """(seeds, what is compared): all bins of the film, and 3 x 3 blocks of the picture."""
    loaded = load(described)

    def estimate(seed: int) -> np.ndarray:
        steady, transient = rendered(loaded, SPP, seed)
        blocks = [np.array_split(row, 3, axis=1) for row in np.array_split(steady, 3)]
        means = [part.mean() for row in blocks for part in row]
        return np.concatenate([transient.sum(axis=(0, 1)).mean(axis=1), means])

    return over_seeds(estimate, seeds)


@pytest.mark.statistical
@pytest.mark.parametrize("name", SCENES)
def test_the_same_light(name, monkeypatch):
    described = SCENES[name]()
    apart = found_apart(described)
    assert apart is not None
    assert apart.rate > 1
    found = seen(described, SEEDS)
    all_in_one(monkeypatch)
    expected = seen(described, OTHER_SEEDS)
    assert agree(found, expected, rounding=1e-4)


def test_there_is_less_noise(monkeypatch):
    described = SCENES["disk"]()
    rate = found_apart(described).rate
    loaded = load(described)

    def variance() -> float:
        return over_seeds(lambda seed: rendered(loaded, SPP, seed)[1], SEEDS).var(axis=0).mean()

    apart = variance()
    all_in_one(monkeypatch)
    assert variance() > 0.5 * rate * apart


@pytest.mark.parametrize("kind", ["gate", "phasors"])
def test_gates_and_phasors(kind, monkeypatch):
    """Equal in the mean, to what noise is left in many samples."""
    described = SCENES["disk"]()
    loaded = load(described)
    sensor = loaded.sensors()[0]

    def measured() -> np.ndarray:
        if kind == "phasors":
            return np.array(tofrender.render_amcw_phasor(loaded, sensor, [1e9], spp=1024)[:2])
        gate = mi.load_dict({"type": "time_gated_transient_path", "pulse_width_opl": 0.02})
        return tofrender.render_at_time(loaded, gate, sensor, 2.05, spp=1024)

    apart = measured()
    all_in_one(monkeypatch)
    one = measured()
    assert abs(apart.sum() / one.sum() - 1) < 2e-3
    assert largest(apart, one) < 0.03
    assert largest(apart, one) > 0


def test_many_rays_are_folded(monkeypatch):
    """Rays that are added in several kernels are all there, as many as in one."""
    loaded = load(SCENES["disk"]())
    whole = rendered(loaded, SPP)
    lower(monkeypatch, max_added=256)
    parts = rendered(loaded, SPP)
    for a, b in zip(parts, whole, strict=True):
        assert largest(a, b) < 1e-5


@pytest.mark.parametrize("added", [passes.MAX_ADDED, 256])
def test_lanes_that_share_a_ray_take_the_same_samples(monkeypatch, added):
    """Two lanes of a GPU share the samples of a ray. LLVM stands in for the GPU."""
    loaded = load(SCENES["disk"]())
    whole = rendered(loaded, SPP)
    lanes = []

    def noted(launch):
        def step(pixels, pixel, count, weight=1.0):
            if weight == 0:
                lanes.append((dr.width(pixel), count))
            return launch(pixels, pixel, count, weight)

        return step

    replace_launch(monkeypatch, noted)
    lower(monkeypatch, max_added=added)
    alone = rendered(loaded, SPP)
    few, lanes[:] = lanes[:], []
    monkeypatch.setattr(passes, "_shared_by", lambda rays, lanes, most: 2)
    shared = rendered(loaded, SPP)
    for a, b, c in zip(whole, alone, shared, strict=True):
        assert largest(b, a) < 1e-5
        assert largest(c, a) < 1e-5
    assert {width for width, _ in lanes} == {2 * width for width, _ in few}
    assert sum(width * count for width, count in lanes) == sum(w * count for w, count in few)


def test_how_many_lanes_share_a_ray(monkeypatch):
    assert passes._shared_by(2000, lanes=16, most=2048) == 1
    monkeypatch.setattr(mi, "variant", lambda: "cuda_ad_rgb")
    lower(monkeypatch, lanes={"cuda": 1 << 20})
    assert passes._shared_by(2000, lanes=16, most=2048) == 16
    assert passes._shared_by(2000, lanes=1024, most=2048) == 512
    assert passes._shared_by(2000, lanes=1024, most=100) == 64
    assert passes._shared_by(1 << 21, lanes=16, most=2048) == 1


@pytest.mark.statistical
@pytest.mark.parametrize(("rfilter", "border"), [("gaussian", True), ("tent", False)])
def test_few_samples_and_wide_filters(rfilter, border):
    """A lamp of even radiance in a corner of the film, which no weights of others make brighter.

    False alarms: 1e-6 each.
    """
    corner = {"lamp": plane(translate(-0.5, 0.5, -2), size=0.25, emitter=area_light(2.0))}
    more = {"rfilter": {"type": rfilter}, "sample_border": border}
    described = with_integrator(with_film(view(corner, 16), **more), temporal_filter="box")
    assert found_apart(described) is not None
    loaded = load(described)

    def estimate(seed: int) -> np.ndarray:
        steady, transient = rendered(loaded, 1, seed)
        return np.array([each.mean() for each in (steady[:2, :2], transient.sum(axis=2)[:2, :2])])

    found = over_seeds(estimate, range(200)) / 2
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert (np.abs(found.mean(axis=0) - 1) < 5 * error).all()
    assert (error < 0.01).all()


def beside_the_camera() -> dict:
    tall = plane(translate(0, 0.5, 0) @ rotate((1, 0, 0), 90), size=3, emitter=area_light(1.0))
    return view({"lamp": tall})


LAMP = {"lamp": lamp()}
NOT_APART = {
    "fills": view({"lamp": lamp(5.0)}),
    "hidden": with_integrator(view(LAMP), hide_emitters=True),
    "discarded": with_integrator(view(LAMP), discard_direct_light=True),
    "sky": view({"sky": SKY}),
    "behind": view({"lamp": lamp(z=3.0), "sky": SKY}),
    "beside": beside_the_camera(),
    "both ends": with_integrator(view(LAMP), type="transient_bdpt"),
    "orthographic": view(LAMP, type="orthographic"),
}
del NOT_APART["orthographic"]["sensor"]["fov"]


@pytest.mark.parametrize("name", NOT_APART)
def test_paths_find_what_is_not_apart(name):
    assert found_apart(NOT_APART[name]) is None


def test_steady_pictures_are_left_as_they_are(monkeypatch):
    """A picture of all light has nothing to gain."""
    described = view({"lamp": lamp()})
    described["sensor"]["film"] = {"type": "hdrfilm", "width": 12, "height": 12}
    loaded = load(described | {"integrator": {"type": "path_tracer_mis", "max_depth": 2}})
    whole = np.array(mi.render(loaded, spp=4))
    all_in_one(monkeypatch)
    assert largest(np.array(mi.render(loaded, spp=4)), whole) < 1e-6


@pytest.mark.parametrize("thin", [False, True])
def test_the_box_of_a_lamp_holds_its_picture(thin):
    """Points of a box land within its bounds, which are not much larger."""
    described = view({"lamp": lamp()}, 64, **(THIN if thin else {}))
    lens = Lens(load(described).sensors()[0])
    low, high = np.array([-0.1, -0.2, -2.5]), np.array([0.2, 0.1, -1.5])
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(0, 1 << 16)
    corner = mi.Point3f(sampler.next_1d(), sampler.next_1d(), sampler.next_1d())
    points = mi.Point3f(low.tolist()) + corner * mi.Vector3f((high - low).tolist())
    arrival = lens.arrive(points, lens.sample(sampler))
    found = np.array(arrival.position)[:, np.array(arrival.seen)]
    first, last = lens.pixels_of(low, high)
    assert (first - 1e-3 <= found.T).all()
    assert (last + 1e-3 >= found.T).all()
    assert (last - first < (1.7 if thin else 1.15) * np.ptp(found, axis=1)).all()
    assert lens.pixels_of(low, np.array([0.2, 0.1, 0.5])) is None
    assert dr.width(found) > 0
