# pyright: reportArgumentType=false, reportOperatorIssue=false, reportAttributeAccessIssue=false
"""Polarised light: Stokes vectors and Mueller matrices, and plain spectra in other variants.

Polarised variants of Mitsuba follow, for each channel, a Stokes vector

    S0  radiance
    S1  horizontal less vertical linear polarisation
    S2  linear polarisation at +45° less that at -45°
    S3  right less left circular polarisation

of light towards the sensor. S1 and S2 mean something in a frame only: of a ray from the sensor with
the direction d it is `stokes_basis(-d)` of Mitsuba, until `sensor_frame` turns it. What a path does
to light is a Mueller matrix, whose first column is what unpolarised light becomes; all emitters of
Mitsuba are unpolarised.

In variants without polarisation, the functions here leave spectra as they are.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

STOKES = ("S0", "S1", "S2", "S3")
"""Names of a Stokes vector's components."""


def stokes_count() -> int:
    """Components of light in the active variant: 4 if it is polarised, else 1."""
    return 4 if mi.is_polarized else 1


def no_light() -> Any:
    """Light of radiance 0: an `mi.UnpolarizedSpectrum`, or a Stokes vector of four of these."""
    return mi.SpectrumEntry(0) if mi.is_polarized else mi.UnpolarizedSpectrum(0)


def components(light: Any) -> list[Any]:
    """Spectra of a light's Stokes components, the only one of light that has none."""
    return list(light) if is_stokes(light) else [light]


def is_stokes(light: Any) -> bool:
    """Whether light is a Stokes vector."""
    return bool(mi.is_polarized) and isinstance(light, mi.SpectrumEntry)


def intensity(x: Any) -> Any:
    """The spectrum of a Stokes vector's S0, or of a Mueller matrix's first entry."""
    return x[0] if is_stokes(x) else mi.unpolarized_spectrum(x)


def summed(x: Any) -> Any:
    """Sum over all components and channels of light or of a throughput."""
    if not mi.is_polarized:
        return dr.sum(x)
    if isinstance(x, mi.Spectrum):
        entries = [x[i, j] for i in range(4) for j in range(4)]
        return dr.sum(mi.UnpolarizedSpectrum(sum(entries[1:], entries[0])))
    return dr.sum(sum(components(x)[1:], components(x)[0]))


def scaled(light: Any, spectrum: Any) -> Any:
    """Light times a spectrum, or times a number."""
    if not is_stokes(light):
        return light * spectrum
    return mi.SpectrumEntry(*[each * spectrum for each in light])


def unpolarised(radiance: Any) -> Any:
    """Light of some radiance that is not polarised."""
    return received(mi.Spectrum(1), radiance) if mi.is_polarized else radiance


def received(throughput: Any, radiance: Any) -> Any:
    """What a path of a throughput carries of light: of a Stokes vector, or of a radiance."""
    if not mi.is_polarized:
        return throughput * radiance
    if is_stokes(radiance):
        rows = ([throughput[i, j] * radiance[j] for j in range(4)] for i in range(4))
        return mi.SpectrumEntry(*[sum(row[1:], row[0]) for row in rows])
    return mi.SpectrumEntry(*[throughput[i, 0] * radiance for i in range(4)])


def sent(radiance: Any, throughput: Any, factor: Any) -> Any:
    """What light of some radiance is after a path of its own, and one more factor."""
    if not mi.is_polarized:
        return extended(radiance * throughput, factor)
    return received(extended(throughput, factor, importance=True), radiance)


def light_of(spectrum: Any) -> Any:
    """Light of what integrators of Mitsuba call a spectrum: the first column of its matrix."""
    if not mi.is_polarized:
        return mi.UnpolarizedSpectrum(mi.unpolarized_spectrum(spectrum))
    if isinstance(spectrum, mi.SpectrumEntry):
        return spectrum
    return received(mi.Spectrum(spectrum), mi.UnpolarizedSpectrum(1))


def as_spectrum(light: Any) -> mi.Spectrum:
    """The reverse of `light_of`: what an integrator of Mitsuba returns."""
    if not mi.is_polarized:
        return mi.Spectrum(light)
    zero = mi.UnpolarizedSpectrum(0)
    return mi.Spectrum(*[each for s in light for each in (s, zero, zero, zero)])


def unit_throughput() -> Any:
    """Throughput of a path that has lost nothing."""
    return mi.Spectrum(1) if mi.is_polarized else mi.UnpolarizedSpectrum(1)


