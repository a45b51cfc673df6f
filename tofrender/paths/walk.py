"""The path loop, the only one of the package.

`walk` traces paths and adds every contribution to a measurement. It has path lengths, and no
pulses, films or frequencies: what varies are the interfaces of `protocols`.

**Paths from lights** use the same loop, see `bidirectional`: they start with an emission sample,
and their endpoint is the camera, whose connections end on the lens. Scattering is then adjoint
(`Materials(importance=True)`), and Russian roulette leaves η² out, since importance is not
compressed at refraction. `bidirectional.mis` weights the strategies of both ends.

**Polarised light** makes the throughput a Mueller matrix, see `signals.polarisation`. Russian
roulette and MIS weights use its first entry, and a contribution is a Stokes vector.

**Media** are a space: `next_vertex` may return a point that scatters, and `transmittance` is a
spectrum. Phase functions are a scattering that wraps another one.

**Gradients** differentiate `step`, one vertex at a time (`gradients.steps`), which therefore
returns a new path. Fields that the given path shares are assigned, since Dr.Jit's `+=` and `*=`
change the array itself.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import TypeVar

import drjit as dr
import mitsuba as mi

from ..films.contribution import Contribution
from ..signals.polarisation import apply_throughput, intensity, multiply_throughput, summed
from .kinds import Kind
from .protocols import FurtherConnections, Measurement, MediumConnections, Parts, Target
from .records import BSDFEval, Connection, Path, Vertex

M = TypeVar("M", bound=Measurement)


@dr.syntax
def walk(sampler: mi.Sampler, path: Path, parts: Parts, measurement: M) -> tuple[M, Path]:
    """Trace paths, and add all of their contributions to a measurement.

    Unidirectional path tracing with next-event estimation and multiple importance sampling. The
    optical path length is the sum of index of refraction times point-to-point distance. Returns the
    measurement, and the paths at their ends.
    """
    while dr.hint(path.active, max_iterations=parts.iterations, label="walk"):
        path = step(sampler, path, parts, measurement)
    return measurement, path


def step(sampler: mi.Sampler, path: Path, parts: Parts, measurement: Measurement) -> Path:
    """Extend paths by one vertex: find it, connect it, and sample the next ray."""
    space, endpoint = parts.space, parts.endpoint
    scattering, limits = parts.scattering, parts.limits
    before, path = path, copy(path)

    # ------------------------- Find the next vertex -------------------------

    if endpoint.in_media is not None:  # After smooth vertices, `_connect_medium_around` has done it
        along_ray = path.active & path.specular
        if path.passed is not None:  # The ray was connected when it left the last vertex
            along_ray &= path.passed == 0
        path.not_finite = path.not_finite + _connect_medium(
            path, along_ray, parts, endpoint.in_media, measurement, sampler
        )
    path, vertex = space.next_vertex(path, sampler)
    onwards = None
    if vertex.passes is not None:
        onwards = space.behind_emitter(path, vertex)
    path = scattering.complete_sample(path, vertex)

    # --------------- Add emission that the ray has run into -----------------

    path = add_emission(path, vertex, parts, measurement)

    # ------------ Stop at the maximum depth, or beyond the last bin ----------

    active = path.active & vertex.valid
    if vertex.passes is not None:
        active &= ~vertex.passes
    reached = active
    below_max_depth = active
    if limits.bounded:  # Null interactions, if they do not count, may follow the last vertex
        below_max_depth = active & (path.depth + 1 < limits.max_depth)
        active = active if limits.ignore_null else below_max_depth
    if limits.max_opl is not None:
        # Indices of refraction may be below 1, so that distances bound nothing
        to_light = mi.Float(0) if scattering.refracts else endpoint.min_distance(vertex.si.p)
        active = active & (path.opl + to_light <= limits.max_opl)

    # ------------- Next-event estimation, and BSDF sampling -----------------

    if endpoint.history is not None:
        path.history = endpoint.history.at_vertex(path, vertex, active)
    if endpoint.connects:
        # Delta lobes reflect no connection
        connects = below_max_depth & active & limits.long_enough(path.depth + 2)
        connects &= scattering.smooth(vertex)
        connection = endpoint.connect(vertex, path, sampler, connects)
        _attenuate(connection, path, vertex, parts, sampler)
        bsdf_eval, bsdf_sample = scattering.sample(vertex, connection, sampler, active)
        contribution = _contribution(connection, path, vertex, bsdf_eval, parts)
        path.not_finite = path.not_finite + accumulate(measurement, contribution)
        if endpoint.further is not None:
            path.not_finite = path.not_finite + _connect_further(
                connection, path, vertex, parts, endpoint.further, sampler, measurement, connects
            )
        if endpoint.in_media is not None:
            path.not_finite = path.not_finite + _connect_medium_around(
                path, vertex, connects, parts, endpoint.in_media, measurement, sampler
            )
    else:
        _, bsdf_sample = scattering.sample(vertex, None, sampler, active)
    if parts.caustic_rays is not None:
        path.not_finite = path.not_finite + parts.caustic_rays.trace(
            path, vertex, sampler, measurement, active & scattering.smooth(vertex)
        )

    if limits.ignore_null:
        active = active & (below_max_depth | bsdf_sample.null)

    # ------------------------- Update the path ------------------------------

    if endpoint.hide_emitters:
        path.valid_ray |= reached & ~bsdf_sample.null
    else:
        path.valid_ray |= reached & (path.depth == 0)
    if endpoint.history is not None:
        path.history = endpoint.history.after_sample(path, vertex, bsdf_sample)
    path.medium = space.medium_behind(path, vertex, bsdf_sample.ray.d)
    path.ray, path.guide = bsdf_sample.ray, bsdf_sample.guide
    path.β = multiply_throughput(path.β, bsdf_sample.weight, importance=endpoint.importance)
    path.η = path.η * bsdf_sample.η
    path.prev = mi.Interaction3f(vertex.si)
    if path.passed is not None:  # The next ray starts at this vertex
        path.passed = dr.zeros(mi.Float, dr.width(path.passed))
    path.pdf, path.specular = bsdf_sample.pdf, bsdf_sample.specular
    if path.lobes is not None:
        path.lobes = path.lobes.after(bsdf_sample.specular, path.depth == 0)
    path.depth = path.depth + dr.select(vertex.valid, mi.UInt32(1), 0)
    if limits.ignore_null:
        for name in ("depth", "pdf", "specular_flag"):
            unchanged = getattr(before, name)
            setattr(path, name, dr.select(bsdf_sample.null, unchanged, getattr(path, name)))

    # End paths whose throughput is not finite
    finite = dr.isfinite(summed(path.β))
    path.not_finite = path.not_finite + dr.select(active & ~finite, mi.UInt32(1), 0)
    active = active & finite

    # The last ray could only run into emitters, which connections from smooth surfaces have found
    if limits.bounded and endpoint.finds_all:
        active &= path.specular | (path.depth + 1 < limits.max_depth)

    # -------------------------- Russian roulette -----------------------------

    # η² undoes the compression of radiance at refraction, which the throughput contains
    compression = mi.Float(1) if endpoint.importance else dr.square(path.η / space.index)
    survival = dr.detach(dr.minimum(dr.max(intensity(path.β)) * compression, 0.95))
    roulette = path.depth >= limits.rr_depth
    path.β = dr.select(roulette, path.β * dr.rcp(survival), path.β)
    active &= ~roulette | (sampler.next_1d() < survival)

    path.active = active & dr.any(intensity(path.β) != 0)

    # ------------ Follow the same ray behind an emitter on a boundary --------

    if onwards is not None:
        onwards.not_finite = path.not_finite
        if not endpoint.hide_emitters:
            onwards.valid_ray |= vertex.passes
        path = dr.select(vertex.passes, onwards, path)
    return path


def add_emission(path: Path, vertex: Vertex, parts: Parts, measurement: Measurement) -> Path:
    """Add emission at the next vertex, or from infinity; returns the path with `opl` up to it."""
    path, limits = copy(path), parts.limits
    hit = parts.endpoint.hit(vertex, path)
    length = dr.select(path.depth == 0, 0, hit.length) if limits.camera_unwarp else hit.length
    path.opl = dr.fma(path.η, length, path.opl)
    if parts.motion is not None:
        parts.motion.extend(path, vertex, (path.depth > 0) | (not limits.camera_unwarp))
    active = hit.active
    if Kind.VISIBLE in limits.left_out:  # `step` sets `valid_ray` after the first hit
        active = active & (path.valid_ray | ~vertex.valid)
    if path.lobes is not None:
        active = active & ~path.lobes.of_kinds(limits.left_out, path.specular, path.depth)
    active = active & limits.long_enough(path.depth + 1)
    emitted = apply_throughput(path.β * hit.mis_weight, hit.radiance)
    end = dr.select(vertex.valid, vertex.si.p, path.prev.p + path.ray.d * hit.length)
    contribution = Contribution(emitted, path.opl, active, end=end, rate=path.rate)
    path.not_finite = path.not_finite + accumulate(measurement, contribution)
    return path


@dr.syntax
def _connect_further(
    first: Connection,
    path: Path,
    vertex: Vertex,
    parts: Parts,
    further: FurtherConnections,
    sampler: mi.Sampler,
    measurement: Measurement,
    active: mi.Bool,
) -> mi.UInt32:
    """Add the connections that follow a vertex's first one; returns how many were not finite."""
    count, k, not_finite = further.count(path), mi.UInt32(0), mi.UInt32(0)
    while active & (k < count):
        connection = further.sample(k, first, vertex, path, sampler, active)
        _attenuate(connection, path, vertex, parts, sampler)
        bsdf_eval = parts.scattering.eval_connection(vertex, connection)
        contribution = _contribution(connection, path, vertex, bsdf_eval, parts)
        not_finite += accumulate(measurement, contribution)
        k += 1
    return not_finite


