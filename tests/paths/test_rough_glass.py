"""Connections through rough glass that something holds: masks, blends, maps, instances.

The way behind a rough face counts with the index of that side, whatever the face is nested in.
"""

import re

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, diffuse, gray, plane, point_light, translate
from helpers.scenes import refusal
from helpers.support import (
    agree,
    camera,
    film,
    load,
    over_seeds,
    path_image,
    rendered,
    scene,
    with_integrator,
)

import tofrender

INDEX = 1.5
FINE = {"bins": 3000, "bin_width": 1e-3}


def glass(alpha: float = 0.35, index: float = INDEX, **more) -> dict:
    ior = {"int_ior": index, "ext_ior": 1.0}
    return {"type": "roughdielectric", "distribution": "ggx", "alpha": alpha, **ior, **more}


def mask(inner: dict, opacity: float) -> dict:
    return {"type": "mask", "opacity": opacity, "nested": inner}


def blend(one: dict, other: dict, weight: float, **more) -> dict:
    return {"type": "blendbsdf", "weight": weight, "one": one, "other": other, **more}


def principled(spec_trans: float, **more) -> dict:
    return {"type": "principled", "roughness": 0.6, "eta": INDEX, "spec_trans": spec_trans, **more}


def bumps(inner: dict) -> dict:
    texture = {"type": "uniform", "value": 0.5}
    return {"type": "bumpmap", "scale": 1e-3, "texture": texture, "nested": inner}


def normals(inner: dict) -> dict:
    flat = np.tile(np.array([0.5, 0.5, 1.0], np.float32), (2, 2, 1))
    texture = {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(flat)}
    return {"type": "normalmap", "normalmap": texture, "nested": inner}


def face(bsdf: dict) -> dict:
    """The plane z = 0."""
    return {"face": plane(bsdf=bsdf)}


def instance(bsdf: dict) -> dict:
    """The same plane, as an instance of a group."""
    return {
        "group": {"type": "shapegroup", "inner": plane(bsdf=bsdf)},
        "face": {"type": "instance", "shapes": {"type": "ref", "id": "group"}},
    }


CASES = {
    "plain": face(glass()),
    "principled": face(principled(0.9)),
    "mask": face(mask(glass(), 0.5)),
    "mask, nearly clear": face(mask(glass(), 0.02)),
    "blend": face(blend(glass(), diffuse(0.5), 0.5)),
    "blend, little glass": face(blend(diffuse(0.5), glass(), 0.05)),
    "blend of one index": face(blend(glass(0.2), glass(0.5), 0.3)),
    "mask in blend": face(blend(mask(glass(), 0.3), diffuse(0.5), 0.7)),
    "metallic": face(principled(0.4, metallic=0.4, base_color=gray(0.6))),
    "clearcoat": face(principled(0.1, clearcoat=0.8, base_color=gray(0.6))),
    "mask in bump map": face(bumps(mask(glass(), 0.5))),
    "blend in normal map": face(normals(blend(glass(), diffuse(0.5), 0.6))),
    "instance": instance(glass()),
    "instance of a mixture": instance(principled(0.4, base_color=gray(0.6))),
}
"""Faces of which most look like no glass from outside."""


def bent(side: float, angle: float = 30.0) -> tuple[np.ndarray, np.ndarray]:
    """An eye at an angle at a distance of 1, and a lamp at .8, near the refracted ray.

    From within the glass, 50 and 70 degrees are beyond the angle of total reflection; the lamp
    then stands where microfacets still send light.
    """
    a = np.radians(angle)
    b = 0.9 * np.arcsin(min(0.98, np.sin(a) * INDEX**-side))
    eye = np.array([np.sin(a), 0, side * np.cos(a)])
    return eye, 0.8 * np.array([-np.sin(b), 0.05, -side * np.cos(b)])


def length_to(lamp, parts: dict, eye) -> float:
    """Mean optical path length of a connection to a point light."""
    sensor = camera(eye, (0, 0, 0), film(**FINE), fov=0.01)
    lit = scene(parts | {"lamp": point_light(lamp, 1.0)}, sensor, max_depth=2)
    transient = rendered(lit, spp=4)[1][0, 0, :, 1]
    assert transient.sum() > 0
    return float(transient @ (np.arange(FINE["bins"]) + 0.5) * FINE["bin_width"] / transient.sum())


@pytest.mark.parametrize(
    ("name", "angle"),
    [
        *((name, 30.0) for name in CASES),
        *((name, a) for name in ("plain", "principled") for a in (0.0, 50.0, 70.0)),
    ],
)
def test_a_connection_has_the_length_of_its_side(name, angle):
    """One connection to a point light: |eye| + n |lamp|, from within the glass n |eye| + |lamp|.

    Where the light is taken for air's, the first is .4 m short and the second .4 m long.
    """
    for side, ahead, behind in ((1.0, 1.0, INDEX), (-1.0, INDEX, 1.0)):
        eye, lamp = bent(side, angle)
        expected = ahead + behind * np.linalg.norm(lamp)
        assert length_to(lamp, CASES[name], eye) == pytest.approx(expected, abs=1e-3), side


def test_reflection_and_thin_sheets_do_not_slow_light_down():
    """`principledthin` has an index for its reflection, and no inside."""
    sheet = {"type": "principledthin", "roughness": 0.5, "spec_trans": 0.8, "eta": INDEX}
    eye, lamp = bent(1.0)
    expected = 1 + np.linalg.norm(lamp)
    assert length_to(lamp, face(sheet), eye) == pytest.approx(expected, abs=1e-3)
    assert length_to(-eye * [1, 1, -1], face(glass()), eye) == pytest.approx(2, abs=1e-3)


