# pyright: reportArgumentType=false, reportOperatorIssue=false, reportAttributeAccessIssue=false
"""Polarised light: Stokes vectors and Mueller matrices, and plain spectra in other variants.

Polarised variants of Mitsuba compute, for each channel, a Stokes vector

    S0  radiance
    S1  horizontal minus vertical linear polarisation
    S2  linear polarisation at +45° minus that at -45°
    S3  right minus left circular polarisation

of light towards the sensor. S1 and S2 refer to a frame: of a ray from the sensor with direction d,
it is `stokes_basis(-d)` of Mitsuba, until `sensor_frame` rotates it. The throughput of a path is a
Mueller matrix, whose first column applies to unpolarised light; all emitters of Mitsuba are
unpolarised. In variants without polarisation, the functions here handle plain spectra.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..runtime.interface import world_transform

STOKES = ("S0", "S1", "S2", "S3")  # Names of a Stokes vector's components


def stokes_count() -> int:
    """Number of Stokes components in the active variant: 4 if it is polarised, else 1."""
    return 4 if mi.is_polarized else 1


def no_light() -> Any:
    """Zero radiance: an `mi.UnpolarizedSpectrum`, or a Stokes vector of four of these."""
    return mi.SpectrumEntry(0) if mi.is_polarized else mi.UnpolarizedSpectrum(0)


def components(light: Any) -> list[Any]:
    """List the spectra of the Stokes components; of plain radiance, the radiance."""
    return list(light) if is_stokes(light) else [light]


def is_stokes(light: Any) -> bool:
    """Whether a value is a Stokes vector."""
    return bool(mi.is_polarized) and isinstance(light, mi.SpectrumEntry)


def intensity(x: Any) -> Any:
    """Spectrum of a Stokes vector's S0, or of a Mueller matrix's first entry."""
    return x[0] if is_stokes(x) else mi.unpolarized_spectrum(x)


def summed(x: Any) -> Any:
    """Sum of all entries and channels of radiance or of a throughput."""
    if not mi.is_polarized:
        return dr.sum(x)
    if isinstance(x, mi.Spectrum):
        entries = [x[i, j] for i in range(4) for j in range(4)]
        return dr.sum(mi.UnpolarizedSpectrum(sum(entries[1:], entries[0])))
    return dr.sum(sum(components(x)[1:], components(x)[0]))


def scaled(light: Any, spectrum: Any) -> Any:
    """Radiance times a spectrum or a number."""
    if not is_stokes(light):
        return light * spectrum
    return mi.SpectrumEntry(*[each * spectrum for each in light])


def unpolarised(radiance: Any) -> Any:
    """Stokes vector of unpolarised light."""
    return apply_throughput(mi.Spectrum(1), radiance) if mi.is_polarized else radiance


def apply_throughput(throughput: Any, radiance: Any) -> Any:
    """Throughput times a Stokes vector, or times unpolarised radiance."""
    if not mi.is_polarized:
        return throughput * radiance
    if is_stokes(radiance):
        rows = ([throughput[i, j] * radiance[j] for j in range(4)] for i in range(4))
        return mi.SpectrumEntry(*[sum(row[1:], row[0]) for row in rows])
    return mi.SpectrumEntry(*[throughput[i, 0] * radiance for i in range(4)])


def apply_light_path(radiance: Any, throughput: Any, factor: Any) -> Any:
    """Radiance times the throughput of a light path and one more factor."""
    if not mi.is_polarized:
        return multiply_throughput(radiance * throughput, factor)
    return apply_throughput(multiply_throughput(throughput, factor, importance=True), radiance)


def to_stokes(spectrum: Any) -> Any:
    """Convert a spectrum of an integrator of Mitsuba: the first column of its Mueller matrix."""
    if not mi.is_polarized:
        return mi.UnpolarizedSpectrum(mi.unpolarized_spectrum(spectrum))
    if isinstance(spectrum, mi.SpectrumEntry):
        return spectrum
    return apply_throughput(mi.Spectrum(spectrum), mi.UnpolarizedSpectrum(1))


def to_spectrum(light: Any) -> mi.Spectrum:
    """Convert to a spectrum as integrators of Mitsuba return it, the inverse of `to_stokes`."""
    if not mi.is_polarized:
        return mi.Spectrum(light)
    zero = mi.UnpolarizedSpectrum(0)
    return mi.Spectrum(*[each for s in light for each in (s, zero, zero, zero)])


def unit_throughput() -> Any:
    """Throughput at the start of a path."""
    return mi.Spectrum(1) if mi.is_polarized else mi.UnpolarizedSpectrum(1)


def multiply_throughput(throughput: Any, factor: Any, importance: bool = False) -> Any:
    """Multiply a throughput by a Mueller matrix, or by a spectrum.

    Paths from the sensor multiply new matrices from the right, as light traverses them in reverse;
    light paths, with `importance`, from the left.
    """
    if not mi.is_polarized:
        return throughput * mi.unpolarized_spectrum(factor)
    if isinstance(factor, mi.Spectrum):
        return factor @ throughput if importance else throughput @ factor
    return mi.Spectrum(*[throughput[i, j] * factor for i in range(4) for j in range(4)])


def depolarise(factor: Any) -> Any:
    """Scattering factor that depolarises."""
    plain = mi.unpolarized_spectrum(factor)
    return mi.depolarizer(plain) if mi.is_polarized else plain


def rayleigh(f: Any, incident: mi.Vector3f, outgoing: mi.Vector3f) -> mi.Spectrum:
    """Mueller matrix of Rayleigh scattering (Bohren and Huffman 1983, section 5.2).

    With the cosine c of the scattering angle, polarisation normal to the scattering plane keeps its
    power, and that in the plane is scaled by c². `f` is the phase function for unpolarised light;
    the unit vectors point to the source of light and along the scattered light, in world space.
    """
    f, c = mi.unpolarized_spectrum(f), -dr.dot(incident, outgoing)
    normal, total = dr.cross(incident, outgoing), 1 + c * c
    has_plane = dr.squared_norm(normal) > 1e-10  # Else forward or backward: any axis is normal
    basis = mi.mueller.stokes_basis(outgoing)
    axis = dr.select(has_plane, dr.normalize(normal), basis)
    zero = mi.UnpolarizedSpectrum(0)
    difference, phase = f * ((1 - c * c) / total), f * (2 * c / total)
    matrix = mi.Spectrum(
        *(f, difference, zero, zero),
        *(difference, f, zero, zero),
        *(zero, zero, phase, zero),
        *(zero, zero, zero, phase),
    )
    before = mi.mueller.stokes_basis(-incident)
    return mi.mueller.rotate_mueller_basis(matrix, -incident, axis, before, outgoing, axis, basis)


class Finite(dr.CustomOp):
    """Identity with derivatives that are 0 where they are not finite.

    Mitsuba rotates by an angle whose derivative is 0 times infinity where two frames are equal.
    """

    def eval(self, value):
        """Return the value."""
        return value

    def forward(self):
        """Propagate finite derivatives forward."""
        self.set_grad_out(_finite(self.grad_in("value")))

    def backward(self):
        """Propagate finite derivatives backward."""
        self.set_grad_in("value", _finite(self.grad_out()))


def _finite(value: Any) -> Any:
    if dr.is_array_v(value):
        return dr.select(dr.isfinite(value), value, 0)
    return type(value)(*[_finite(each) for each in (value.s, value.t, value.n)])


def bsdf_to_world(
    si: mi.SurfaceInteraction3f, f: Any, incident: mi.Vector3f, outgoing: mi.Vector3f
) -> Any:
    """Rotate a BSDF's value from its own frames to those of world space.

    The local unit vectors point to the source of light and along the scattered light.
    """
    if not mi.is_polarized:
        return f
    valid = dr.any(intensity(f) != 0)  # Failed samples have no frame
    if dr.grad_enabled(si, incident, outgoing):
        si = type(si)(si)
        values = si.sh_frame, incident, outgoing
        si.sh_frame, incident, outgoing = (dr.custom(Finite, x) for x in values)
    return dr.select(valid, si.to_world_mueller(f, -incident, outgoing), mi.Spectrum(0))


def sensor_frame(sensor: mi.Sensor, ray: mi.Ray3f) -> Any:
    """Mueller matrix that rotates light along a ray into the sensor's frame; None if unpolarised.

    As in Mitsuba's `stokes`, the frame's first axis is normal to the ray and the sensor's `up`,
    which makes S1 positive across `up`. Rays of one pixel differ.
    """
    if not mi.is_polarized:
        return None
    up = world_transform(sensor) @ mi.Vector3f(0, 1, 0)
    across, basis = dr.cross(ray.d, up), mi.mueller.stokes_basis(-ray.d)
    axis = dr.select(dr.squared_norm(across) > 0, dr.normalize(across), basis)
    return frame_rotation(-ray.d, axis)


def frame_rotation(forward: mi.Vector3f, axis: mi.Vector3f) -> Any:
    """Mueller matrix that rotates light along `forward` from Mitsuba's frame to that of `axis`."""
    basis = mi.mueller.stokes_basis(forward)
    return mi.Spectrum(mi.mueller.rotate_stokes_basis(forward, basis, axis))
