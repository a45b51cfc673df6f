"""Integrator plugin `transient_nlos_path`: captures with a projector that is part of the scene."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...films.contribution import Contribution
from ...paths.endpoints import SceneLights
from ...paths.records import Connection, Path, Vertex
from ...paths.surfaces import first_surface
from ...runtime import checks
from ...runtime.backend import tracing_lock
from ...signals.illuminants import white
from ..device.laser import apply_meters, axis, find_laser, position_of, require_aim, solid_angle
from ..device.relay_wall import first_hits, trace_laser_spot
from ..modes import MODES
from .laser_spot import (
    OffWallHistory,
    Spot,
    counted_lanes,
    require_clear_way,
    require_smooth_spot,
    trace_beam,
)
from .relay_wall_path import HIDDEN_SAMPLING, RelayWallPath, flag, warn_no_effect
from .scan import Scan
from .scan_plan import ScanPlan

AREA = 1.0
"""Area of the laser spot [m^2], as in the plugin of the same name in mitransient."""

GRAZING = 1e-4
"""A laser is in the plane of the wall if its cosine to the wall's normal is smaller."""


class TransientNLOSPath(RelayWallPath):
    """Non-line-of-sight captures as mitransient describes them (plugin `transient_nlos_path`).

    The only emitter of the scene, a projector or spot, is the laser. An `nlos_capture_meter` can
    define its position. With `nlos_laser_sampling`, paths connect to the laser spot. In a single
    capture, the spot is where the laser is aimed. In a confocal capture, the spot is where the
    camera ray hits, as if the emitter were aimed there.

    A laser spot represents one square meter. The power that arrives is the irradiance at the spot
    times 1 m^2, so that it decreases with the distance of the laser. `laser_power` [W] sets the
    power of a real laser instead. All bounces have the same power. In light of a single bounce,
    the beam carries this power. Therefore this light is brighter than the emitter's light by 1 m^2
    over the beam's footprint, e.g. 10^4 times for 0.2 degrees at 2.8 m. Without
    `nlos_laser_sampling`, all bounces have the emitter's power.

    Accepts the parameters of `RelayWallPath`, with `account_first_and_last_bounces` false by
    default, and

    | parameter | default | meaning |
    |---|---|---|
    | `capture_type` | none | "single", "confocal" or "exhaustive" (1, 2, 3), see below |
    | `laser_power` | none | power that arrives on the wall at each laser spot [W] |
    | `nlos_laser_sampling` | false | connect to the laser spot; otherwise to the emitter |
    | `nlos_hidden_geometry_sampling` | false | as in `RelayWallPath` |
    | `nlos_hidden_geometry_sampling_do_rroulette` | false | sample by BSDF and area equally often |
    | `nlos_hidden_geometry_sampling_includes_relay_wall` | false | the wall is a target, too |
    | `nlos_hidden_geometry_sampling_max_depth` | -1 | ignored with a warning |
    | `discard_direct_paths` | false | drop paths of a single bounce |
    | `filter_depth` | -1 | `filter_bounces` plus one, set instead of `filter_bounces` |
    | `force_equal_illumination_scanning` | true | exhaustive captures light the sensor's points |
    | `illumination_scan_fov` | 20 | ignored with a warning |

    `capture` uses `capture_type` as its mode. Without `capture_type`, `render` renders the light of
    a single laser spot. Only `capture` renders exhaustive captures.

    Unlike in mitransient, light of a single bounce is visible, occluded light does not count,
    surfaces count from both sides, and the choice between two techniques conserves energy.

    Example:
        >>> integrator = mi.load_dict({"type": "transient_nlos_path", "capture_type": 2})
        >>> integrator.capture_type
        'confocal'
    """

    counts_legs_by_default = False
    samples_hidden_by_default = False

    def __init__(self, props: mi.Properties) -> None:
        # Read the capture type, a name or a number
        kind: Any = props.get("capture_type", None)
        if isinstance(kind, int) and not isinstance(kind, bool) and 1 <= kind <= 3:
            kind = MODES[kind - 1]
        kind = kind.lower() if isinstance(kind, str) else kind
        if kind is not None:
            checks.one_of("capture_type", kind, MODES)
        self.capture_type: str | None = kind
        _read_mitransient(props)

        # Read which directions are sampled and which paths count
        self.lights_a_point = flag(props, "nlos_laser_sampling")
        self.discard_direct_paths = flag(props, "discard_direct_paths")
        self.targets_wall = flag(props, f"{HIDDEN_SAMPLING}_includes_relay_wall")

        # A few BSDF samples remain always, because they find the edges where wall and hidden
        # geometry meet
        by_material = flag(props, f"{HIDDEN_SAMPLING}_do_rroulette")
        self.hidden_probability = 0.5 if by_material else 0.9

        # Read the power of the laser spot
        self.laser_power: Any = props.get("laser_power", None)
        if self.laser_power is not None:
            power = checks.number("laser_power", self.laser_power, positive=True, unit="watts")
            self.laser_power = power
            allowed = "left out without nlos_laser_sampling"
            checks.require("laser_power", self.laser_power, self.lights_a_point, allowed)
        super().__init__(props)

    def targets(self, hidden: list[mi.Shape], wall: list[mi.Shape]) -> list[mi.Shape]:
        """Return the target surfaces: the hidden shapes, and the wall if it is included."""
        return hidden + wall * self.targets_wall

    def capture_plan(
        self, scene: mi.Scene, sensor: mi.Sensor | None, wall: Any = None, mode: str | None = None
    ) -> ScanPlan:
        """Plan the scan with the scene's laser.

        An exhaustive capture is planned as a single capture, once for each laser spot.
        """
        # An exhaustive scan cannot be rendered at once
        kind = self._kind(sensor) if mode is None else mode
        if kind == "exhaustive":
            allowed = (
                "'single' or 'confocal' to render; "
                "tofrender.capture(scene, mode='exhaustive') makes exhaustive captures"
            )
            checks.require("capture_type", kind, mode, allowed)
            require_clear_way(scene, sensor, self.laser_origin(scene, sensor))
            kind = "single"

        # Refuse a confocal capture without a laser spot
        allowed = "true for confocal captures, whose laser lights one point after the other"
        samples = self.lights_a_point
        checks.require("nlos_laser_sampling", samples, samples or kind != "confocal", allowed)

        # Plan the scan of this laser
        find_laser(scene)
        apply_meters(scene, sensor)
        plan = super().capture_plan(scene, sensor, wall)
        if self.lights_a_point:
            self._check_aim(plan.scan, kind, sensor)

            # An opaque solid angle allows one kernel for all lasers
            if self.shows_spot:
                beam = solid_angle(find_laser(scene))
                plan.scan.solid_angle = dr.opaque(mi.Float, beam)
        plan.scan.follows_camera = kind == "confocal"
        if kind == "confocal" and sensor is not None:
            require_clear_way(scene, sensor, self.laser_origin(scene, sensor))
        return plan

    def laser_origin(self, scene: mi.Scene, sensor: mi.Sensor) -> np.ndarray:
        """Return the position of the scene's laser [m]."""
        return position_of(find_laser(scene))

    def capture_modes(self, sensor: mi.Sensor | None) -> tuple[str, ...]:
        """Return the mode of `capture_type`, otherwise the modes that the sensor allows."""
        if self.capture_type is not None:
            return (self.capture_type,)
        confocal = getattr(sensor, "confocal", None)
        if confocal is None:
            return super().capture_modes(sensor)
        return ("confocal",) if confocal else ("single", "exhaustive")

    def _kind(self, sensor: mi.Sensor | None) -> str:
        """Return the capture type, by default the sensor's, and warn if they differ."""
        confocal = getattr(sensor, "confocal", None)
        if self.capture_type is None:
            return "confocal" if confocal else "single"
        differs = confocal is not None and confocal != (self.capture_type == "confocal")
        if differs:
            warn_no_effect("confocal", confocal, f"capture_type is {self.capture_type!r}")
        return self.capture_type

    @tracing_lock()
    def _check_aim(self, scan: Scan, kind: str, sensor: mi.Sensor | None) -> None:
        """Raise a ValueError if the laser misses the wall or is in the plane of the wall."""
        # Single capture: where does the laser hit the wall?
        if kind == "single":
            require_aim(scan.scene)
            trace_laser_spot(scan.scene, scan.wall)
            beam = mi.Ray3f(*axis(find_laser(scan.scene)))
            require_smooth_spot(scan, first_surface(scan.scene, beam))
        elif sensor is not None:
            # Confocal capture: does any pixel see the laser?
            origin = axis(find_laser(scan.scene))[0]
            _, si = first_hits(scan.scene, sensor)
            require_smooth_spot(scan, si)
            cos = dr.dot(si.n, dr.normalize(origin - si.p))
            if not dr.any(si.is_valid() & (dr.abs(cos) > GRAZING)):
                where = np.array(origin).ravel().tolist()
                raise ValueError(
                    f"laser: its position {where} is in the plane of the surface that the sensor "
                    "sees. Move the laser in front of this surface"
                )

    def laser(
        self, scan: Scan, ray: mi.Ray3f, origin: mi.Point3f, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Any, Contribution | None]:
        """Return the endpoint at the laser spot, or at the emitter, and the visible spot."""
        if not self.lights_a_point:
            return LaserEmitter(scan, self.shows_spot), None
        scene = scan.scene
        emitter = find_laser(scene)
        source, forward = axis(emitter)

        def irradiance(d: mi.Vector3f, r: mi.Float) -> Any:
            # Irradiance on a surface that faces the laser, from one emitter sample
            lit = dr.zeros(mi.SurfaceInteraction3f)
            lit.p = source + r * d
            lit.wavelengths = ray.wavelengths
            return mi.unpolarized_spectrum(emitter.sample_direction(lit, mi.Point2f(0.5))[1])

        # Aim the laser at the surface that the camera ray hits, or along the emitter's axis
        confocal = scan.follows_camera
        towards = forward
        if confocal:
            towards = dr.normalize(first_surface(scene, ray, active).p - source)
        beam = mi.Ray3f(source, towards, 0, ray.wavelengths)
        unit = mi.UnpolarizedSpectrum(1)

        def single(sampler: mi.Sampler, active: mi.Bool) -> Spot:
            spot = trace_beam(scan, beam, unit, active, source)
            if self.laser_power:
                spot.power *= self.laser_power * white(ray.wavelengths)
            else:
                # The power that the emitter sends to AREA along its axis
                facing = irradiance(forward, dr.norm(spot.si.p - source))
                spot.power *= facing * dr.abs(spot.si.wi.z) * AREA
            return spot

        spot = single(sampler, active)
        power = spot.power

        # Light of a single bounce: a beam of the same power, with the emitter's solid angle
        seen = None
        if self.shows_spot:

            def light(d: mi.Vector3f, r: mi.Float) -> Any:
                off_axis = mi.Float(1)
                if not confocal:
                    off_axis = dr.max(irradiance(d, r)) / dr.max(irradiance(forward, r))
                return power * off_axis / (scan.solid_angle * r * r)

            seen = self.single_bounce(scan, ray, origin, source, light, sampler, active)
        return self.laser_spot(scan, scan.reuse(single, spot)), seen

    @property
    def shows_spot(self) -> bool:
        """Return whether light of a single bounce counts."""
        return not (self.discard_direct_paths or self.use_nlos_only)


