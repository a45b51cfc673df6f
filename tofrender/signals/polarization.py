# pyright: reportArgumentType=false, reportOperatorIssue=false, reportAttributeAccessIssue=false
"""Polarized light: Stokes vectors and Mueller matrices, and plain spectra in other variants.

In polarized variants of Mitsuba, light towards the sensor is a Stokes vector for each channel:

    S0  radiance
    S1  horizontal minus vertical linear polarization
    S2  linear polarization at +45° minus linear polarization at -45°
    S3  right minus left circular polarization

S1 and S2 refer to a frame around the ray. For a ray from the sensor with direction d, the frame is
Mitsuba's `stokes_basis(-d)`, until `sensor_frame` rotates the light to the frame of the sensor. The
throughput of a path is a Mueller matrix. Its first column applies to unpolarized light, and all
emitters of Mitsuba are unpolarized. In other variants, the functions of this module process plain
spectra.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..runtime.interface import world_transform

STOKES = ("S0", "S1", "S2", "S3")  # Names of a Stokes vector's components


def stokes_count() -> int:
    """Return the number of Stokes components: 4 in polarized variants, 1 in other variants."""
    return 4 if mi.is_polarized else 1


def no_light() -> Any:
    """Return zero radiance: an `mi.UnpolarizedSpectrum`, or a Stokes vector of four spectra."""
    return mi.SpectrumEntry(0) if mi.is_polarized else mi.UnpolarizedSpectrum(0)


def components(light: Any) -> list[Any]:
    """Return the four spectra of a Stokes vector, or a list with the plain radiance."""
    return list(light) if is_stokes(light) else [light]


def is_stokes(light: Any) -> bool:
    """Return whether a value is a Stokes vector."""
    return bool(mi.is_polarized) and isinstance(light, mi.SpectrumEntry)


def intensity(x: Any) -> Any:
    """Return S0 of a Stokes vector, or the first entry of a Mueller matrix, as a spectrum."""
    return x[0] if is_stokes(x) else mi.unpolarized_spectrum(x)


def summed(x: Any) -> Any:
    """Return the sum of all entries and channels of a radiance or a throughput."""
    if not mi.is_polarized:
        return dr.sum(x)
    if isinstance(x, mi.Spectrum):
        entries = [x[i, j] for i in range(4) for j in range(4)]
        return dr.sum(mi.UnpolarizedSpectrum(sum(entries[1:], entries[0])))
    return dr.sum(sum(components(x)[1:], components(x)[0]))


def scaled(light: Any, spectrum: Any) -> Any:
    """Return the radiance times a spectrum or a number."""
    if not is_stokes(light):
        return light * spectrum
    return mi.SpectrumEntry(*[each * spectrum for each in light])


def unpolarized(radiance: Any) -> Any:
    """Return the Stokes vector of unpolarized light; in other variants, the radiance."""
    return apply_throughput(mi.Spectrum(1), radiance) if mi.is_polarized else radiance


def apply_throughput(throughput: Any, radiance: Any) -> Any:
    """Return the throughput times a Stokes vector, or times unpolarized radiance."""
    if not mi.is_polarized:
        return throughput * radiance
    if is_stokes(radiance):
        rows = ([throughput[i, j] * radiance[j] for j in range(4)] for i in range(4))
        return mi.SpectrumEntry(*[sum(row[1:], row[0]) for row in rows])
    return mi.SpectrumEntry(*[throughput[i, 0] * radiance for i in range(4)])


def apply_light_path(radiance: Any, throughput: Any, factor: Any) -> Any:
    """Return the radiance times the throughput of a light path and another factor.

    Args:
        radiance: Emitted radiance of the light path.
        throughput: Throughput of the light path.
        factor: Mueller matrix or spectrum that follows after the light path.
    """
    if not mi.is_polarized:
        return multiply_throughput(radiance * throughput, factor)
    return apply_throughput(multiply_throughput(throughput, factor, importance=True), radiance)


def to_stokes(spectrum: Any) -> Any:
    """Convert the result of a Mitsuba integrator, a Mueller matrix, to a Stokes vector.

    The Stokes vector is the first column of the matrix. In other variants, the result is a
    spectrum.
    """
    if not mi.is_polarized:
        return mi.UnpolarizedSpectrum(mi.unpolarized_spectrum(spectrum))
    if isinstance(spectrum, mi.SpectrumEntry):
        return spectrum
    return apply_throughput(mi.Spectrum(spectrum), mi.UnpolarizedSpectrum(1))


def to_spectrum(light: Any) -> mi.Spectrum:
    """Convert light to the type that Mitsuba integrators return, the inverse of `to_stokes`."""
    if not mi.is_polarized:
        return mi.Spectrum(light)
    zero = mi.UnpolarizedSpectrum(0)
    return mi.Spectrum(*[each for s in light for each in (s, zero, zero, zero)])


def unit_throughput() -> Any:
    """Return the throughput at the start of a path."""
    return mi.Spectrum(1) if mi.is_polarized else mi.UnpolarizedSpectrum(1)


def multiply_throughput(throughput: Any, factor: Any, importance: bool = False) -> Any:
    """Multiply a throughput by a Mueller matrix or a spectrum.

    Args:
        throughput: Throughput of a path.
        factor: Mueller matrix or spectrum of the next vertex.
        importance: False for paths from the sensor, where new matrices are multiplied from the
            right, because light traverses the path in reverse. True for light paths, where new
            matrices are multiplied from the left.
    """
    if not mi.is_polarized:
        return throughput * mi.unpolarized_spectrum(factor)
    if isinstance(factor, mi.Spectrum):
        return factor @ throughput if importance else throughput @ factor
    return mi.Spectrum(*[throughput[i, j] * factor for i in range(4) for j in range(4)])


def depolarize(factor: Any) -> Any:
    """Return a scattering factor that removes all polarization."""
    plain = mi.unpolarized_spectrum(factor)
    return mi.depolarizer(plain) if mi.is_polarized else plain


def rayleigh(f: Any, incident: mi.Vector3f, outgoing: mi.Vector3f) -> mi.Spectrum:
    """Return the Mueller matrix of Rayleigh scattering (Bohren and Huffman 1983, section 5.2).

    With the cosine c of the scattering angle, polarization normal to the scattering plane keeps its
    power, and polarization in the plane is scaled by c².

    Args:
        f: Phase function for unpolarized light.
        incident: Unit vector towards the source of light, in world space.
        outgoing: Unit vector along the scattered light, in world space.
    """
    f = mi.unpolarized_spectrum(f)
    c = -dr.dot(incident, outgoing)
    normal = dr.cross(incident, outgoing)
    total = 1 + c * c

    # Forward and backward scattering define no plane, and every axis is valid
    has_plane = dr.squared_norm(normal) > 1e-10
    basis = mi.mueller.stokes_basis(outgoing)
    axis = dr.select(has_plane, dr.normalize(normal), basis)

    # The matrix in the frame of the scattering plane, in rows
    zero = mi.UnpolarizedSpectrum(0)
    difference = f * ((1 - c * c) / total)
    phase = f * (2 * c / total)
    # fmt: off
    matrix = mi.Spectrum(
        f, difference, zero, zero,
        difference, f, zero, zero,
        zero, zero, phase, zero,
        zero, zero, zero, phase,
    )
    # fmt: on

    # Rotate to Mitsuba's frames
    before = mi.mueller.stokes_basis(-incident)
    return mi.mueller.rotate_mueller_basis(matrix, -incident, axis, before, outgoing, axis, basis)


class Finite(dr.CustomOp):
    """Identity that replaces derivatives that are not finite by 0.

    Mitsuba rotates frames by an angle. If two frames are equal, the derivative of this angle is 0
    times infinity, although the exact derivative of the rotated light is 0.
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
    """Replace numbers that are not finite by 0, in an array or in a frame."""
    if dr.is_array_v(value):
        return dr.select(dr.isfinite(value), value, 0)
    return type(value)(*[_finite(each) for each in (value.s, value.t, value.n)])


