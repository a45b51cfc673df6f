"""`transient_volpath` in media and where surfaces let light straight through: it is `volpath`.

Connections of Mitsuba's `volpath` lose light where they pass a boundary shortly before a lamp or a
surface: the epsilons of its rays add up, and a part of the lamp hides behind itself. (A cube of fog
that is almost empty, 5 cm from the walls of the Cornell box, takes 1.3 % of the picture's light.)
In the scenes below, boundaries are far from all else.
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.fogs import BALL, FLOOR, LIT, SCENES as IN_MEDIA, SKY, THIN, looked_at, sphere
from helpers.parts import area_light, diffuse, plane, point_light, rotate, translate
from helpers.support import (
    agree,
    camera,
    camera_rays,
    film,
    load,
    over_seeds,
    rendered,
    scene,
    steady_twin,
)

import tofrender

SEEDS, OTHER_SEEDS = range(8), range(1000, 1008)
SPP = 1024

NULL = {"type": "null"}
PANE = {"type": "thindielectric", "int_ior": 1.9}
MASK = {"type": "mask", "opacity": 0.5, "of": {"type": "twosided", "all": diffuse(0.6)}}
CLEAR = MASK | {"opacity": 0.0}
OVER_PANE = {"type": "mask", "opacity": 0.3, "of": PANE}
BLEND = {"type": "blendbsdf", "weight": 0.4, "a": NULL, "b": diffuse(0.5)}
POLARIZER = {"type": "polarizer"}

POINT = {"floor": FLOOR, "lamp": point_light((0.5, 0.5, 1.5), 5.0)}
GLOW = {"glow": sphere(0.3, emitter=area_light(3.0))}


def ball(material: dict, radius: float = 0.8) -> dict:
    return {"ball": sphere(radius, bsdf=material)}


def sheet(material: dict, size: float = 1.5, z: float = 0.5) -> dict:
    return {"sheet": plane(translate(0, 0, z), size, bsdf=material)}


def seen(description: dict, seeds=SEEDS, spp: int = SPP, by: Any = None) -> np.ndarray:
    """Means of the picture's channels for each seed."""
    loaded = load(description)

    def one(seed: int) -> np.ndarray:
        if by is None:
            return rendered(loaded, spp, seed)[0].mean((0, 1))
        return np.array(mi.render(loaded, integrator=by, spp=spp, seed=seed), float).mean((0, 1))

    return over_seeds(one, seeds)


ONE_SAMPLE = {"type": "path_tracer_mis", "technique": "one_sample"}
SCENES: dict[str, tuple[dict, dict]] = {
    "point behind a pane": (POINT | sheet(PANE, 30.0, 1.0), {}),
    "point behind null": (POINT | ball(NULL), {}),
    "point behind a mask": (POINT | sheet(MASK), {}),
    "point behind a masked pane": (POINT | sheet(OVER_PANE), {}),
    "point behind a blend": (POINT | sheet(BLEND), {}),
    "lamp above a mask": (LIT | sheet(MASK, 1.0), {}),
    "lamp in a mask": (LIT | GLOW | ball(MASK), {}),
    "sky and a mask": ({"floor": FLOOR, "sky": SKY} | ball(MASK), {}),
    "mask around fog": (LIT | BALL | {"mask": sphere(1.2, bsdf=MASK)}, {}),
    "pane in fog": (LIT | sheet(PANE, 30.0) | {"around": THIN}, {}),
    "one segment": (LIT | GLOW | ball(PANE), {"max_depth": 1}),
    "two segments": (LIT | GLOW | ball(PANE), {"max_depth": 2}),
    "three segments": (LIT | ball(MASK), {"max_depth": 3}),
    "lamps by hits": (LIT | GLOW | ball(MASK), {"emitter_sampling": False}),
    **{name: (parts, {}) for name, parts in IN_MEDIA.items()},
    "one sample": (IN_MEDIA["cloud under a sky"], ONE_SAMPLE),
}


@pytest.mark.statistical
@pytest.mark.parametrize("name", SCENES)
def test_energy_is_that_of_volpath(name):
    """Of each channel."""
    parts, more = SCENES[name]
    description = looked_at(parts, **more)
    depth = description["integrator"]["max_depth"]
    volpath = mi.load_dict({"type": "volpath", "max_depth": depth, "rr_depth": 20})
    expected = seen(steady_twin(description), OTHER_SEEDS, by=volpath)
    assert agree(seen(description), expected, rounding=2e-4)


@pytest.mark.statistical
def test_shares_with_hits_are_those_of_the_last_turn():
    """What lets all through changes nothing, unless its own connections had a share.

    Lamps behind it are hidden as without it.
    """
    hidden = LIT | GLOW, LIT | GLOW | ball(CLEAR)
    bare, behind = (
        seen(looked_at(parts, hide_emitters=True), seeds)
        for parts, seeds in zip(hidden, (SEEDS, OTHER_SEEDS), strict=True)
    )
    assert agree(behind, bare, rounding=2e-3)
    bare = seen(looked_at(LIT), OTHER_SEEDS)
    before_lamp = looked_at(LIT | sheet(CLEAR, 3.0, 2.5))
    assert agree(seen(before_lamp), bare, rounding=2e-3)