def through(parts: dict, side: float = 1.0) -> dict:
    """An eye at 2.06 m from a rough face, a lamp of 2 m x 2 m at 1 m behind it.

    On the other side, the eye is within the glass and the lamp is outside.
    """
    window = film(bins=12, start=3.0, bin_width=0.1)
    turned = mi.ScalarTransform4f().rotate([0, 1, 0], 0 if side > 0 else 180)
    lamp = plane(turned @ translate(0.2, 0, -1), size=1.0, emitter=area_light(1.0))
    eye = camera((0.5 * side, 0, 2 * side), (0, 0, 0), window, fov=0.01)
    return scene(parts | {"lamp": lamp}, eye, max_depth=3)


@pytest.mark.statistical
@pytest.mark.parametrize("name", ["plain", "principled", "mask", "blend", "instance"])
def test_connected_or_hit_it_arrives_at_the_same_time(name):
    """Paths that run into the lamp count with the index of the direction that was sampled."""
    blended = face(blend(glass(), diffuse(0.3), 0.6))
    described = through(blended if name == "blend" else CASES[name])

    def arrivals(sampling: bool, spp: int):
        loaded = load(with_integrator(described, emitter_sampling=sampling))
        return lambda seed: rendered(loaded, spp, seed)[1][0, 0, :, 1]

    connected = over_seeds(arrivals(True, 2048), range(16))
    hit = over_seeds(arrivals(False, 8192), range(1000, 1016))
    there = hit.mean(axis=0) > 0.01 * hit.mean(axis=0).sum()
    assert there.sum() >= 4
    assert agree(connected[:, there], hit[:, there])
    assert not agree(np.roll(connected, 1, axis=1)[:, there], hit[:, there])


@pytest.mark.parametrize("wrap", [face, instance])
@pytest.mark.parametrize("integrator", ["transient_path", "time_gated_transient_path"])
def test_two_indices_in_one_blend_are_refused(wrap, integrator):
    """A connection through both has no single length."""
    two = blend(glass(), glass(index=1.2), 0.5, id="two_glasses")
    parts = wrap(two) | {"lamp": point_light((0, 0, -1), 1.0)}
    loaded = load(scene(parts, camera((0, 0, 1), (0, 0, 0), film())))
    tracer = mi.load_dict({"type": integrator}, parallel=False)
    call, *options = (tracer.render, loaded)
    if integrator != "transient_path":
        call, *options = tofrender.render_at_time, loaded, tracer, loaded.sensors()[0], 2.0
    said = refusal(call, *options, spp=1)
    assert re.search(r"two_glasses.*1\.2.*1\.5", said)


SPACING = 0.03


def gates(loaded: mi.Scene, times, spp: int, seed: int) -> np.ndarray:
    """One picture for each gate, a single pixel's green [1/m]."""
    gate = {"type": "time_gated_transient_path", "pulse_width_opl": SPACING, "max_depth": 3}
    sensor, tracer = loaded.sensors()[0], mi.load_dict(gate, parallel=False)
    images = (tofrender.render_at_time(loaded, tracer, sensor, t, spp, seed) for t in times)
    return np.array([image[0, 0, 1] for image in images], dtype=float)


def test_an_instance_is_its_shape_to_a_gate():
    """The same paths and weights, gate by gate."""
    times = (3.5, 3.7, 4.0)
    plain, other = (
        gates(load(through(wrap(glass()))), times, 1024, 0) for wrap in (face, instance)
    )
    assert (plain > 0).all()
    assert other == pytest.approx(plain, rel=1e-3)


@pytest.mark.statistical
def test_gates_sum_to_the_steady_picture():
    """From within an instance of glass: no gate ends the paths that would reach it."""
    described = through(instance(glass()), side=-1.0)
    steady = np.array(path_image(described, spp=1 << 16)[0, 0, 1])
    times = np.arange(3.9, 5.25, SPACING)
    loaded = load(described)
    samples = over_seeds(lambda seed: SPACING * gates(loaded, times, 256, seed).sum(), range(8))
    assert agree(samples, steady, rounding=5e-3)
    assert not agree(0.9 * samples, steady, rounding=5e-3)


@pytest.mark.parametrize("wrap", [face, instance])
def test_a_gate_does_not_close_before_light_from_glass(wrap):
    """From within glass, whose index the camera's own segment counts with, the way on is shorter.

    At its length a path sees the peak of the pulse, 1 / (sqrt(2 pi) s).
    """
    flint = {"type": "dielectric", "int_ior": INDEX, "ext_ior": 1.0}
    lamp = plane(mi.ScalarTransform4f().look_at([0, 0, 1], [0, 0, 0], [0, 1, 0]), size=1.0)
    parts = wrap(flint) | {"lamp": lamp | {"emitter": area_light(1.0)}}
    described = scene(parts, camera((0, 0, -1), (0, 0, 0), film(), fov=0.01), max_depth=3)
    loaded = load(described)
    reflected = ((INDEX - 1) / (INDEX + 1)) ** 2
    steady = (1 - reflected) * INDEX**2
    found = gates(loaded, [INDEX + 1], 1 << 14, 0)
    expected = steady / (np.sqrt(2 * np.pi) * SPACING)
    assert found == pytest.approx([expected], rel=0.02)