def bsdf_to_world(
    si: mi.SurfaceInteraction3f, f: Any, incident: mi.Vector3f, outgoing: mi.Vector3f
) -> Any:
    """Rotate the value of a BSDF from the frames of the surface to the frames of world space.

    Args:
        si: Surface interaction.
        f: Value of the BSDF, a Mueller matrix. In other variants, a spectrum, which is returned.
        incident: Local unit vector towards the source of light.
        outgoing: Local unit vector along the scattered light.
    """
    if not mi.is_polarized:
        return f

    # The frame of a failed sample is invalid
    valid = dr.any(intensity(f) != 0)

    # Replace derivatives that are not finite
    if dr.grad_enabled(si, incident, outgoing):
        si = type(si)(si)
        values = si.sh_frame, incident, outgoing
        si.sh_frame, incident, outgoing = (dr.custom(Finite, x) for x in values)
    return dr.select(valid, si.to_world_mueller(f, -incident, outgoing), mi.Spectrum(0))


def sensor_frame(sensor: mi.Sensor, ray: mi.Ray3f) -> Any:
    """Return the Mueller matrix that rotates light along a ray to the frame of the sensor.

    As in Mitsuba's integrator `stokes`, the first axis of the frame is normal to the ray and to the
    sensor's `up` vector. Therefore S1 is positive for polarization across `up`. The frames of rays
    of one pixel differ slightly.

    Returns:
        The matrix, or None in variants without polarization.
    """
    if not mi.is_polarized:
        return None
    up = world_transform(sensor) @ mi.Vector3f(0, 1, 0)
    across = dr.cross(ray.d, up)
    basis = mi.mueller.stokes_basis(-ray.d)
    axis = dr.select(dr.squared_norm(across) > 0, dr.normalize(across), basis)
    return frame_rotation(-ray.d, axis)


def frame_rotation(forward: mi.Vector3f, axis: mi.Vector3f) -> Any:
    """Return the Mueller matrix that rotates light to the frame with a given first axis.

    Args:
        forward: Direction of the light. The light is in Mitsuba's frame `stokes_basis(forward)`.
        axis: First axis of the new frame.
    """
    basis = mi.mueller.stokes_basis(forward)
    return mi.Spectrum(mi.mueller.rotate_stokes_basis(forward, basis, axis))
