"""Derivatives in all variants: one scene in grey, in colours, in spectra, and polarised."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from helpers.gradient_cases import ALBEDO_2, MIRROR_2, PLANE
from helpers.gradient_of import attached, moved_render, tracked

VARIANTS = [
    "llvm_ad_mono",
    "llvm_ad_rgb",
    "llvm_ad_spectral",
    "llvm_ad_mono_polarized",
    "llvm_ad_spectral_polarized",
]
GREY_ALBEDO = replace(ALBEDO_2, value=lambda albedo: albedo)
"""In grey variants a reflectance is a single number."""


def colours(tensor) -> np.ndarray:
    """Bins of the intensity, a mean over pixels and colours: S0 comes first."""
    values = np.array(tensor, dtype=np.float64).mean(axis=(0, 1))
    count = 1 if mi.is_monochromatic else 3
    return values[..., :count].mean(axis=-1)


@pytest.mark.parametrize(
    ("variant", "case"),
    [(variant, PLANE) for variant in VARIANTS]
    + [(variant, GREY_ALBEDO) for variant in VARIANTS if "mono" in variant],
)
def test_derivative_is_the_closed_form(variant, case):
    mi.set_variant(variant)
    plain = case is PLANE and not mi.is_spectral
    theta, transient = attached(case, spp=1 << (13 if plain else 16))
    dr.forward(theta)
    found, expected = colours(dr.grad(transient)), case.expected()[1]
    for what, weights in case.weights().items():
        value = float(weights @ expected)
        assert weights @ found == pytest.approx(value, rel=5e-3 if plain else 2e-2), what


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


def test_colours_have_their_own_derivatives():
    red, key = tracked(0.5), "floor.bsdf.reflectance.value"
    _, transient = moved_render(PLANE.load(), key, mi.Color3f(red, 0.5, 0.5), spp=1 << 10)
    dr.forward(red)
    found = np.array(dr.grad(transient), dtype=np.float64)[0, 0]
    assert found[:, 0] == pytest.approx(np.array(transient)[0, 0, :, 0] / 0.5, rel=1e-2, abs=1e-5)
    assert not found[:, 1:].any()
