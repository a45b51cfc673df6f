"""The path loop, the only one of the package.

`walk` follows paths from the sensor and hands every connection to a light to a measurement, as
(spectrum, opl, active). It knows how long each path is and nothing of pulses, films or frequencies.

A measurement is any object with `add(spectrum, opl, active)`. One that accumulates in variables is
a dataclass of Dr.Jit arrays, which the loop carries as its state; one that scatters into a film
has none. `Radiance` is the simplest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import drjit as dr
import mitsuba as mi

from .endpoints import PathState, SceneLights


class Measurement(Protocol):
    """What is done with light that arrives."""

    def add(self, spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
        """Take in a contribution.

        Args:
            spectrum: Radiance that this path carries to the sensor.
            opl: Optical path length from the emitter to the sensor [m].
            active: Lanes that have such a contribution.
        """
        ...


@dataclass
class Radiance:
    """The plain sum, as a steady camera measures it.

    Attributes:
        total: Sum of all contributions, of type `mi.UnpolarizedSpectrum`.
    """

    total: Any

    @classmethod
    def zero(cls) -> Radiance:
        """Nothing measured yet."""
        return cls(mi.UnpolarizedSpectrum(0))

    def add(self, spectrum: mi.Spectrum, opl: mi.Float, active: mi.Bool) -> None:
        """Add a contribution."""
        self.total += dr.select(active, spectrum, 0)


M = TypeVar("M", bound=Measurement)


def mis_weight(pdf_a: mi.Float, pdf_b: mi.Float) -> mi.Float:
    """Power heuristic a^2 / (a^2 + b^2) of a sample from the first density (Veach 1997, 9.13)."""
    a2 = pdf_a * pdf_a
    return dr.select(pdf_a > 0, a2 / dr.fma(pdf_b, pdf_b, a2), 0)


def transmits(scene: mi.Scene, *ways: mi.BSDFFlags) -> bool:
    """Whether a surface of the scene lets light through in one of the given ways."""
    bsdfs = [shape.bsdf().flags() for shape in scene.shapes()]
    return any(mi.has_flag(flags, way) for flags in bsdfs for way in ways)


def index_behind(
    bsdf: mi.BSDFPtr, si: mi.SurfaceInteraction3f, wo: mi.Vector3f, active: mi.Bool
) -> mi.Float:
    """Index of refraction on the side that `wo` points to, over that on the side of `si.wi`.

    Mitsuba tells it with a sample only. The one that is drawn here comes along the normal, where
    nothing is totally reflected.
    """
    ctx = mi.BSDFContext(mi.TransportMode.Radiance, int(mi.BSDFFlags.GlossyTransmission))
    through = mi.SurfaceInteraction3f(si)
    through.wi = mi.Vector3f(0, 0, dr.sign(si.wi.z))
    crossing = active & (si.wi.z * wo.z < 0)
    sample, _ = bsdf.sample(ctx, through, 0.5, mi.Point2f(0.5), crossing)
    return dr.select(crossing & (sample.eta > 0), sample.eta, 1)


def leave(si: mi.SurfaceInteraction3f, d: mi.Vector3f, specular: mi.Bool) -> mi.Ray3f:
    """The ray from a vertex in direction `d`, started a little off the surface.

    Mitsuba moves the start along the normal. After a specular bounce, whose direction is no random
    number, that would move every further vertex sideways: there the start moves along the ray, as
    far off the surface, but at most ten times that far at grazing angles.
    """
    ray = si.spawn_ray(d)
    along = dr.norm(ray.o - si.p) / dr.maximum(dr.abs(dr.dot(si.n, d)), 0.1)
    ray.o = dr.select(specular, dr.fma(d, along, si.p), ray.o)
    return ray


@dr.syntax
def walk(
    scene: mi.Scene,
    sampler: mi.Sampler,
    ray: mi.Ray3f,
    measurement: M,
    lights: SceneLights,
    max_depth: int,  # No bare * before it: dr.syntax would drop the defaults
    rr_depth: int = 5,
    origin: mi.Point3f | None = None,
    unwarp: bool = False,
    first_emission: bool = True,
    hide_emitters: bool = False,
    active: mi.Bool = True,
    last_opl: mi.Float | None = None,
    material: mi.BSDF | None = None,
    targets: Any = None,
) -> tuple[M, mi.Bool]:
    """Trace paths and hand each of their connections to a light to `measurement`.

    Unidirectional path tracing with next-event estimation and multiple importance sampling. The
    length of a path is the sum of index of refraction times distance between its vertices, taken
    point to point: rays start a little off the surface, and camera rays at the near plane. The
    index is relative to the medium that the camera is in.

    Args:
        scene: The scene.
        sampler: Random numbers; every vertex draws four, and what its connection draws.
        ray: Camera rays, of any number.
        measurement: Receives (spectrum, opl, active) of every connection.
        lights: What connections are made to.
        max_depth: Longest path in segments, camera's included: 1 shows emitters only, 2 adds
            direct light; -1 means no limit.
        rr_depth: Number of surface vertices from which on Russian roulette may end a path.
        origin: Points from which lengths are measured, the sensor's lens; by default where the
            rays start.
        unwarp: Leave out the segment from the sensor to the first vertex, so that time is the
            scene's own ("camera unwarping").
        first_emission: Whether light that comes straight from an emitter counts.
        hide_emitters: Whether the environment is invisible to the camera, as in Mitsuba. (Area
            lights are hidden before the walk, by `camera.behind_emitters`.)
        active: Lanes to trace.
        last_opl: Length at which paths may end, because longer ones count for nothing [m].
        material: What all surfaces are made of; by default each of its own.
        targets: Surfaces that rays are sent to besides where materials send them; see `targets`.

    Returns:
        The measurement, and the lanes whose camera ray met a surface.
    """
    bsdf_ctx = mi.BSDFContext()
    bounded = max_depth >= 0
    rough_glass = transmits(scene, mi.BSDFFlags.GlossyTransmission)
    glass = rough_glass or transmits(scene, mi.BSDFFlags.DeltaTransmission)

    # --------------------- Configure loop state ----------------------

    # fmt: off
    ray = mi.Ray3f(ray)              # Current ray
    depth = mi.UInt32(0)             # Surface vertices so far
    β = mi.UnpolarizedSpectrum(1)    # Path throughput
    η = mi.Float(1)                  # Index of refraction around the ray
    opl = mi.Float(0)                # Optical length up to the last vertex [m]
    valid = mi.Bool(False)           # Has the camera ray met a surface?
    active = mi.Bool(active)         # Lanes that still walk
    # fmt: on

    # The vertex before this one, and how its BSDF was sampled
    prev = dr.zeros(mi.Interaction3f)
    prev.p = mi.Point3f(ray.o if origin is None else origin)
    prev_pdf = mi.Float(1)
    prev_delta = mi.Bool(True)
    aimed = mi.Float(0)  # Distance to the point that the ray was sent to, or 0 [m]
    memory = mi.Bool(False)  # What the light strategy remembers of the vertices

    while dr.hint(active, max_iterations=max_depth if bounded else -1, label="walk"):
        si = scene.ray_intersect(
            ray, ray_flags=mi.RayFlags.All, coherent=(depth == 0), active=active
        )
        if dr.hint(targets is not None, mode="scalar"):
            β, prev_pdf, active = targets.arrive(si, prev, prev_pdf, prev_delta, aimed, β, active)
        active_next = active & si.is_valid()

        # ------------------ Light that the ray runs into -----------------

        Le, em_pdf, length = lights.hit(si, prev, ray, active)
        if dr.hint(unwarp, mode="scalar"):
            length = dr.select(depth == 0, 0, length)
        visible = active & dr.any(Le != 0)
        if dr.hint(hide_emitters, mode="scalar"):
            visible &= (depth > 0) | si.is_valid()
        if dr.hint(not first_emission, mode="scalar"):
            visible &= depth > 0

        opl = dr.fma(η, length, opl)
        mis_hit = 0 if lights.finds_all else mis_weight(prev_pdf, em_pdf)
        mis_hit = dr.select(prev_delta, mi.Float(1), mis_hit)
        measurement.add(β * mis_hit * Le, opl, visible)

        # ----------------- Stop at the last surface vertex ---------------

        valid |= active_next & (depth == 0)
        if dr.hint(bounded, mode="scalar"):
            active_next &= depth + 1 < max_depth
        if dr.hint(last_opl is not None, mode="scalar"):
            # Behind glass, the way to a light may be optically shorter than it is long
            to_light = mi.Float(0) if glass else lights.nearest(si.p)
            active_next &= opl + to_light <= last_opl

        # ---------- Connect to a light and sample the next ray -----------

        bsdf = si.bsdf() if material is None else material
        if dr.hint(lights.connects, mode="scalar"):
            # Connections to a smooth BSDF only: a delta lobe reflects none of them
            active_em = active_next & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            memory = lights.remember(memory, si, active_next)
            shared = (aimed != 0) & ~prev_delta
            path = PathState(opl, η, depth, memory, prev, prev_pdf, shared)
            em = lights.connect(si, path, sampler, active_em)
            wo = si.to_local(em.direction)
            f, pdf, bs, bsdf_weight = bsdf.eval_pdf_sample(
                bsdf_ctx, si, wo, sampler.next_1d(), sampler.next_2d(), active_next
            )
            if dr.hint(targets is not None, mode="scalar"):
                pdf *= targets.material_share(si)
            mis_em = dr.select(em.delta, 1, mis_weight(em.pdf, pdf))
            Lr = β * mis_em * mi.unpolarized_spectrum(f) * em.weight
            η_em = mi.Float(η)
            if dr.hint(rough_glass, mode="scalar"):
                η_em *= index_behind(bsdf, si, wo, em.active)
            measurement.add(Lr, dr.fma(η_em, em.length, opl), em.active & dr.any(Lr != 0))
        else:
            bs, bsdf_weight = bsdf.sample(
                bsdf_ctx, si, sampler.next_1d(), sampler.next_2d(), active_next
            )

        # ------------------- Move to the next vertex ---------------------

        if dr.hint(targets is not None, mode="scalar"):
            bs, bsdf_weight, aimed = targets.aim(
                bsdf_ctx, si, bsdf, bs, bsdf_weight, sampler, active_next
            )
        ray = leave(si, si.to_world(bs.wo), mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta))
        if dr.hint(targets is not None, mode="scalar"):
            ray = targets.send(ray, si, aimed)
        β *= mi.unpolarized_spectrum(bsdf_weight)
        η *= bs.eta
        prev = mi.Interaction3f(si)
        prev_pdf = bs.pdf
        prev_delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)

        depth[si.is_valid()] += 1

        # The last ray can only run into lights; a smooth surface's connections have found those
        if dr.hint(bounded and lights.finds_all, mode="scalar"):
            active_next &= prev_delta | (depth + 1 < max_depth)

        # ---------------------- Russian roulette -------------------------

        # η² undoes the compression of radiance at refraction, which the throughput contains
        survival = dr.minimum(dr.max(β) * η * η, 0.95)
        roulette = depth >= rr_depth
        β[roulette] *= dr.rcp(survival)
        active_next &= ~roulette | (sampler.next_1d() < survival)

        # Do not go on once the throughput is zero
        active_next &= dr.any(β != 0)
        active = active_next

    return measurement, valid