def extended(throughput: Any, factor: Any, importance: bool = False) -> Any:
    """A throughput after one more factor: a Mueller matrix, or a spectrum that leaves frames alone.

    Light meets the factors of a path from the sensor in reverse: a new one stands on the right.
    With `importance`, for paths that light itself goes along, it stands on the left.
    """
    if not mi.is_polarized:
        return throughput * mi.unpolarized_spectrum(factor)
    if isinstance(factor, mi.Spectrum):
        return factor @ throughput if importance else throughput @ factor
    return mi.Spectrum(*[throughput[i, j] * factor for i in range(4) for j in range(4)])


def depolarised(factor: Any) -> Any:
    """A factor of scattering whose light is unpolarised, whatever comes."""
    plain = mi.unpolarized_spectrum(factor)
    return mi.depolarizer(plain) if mi.is_polarized else plain


def rayleigh(f: Any, comes: mi.Vector3f, goes: mi.Vector3f) -> mi.Spectrum:
    """What a particle much smaller than the wavelength makes of light, as a dipole.

    With the cosine c of the angle that light is turned by, the part across the plane of both
    directions stays, and that in it counts c² (Bohren and Huffman 1983, section 5.2).

    Args:
        f: What it makes of unpolarised light.
        comes: Unit vector towards where light comes from, world space.
        goes: Unit vector towards where it goes to.
    """
    f, c = mi.unpolarized_spectrum(f), -dr.dot(comes, goes)
    across, total = dr.cross(comes, goes), 1 + c * c
    there = dr.squared_norm(across) > 1e-10  # Straight on and back, any axis is across
    basis = mi.mueller.stokes_basis(goes)
    axis = dr.select(there, dr.normalize(across), basis)
    one, zero = f, mi.UnpolarizedSpectrum(0)
    apart, phase = f * ((1 - c * c) / total), f * (2 * c / total)
    matrix = mi.Spectrum(
        *(one, apart, zero, zero),
        *(apart, one, zero, zero),
        *(zero, zero, phase, zero),
        *(zero, zero, zero, phase),
    )
    before = mi.mueller.stokes_basis(-comes)
    return mi.mueller.rotate_mueller_basis(matrix, -comes, axis, before, goes, axis, basis)


class Finite(dr.CustomOp):
    """What is given, with derivatives that are 0 where they are not finite.

    Mitsuba turns frames by an angle whose derivative is 0 times infinity where two of them are one.
    """

    def eval(self, value):
        """The value."""
        return value

    def forward(self):
        """Its rate."""
        self.set_grad_out(_finite(self.grad_in("value")))

    def backward(self):
        """Its gradient."""
        self.set_grad_in("value", _finite(self.grad_out()))


def _finite(value: Any) -> Any:
    if dr.is_array_v(value):
        return dr.select(dr.isfinite(value), value, 0)
    return type(value)(*[_finite(each) for each in (value.s, value.t, value.n)])


def in_world(si: mi.SurfaceInteraction3f, f: Any, comes: mi.Vector3f, goes: mi.Vector3f) -> Any:
    """A BSDF's value between frames of world space; light comes from and goes to local directions.

    Args:
        si: The surface point.
        f: What the BSDF says, in its own frames.
        comes: Unit vector from the surface towards where light comes from.
        goes: Unit vector towards where it goes to.
    """
    if not mi.is_polarized:
        return f
    lit = dr.any(intensity(f) != 0)  # Directions that were not found have no frame
    if dr.grad_enabled(si, comes, goes):
        si = type(si)(si)
        si.sh_frame, comes, goes = (dr.custom(Finite, x) for x in (si.sh_frame, comes, goes))
    return dr.select(lit, si.to_world_mueller(f, -comes, goes), mi.Spectrum(0))


def sensor_frame(sensor: mi.Sensor, ray: mi.Ray3f) -> Any:
    """The matrix that turns light of a sensor's rays into the sensor's own frame, or None.

    As in Mitsuba's `stokes`: the frame's first axis is across the ray and the sensor's `up`, which
    makes S1 positive across `up`. Rays of one pixel differ. None in variants without polarisation.
    """
    if not mi.is_polarized:
        return None
    up = sensor.world_transform() @ mi.Vector3f(0, 1, 0)
    across = dr.cross(ray.d, up)
    axis = dr.select(
        dr.squared_norm(across) > 0, dr.normalize(across), mi.mueller.stokes_basis(-ray.d)
    )
    return turned(-ray.d, axis)


def turned(forward: mi.Vector3f, axis: mi.Vector3f) -> Any:
    """The matrix that turns light that goes `forward` from Mitsuba's frame into that of `axis`."""
    basis = mi.mueller.stokes_basis(forward)
    return mi.Spectrum(mi.mueller.rotate_stokes_basis(forward, basis, axis))