def _connect_medium(
    path: Path,
    active: mi.Bool,
    parts: Parts,
    in_media: MediumConnections,
    measurement: Measurement,
    sampler: mi.Sampler,
    target: Target | None = None,
) -> mi.UInt32:
    """Connect a point of a medium along the path's ray; returns how many were not finite."""
    if parts.limits.bounded:
        active = active & (path.depth + 1 < parts.limits.max_depth)
    active = active & parts.limits.long_enough(path.depth + 2)
    target = in_media.prepare(path, sampler, active) if target is None else target
    path, vertex, connection = in_media.connect(path, target, sampler)
    _attenuate(connection, path, vertex, parts, sampler)
    bsdf_eval = parts.scattering.eval_connection(vertex, connection)
    contribution = _contribution(connection, path, vertex, bsdf_eval, parts, mis_weight=False)
    return accumulate(measurement, contribution)


def _connect_medium_around(
    path: Path,
    vertex: Vertex,
    active: mi.Bool,
    parts: Parts,
    in_media: MediumConnections,
    measurement: Measurement,
    sampler: mi.Sampler,
) -> mi.UInt32:
    """As `_connect_medium`, along a ray from the vertex that is sampled for this purpose."""
    around = copy(path)
    around.prev = mi.Interaction3f(vertex.si)
    around.depth = path.depth + 1
    if parts.limits.bounded:
        active = active & (around.depth + 1 < parts.limits.max_depth)
    target = in_media.prepare(around, sampler, active)
    target, direction, pdf = in_media.sample_direction(target, sampler)
    bsdf_eval = parts.scattering.eval_pdf(vertex, direction, target.active)
    around.medium = parts.space.medium_behind(path, vertex, direction)
    around.ray = vertex.si.spawn_ray(direction)
    around.β = multiply_throughput(path.β, bsdf_eval.f / pdf)
    return _connect_medium(around, target.active, parts, in_media, measurement, sampler, target)


