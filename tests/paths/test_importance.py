"""Light that scatters on its way from a lamp: it carries what Mitsuba's materials say, no more.

On a flat surface, the importance of each choice is Mitsuba's own weight for that mode. A choice
may fail, such as a rough face's facet that reflects light into the glass; Mitsuba then gives it no
weight, but the density of the facet, while its direction is one that refracted light takes too.
"""

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.light_paths import GLASS
from helpers.parts import diffuse, plane, point_light
from helpers.scenes import numbers
from helpers.support import load

from tofrender.paths.records import Vertex
from tofrender.paths.scattering import Materials

LANES = 1 << 15
FROSTED = GLASS | {"type": "roughdielectric", "distribution": "ggx", "alpha": 0.3}
METAL = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.3, "material": "none"}
RECIPROCAL = {
    "ggx": FROSTED,
    "fine ggx": FROSTED | {"alpha": 0.1},
    "beckmann": FROSTED | {"distribution": "beckmann", "alpha": 0.4},
    "half transparent": {"type": "mask", "opacity": 0.7, "nested": FROSTED},
    "metal": METAL,
    "smooth glass": GLASS,
    "plastic": {"type": "plastic"},
    "diffuse": diffuse(0.5),
}
OTHERS = {
    "all facets": FROSTED | {"sample_visible": False},
    "principled": {"type": "principled", "roughness": 0.5, "spec_trans": 0.7, "eta": 1.5},
    "sheet": {"type": "principledthin", "roughness": 0.5, "spec_trans": 0.7, "diff_trans": 0.6},
}
COSINES = (0.95, 0.25, -0.95, -0.25)


def scattered(material: dict, cos: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights of light that falls on a material; Mitsuba's for the same choices; the integral.

    The last one is an estimate by even directions, without what is smooth.
    """
    loaded = load(
        {"type": "scene", "floor": plane(bsdf=material), "lamp": point_light((0, 0, 3), 1)}
    )
    materials = Materials(loaded, importance=True)
    sine = math.sqrt(1 - cos**2)
    start = mi.Point3f(sine, 0, cos) + dr.zeros(mi.Float, LANES)
    si = loaded.ray_intersect(mi.Ray3f(start, mi.Vector3f(-sine, 0, -cos)))
    vertex = Vertex(si, si.t, si.is_valid())
    sampler = numbers(0, LANES)
    _, bsdf_sample = materials.sample(vertex, None, sampler, vertex.valid)
    sampler.seed(0, LANES)
    flux = mi.BSDFContext(mi.TransportMode.Importance)
    _, weight = si.bsdf().sample(flux, si, sampler.next_1d(), sampler.next_2d())
    even = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    f = materials.eval_pdf(vertex, si.to_world(even), vertex.valid).f
    found = bsdf_sample.weight.x, mi.unpolarized_spectrum(weight).x, 4 * dr.pi * f.x
    own, mitsubas, integrand = (np.array(each, float) for each in found)
    return own, mitsubas, integrand


@pytest.mark.parametrize("cos", COSINES)
@pytest.mark.parametrize("name", RECIPROCAL)
def test_importance_is_mitsubas(name, cos):
    """Choice by choice."""
    own, mitsubas, _ = scattered(RECIPROCAL[name], cos)
    np.testing.assert_allclose(own, mitsubas, rtol=0.02, atol=2e-3)


@pytest.mark.statistical
@pytest.mark.parametrize("cos", COSINES)
@pytest.mark.parametrize("name", OTHERS)
def test_importance_has_the_right_mean(name, cos):
    """Of materials whose own weights differ: the integral of their BSDF, the other way round."""
    own, mitsubas, integrand = scattered(OTHERS[name], cos)
    assert not own[mitsubas == 0].any()
    noise = np.hypot(own.std(), integrand.std()) / np.sqrt(LANES)
    assert abs(own.mean() - integrand.mean()) < 4 * noise