def facing_a_sky(material: dict, tilt: float, **integrator: Any) -> dict:
    """A sheet of a material that fills the view, and a sky that is hidden from the camera."""
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": [0.5, 1.0, 2.0]}}
    sheet = plane(translate(0.1, 0.2, -1) @ rotate((1, 0, 0), tilt), 5.0, bsdf=material)
    view = camera((0.1, 0.2, 2), (0.1, 0.2, 0), film(3, 2, 20, 0.0, 2.0), fov=0.1)
    return scene({"sky": sky, "sheet": sheet}, view, hide_emitters=True, **integrator)


def reflected_by_pane(tilt: float, index: float = 1.9) -> float:
    """Reflectance 2 r / (1 + r) of a pane, with Fresnel's reflectance r of unpolarized light."""
    cos = np.cos(np.radians(tilt))
    bent = np.sqrt(1 - (1 - cos**2) / index**2)
    r = ((cos - index * bent) / (cos + index * bent)) ** 2 / 2
    r += ((index * cos - bent) / (index * cos + bent)) ** 2 / 2
    return 2 * r / (1 + r)


TILT = 35.0
SHOWN: dict[str, tuple[dict, float]] = {
    "null": (NULL, 0.0),
    "pane": (PANE, reflected_by_pane(TILT)),
    "mask": (MASK, 0.5 * 0.6),
    "masked pane": (OVER_PANE, 0.3 * reflected_by_pane(TILT)),
    "blend": (BLEND, 0.4 * 0.5),
    "polarizer": (POLARIZER, 0.0),
}
"""Share of the sky's radiance that a surface reflects to the camera; the rest is hidden."""

HIDERS: dict[str, dict[str, Any]] = {
    "path": {"type": "transient_path", "max_depth": 4},
    "volpath": {"type": "transient_volpath", "max_depth": 4},
    "hits": {"type": "transient_path", "max_depth": 4, "emitter_sampling": False},
    "bdpt": {"type": "transient_bdpt", "max_depth": 4},
    "one sample": ONE_SAMPLE | {"max_depth": 4},
}


@pytest.mark.statistical
@pytest.mark.parametrize("technique", HIDERS)
@pytest.mark.parametrize("name", SHOWN)
def test_a_hidden_sky_is_hidden_behind_what_lets_it_through(name, technique):
    """Only the sky that surfaces reflect is shown."""
    material, share = SHOWN[name]
    described = facing_a_sky(material, TILT, **HIDERS[technique])
    if share == 0:
        assert rendered(described, 16)[0].max() == 0
        return
    found = seen(described, spp=512)
    expected = np.broadcast_to(share * np.array([0.5, 1.0, 2.0]), found.shape)
    assert agree(found, expected, rounding=1e-3)


@pytest.mark.parametrize("name", SHOWN)
def test_rays_to_a_hidden_sky_are_not_valid(name):
    """As in Mitsuba, surfaces that a ray only passes do not count."""
    material, share = SHOWN[name]
    loaded = load(facing_a_sky(material, TILT, type="transient_path", max_depth=4))
    camera = camera_rays(loaded, 256)
    sampler = mi.load_dict({"type": "independent", "sample_count": 256})
    sampler.seed(0, 256)
    _, valid, _ = loaded.integrator().sample(loaded, sampler, camera.ray)
    fraction = float(dr.mean(dr.select(valid, 1.0, 0.0))[0])
    assert fraction == 0 if share == 0 else 0 < fraction < 1


HEIGHT, ASIDE, INTENSITY, ALBEDO = 1.5, 0.7, 5.0, 0.6


def below(material: dict | None, kind: str = "transient_volpath", **more: Any) -> dict:
    """A camera between floor and sheet, a lamp above: 1 + sqrt(1.5² + .7²) m in bins of .01 m."""
    lamp = point_light((ASIDE, 0, HEIGHT), INTENSITY)
    parts = {"floor": plane(bsdf=diffuse(ALBEDO)) | {"id": "floor"}, "lamp": lamp}
    if material is not None:
        parts["sheet"] = plane(translate(0, 0, 1.2), bsdf=material) | {"id": "sheet"}
    view = camera((0, -0.6, 0.8), (0, 0, 0), film(1, 1, 400, 0.0, 0.01), up=(0, 0, 1), fov=0.01)
    return scene(parts, view) | {"integrator": {"type": kind, "max_depth": 2} | more}


def through_pane(index: float = 1.9) -> float:
    """1 - 2 r / (1 + r), with Fresnel's reflectance r of unpolarized light."""
    cos = HEIGHT / np.hypot(HEIGHT, ASIDE)
    bent = np.sqrt(1 - (1 - cos**2) / index**2)
    across = (cos - index * bent) / (cos + index * bent)
    along = (index * cos - bent) / (index * cos + bent)
    r = (across**2 + along**2) / 2
    return 1 - 2 * r / (1 + r)


