"""Integrator plugin `confocal_transient_path`: a scanned laser that follows the camera rays."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from ...films.contribution import Contribution
from ...runtime import checks
from ...signals.illuminants import white
from ..device.relay_wall import first_hits
from .laser_spot import require_clear_way, require_smooth_spot, trace_beam
from .relay_wall_path import RelayWallPath
from .scan import Scan, Spot

MAX_SIGMA = 0.75
"""Standard deviation of the widest beam [rad]. The projector must contain eight of its tangents."""


class ConfocalTransientIntegrator(RelayWallPath):
    """Laser and camera along the same ray (plugin `confocal_transient_path`).

    Each camera ray is also a laser beam. Its first surface point is the laser spot, to which all
    further vertices connect (see `LaserSpot`). Light travels from the laser to the wall, to the
    hidden scene, back to the same point of the wall, and to the camera. Consider a small hidden
    patch of area A at a distance r from the wall point, which is at the distance d from the laser.
    Its radiance and path length are

        L = Phi rho_w^2 rho_h A cos_w^2 cos_h^2 / (pi^3 r^4)   at the length 2 d + 2 r.

    At the relay wall, half of the paths continue to random points of the hidden geometry, and half
    are sampled from the wall's BSDF (see `Guided`). Accepts the parameters of `RelayWallPath`, and

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 8 | longest path in segments between camera and laser spot |
    | `power` | 1.0 | power of the laser that arrives on the wall, Phi [W] |
    | `spot_sigma` | 0.0 | standard deviation of the beam in rad, below 0.75; 0 is a point |
    | `confocal_projector` | none | a nested projector that replaces `power` and `spot_sigma` |

    The assignment handout uses other defaults: a `max_depth` of 10 and a pulse of 0.03 m. The
    defaults here are a `max_depth` of 8 and a pulse without width.

    A laser spot without a width has an infinite radiance. Therefore paths of a single bounce
    (laser, wall, camera) require a `spot_sigma` or a projector.

    Example:
        >>> integrator = mi.load_dict({"type": "confocal_transient_path", "power": 0.5})
        >>> integrator.power, integrator.max_depth
        (0.5, 8)
    """

    default_depth = 8

    def __init__(self, props: mi.Properties) -> None:
        # A projector replaces the parameters of the beam
        projector: Any = props.get("confocal_projector", None)
        if projector is not None:
            for name in ("power", "spot_sigma", "pulse_width_opl"):
                allowed = "left out; confocal_projector has it"
                checks.require(name, props.get(name, None), name not in props, allowed)

        # Read the parameters of the beam
        self.power = checks.number("power", props.get("power", 1.0), positive=True, unit="watts")
        sigma = checks.number("spot_sigma", props.get("spot_sigma", 0.0), unit="radians")
        allowed = f"from 0 to {MAX_SIGMA} radians"
        self.spot_sigma = checks.require("spot_sigma", sigma, 0 <= sigma < MAX_SIGMA, allowed)
        super().__init__(props)

        # Represent a beam with a width by a projector with a single spot
        if projector is not None:
            self.pulse = projector.pulse
        elif sigma > 0:
            projector = gaussian_beam(sigma, self.power)
        self.projector: Any = projector

    def scan(self, scene: mi.Scene, sensor: mi.Sensor | None, wall: list[mi.Shape]) -> Scan:
        """Describe the scan. Raise an error for fog between camera and spot of a point laser."""
        if self.projector is None and sensor is not None:
            require_clear_way(scene, sensor, self.laser_origin(scene, sensor))
        scan = super().scan(scene, sensor, wall)
        if sensor is not None:
            require_smooth_spot(scan, first_hits(scene, sensor)[1])
        return scan

    def laser(
        self, scan: Scan, ray: mi.Ray3f, origin: mi.Point3f, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Any, Contribution | None]:
        """Return the endpoint and visible light of a beam or a projector along the camera rays."""
        projector = self.projector
        if projector is None:
            # A point laser: trace the beam once
            power = self.power * white(ray.wavelengths)

            def single(sampler: mi.Sampler, active: mi.Bool) -> Spot:
                return trace_beam(scan, ray, power, active, origin)

            return self.laser_spot(scan, scan.reuse(single, single(sampler, active))), None
        # A projector: sample its pattern for each connection
        axes = projector.axes(ray.d, mi.Vector3f(scan.up))
        source = projector.origin(origin)

        def beam(sampler: mi.Sampler, active: mi.Bool) -> Spot:
            d, power = projector.sample_beam(axes, sampler, active, ray.wavelengths)
            lit = active & dr.any(power > 0)
            return trace_beam(scan, mi.Ray3f(source, d, 0, ray.wavelengths), power, lit, source)

        def irradiance(d: mi.Vector3f, r: mi.Float) -> Any:
            return projector.intensity(axes, d, ray.wavelengths) / (r * r)

        # The camera sees the lit surface, because the spot has a width
        seen = self.single_bounce(scan, ray, origin, source, irradiance, sampler, active)
        return self.laser_spot(scan, beam), seen

    def capture_modes(self, sensor: mi.Sensor | None) -> tuple[str, ...]:
        """Return "confocal". Raise an error for a projector that does not follow the camera."""
        follows = self.projector is None or self.projector.is_confocal
        allowed = "True for a capture, whose laser follows the camera"
        checks.require("is_confocal", follows, follows, allowed)
        return ("confocal",)

    def to_string(self) -> str:
        """Return the integrator's parameters as text."""
        laser = f"power = {self.power!r}" if self.projector is None else f"{self.projector}"
        return super().to_string()[:-1] + f", {laser}]"


def gaussian_beam(sigma: float, power: float) -> Any:
    """Create a projector with one Gaussian spot, cut off at 8 standard deviations.

    Args:
        sigma: Standard deviation of the beam's direction [rad].
        power: Power of the beam [W].
    """
    fov = min(16 * sigma, 3.0)
    return mi.load_dict(
        {
            "type": "tofrender_confocal_projector",
            "fov": fov,
            "grid_sigma": math.tan(sigma) / math.tan(fov / 2),
            "grid_intensity": power,
        }
    )


def maker(plain: Callable[[mi.Properties], Any]) -> Callable[[mi.Properties], Any]:
    """Return the factory of `transient_path`, which is confocal if it contains a projector.

    Args:
        plain: Factory of the integrator without a projector.

    The factory refers to the class of the active variant. It stays correct if this module is loaded
    again for another variant.
    """
    confocal = ConfocalTransientIntegrator
    return lambda props: (confocal if "confocal_projector" in props else plain)(props)
