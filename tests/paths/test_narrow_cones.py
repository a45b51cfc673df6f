"""Sphere lights that fill narrow cones, where 1 - cos cancels in single precision."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import area_light, diffuse, plane, point_light, rotate
from helpers.support import agree, camera, film, load, over_seeds, rendered, scene, uniform

from tofrender.paths.surfaces import EmitterSamples

DIRECTION = np.array([0.3, 0.2, np.sqrt(1 - 0.13)])
DISTANCES = [5, 36, 39, 300, 1500, 2000, 1e4, 1e5]
"""Distances over radii, on both sides of the angle from which Mitsuba samples otherwise."""


def solid_angle(distance: float) -> float:
    """Solid angle of a sphere of radius 1 [sr]."""
    return 2 * np.pi / distance**2 / (1 + np.sqrt(1 - 1 / distance**2))


@pytest.mark.parametrize("others", [0, 2])
@pytest.mark.parametrize("distance", DISTANCES)
def test_densities(distance, others):
    """Each sample has the density 1 / solid angle, times the probability of the emitter."""
    sphere = {"type": "sphere", "radius": 1.0, "emitter": area_light(3.0)}
    sphere["center"] = (DIRECTION * distance).tolist()
    more = {f"lamp {k}": point_light((0, 0, -1 - k), 1.0) for k in range(others)}
    more["floor"] = plane(size=distance)  # The scene extends from the point to the sphere
    loaded = mi.load_dict({"type": "scene", **more, "sphere": sphere})
    samples = EmitterSamples(loaded)
    at = dr.zeros(mi.SurfaceInteraction3f, 1000)
    ds, weight = samples.sample_direction(at, uniform(1000))
    on_sphere = np.array(ds.emitter.get_shape().is_emitter())
    assert on_sphere.sum() > 200
    expected = 1 / solid_angle(distance) / (1 + others)
    for pdf in (ds.pdf, samples.pdf_direction(at, ds)):
        np.testing.assert_allclose(np.array(pdf)[on_sphere], expected, rtol=2e-4)
    np.testing.assert_allclose(np.array(weight.x)[on_sphere], 3.0 / expected, rtol=2e-4)


def test_textured_spheres_are_sampled_by_mitsuba():
    pixels = np.arange(1, 13, dtype=np.float32).reshape(2, 2, 3)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(pixels), "raw": True}
    sphere = {"type": "sphere", "center": [0, 0, 300.0]}
    sphere["emitter"] = {"type": "area", "radiance": texture}
    samples = EmitterSamples(mi.load_dict({"type": "scene", "sphere": sphere}))
    assert not samples.cones.exist


def far_lamp(technique: str, radius: float, distance: float) -> dict[str, Any]:
    """A tilted floor that is lit by a far sphere above."""
    lamp = {"type": "sphere", "center": [0, 0, distance], "radius": radius}
    lamp["emitter"] = area_light(1e6)
    floor = plane(rotate((1, 0, 0), 30), 1.0, bsdf=diffuse(0.5))
    width = 0.05 * distance
    view = camera((0, -1, 2), (0, 0, 0), film(2, 1, 40, 0.0, width), up=(0, 0, 1), fov=5)
    return scene({"lamp": lamp, "floor": floor}, view, max_depth=2) | {
        "integrator": {"type": technique, "max_depth": 2}
    }


@pytest.mark.statistical
@pytest.mark.parametrize(("radius", "distance"), [(0.01, 15.0), (0.05, 100.0), (0.05, 1000.0)])
@pytest.mark.parametrize("technique", ["transient_path", "path_tracer_nee", "transient_bdpt"])
def test_light_of_a_far_lamp(radius, distance, technique):
    """L albedo sin²(angle) cos 30°, 7 % off in single precision."""
    loaded = load(far_lamp(technique, radius, distance))
    found = over_seeds(lambda seed: rendered(loaded, 256, seed)[0].mean((0, 1)), range(8))
    expected = 1e6 * 0.5 * (radius / distance) ** 2 * np.cos(np.radians(30))
    assert agree(found, np.full_like(found, expected), rounding=3e-3)


def test_derivative_by_the_radiance():
    """The sample's weight is proportional to the radiance."""
    lamp = {"type": "sphere", "center": [0, 0, 2000.0], "emitter": area_light(2.0)}
    loaded = mi.load_dict({"type": "scene", "sphere": lamp})
    params = mi.traverse(loaded)
    name = "sphere.emitter.radiance.value"
    dr.enable_grad(params[name])
    params.update()
    at = dr.zeros(mi.SurfaceInteraction3f, 8)
    _, weight = EmitterSamples(loaded).sample_direction(at, uniform(8))
    dr.backward(weight.x)
    assert float(dr.grad(params[name]).x[0]) == pytest.approx(8 * solid_angle(2000.0), rel=1e-4)
