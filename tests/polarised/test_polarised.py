"""Polarised light against Fresnel's equations, and against Mitsuba's `stokes` integrator."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from tofrender.films.sums import Radiance, Weighted
from tofrender.paths.camera import sample_camera

MONO, SPECTRAL = "llvm_ad_mono_polarized", "llvm_ad_spectral_polarized"
N = 1.5
BREWSTER = np.degrees(np.arctan(N))
GLASS = {"type": "dielectric", "int_ior": N, "ext_ior": 1.0}
INSIDE = {"type": "dielectric", "int_ior": 1.0, "ext_ior": N}


@pytest.fixture(autouse=True)
def _polarised(_variant):
    mi.set_variant(MONO)


# ----------------------------------------------------------------------------------- a bench


def unit(v) -> np.ndarray:
    return np.asarray(v, float) / np.linalg.norm(v)


def turned(v: np.ndarray, axis: np.ndarray, degrees: float) -> np.ndarray:
    """A vector, turned around an axis."""
    a = np.radians(degrees)
    across, along = np.cross(axis, v), axis * (axis @ v) * (1 - np.cos(a))
    return v * np.cos(a) + across * np.sin(a) + along


def facing(p, d, up, size: float, **more) -> dict:
    """A square at a point that looks along a direction."""
    look = mi.ScalarTransform4f().look_at(list(p), list(np.add(p, d)), list(up))
    return {"type": "rectangle", "to_world": look @ mi.ScalarTransform4f().scale(size), **more}


def bench(
    *mirrors: tuple[float, float],
    bsdf: dict = GLASS,
    polariser: float | None = None,
    roll: float = 0.0,
    **integrator,
) -> mi.Scene:
    """A lamp of radiance 1, mirrors after each other, and a camera that looks into the last.

    Each mirror has an angle of incidence and a twist around the ray that arrives, both in degrees.
    Light that is polarised across the last plane of incidence oscillates along the camera's `up`
    if there is no `roll`. The polariser before the lamp has an angle to the first mirror's plane.
    """
    p, d, s = np.zeros(3), np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])
    light = {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}
    scene = {"type": "scene", "lamp": facing(p, d, s, 0.3, emitter=light)}
    if polariser is not None:
        plate = {"type": "polarizer", "theta": {"type": "uniform", "value": polariser}}
        scene["polariser"] = facing(p + 0.1 * d, d, s, 0.4, bsdf=plate)
    for k, (incidence, twist) in enumerate(mirrors):
        p = p + d
        s = turned(s, d, twist)
        n = turned(-d, s, incidence)
        scene[f"mirror{k}"] = facing(p, n, s, 0.3, bsdf=bsdf)
        d = d - 2 * n * (n @ d)
    p = p + d
    up = turned(s, d, roll)
    look = mi.ScalarTransform4f().look_at(list(p), list(p - d), list(up))
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    scene["sensor"] = {"type": "perspective", "fov": 0.01, "to_world": look, "film": film}
    scene["integrator"] = {"type": "transient_path", "max_depth": 8, "rr_depth": 99, **integrator}
    return mi.load_dict(scene)


def traced(scene: mi.Scene, samples: int, measurement=None, seed: int = 0) -> np.ndarray:
    """The mean Stokes vector that the first sensor's rays bring, of the first channel."""
    sensor, sampler = scene.sensors()[0], mi.load_dict({"type": "independent"})
    sampler.seed(seed, samples)
    pixel = dr.zeros(mi.UInt32, samples)
    camera = sample_camera(sensor, sensor.film(), sampler, pixel)
    measured, _ = (
        scene.integrator()
        .plan(scene, sensor)
        .trace(
            sampler,
            camera.ray,
            camera.origin,
            measurement or Radiance.zero(),
            frame=camera.frame,
        )
    )
    dr.eval(measured.total)
    return np.array([np.array(each[0], float).mean() for each in measured.total])


