"""The path loop of the package. All integrators use this loop.

`walk` traces paths and adds every contribution to a measurement. The loop knows optical path
lengths. Pulses, films and frequencies are behind the interfaces of `protocols`.

**The state of the loop** is a `Path`, and the fields of the measurement if it is a dataclass. The
fields of `Path` are arrays with one entry per lane:

| field | meaning | unit | at the start |
|---|---|---|---|
| `ray` | ray to the next vertex | m | camera ray |
| `depth` | number of vertices so far | | 0 |
| `β` | path throughput | | 1, or the sensor's Mueller matrix |
| `η` | relative index of refraction around the ray | | 1 |
| `opl` | optical path length up to the last vertex | m | 0 |
| `prev` | last vertex | m | point where lengths start |
| `pdf` | solid-angle density of the ray's direction | 1/sr | 1 |
| `history` | data of earlier vertices for MIS weights | | `HistoryUpdates.start()` |
| `guide` | distance to the target of a guided ray | m | `Scattering.guide()` |
| `medium` | current medium | | `Space.medium_at_sensor()` |
| `not_finite` | number of dropped contributions | | 0 |
| `active` | does the path continue? | | true |
| `valid_ray` | has the path met a surface? | | false |
| `specular` | does the ray come from a delta lobe or the sensor? | | true |
| `rate` | rate of change of `opl` | m/s | 0 |
| `velocity` | velocity of the last vertex | m/s | velocity where lengths start |
| `passed` | distance from `prev` to the start of `ray` | m | 0 |
| `lobes` | kinds of lobes that have scattered the path | | no lobes |

Fields that a render does not need are None.

**Paths from lights** use the same loop, see `bidirectional`. These paths start with an emission
sample. Their endpoint is the camera, and their connections end on the lens. Scattering is then
adjoint (`Materials(importance=True)`). Refraction does not compress importance, so that Russian
roulette omits the factor η². `bidirectional.mis` weights the strategies of both directions.

**Polarized light** makes the throughput a Mueller matrix, see `signals.polarization`. Russian
roulette and MIS weights use the first entry of the matrix. A contribution is a Stokes vector.

**Participating media** are a space. Its `next_vertex` may return a point that scatters, and its
`transmittance` returns a spectrum. Phase functions are a scattering that wraps the BSDFs.

**Derivatives** are derivatives of `step`, one vertex at a time (`gradients.steps`). Therefore
`step` returns a new path. The new path may share arrays with its argument, and Dr.Jit's `+=` and
`*=` change an array in place. Always assign a new array to a field of the path.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import TypeVar

import drjit as dr
import mitsuba as mi

from ..films.contribution import Contribution
from ..signals.polarization import apply_throughput, intensity, multiply_throughput, summed
from .path_kinds import Kind
from .protocols import FurtherConnections, LeaveVertex, Measurement, MediumConnections, Parts
from .records import BSDFEval, Connection, Path, Vertex

M = TypeVar("M", bound=Measurement)


@dr.syntax
def walk(sampler: mi.Sampler, path: Path, parts: Parts, measurement: M) -> tuple[M, Path]:
    """Trace paths, and add all of their contributions to a measurement.

    This is unidirectional path tracing with next-event estimation and multiple importance sampling.
    The optical path length is the sum of index of refraction times point-to-point distance.

    Returns the measurement, and the paths after their last vertex.
    """
    while dr.hint(path.active, max_iterations=parts.iterations, label="walk"):
        path = step(sampler, path, parts, measurement)
    return measurement, path


def step(sampler: mi.Sampler, path: Path, parts: Parts, measurement: Measurement) -> Path:
    """Extend paths by one vertex: find the vertex, connect it, and sample the next ray."""
    space = parts.space
    endpoint = parts.endpoint
    scattering = parts.scattering
    limits = parts.limits

    before = path
    path = copy(path)

    # -------------------- Connect a point of a medium along the ray --------------------

    if endpoint.in_media is not None:
        # After smooth vertices, `_connect_medium_around` has already made this connection
        along_ray = path.active & path.specular
        # A ray behind an emitter was connected when it left the last vertex
        if path.passed is not None:
            along_ray &= path.passed == 0
        path.not_finite = path.not_finite + _connect_medium_ahead(
            path, along_ray, parts, endpoint.in_media, measurement, sampler
        )

    # ----------------------------- Find the next vertex -----------------------------

    path, vertex = space.next_vertex(path, sampler)

    # If the ray has stopped at an emitter on a boundary, prepare the ray behind the emitter
    path_behind = None
    if vertex.passes is not None:
        path_behind = space.behind_emitter(path, vertex)

    path = scattering.complete_sample(path, vertex)

    # -------------------- Direct emission: does the ray hit an emitter? --------------------

    path = add_emission(path, vertex, parts, measurement)

    # ------------------ Stop at the maximum depth, or beyond the last bin ------------------

    active = path.active & vertex.valid
    if vertex.passes is not None:
        active &= ~vertex.passes
    reached = active

    # May the path have another vertex?
    below_max_depth = active
    if limits.bounded:
        below_max_depth = active & (path.depth + 1 < limits.max_depth)
        # With `ignore_null`, null interactions may still follow the last vertex
        active = active if limits.ignore_null else below_max_depth

    # Can light still arrive within the window? A distance is not a lower bound of the optical
    # length if an index of refraction is below 1
    if limits.max_opl is not None:
        to_light = mi.Float(0) if scattering.refracts else endpoint.min_distance(vertex.si.p)
        active = active & (path.opl + to_light <= limits.max_opl)

    # --------------------- Next-event estimation, and BSDF sampling ---------------------

    if endpoint.history is not None:
        path.history = endpoint.history.at_vertex(path, vertex, active)

    if endpoint.connects:
        # Connect only vertices with smooth lobes: a delta lobe reflects no light of a connection
        connects = below_max_depth & active & limits.long_enough(path.depth + 2)
        connects &= scattering.smooth(vertex)

        # Sample an emitter, and find out how much of its light arrives
        connection = endpoint.connect(vertex, path, sampler, connects)
        _attenuate(connection, path, vertex, parts, sampler)

        # Evaluate the BSDF for the connection, and sample the next direction
        bsdf_eval, bsdf_sample = scattering.sample(vertex, connection, sampler, active)
        contribution = _contribution(connection, path, vertex, bsdf_eval, parts)
        path.not_finite = path.not_finite + accumulate(measurement, contribution)

        # Add more emitter samples of this vertex
        if endpoint.further is not None:
            path.not_finite = path.not_finite + _connect_further(
                connection, path, vertex, parts, endpoint.further, sampler, measurement, connects
            )

        # Connect a point of a medium along another ray from this vertex
        if endpoint.in_media is not None:
            path.not_finite = path.not_finite + _connect_medium_around(
                path, vertex, connects, parts, endpoint.in_media, measurement, sampler
            )
    else:
        _, bsdf_sample = scattering.sample(vertex, None, sampler, active)

    # Trace additional rays that follow delta lobes to an emitter
    if parts.caustic_rays is not None:
        path.not_finite = path.not_finite + parts.caustic_rays.trace(
            path, vertex, sampler, measurement, active & scattering.smooth(vertex)
        )

    # At the maximum depth, only null interactions may follow
    if limits.ignore_null:
        active = active & (below_max_depth | bsdf_sample.null)

    # ------------------------------- Update the path -------------------------------

    # Did the first ray meet a surface? With `hide_emitters`, null interactions do not count
    if endpoint.hide_emitters:
        path.valid_ray |= reached & ~bsdf_sample.null
    else:
        path.valid_ray |= reached & (path.depth == 0)

    # The history and the current medium need the path before its update
    if endpoint.history is not None:
        path.history = endpoint.history.after_sample(path, vertex, bsdf_sample)
    path.medium = space.medium_behind(path, vertex, bsdf_sample.ray.d)

    # Leave the vertex along the sampled ray
    path.ray = bsdf_sample.ray
    path.guide = bsdf_sample.guide
    path.β = multiply_throughput(path.β, bsdf_sample.weight, importance=endpoint.importance)
    path.η = path.η * bsdf_sample.η
    path.prev = mi.Interaction3f(vertex.si)
    if path.passed is not None:
        path.passed = dr.zeros(mi.Float, dr.width(path.passed))

    # Remember the lobe and its density for MIS weights
    path.pdf = bsdf_sample.pdf
    path.specular = bsdf_sample.specular
    if path.lobes is not None:
        path.lobes = path.lobes.after(bsdf_sample.specular, path.depth == 0)
    path.depth = path.depth + dr.select(vertex.valid, mi.UInt32(1), 0)

    # Null interactions leave depth and MIS weights unchanged
    if limits.ignore_null:
        path.depth = dr.select(bsdf_sample.null, before.depth, path.depth)
        path.pdf = dr.select(bsdf_sample.null, before.pdf, path.pdf)
        path.specular_flag = dr.select(bsdf_sample.null, before.specular_flag, path.specular_flag)

    # ----------------------------- Should the path stop? -----------------------------

    # Stop if the throughput is not finite
    finite = dr.isfinite(summed(path.β))
    path.not_finite = path.not_finite + dr.select(active & ~finite, mi.UInt32(1), 0)
    active = active & finite

    # The last ray can only hit emitters. Connections of smooth lobes have already found this light
    if limits.bounded and endpoint.finds_all:
        active &= path.specular | (path.depth + 1 < limits.max_depth)

    # -------------------------------- Russian roulette --------------------------------

    # The throughput contains the compression of radiance at refraction, and η² removes it
    compression = mi.Float(1) if endpoint.importance else dr.square(path.η / space.index)
    survival = dr.detach(dr.minimum(dr.max(intensity(path.β)) * compression, 0.95))
    roulette = path.depth >= limits.rr_depth
    path.β = dr.select(roulette, path.β * dr.rcp(survival), path.β)
    active &= ~roulette | (sampler.next_1d() < survival)

    path.active = active & dr.any(intensity(path.β) != 0)

    # -------------- Follow the same ray behind an emitter on a boundary --------------

    if path_behind is not None:
        path_behind.not_finite = path.not_finite
        if not endpoint.hide_emitters:
            path_behind.valid_ray |= vertex.passes
        path = dr.select(vertex.passes, path_behind, path)
    return path


def add_emission(path: Path, vertex: Vertex, parts: Parts, measurement: Measurement) -> Path:
    """Add the emission at the next vertex, or from infinity if the ray meets no surface.

    Returns a copy of the path with `opl` and `rate` up to this vertex.
    """
    path = copy(path)
    limits = parts.limits

    # Extend the optical path length. With `camera_unwarp`, the first segment does not count
    hit = parts.endpoint.hit(vertex, path)
    length = dr.select(path.depth == 0, 0, hit.length) if limits.camera_unwarp else hit.length
    path.opl = dr.fma(path.η, length, path.opl)
    if parts.motion is not None:
        parts.motion.extend(path, vertex, (path.depth > 0) | (not limits.camera_unwarp))

    # Is the path of a kind that this walk renders? `step` sets `valid_ray` after the first hit
    active = hit.active
    if Kind.VISIBLE in limits.left_out:
        active = active & (path.valid_ray | ~vertex.valid)
    if path.lobes is not None:
        active = active & ~path.lobes.of_kinds(limits.left_out, path.specular, path.depth)
    active = active & limits.long_enough(path.depth + 1)

    # Add the emission
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
    """Add the connections of a vertex that follow its first connection.

    Returns how many contributions were not finite.
    """
    count = further.count(path)
    k = mi.UInt32(0)
    not_finite = mi.UInt32(0)
    while active & (k < count):
        connection = further.sample(k, first, vertex, path, sampler, active)
        _attenuate(connection, path, vertex, parts, sampler)
        bsdf_eval = parts.scattering.eval_connection(vertex, connection)
        contribution = _contribution(connection, path, vertex, bsdf_eval, parts)
        not_finite += accumulate(measurement, contribution)
        k += 1
    return not_finite


def _connect_medium_ahead(
    path: Path,
    active: mi.Bool,
    parts: Parts,
    in_media: MediumConnections,
    measurement: Measurement,
    sampler: mi.Sampler,
) -> mi.UInt32:
    """Connect a point of a medium along the path's ray.

    Returns how many contributions were not finite.
    """
    # Does a path with one more vertex count?
    if parts.limits.bounded:
        active = active & (path.depth + 1 < parts.limits.max_depth)
    active = active & parts.limits.long_enough(path.depth + 2)
    return _connect_medium(path, active, parts, in_media, measurement, sampler)


def _connect_medium_around(
    path: Path,
    vertex: Vertex,
    active: mi.Bool,
    parts: Parts,
    in_media: MediumConnections,
    measurement: Measurement,
    sampler: mi.Sampler,
) -> mi.UInt32:
    """Connect a point of a medium along a new ray from the vertex.

    The ray is sampled for this connection only. Returns how many contributions were not finite.
    """
    around = copy(path)
    around.prev = mi.Interaction3f(vertex.si)
    around.depth = path.depth + 1
    if parts.limits.bounded:
        active = active & (around.depth + 1 < parts.limits.max_depth)

    def leave(direction: mi.Vector3f, pdf: mi.Float, active: mi.Bool) -> Path:
        """Scatter into the sampled ray."""
        bsdf_eval = parts.scattering.eval_pdf(vertex, direction, active)
        around.medium = parts.space.medium_behind(path, vertex, direction)
        around.ray = vertex.si.spawn_ray(direction)
        around.β = multiply_throughput(path.β, bsdf_eval.f / pdf)
        return around

    return _connect_medium(around, active, parts, in_media, measurement, sampler, leave)


def _connect_medium(
    path: Path,
    active: mi.Bool,
    parts: Parts,
    in_media: MediumConnections,
    measurement: Measurement,
    sampler: mi.Sampler,
    leave: LeaveVertex | None = None,
) -> mi.UInt32:
    """Add the connection of a point of a medium, with the arguments of `MediumConnections.connect`.

    Returns how many contributions were not finite.
    """
    # Sample emitter and path length, and find the point of the ray with this length
    path, vertex, connection = in_media.connect(path, sampler, active, leave)

    # Add the contribution. No other technique finds this light, so the MIS weight is 1
    _attenuate(connection, path, vertex, parts, sampler)
    bsdf_eval = parts.scattering.eval_connection(vertex, connection)
    contribution = _contribution(connection, path, vertex, bsdf_eval, parts, mis_weight=False)
    return accumulate(measurement, contribution)


def _attenuate(
    connection: Connection, path: Path, vertex: Vertex, parts: Parts, sampler: mi.Sampler
) -> None:
    """Multiply a connection by its transmittance, and deactivate lanes without transmittance.

    Changes `weight`, `frame` and `active` of the connection.
    """
    transmittance = parts.space.transmittance(path, vertex, connection, sampler)
    connection.weight *= transmittance.value
    if transmittance.frame is not None:
        connection.frame = transmittance.frame
    connection.active &= ~dr.all(intensity(connection.weight) == 0)


def _contribution(
    connection: Connection,
    path: Path,
    vertex: Vertex,
    bsdf_eval: BSDFEval,
    parts: Parts,
    mis_weight: bool = True,
) -> Contribution:
    """Return the contribution of a connection: radiance, path length, and position on the film."""
    endpoint = parts.endpoint

    # Throughput up to the end of the connection
    throughput = path.β
    if mis_weight:
        throughput = throughput * endpoint.mis_weight(path, vertex, connection, bsdf_eval)
    throughput = multiply_throughput(throughput, bsdf_eval.f, importance=endpoint.importance)
    if connection.frame is not None:
        throughput = multiply_throughput(
            throughput, connection.frame, importance=endpoint.importance
        )
    spectrum = apply_throughput(throughput, connection.weight)

    # Optical path length [m], and its rate of change [m/s]
    η = path.η * bsdf_eval.η
    opl = dr.fma(η, connection.length, path.opl)
    rate = path.rate
    if parts.motion is not None:
        rate = dr.fma(η, parts.motion.of_connection(connection, path), rate)

    # For paths from lights, η is relative to the index around the light, which is not known.
    # The path ends at the sensor with a known index, so that the ratio gives absolute lengths
    if endpoint.importance:
        opl = opl / η * parts.space.index
        rate = None if rate is None else rate / η * parts.space.index

    return Contribution(
        spectrum=spectrum,
        opl=opl,
        active=connection.active,
        position=connection.position,
        end=connection.point,
        rate=rate,
    )


def accumulate(measurement: Measurement, contribution: Contribution) -> mi.UInt32:
    """Add a contribution to a measurement, unless the contribution is black or not finite.

    Returns 1 in active lanes with a contribution that is not finite, otherwise 0.
    """
    spectrum = contribution.spectrum
    active = contribution.active
    black = dr.all(intensity(spectrum) == 0)
    finite = black | dr.isfinite(summed(spectrum) + contribution.opl)
    measurement.add(replace(contribution, active=active & finite & ~black))
    return dr.select(active & ~finite, mi.UInt32(1), 0)