def _attenuate(
    connection: Connection, path: Path, vertex: Vertex, parts: Parts, sampler: mi.Sampler
) -> None:
    """Multiply a connection by its transmittance, and disable it where that is 0."""
    connection.weight *= parts.space.transmittance(path, vertex, connection, sampler)
    connection.active &= ~dr.all(intensity(connection.weight) == 0)


def _contribution(
    connection: Connection,
    path: Path,
    vertex: Vertex,
    bsdf_eval: BSDFEval,
    parts: Parts,
    mis_weight: bool = True,
) -> Contribution:
    """Return a connection's contribution: radiance, path length, and position on the film."""
    endpoint, throughput = parts.endpoint, path.β
    if mis_weight:
        throughput = throughput * endpoint.mis_weight(path, vertex, connection, bsdf_eval)
    throughput = multiply_throughput(throughput, bsdf_eval.f, importance=endpoint.importance)
    if connection.frame is not None:
        throughput = multiply_throughput(
            throughput, connection.frame, importance=endpoint.importance
        )
    spectrum = apply_throughput(throughput, connection.weight)
    η = path.η * bsdf_eval.η
    opl = dr.fma(η, connection.length, path.opl)
    rate = path.rate
    if parts.motion is not None:
        rate = dr.fma(η, parts.motion.of_connection(connection, path), rate)
    if endpoint.importance:  # η is relative to that around the light, the sensor's is known
        opl = opl / η * parts.space.index
        rate = None if rate is None else rate / η * parts.space.index
    return Contribution(
        spectrum, opl, connection.active, connection.position, connection.point, rate
    )


def accumulate(measurement: Measurement, contribution: Contribution) -> mi.UInt32:
    """Add a contribution to a measurement, unless it is black or not finite.

    Returns 1 in lanes where it was not finite, else 0.
    """
    spectrum, active = contribution.spectrum, contribution.active
    black = dr.all(intensity(spectrum) == 0)
    finite = black | dr.isfinite(summed(spectrum) + contribution.opl)
    measurement.add(replace(contribution, active=active & finite & ~black))
    return dr.select(active & ~finite, mi.UInt32(1), 0)