# ------------------------------------------------------------------------------ closed forms


@pytest.mark.parametrize(
    ("incidence", "reflected", "degree"),
    [
        (45, 0.0502399, 0.8314794),
        (56.30993, 0.0739645, 1.0),
        (70, 0.1710425, 0.7515800),
    ],
)
def test_glass_polarises_what_it_reflects(incidence, reflected, degree):
    # p1. Across the plane of incidence, which is along the camera's up, and so negative
    S = traced(bench((incidence, 0)), 200_000)
    assert abs(S[0] / reflected - 1) < 0.02
    assert np.allclose(S[1:] / S[0], [-degree, 0, 0], atol=1e-4)


@pytest.mark.parametrize("roll", [0, 45, 90, -30])
def test_the_frame_turns_with_the_camera(roll):
    S = traced(bench((BREWSTER, 0), roll=roll), 2_000)
    a = np.radians(2 * roll)
    assert np.allclose(S[1:] / S[0], [-np.cos(a), np.sin(a), 0], atol=1e-4)


@pytest.mark.parametrize("twist", [0, 30, 90])
def test_two_mirrors_at_brewsters_angle(twist):
    # p3
    S = traced(bench((BREWSTER, 0), (BREWSTER, twist)), 200_000)
    both = ((N**2 - 1) / (N**2 + 1)) ** 4 * np.cos(np.radians(twist)) ** 2 / 2
    assert abs(S[0] - both) < 0.05 * both + 1e-7
    assert np.allclose(S[1:], [-S[0], 0, 0], atol=1e-7)


def test_matrices_stand_in_the_order_of_the_path():
    # In the other order, S0 would be right, S1 18 % less, and S2 0.57 of S0
    S = traced(bench((70, 0), (BREWSTER, 40)), 200_000)
    assert abs(S[0] / 0.0143022 - 1) < 0.05
    assert np.allclose(S[1:] / S[0], [-1, 0, 0], atol=1e-4)


def phase(incidence: float) -> float:
    """What total reflection turns one polarisation by against the other [rad]."""
    sine, cosine = np.sin(np.radians(incidence)), np.cos(np.radians(incidence))
    return 2 * np.arctan(cosine * np.sqrt(sine**2 - 1 / N**2) / sine**2)


def test_total_reflection_turns_phases():
    # p4
    assert abs(np.degrees(phase(45)) - 36.869898) < 1e-6
    S = traced(bench((45, 0), bsdf=INSIDE, polariser=45.0), 1_000)
    assert abs(S[0] - 0.5) < 1e-5
    assert np.allclose(np.abs(S[1:]) / S[0], [0, 0.8, 0.6], atol=1e-5)


@pytest.mark.parametrize("incidence", [50.229, 53.258])
@pytest.mark.parametrize("polariser", [45.0, -45.0])
def test_a_fresnel_rhomb_makes_light_circular(incidence, polariser):
    S = traced(bench((incidence, 0), (incidence, 0), bsdf=INSIDE, polariser=polariser), 1_000)
    assert np.allclose(np.abs(S[1:]) / S[0], [0, 0, 1], atol=1e-4)


def test_opposite_polarisers_turn_light_the_other_way():
    left, right = (
        traced(bench((50.229, 0), (50.229, 0), bsdf=INSIDE, polariser=each), 1_000)[3]
        for each in (45.0, -45.0)
    )
    assert left * right < 0


def slab(degrees: float, thickness: float = 0.3) -> mi.Scene:
    """A slab of glass across the z axis before a wide lamp, seen under an angle."""
    light = {"type": "area", "radiance": {"type": "uniform", "value": 1.0}}
    up, across = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    a = np.radians(degrees)
    o = 2 * np.array([np.sin(a), 0, np.cos(a)])
    look = mi.ScalarTransform4f().look_at(list(o), [0, 0, 0], list(up))
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    return mi.load_dict(
        {
            "type": "scene",
            "lamp": facing([0, 0, -1 - thickness], across, up, 50, emitter=light),
            "front": facing([0, 0, 0], across, up, 50, bsdf=GLASS),
            "back": facing([0, 0, -thickness], -across, up, 50, bsdf=GLASS),
            "sensor": {"type": "perspective", "fov": 0.01, "to_world": look, "film": film},
            "integrator": {"type": "transient_path", "max_depth": 12, "rr_depth": 99},
        }
    )


