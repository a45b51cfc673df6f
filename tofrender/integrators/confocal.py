"""Integrator plugin `confocal_transient_path`: a scanned laser that lights what the camera sees."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import checks
from ..lights.laser_spot import LaserSpot, Spot
from ..relay_wall import DEFAULT_ID, find_relay_wall
from ..targets import Targets
from .transient_path import TransientPath

MAX_SIGMA = 0.35
"""Widest beam: standard deviation of its direction [rad]."""

HIDDEN_SHARE = 0.5
"""Probability with which a path leaves the wall towards a point of the hidden geometry."""


class ConfocalTransientIntegrator(TransientPath):
    """Laser and camera along the same ray (plugin `confocal_transient_path`).

    Each camera ray is a laser beam, too: the point that it meets first is lit, and is the light of
    all further vertices (`lights.LaserSpot`). Light goes from laser to wall, to the hidden scene,
    to the same point of the wall, and back to the camera; for a small patch of area A at a distance
    r from the wall, which is at d,

        L = Phi rho_w^2 rho_h A cos_w^2 cos_h^2 / (pi^3 r^4)   at the length 2 d + 2 r.

    Paths leave the relay wall towards points of the hidden geometry, by area, as often as by the
    wall's material (`targets.Targets`). Takes the parameters of `TransientPath`, and

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 8 | longest path in segments between camera and lit point |
    | `power` | 1.0 | power of the laser that arrives on the wall, Phi [W] |
    | `spot_sigma` | 0.0 | standard deviation of the beam's direction [rad]; 0 is a point |
    | `confocal_projector` | none | a nested emitter of that kind, instead of the two above |
    | `relay_wall` | "relay_wall" | ids of the wall's shapes, separated by commas |
    | `use_nlos_only` | false | count only paths that have met something else than the wall |
    | `filter_bounces` | 0 | count only paths of so many surface points (3: wall, object, wall) |
    | `nlos_hidden_geometry_sampling` | true | sample hidden geometry by area where it is known |
    | `account_first_and_last_bounces` | true | count the legs from laser and camera to the wall |

    A point lit by a point has no finite radiance of its own: paths of a single bounce (laser, wall,
    camera) are there with a spot of some width only.

    Attributes:
        relay_wall: Ids or shapes of the wall; can be set.

    Example:
        >>> integrator = mi.load_dict({"type": "confocal_transient_path", "power": 0.5})
        >>> integrator.power, integrator.max_depth
        (0.5, 8)
    """

    def __init__(self, props: mi.Properties) -> None:
        if "max_depth" not in props:
            props["max_depth"] = 8
        projector: Any = props.get("confocal_projector", None)
        if projector is not None:
            for name in ("power", "spot_sigma", "pulse_width_opl"):
                if name in props:
                    raise ValueError(
                        f"{name} = {props[name]}: must be left out; confocal_projector has it"
                    )
        self.power = checks.metres("power", props.get("power", 1.0), positive=True, unit="watts")
        sigma = checks.metres("spot_sigma", props.get("spot_sigma", 0.0), unit="radians")
        if not 0 <= sigma < MAX_SIGMA:
            raise ValueError(f"spot_sigma = {sigma:g}: must be from 0 to {MAX_SIGMA} radians")
        self.spot_sigma = sigma
        wall: Any = props.get("relay_wall", None)
        self.relay_wall: Any = None if wall is None else [each.strip() for each in wall.split(",")]
        self.use_nlos_only, self.samples_hidden, self.counts_legs = (
            checks.boolean(name, props.get(name, default))
            for name, default in (
                ("use_nlos_only", False),
                ("nlos_hidden_geometry_sampling", True),
                ("account_first_and_last_bounces", True),
            )
        )
        bounces = props.get("filter_bounces", 0)
        self.filter_bounces = checks.integer("filter_bounces", bounces, 0, checks.MAX_DEPTH)
        super().__init__(props)
        self.camera_unwarp |= not self.counts_legs
        if projector is not None:
            self.pulse = projector.pulse
        elif sigma > 0:
            projector = round_beam(sigma, self.power)
        self.projector: Any = projector

    def lights(self, scene: mi.Scene, sensor: mi.Sensor | None = None) -> Any:
        """What lights the wall; a camera ray makes it a strategy for `walk`."""
        wall = self._wall(scene)
        hidden = [s for s in scene.shapes() if s not in wall and not s.is_emitter()]
        if self.use_nlos_only and not hidden:
            raise ValueError("scene: has no hidden geometry; all its shapes are the relay wall")
        self.targets = None
        if self.samples_hidden and wall and hidden:
            self.targets = Targets(scene, hidden, wall, HIDDEN_SHARE)
        up = [0, 1, 0]
        if sensor is not None:
            up = np.array(sensor.world_transform().matrix).reshape(4, 4)[:3, 1].tolist()
        return Scan(scene, wall, up)

    def _wall(self, scene: mi.Scene) -> list[mi.Shape]:
        """The relay wall; none where nobody asks for it and the scene does not name one."""
        needed = self.use_nlos_only or self.relay_wall is not None
        if not needed and DEFAULT_ID not in [shape.id() for shape in scene.shapes()]:
            return []
        return find_relay_wall(scene, self.relay_wall or DEFAULT_ID)

    def trace(self, scene, sampler, ray, origin, measurement, lights, active=True, last_opl=None):
        """Follow camera rays, each of them lit by its own laser beam."""
        scan, active = lights, mi.Bool(active)
        beam, first = self._beam(scan, ray, origin, active)
        laser = LaserSpot(scene, beam, scan.wall, self.use_nlos_only, self.filter_bounces)
        if first is not None and not self.use_nlos_only and self.filter_bounces in (0, 1):
            measurement.add(*first)
        return super().trace(
            scene, sampler, ray, origin, measurement, laser, active=active, last_opl=last_opl
        )

    def _beam(self, scan: Scan, ray: mi.Ray3f, origin: Any, active: mi.Bool) -> tuple[Any, Any]:
        """The beam that belongs to a camera ray, and what the camera sees of its spot."""
        power = mi.UnpolarizedSpectrum(self.power)
        if self.projector is None:
            spot = self._spot(scan.scene, ray, origin, power, active)
            return lambda sampler, active: spot, None
        projector = self.projector
        axes, source = projector.axes(ray.d, mi.Vector3f(scan.up)), projector.origin(origin)

        def beam(sampler: mi.Sampler, active: mi.Bool) -> Spot:
            d, carried = projector.sample_beam(axes, sampler, active)
            lit = dr.any(carried > 0)
            return self._spot(scan.scene, mi.Ray3f(source, d), source, carried, active & lit)

        return beam, self._seen_spot(scan.scene, ray, origin, source, axes, active)

    def _spot(self, scene: mi.Scene, ray: Any, origin: Any, power: Any, active: mi.Bool) -> Spot:
        spot = Spot.of_beam(scene, ray, power, active, origin)
        spot.distance = spot.distance if self.counts_legs else mi.Float(0)
        return spot

    def _seen_spot(self, scene, ray, origin, source, axes, active) -> tuple[Any, Any, Any]:
        """Light that comes straight back from what the camera sees: (spectrum, opl, active)."""
        si = scene.ray_intersect(ray, active)
        to_laser = source - si.p
        r = dr.norm(to_laser)
        d = to_laser / r
        seen = active & si.is_valid()
        if not self.projector.is_confocal:
            seen &= ~scene.ray_test(si.spawn_ray_to(source), seen)
        f = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(d), seen)
        radiance = mi.unpolarized_spectrum(f) * self.projector.intensity(axes, -d) / (r * r)
        camera = dr.select(self.camera_unwarp, 0, dr.norm(si.p - origin))
        opl = camera + (r if self.counts_legs else 0)
        return radiance, opl, seen & dr.any(radiance != 0)

    def to_string(self) -> str:
        """The integrator's parameters."""
        names = ("max_depth", "power", "spot_sigma", "projector", "use_nlos_only", "filter_bounces")
        values = ", ".join(f"{name} = {getattr(self, name)!r}" for name in names)
        return f"ConfocalTransientIntegrator[{values}]"


@dataclass
class Scan:
    """A scene, its relay wall and the camera's upward direction."""

    scene: mi.Scene
    wall: list[mi.Shape]
    up: list[float]


def round_beam(sigma: float, power: float) -> Any:
    """A projector with one spot of standard deviation `sigma` [rad], cut off at 8 of them."""
    fov = min(16 * sigma, 3.0)
    return mi.load_dict(
        {
            "type": "tofrender_confocal_projector",
            "fov": fov,
            "grid_sigma": math.tan(sigma) / math.tan(fov / 2),
            "grid_intensity": power,
        }
    )


def _chooser(plain: type, confocal: type) -> Callable[[mi.Properties], Any]:
    """Makes `transient_path` as scenes name it: a confocal one with a projector nested in it.

    The classes are those of the active variant, whatever this module becomes in another one.
    """
    return lambda props: (confocal if "confocal_projector" in props else plain)(props)


for name in ("confocal_transient_path", "tofrender_confocal_transient_path"):
    mi.register_integrator(name, ConfocalTransientIntegrator)
for name in ("transient_path", "tofrender_transient_path"):
    mi.register_integrator(name, _chooser(TransientPath, ConfocalTransientIntegrator))