LETS_THROUGH: dict[str, tuple[dict | None, float]] = {
    "nothing": (None, 1.0),
    "null": (NULL, 1.0),
    "pane": (PANE, through_pane()),
    "mask": (MASK, 0.5),
    "masked pane": (OVER_PANE, 1 - 0.3 * (1 - through_pane())),
    "blend": (BLEND, 0.6),
    "polarizer": (POLARIZER, 0.5),
}


def lit(share: float) -> float:
    r = np.hypot(HEIGHT, ASIDE)
    return share * ALBEDO / np.pi * INTENSITY * HEIGHT / r**3


@pytest.mark.parametrize("name", LETS_THROUGH)
def test_a_point_lamp_behind(name):
    """Dimmer by what is let through, as late as without; `path`'s rules leave it dark."""
    material, share = LETS_THROUGH[name]
    steady, transient = rendered(below(material), 16)
    np.testing.assert_allclose(steady, lit(share), rtol=1e-3)
    length = 1 + np.hypot(HEIGHT, ASIDE)
    assert int(np.argmax(transient.sum(axis=(0, 1, 3)))) == int(length / 0.01)
    np.testing.assert_allclose(transient.sum(axis=2), steady, rtol=1e-5)
    if material is not None:
        assert rendered(below(material, "transient_path"), 16)[0].max() == 0


def test_scenes_without_such_surfaces_are_as_by_transient_path():
    described = tofrender.cornell_box(width=8, height=8)
    pictures = (
        rendered(described | {"integrator": {"type": kind, "max_depth": 6}}, 4)[1]
        for kind in ("transient_path", "transient_volpath")
    )
    np.testing.assert_array_equal(*pictures)


def test_polarized_light_is_that_of_volpath():
    """Through a polarizer and a quarter-wave plate, off metal."""
    mi.set_variant("llvm_ad_mono_polarized")

    def value(x: float) -> dict:
        return {"type": "uniform", "value": x}

    metal = {"type": "roughconductor", "alpha": 0.4, "eta": value(0.2), "k": value(3.9)}
    plates = {"type": "polarizer", "theta": value(30)}, {"type": "retarder", "theta": value(20)}
    lamp = {"type": "point", "position": [0.5, -0.5, 2.5], "intensity": value(5)}
    parts = {"floor": plane(bsdf=metal), "lamp": lamp}
    for k, plate in enumerate(plates):
        to_world = translate(0, 0, 2 - 0.5 * k) @ rotate((1, 0, 0), 10 * k)
        parts[f"plate {k}"] = plane(to_world, bsdf=plate)
    view = camera((-0.5, -1.5, 1), (0, 0, 0), film(1, 1, 20, 0.0, 2.0), up=(0, 0, 1), fov=0.01)
    ours = scene(parts, view) | {"integrator": {"type": "transient_volpath", "max_depth": 2}}
    volpath = {"type": "stokes", "of": {"type": "volpath", "max_depth": 2}}
    found = tofrender.render(ours, spp=16, progress=False)["transient"].values.sum(axis=2)
    expected = mi.render(load(steady_twin(ours)), integrator=mi.load_dict(volpath), spp=16)
    wanted = np.array(expected).ravel()[-12::3]  # The last layers are S0 to S3, in R, G and B
    assert np.abs(wanted[1:]).max() > 0.1 * wanted[0]
    np.testing.assert_allclose(found.reshape(4, -1)[:, 0], wanted, rtol=2e-3, atol=1e-5)


def changing(material: dict | None, end: str) -> tuple[mi.Scene, Any, str]:
    loaded = load(below(material, pulse_width_opl=0.1))
    params = mi.traverse(loaded)
    name = next(key for key in params.keys() if key.endswith(end))  # noqa: SIM118
    dr.enable_grad(params[name])
    params.update()
    return loaded, params, name


@pytest.mark.parametrize("name", ["pane", "mask", "null"])
def test_derivative_by_the_albedo_behind(name):
    material, share = LETS_THROUGH[name]
    wanted = lit(share) / ALBEDO
    loaded, params, key = changing(material, "floor.bsdf.reflectance.value")
    steady, _ = mi.render(loaded, params=params, spp=16)
    dr.backward(dr.mean(steady, axis=None))
    np.testing.assert_allclose(float(dr.sum(dr.grad(params[key]))[0]), wanted, rtol=1e-3)


@pytest.mark.parametrize(
    ("material", "end", "message"),
    [
        (MASK, "sheet.bsdf.opacity.value", "derivatives of null transmission"),
        (MASK, "floor.to_world", "in scenes with null transmission"),
        (NULL, "floor.to_world", "in scenes with null transmission"),
    ],
)
def test_derivatives_that_are_not_known_are_refused(material, end, message):
    loaded, params, _ = changing(material, end)
    with pytest.raises(RuntimeError) as caught:
        mi.render(loaded, params=params, spp=16)
    assert message in str(caught.value.__cause__)