SLAB = (0.91161175, -0.0657889), (0.0026345074, 0.9244850), (1.5112234e-5, 0.9973043)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_what_goes_to_and_fro_in_a_slab(order):
    # p2. Unpolarised renderers have .91062428, .0019046309 and 3.98366e-6
    inside = np.cos(np.arcsin(np.sin(np.radians(40)) / N))
    first = 2 + 1 / np.cos(np.radians(40)) + N * 0.3 / inside
    opl = first + order * 2 * N * 0.3 / inside

    def near(length: mi.Float) -> mi.Float:
        return dr.select(dr.abs(length - opl) < 1e-3, mi.Float(1), 0)

    expected, degree = SLAB[order]
    S = traced(slab(40), (100_000, 1_000_000, 4_000_000)[order], Weighted.zero(near))
    assert abs(S[0] / expected - 1) < (0.01, 0.05, 0.4)[order]
    assert np.allclose(S[1:] / S[0], [-degree, 0, 0], atol=1e-3)


# ------------------------------------------------------------------------ against `stokes`


def metals(roll: float = 20.0, **film) -> dict:
    """Rough and smooth metals, glass and plastic in a room, seen by a camera that is rolled."""
    up = turned(np.array([0.0, 1.0, 0.0]), unit([0, -0.3, -1]), roll)
    look = mi.ScalarTransform4f().look_at([0, 0.9, 3], [0, 0, 0], list(up))

    def ball(x, y, z, radius, **bsdf):
        return {"type": "sphere", "center": [x, y, z], "radius": radius, "bsdf": bsdf}

    def conductor(**more):
        return {"eta": 0.2, "k": 3.9, "specular_reflectance": 0.9, **more}

    light = {"type": "area", "radiance": {"type": "uniform", "value": 5.0}}
    return {
        "type": "scene",
        "floor": facing(
            [0, -0.5, 0],
            [0, 1, 0],
            [0, 0, 1],
            3,
            bsdf={"type": "roughconductor", "alpha": 0.3, **conductor()},
        ),
        "back": facing([0, 0, -1.5], [0, 0, 1], [0, 1, 0], 3, bsdf={"type": "diffuse"}),
        "a": ball(-0.7, 0, 0, 0.5, type="roughconductor", alpha=0.15, **conductor()),
        "b": ball(0.5, 0, 0.2, 0.45, type="pplastic", alpha=0.1),
        "c": ball(0.1, -0.25, 0.9, 0.2, type="dielectric"),
        "lamp": facing([1, 1.6, 1], [-0.5, -1, -0.6], [0, 0, 1], 0.5, emitter=light),
        "sky": {"type": "constant", "radiance": {"type": "uniform", "value": 0.2}},
        "sensor": {
            "type": "perspective",
            "fov": 45,
            "to_world": look,
            "film": {"type": "hdrfilm", "width": 24, "height": 16, "rfilter": {"type": "box"}}
            | film,
        },
    }


def mitsubas(scene: dict, spp: int, seed: int, **path) -> np.ndarray:
    """Mitsuba's Stokes vectors, (height, width, 4, 3)."""
    inner = {"type": "path", "max_depth": 6, **path}
    reference = mi.load_dict(scene | {"integrator": {"type": "stokes", "nested": inner}})
    image = np.array(mi.render(reference, spp=spp, seed=seed))
    return image[:, :, -12:].reshape(*image.shape[:2], 4, 3)
