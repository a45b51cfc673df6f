"""The path loop, the only one of the package.

`walk` follows paths and hands every connection to an endpoint to a measurement. It knows how long
each path is, and nothing of pulses, films or frequencies: what varies are the four parts of
`protocols`.

**Paths that start at lights** are walked by it too. They start with an emitter's ray (`emission`);
their endpoint is the camera (`endpoints.camera`), which ends connections on the lens, says where on
the film they land, and weighs them with what the light started with. Scattering then turns the
materials round (`Materials(importance=True)`), and roulette leaves η² out, since what such a path
carries is not compressed at refraction. How the strategies of both ends share light is `sharing`;
what a path knows of it is in its memory.

**Polarised light** makes the throughput a Mueller matrix, see `signals.polarisation`. `extend`
multiplies factors of the path, which then are `si.to_world_mueller` of the BSDF's; roulette and
shares look at the first entry, and a contribution is a Stokes vector.

All else enters through the parts, without a second loop:

- **Media** are a space: `next` returns a vertex without a surface and a path with another
  throughput, passes null collisions and boundaries of equal index without moving `prev`, and
  `transmittance` is a spectrum; what it must know of the medium is a field of the path. Phase
  functions are a scattering that wraps another one.
- **Gradients** differentiate `step`, one vertex at a time (`derivatives`): forwards with the rates
  of the path's state, in reverse from states that a first walk keeps. All parts are therefore pure:
  `step` returns a new path, and nothing is remembered outside of it.
- **A velocity** along the path, if it comes, is one more field of the path that `space.next`
  returns, and one more of `Contribution`.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import TypeVar

import drjit as dr
import mitsuba as mi

from ..films.contribution import Contribution
from ..signals.polarisation import apply_throughput, intensity, summed
from .protocols import Endpoint, Measurement, Scattering, Space
from .records import Connection, Limits, Path, Turn, Vertex, extend

M = TypeVar("M", bound=Measurement)


@dr.syntax
def walk(
    sampler: mi.Sampler,
    path: Path,
    space: Space,
    endpoint: Endpoint,
    scattering: Scattering,
    measurement: M,
    limits: Limits,
) -> tuple[M, Path]:
    """Trace paths and hand each of their connections to `measurement`.

    Unidirectional path tracing with next-event estimation and multiple importance sampling. The
    length of a path is the sum of index of refraction times distance between its vertices, taken
    point to point.

    Args:
        sampler: Random numbers; every vertex draws four, and what its parts draw.
        path: Where paths start, see `Path.start`.
        space: How vertices are found.
        endpoint: What connections are made to.
        scattering: How paths go on.
        measurement: Receives every contribution.
        limits: Which paths count, and how much of them.

    Returns:
        The measurement, and the paths at their ends; `path.covered` are the lanes whose first ray
        met a surface.
    """
    while dr.hint(path.active, max_iterations=limits.iterations, label="walk"):
        path = step(sampler, path, space, endpoint, scattering, measurement, limits)
    return measurement, path


def step(
    sampler: mi.Sampler,
    path: Path,
    space: Space,
    endpoint: Endpoint,
    scattering: Scattering,
    measurement: Measurement,
    limits: Limits,
) -> Path:
    """Follow paths to their next vertex, connect it, and choose where they go on.

    Arguments as for `walk`. Returns the paths with that vertex as their last one.
    """
    before, path = path, copy(path)
    parts = space, endpoint, scattering, measurement, limits, sampler
    if endpoint.looks_ahead:
        path.not_finite += _look_ahead(path, path.active & path.specular, *parts)
    path, vertex = space.next(path, sampler)
    path = scattering.arrive(path, vertex)

    path = meet(path, vertex, endpoint, measurement, limits)

    # ------------------- Stop at the last surface vertex -------------------

    active = path.active & vertex.valid
    path.covered |= active & (path.depth == 0)
    further = active
    if limits.bounded:
        further = active & (path.depth + 1 < limits.max_depth)
        active = active if limits.straight else further
    if limits.last_opl is not None:
        # Behind glass, the way to a light may be optically shorter than it is long
        to_light = mi.Float(0) if scattering.refracts else endpoint.nearest(vertex.si.p)
        active &= path.opl + to_light <= limits.last_opl

    # --------------- Connect the vertex, and choose a direction ------------

    path.memory = endpoint.remember(path, vertex, active)
    if endpoint.connects:
        smooth = further & active & scattering.smooth(vertex)
        link = endpoint.connect(vertex, path, sampler, smooth)
        link.weight *= space.transmittance(path, vertex, link, sampler)
        link.active &= ~dr.all(intensity(link.weight) == 0)
        turn, bounce = scattering.scatter(vertex, link, sampler, active)
        share = endpoint.share_of_link(path, vertex, link, turn)
        lit = _along(link, path, turn, share, endpoint, space)
        path.not_finite += deliver(measurement, lit)
        more = endpoint.more_links(path, link)
        if more is not None:
            ways = more, link, path, vertex, space, endpoint, scattering
            path.not_finite += _connect(*ways, sampler, measurement, smooth)
        if endpoint.looks_ahead:
            path.not_finite += _look_around(path, vertex, smooth, *parts)
    else:
        _, bounce = scattering.scatter(vertex, None, sampler, active)

    if limits.straight:
        active &= further | bounce.straight

    # ------------------------ Move to the next vertex ----------------------

    path.memory = endpoint.leave(path, vertex, bounce)
    path.place = space.leave(path, vertex, bounce.ray.d)
    path.ray, path.guide = bounce.ray, bounce.guide
    path.β = extend(path.β, bounce.weight, endpoint.importance)
    path.η *= bounce.η
    path.prev = mi.Interaction3f(vertex.si)
    path.pdf, path.specular = bounce.pdf, bounce.specular
    path.depth = path.depth + dr.select(vertex.valid, mi.UInt32(1), 0)  # `before` keeps its own
    if limits.straight:  # The last vertex is still that before
        for name in ("depth", "pdf", "mirrored"):
            same = getattr(before, name)
            setattr(path, name, dr.select(bounce.straight, same, getattr(path, name)))

    # A path whose throughput is no number has nothing more to bring
    finite = dr.isfinite(summed(path.β))
    path.not_finite += dr.select(active & ~finite, mi.UInt32(1), 0)
    active &= finite

    # The last ray can only run into lights; a smooth surface's connections have found those
    if limits.bounded and endpoint.finds_all:
        active &= path.specular | (path.depth + 1 < limits.max_depth)

    # --------------------------- Russian roulette --------------------------

    # η² undoes the compression of radiance at refraction, which the throughput contains
    compressed = mi.Float(1) if endpoint.importance else dr.square(path.η / space.index)
    survival = dr.detach(dr.minimum(dr.max(intensity(path.β)) * compressed, 0.95))
    roulette = path.depth >= limits.rr_depth
    path.β = dr.select(roulette, path.β * dr.rcp(survival), path.β)
    active &= ~roulette | (sampler.next_1d() < survival)

    # Do not go on once the throughput is zero
    path.active = active & dr.any(intensity(path.β) != 0)
    return path


def meet(
    path: Path, vertex: Vertex, endpoint: Endpoint, measurement: Measurement, limits: Limits
) -> Path:
    """Deliver the light that paths run into at their next vertex; gives them, so much longer."""
    path = copy(path)
    hit = endpoint.hit(vertex, path)
    length = dr.select(path.depth == 0, 0, hit.length) if limits.unwarp else hit.length
    path.opl = dr.fma(path.η, length, path.opl)
    share = endpoint.share_of_hit(path, vertex, hit)
    active = hit.active
    if limits.skips_first:
        active &= path.covered | ~vertex.valid
    seen = Contribution(apply_throughput(path.β * share, hit.radiance), path.opl, active)
    path.not_finite += deliver(measurement, seen)
    return path


@dr.syntax
def _connect(count, first, path, vertex, space, endpoint, scattering, sampler, measurement, active):
    """Make `count` further connections of a vertex after its first, one after the other.

    Returns:
        Number of those that were left out, not finite.
    """
    k, not_finite = mi.UInt32(0), mi.UInt32(0)
    while active & (k < count):
        link = endpoint.link(k, first, vertex, path, sampler, active)
        link.weight *= space.transmittance(path, vertex, link, sampler)
        link.active &= ~dr.all(intensity(link.weight) == 0)
        turn = scattering.turn(vertex, link.direction, link.active)
        share = endpoint.share_of_link(path, vertex, link, turn)
        lit = _along(link, path, turn, share, endpoint, space)
        not_finite += deliver(measurement, lit)
        k += 1
    return not_finite


def _look_ahead(
    path, active, space, endpoint, scattering, measurement, limits, sampler, wait=None
) -> mi.UInt32:
    """Connect a point of a medium that rays pass; gives the number of those left out."""
    if limits.bounded:
        active &= path.depth + 1 < limits.max_depth
    wait = endpoint.wait(path, sampler, active) if wait is None else wait
    ahead, vertex, link = endpoint.ahead(path, wait, space, sampler)
    link.weight *= space.transmittance(ahead, vertex, link, sampler)
    turn = scattering.turn(vertex, link.direction, link.active)
    return deliver(measurement, _along(link, ahead, turn, mi.Float(1), endpoint, space))


def _look_around(
    path, vertex, active, space, endpoint, scattering, measurement, limits, sampler
) -> mi.UInt32:
    """The same with rays from a vertex, in directions of their own."""
    around = copy(path)
    around.prev = mi.Interaction3f(vertex.si)
    around.depth = path.depth + 1
    if limits.bounded:
        active &= around.depth + 1 < limits.max_depth
    wait = endpoint.wait(around, sampler, active)
    wait, d, pdf = endpoint.towards(wait, sampler)
    turn = scattering.turn(vertex, d, wait.active)
    around.place = space.leave(path, vertex, d)
    around.ray = vertex.si.spawn_ray(d)
    around.β = extend(path.β, turn.f / pdf)
    parts = space, endpoint, scattering, measurement, limits, sampler
    return _look_ahead(around, wait.active, *parts, wait)


def _along(
    link: Connection, path: Path, turn: Turn, share: mi.Float, endpoint: Endpoint, space: Space
) -> Contribution:
    """What a connection contributes: its share of the light, its length, and where that lands."""
    throughput = extend(path.β * share, turn.f, endpoint.importance)
    if link.frame is not None:
        throughput = extend(throughput, link.frame, endpoint.importance)
    spectrum = apply_throughput(throughput, link.weight)
    η = path.η * turn.η
    opl = dr.fma(η, link.length, path.opl)
    if endpoint.importance:  # The index is over that around the light; the sensor's is known
        opl = opl / η * space.index
    return Contribution(spectrum, opl, link.active, link.position)


def deliver(measurement: Measurement, contribution: Contribution) -> mi.UInt32:
    """Hand a contribution to a measurement, unless it is dark or not finite.

    Returns:
        1 in lanes where it was not finite, else 0.
    """
    spectrum, active = contribution.spectrum, contribution.active
    dark = dr.all(intensity(spectrum) == 0)
    finite = dark | dr.isfinite(summed(spectrum) + contribution.opl)
    measurement.add(replace(contribution, active=active & finite & ~dark))
    return dr.select(active & ~finite, mi.UInt32(1), 0)
