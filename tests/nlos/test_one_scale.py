"""Light of one bounce and of three bounces in a capture comes from the same laser power.

A lit spot that receives the power Φ reflects the radiance ρ / π E over its footprint. The integral
of E over the footprint is Φ. The spot lights the hidden scene like a point of this power. By
default, Φ is the irradiance on the beam's axis times one square meter. The footprint need not have
this area: light of a single bounce is the light of a beam of the power Φ, too.
"""

import math

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import diffuse, gray, plane, rotate, translate
from helpers.support import film
from oracles.nlos import Grid, Rectangle, Setup, load_nlos, single, total

import tofrender

WALL, HIDDEN = 0.8, 0.7
DEVICE, LASER, LIT = (-0.6, 0.3, 1.2), (-0.3, -0.4, 1.0), (0.1, 0.2, 0.0)
PATCH = Rectangle.turned((0.35, 0.3, 1.1), 30, 240, half=(0.3, 0.3))
SIZE = 64


def looking(kind: str, place, target, **options) -> dict:
    to_world = mi.ScalarTransform4f().look_at(list(place), list(target), [0, 1, 0])
    return {"type": kind, "to_world": to_world} | options


def bounces(data) -> tuple[np.ndarray, np.ndarray]:
    """Return light of one bounce, at length 0, and of more bounces, over a meter later."""
    values = data["transient"].values[..., 1].astype(float)
    early = np.abs(data["opl"].values) < 0.5
    return values[..., early].sum(axis=-1), values[..., ~early].sum(axis=-1)


@pytest.mark.parametrize(("watts", "intensity"), [(None, 0.3), (None, 30.0), (2.5, 30.0)])
def test_single_capture(watts, intensity):
    """The power in the image of the lit footprint equals the power that lights the hidden patch.

    The radiance of the footprint, summed over the 64 x 64 cells of the wall, is ρ / π Φ.
    """
    options = {} if watts is None else {"laser_power": watts}
    window = film(SIZE, SIZE, bins=40, start=-0.05, bin_width=0.1)
    setup = Setup(sensor=DEVICE, laser=LASER, legs=False)
    described = single(setup, {"hidden": PATCH.shape()}, LIT, window, **options)
    described["integrator"].pop("filter_bounces")
    beam = {"intensity": gray(intensity), "cutoff_angle": 12.0, "beam_width": 6.0}
    described["laser"] = looking("spot", LASER, LIT, **beam)
    data = tofrender.capture(load_nlos(described), mode="single", spp=32, progress=False)
    one, three = bounces(data)

    cell = (2 / SIZE) ** 2
    shown = math.pi / WALL * one.sum() * cell
    nodes, every = PATCH.nodes(10, 10), 4
    seen = Grid(SIZE, SIZE).points()[::every, ::every].reshape(-1, 3)
    per_watt = sum(total(setup, nodes, HIDDEN, LIT, point) for point in seen)
    lighting = three[::every, ::every].sum() / per_watt

    away = np.subtract(LASER, LIT)
    by_default = intensity * away[2] / np.linalg.norm(away) ** 3  # on one square meter
    assert lighting == pytest.approx(by_default if watts is None else watts, rel=0.03)
    assert shown == pytest.approx(lighting, rel=0.03)


@pytest.mark.parametrize(("watts", "fov"), [(None, 0.2), (None, 3.0), (2.5, 0.2)])
def test_confocal_capture(watts, fov):
    """A beam of α x α lights A = 4 tan²(α / 2) d² / cos. For a plane at D, with form f2,

    L1 / L3 = (ρ_w / π Φ / A) / (Φ ρ_w² ρ_h / (3 π² D²)) = 3 π D² / (ρ_w ρ_h A).
    """
    options = {} if watts is None else {"laser_power": watts}
    place, depth = (-0.3, -0.4, 0.4), 0.5
    setup = Setup(sensor=place, laser=place, legs=False)
    window = film(3, 2, bins=40, start=-0.05, bin_width=0.1)
    back = translate(0, 0, depth) @ rotate((1, 0, 0), 180)
    hidden = {"hidden": plane(back, size=3.0, bsdf=diffuse(HIDDEN))}
    described = single(setup, hidden, LIT, window, max_depth=3, **options)
    described["integrator"].pop("filter_bounces")
    described["laser"] = looking("projector", place, (0, 0, 0), irradiance=gray(100.0), fov=fov)
    data = tofrender.capture(load_nlos(described), mode="confocal", spp=4096, progress=False)
    one, three = bounces(data)

    away = np.asarray(place) - Grid(3, 2).points()
    d = np.linalg.norm(away, axis=-1)
    footprint = 4 * math.tan(math.radians(fov) / 2) ** 2 * d**3 / away[..., 2]
    expected = 3 * math.pi * depth**2 / (WALL * HIDDEN * footprint)
    assert one / three == pytest.approx(expected, rel=0.03)
    if watts is not None:
        light = watts * WALL**2 * HIDDEN / (3 * math.pi**2 * depth**2)
        assert three == pytest.approx(np.full((2, 3), light), rel=0.03)