def _read_mitransient(props: mi.Properties) -> None:
    """Translate parameters of mitransient, or warn that they are ignored."""
    # Limit of bounces
    depth: Any = props.get("filter_depth", -1)
    if not isinstance(depth, int) or depth != -1:
        checks.integer("filter_depth", depth, 2, checks.MAX_DEPTH)
        free = props.get("filter_bounces", -1) == -1
        checks.require("filter_depth", depth, free, "left out; filter_bounces is given")
        props["filter_bounces"] = depth - 1

    # Illumination points
    name = "force_equal_illumination_scanning"
    equal = checks.boolean(name, props.get(name, True))
    checks.require(name, equal, equal, "True; all captures light the sensor's points")

    # Parameters without an effect
    limit = f"{HIDDEN_SAMPLING}_max_depth"
    fov = "illumination_scan_fov"
    if props.get(limit, -1) != -1:
        checks.integer(limit, props[limit], 1, checks.MAX_DEPTH)
        warn_no_effect(limit, props[limit], "paths are sent from the relay wall only")
    if fov in props:
        checks.number(fov, props[fov], positive=True, unit="degrees")
        warn_no_effect(fov, props[fov], "the laser lights the sensor's points")


class LaserEmitter(SceneLights):
    """Next-event estimation of the scene's laser, restricted to the paths that a scan includes.

    Args:
        scan: The scan.
        counts_single_bounce: Whether to include light that is scattered only once, at the wall.
    """

    def __init__(self, scan: Scan, counts_single_bounce: bool) -> None:
        super().__init__(scan.scene, None, scan.hide_emitters)
        self.scan = scan
        self.counts_single_bounce = counts_single_bounce
        self.history = OffWallHistory(scan.wall) if scan.hidden_only else None

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect to the laser as `SceneLights` does, for paths that the scan includes.

        The scan decides by the depth of the path and by its earlier vertices. Light of a single
        bounce must also have the path length `first_opl` or more. The length of the connection is
        0 if the scan's path lengths do not contain the segment from the laser.
        """
        # Does the path count?
        if not self.counts_single_bounce:
            active = active & (path.depth > 0)
        active = counted_lanes(self.scan, path, path.depth + 1, active)

        # Connect to the laser, with or without the length of this leg
        connection = super().connect(vertex, path, sampler, active)
        connection.length = connection.length if self.scan.counts_legs else mi.Float(0)

        # Drop light of a single bounce that arrives too early
        first_opl = self.scan.first_opl
        if first_opl > 0:
            long_enough = path.opl + connection.length >= first_opl
            connection.active &= (path.depth > 0) | long_enough
        return connection

    def min_distance(self, p: mi.Point3f) -> mi.Float:
        """Return 0 [m], because lengths may not include the leg from the laser."""
        return mi.Float(0)
