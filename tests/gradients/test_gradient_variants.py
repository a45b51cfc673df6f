"""Derivatives in all variants: one scene in grey, in colours, in spectra, and polarised."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gradient_cases import ALBEDO_2, MIRROR_2, PLANE
from helpers.gradient_of import attached

VARIANTS = (
    "llvm_ad_mono",
    "llvm_ad_rgb",
    "llvm_ad_spectral",
    "llvm_ad_mono_polarized",
    "llvm_ad_spectral_polarized",
)


def colours(tensor) -> np.ndarray:
    """Bins of the intensity, a mean over pixels and colours: S0 comes first."""
    values = np.array(tensor, dtype=np.float64).mean(axis=(0, 1))
    count = 1 if mi.is_monochromatic else 3
    return values[..., :count].mean(axis=-1)


@pytest.mark.parametrize("variant", VARIANTS)
def test_plane_in_all_variants(variant):
    mi.set_variant(variant)
    spp = 1 << (16 if mi.is_spectral else 13)
    theta, transient = attached(PLANE, spp=spp)
    dr.forward(theta)
    found, expected = colours(dr.grad(transient)), PLANE.expected()[1]
    for what, weights in PLANE.weights().items():
        value = float(weights @ expected)
        tolerance = 2e-2 if mi.is_spectral else 5e-3
        assert weights @ found == pytest.approx(value, rel=tolerance), what


@pytest.mark.parametrize("variant", VARIANTS)
def test_reverse_is_forward_in_all_variants(variant):
    mi.set_variant(variant)
    for case in (PLANE, MIRROR_2):
        theta, tensor = attached(case, spp=1 << 8, seed=3)
        weights = np.random.default_rng(1).normal(size=tensor.shape).ravel()
        dr.forward(theta)
        gradient = np.array(dr.grad(tensor), dtype=np.float64).ravel()
        theta, tensor = attached(case, spp=1 << 8, seed=3)
        dr.backward(dr.sum(tensor.array * mi.Float(weights.astype(np.float32))))
        scale = np.abs(weights * gradient).sum()
        assert scale > 0
        assert dr.grad(theta)[0] == pytest.approx(weights @ gradient, abs=1e-4 * scale), case.name


@pytest.mark.parametrize("variant", ["llvm_ad_mono", "llvm_ad_mono_polarized"])
def test_an_albedo_without_colours(variant):
    """In grey variants a reflectance is a single number."""
    mi.set_variant(variant)
    loaded = ALBEDO_2.load()
    parameters = mi.traverse(loaded)
    theta = mi.Float(ALBEDO_2.theta)
    dr.enable_grad(theta)
    parameters[ALBEDO_2.key] = theta
    parameters.update()
    _, transient = mi.render(loaded, parameters, spp=1 << 16)
    dr.forward(theta)
    found, expected = colours(dr.grad(transient)), ALBEDO_2.expected()[1]
    for what, weights in ALBEDO_2.weights().items():
        assert weights @ found == pytest.approx(weights @ expected, rel=2e-2), what


def test_colours_have_their_own_derivatives():
    """The red of an albedo changes the red of the bins alone."""
    loaded = PLANE.load()
    parameters = mi.traverse(loaded)
    red = mi.Float(0.5)
    dr.enable_grad(red)
    parameters["floor.bsdf.reflectance.value"] = mi.Color3f(red, 0.5, 0.5)
    parameters.update()
    _, transient = mi.render(loaded, parameters, spp=1 << 10)
    dr.forward(red)
    found = np.array(dr.grad(transient), dtype=np.float64)[0, 0]
    assert found[:, 0] == pytest.approx(np.array(transient)[0, 0, :, 0] / 0.5, rel=1e-2, abs=1e-5)
    assert not found[:, 1:].any()
