"""Confocal paths by a Python loop over bounces, each with a direction that is even in solid angle.

The wall sends its paths out evenly over the hemisphere instead of by its material, and the lit
point's intensity is written out.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
from relay_wall import is_on_relay_wall
from transient_path import TransientPath


class ConfocalTransientIntegrator(TransientPath):
    """Laser and camera along the same ray, into the time bins of a film."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.power = props.get("power", 1.0)
        names = props.get("relay_wall", "relay_wall")
        self.relay_wall = [name.strip() for name in names.split(",")]
        self.use_nlos_only = props.get("use_nlos_only", False)
        self.spot_sigma = props.get("spot_sigma", 0.0)

    def wall_shapes(self, scene: mi.Scene) -> list[mi.Shape]:
        """The shapes of the relay wall (given)."""
        shapes = [shape for shape in scene.shapes() if shape.id() in self.relay_wall]
        if len(shapes) != len(self.relay_wall):
            ids = ", ".join(shape.id() for shape in scene.shapes())
            raise ValueError(
                f"relay_wall = {self.relay_wall}: must be ids of shapes, which are {ids}; "
                "load the scene with optimize=False"
            )
        return shapes

    def sample(self, scene, sampler, ray, deposit, origin, active=True):
        """Follow paths that start at the wall, and connect their vertices to the laser spot."""
        ctx = mi.BSDFContext()
        wall = self.wall_shapes(scene)
        si = scene.ray_intersect(ray, mi.Bool(active))
        first = si
        valid = si.is_valid()
        active = mi.Bool(valid)
        opl = dr.norm(si.p - origin)
        L = mi.Color3f(0)
        throughput = mi.Color3f(1)
        off_wall = active & ~is_on_relay_wall(si, wall)

        for _ in range(2, self.max_depth):
            # Next vertex, by a direction that is even over the hemisphere that the path came from
            wo = mi.warp.square_to_uniform_hemisphere(sampler.next_2d())
            wo.z = dr.mulsign(wo.z, si.wi.z)
            f = si.bsdf().eval(ctx, si, wo, active)
            throughput *= f * (2 * math.pi)
            here = si.p
            si = scene.ray_intersect(si.spawn_ray(si.to_world(wo)), active)
            active &= si.is_valid() & (dr.max(throughput) > 0)
            opl += dr.norm(si.p - here)
            off_wall |= active & ~is_on_relay_wall(si, wall)

            # The lit point as seen from there
            spot = self._spot(scene, sampler, ray, origin, first)
            away = si.p - spot.p
            r = dr.norm(away)
            connected = active & spot.is_valid() & (r > 0)
            if self.use_nlos_only:
                connected &= off_wall
            connected &= ~scene.ray_test(si.spawn_ray_to(spot.p), connected)
            wo = si.to_local(-away / r)
            reflected = si.bsdf().eval(ctx, si, wo, connected)
            towards = spot.to_local(away / r)
            intensity = self.power * spot.bsdf().eval(ctx, spot, towards, connected)
            light = throughput * reflected * intensity / (r * r)
            light = dr.select(connected, light, 0)
            L += light
            deposit(light, opl + r + dr.norm(spot.p - origin), connected & (dr.max(light) > 0))
        return L, valid

    def _spot(self, scene, sampler, ray, origin, first):
        """Where the beam lands: the first vertex, or a point around it."""
        if self.spot_sigma == 0:
            return first
        radius, turn = sampler.next_2d()
        radius = dr.sqrt(-2 * dr.log(1 - radius)) * math.tan(self.spot_sigma)  # Box and Muller
        sin, cos = dr.sincos(2 * math.pi * turn)
        frame = mi.Frame3f(ray.d)
        d = dr.normalize(frame.to_world(mi.Vector3f(radius * cos, radius * sin, 1)))
        return scene.ray_intersect(mi.Ray3f(origin, d))


mi.register_integrator("confocal_transient_path", ConfocalTransientIntegrator)
