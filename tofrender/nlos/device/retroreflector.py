"""BSDF plugin `retroreflector`: a glossy lobe around the direction of incidence."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...runtime import checks

# Largest exponent. Its lobe is 1.4 mrad wide, which single precision can still resolve
MAX_EXPONENT = 1e6


class Retroreflector(mi.BSDF):
    r"""Glossy reflection back along the direction of incidence (plugin `retroreflector`).

        f(wi, wo) = ρ (n + 1) / (2π) max(0, wi · wo)^n / max(cos θi, cos θo)

    if both directions are above the surface, otherwise 0. This is Phong's lobe around `wi` instead
    of the mirror direction. Over the whole sphere, the lobe (n + 1) / (2π) (wi · wo)^n integrates
    to one. The larger of both cosines replaces the cosine of foreshortening. Therefore f is
    reciprocal, and the weight of a sample, ρ cos θo / max(cos θi, cos θo), is at most ρ. Hence the
    albedo is at most ρ at every angle: ρ (n + 1) / (n + 2) at normal incidence, and ρ / 2 at
    grazing incidence, where half of the lobe is below the horizon.

    | parameter | default | meaning |
    |---|---|---|
    | `reflectance` | 0.5 | ρ, a color or texture in [0, 1] |
    | `lobe_exponent` | 100 | n, above 0 and up to 10^6; the lobe is about sqrt(2/n) rad wide |

    Directions are sampled in proportion to the lobe. Samples below the horizon have weight 0 and
    density 0. `pdf` is not normalized to the upper hemisphere: its integral is the fraction of the
    lobe above the horizon.

    The back side is black unless the BSDF is nested in `twosided`. Reflected light is unpolarized.

    The course's fork of mitransient has a plugin with the same name and parameters. Its brightness
    may differ.

    Sources: B. Phong, "Illumination for Computer Generated Pictures", CACM 18(6), 1975. The larger
    cosine is described by L. Neumann, A. Neumann and L. Szirmay-Kalos, "Compact Metallic
    Reflectance Models", CGF 18(3), 1999.

    Example:
        >>> bsdf = mi.load_dict({"type": "retroreflector", "lobe_exponent": 50.0})
        >>> bsdf.lobe_exponent
        [50]
    """

    def __init__(self, props: mi.Properties) -> None:
        self.lobe_exponent = dr.opaque(mi.Float, _exponent(props.get("lobe_exponent", 100.0)))
        super().__init__(props)
        self.reflectance = _in_unit_interval(props.get_texture("reflectance", 0.5))
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
        if self.reflectance.is_spatially_varying():
            flags |= mi.BSDFFlags.SpatiallyVarying
        self.m_components = [flags]
        self.m_flags = flags

    def sample(
        self,
        ctx: mi.BSDFContext,
        si: mi.SurfaceInteraction3f,
        sample1: mi.Float,
        sample2: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.BSDFSample3f, mi.Spectrum]:
        """Sample the lobe. The weight is 0 if the direction is below the horizon."""
        # Invert P(cos) = 1 - cos^(n + 1) = u. With cos = exp(-t), 1 - cos has no cancellation
        n = self.lobe_exponent
        t = -dr.log(dr.maximum(1 - sample2.x, 1e-12)) / (n + 1)
        versine = 2 * dr.exp(-t / 2) * dr.sinh(t / 2)
        sine = dr.safe_sqrt(versine * (2 - versine))
        sin_phi, cos_phi = dr.sincos(2 * dr.pi * sample2.y)
        local = mi.Vector3f(sine * cos_phi, sine * sin_phi, 1 - versine)

        # Evaluate density and weight
        record: Any = dr.zeros(mi.BSDFSample3f)
        record.wo = dr.normalize(mi.Frame3f(si.wi).to_world(local))
        record.pdf = self.pdf(ctx, si, record.wo, active)
        record.eta = 1
        record.sampled_type = mi.UInt32(int(mi.BSDFFlags.GlossyReflection))
        record.sampled_component = mi.UInt32(0)
        weight = self.reflectance.eval(si, active) * _foreshortening(si.wi, record.wo)
        valid = active & (record.pdf > 0)
        return record, mi.depolarizer(weight) & valid

    def eval(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: Any = True
    ) -> mi.Spectrum:
        """Return BSDF times cos θo."""
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: Any = True
    ) -> mi.Float:
        """Return the density of sampling `wo` [1/sr]."""
        above = (mi.Frame3f.cos_theta(si.wi) > 0) & (mi.Frame3f.cos_theta(wo) > 0)
        if not ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0):
            above = mi.Bool(False)

        # Compute cos^n without a loss of digits. For unit vectors at the distance d,
        # 1 - cos = d^2 / 2 = x, and log(1 - x) = -2 atanh(x / (2 - x))
        x = dr.squared_norm(wo - si.wi) / 2
        logarithm = -2 * dr.atanh(x / (2 - x))
        density = (self.lobe_exponent + 1) / (2 * dr.pi) * dr.exp(self.lobe_exponent * logarithm)
        return dr.select(active & above & (x < 1), density, 0)

    def eval_pdf(
        self, ctx: mi.BSDFContext, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: Any = True
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Return BSDF times cos θo, and the density of `wo` [1/sr]."""
        density = self.pdf(ctx, si, wo, active)
        value = self.reflectance.eval(si, active) * (density * _foreshortening(si.wi, wo))
        return mi.depolarizer(value) & (density > 0), density

    def traverse(self, callback: Any) -> None:
        """Make reflectance and exponent visible to `mi.traverse`."""
        callback.put("reflectance", self.reflectance, mi.ParamFlags.Differentiable)
        callback.put("lobe_exponent", self.lobe_exponent, mi.ParamFlags.NonDifferentiable)

    def parameters_changed(self, keys: Any = ()) -> None:
        """Check a changed exponent. The reflectance may leave [0, 1] while it is optimized."""
        if not keys or "lobe_exponent" in keys:
            _exponent(self.lobe_exponent[0])

    def to_string(self) -> str:
        """Return exponent and reflectance as text."""
        return (
            f"Retroreflector[lobe_exponent = {self.lobe_exponent[0]:g}, "
            f"reflectance = {self.reflectance}]"
        )


def _foreshortening(wi: mi.Vector3f, wo: mi.Vector3f) -> mi.Float:
    """Return cos θo / max(cos θi, cos θo)."""
    cos_i = mi.Frame3f.cos_theta(wi)
    cos_o = mi.Frame3f.cos_theta(wo)
    return cos_o / dr.maximum(cos_i, cos_o)


def _exponent(value: Any) -> float:
    """Check an exponent."""
    return checks.number("lobe_exponent", value, positive=True, high=MAX_EXPONENT)


def _in_unit_interval(texture: Any) -> Any:
    """Return a texture. Raise an error for values outside [0, 1].

    A texture that varies is tested at 256 x 256 points. In spectral variants it is not tested,
    because Mitsuba's conversion to spectra limits the values.
    """
    values = np.zeros(1)
    if not texture.is_spatially_varying():
        values = np.array([texture.max()])
    elif not mi.is_spectral:
        si = dr.zeros(mi.SurfaceInteraction3f)
        line = (dr.arange(mi.Float, 256) + 0.5) / 256
        si.uv = mi.Point2f(*dr.meshgrid(line, line))
        values = np.array(texture.eval(si))
    for value in (values.min(), values.max()):
        if not 0 <= value <= 1:
            raise ValueError(f"reflectance = {value:g}: must be a color or texture in [0, 1]")
    return texture
