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
from ..captures import MODES
from ..device.laser import apply_meters, axis, find_laser, position_of, require_aim, solid_angle
from ..device.relay_wall import first_hits, trace_laser_spot
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
"""Area that a laser spot stands for [m^2], as in the plugin of the same name in mitransient."""

GRAZING = 1e-4
"""Cosine between a wall's normal and the laser below which the laser is in the wall's plane."""


class TransientNLOSPath(RelayWallPath):
    """Non-line-of-sight captures as mitransient describes them (plugin `transient_nlos_path`).

    The scene's one emitter, a projector or spot, is the laser; an `nlos_capture_meter` can say
    where it is. With `nlos_laser_sampling` paths connect to its laser spot: in a single capture
    where it is aimed, in a confocal capture where the camera ray hits, as if the emitter were aimed
    there. A laser spot stands for one square metre: the power that arrives is the irradiance at
    that point times 1 m^2, which falls with the distance of the laser, or `laser_power` [W], as of
    a real one. All bounces are of that power. Light of a single bounce is that of a beam of that
    power, so that it is brighter than the emitter's own by 1 m^2 over the beam's footprint: 10^4
    times for 0.2 degrees at 2.8 m. Without `nlos_laser_sampling` all bounces have the emitter's own
    power. Besides the parameters of `RelayWallPath`, with `account_first_and_last_bounces` false by
    default:

    | parameter | default | meaning |
    |---|---|---|
    | `capture_type` | none | "single", "confocal" or "exhaustive" (1, 2, 3), see below |
    | `laser_power` | none | power that arrives on the wall, wherever it is lit [W] |
    | `nlos_laser_sampling` | false | connect to the laser spot; else to the emitter |
    | `nlos_hidden_geometry_sampling` | false | as in `RelayWallPath` |
    | `nlos_hidden_geometry_sampling_do_rroulette` | false | also by material; else by area alone |
    | `nlos_hidden_geometry_sampling_includes_relay_wall` | false | the wall is a target, too |
    | `nlos_hidden_geometry_sampling_max_depth` | -1 | a warning: paths leave the wall only |
    | `discard_direct_paths` | false | drop paths of a single bounce |
    | `filter_depth` | -1 | one more than `filter_bounces`, instead of it |
    | `force_equal_illumination_scanning` | true | exhaustive captures light the sensor's points |
    | `illumination_scan_fov` | 20 | a warning: there are no others |

    `capture` uses `capture_type` as its mode. Without `capture_type`, `render` renders the light of
    a single laser spot. Only `capture` renders exhaustive captures.

    Unlike in mitransient, light of a single bounce is shown, occluded light does not count,
    surfaces count from both sides, and choosing between two samplings keeps the energy.

    Example:
        >>> integrator = mi.load_dict({"type": "transient_nlos_path", "capture_type": 2})
        >>> integrator.capture_type
        'confocal'
    """

    counts_legs_by_default = samples_hidden_by_default = False

    def __init__(self, props: mi.Properties) -> None:
        kind: Any = props.get("capture_type", None)
        if isinstance(kind, int) and not isinstance(kind, bool) and 1 <= kind <= 3:
            kind = MODES[kind - 1]
        kind = kind.lower() if isinstance(kind, str) else kind
        if kind is not None:
            checks.one_of("capture_type", kind, MODES)
        self.capture_type: str | None = kind
        _read_mitransient(props)
        self.lights_a_point = flag(props, "nlos_laser_sampling")
        self.discard_direct_paths = flag(props, "discard_direct_paths")
        self.targets_wall = flag(props, f"{HIDDEN_SAMPLING}_includes_relay_wall")
        # Without the material as often, it still finds where the wall meets hidden geometry
        by_material = flag(props, f"{HIDDEN_SAMPLING}_do_rroulette")
        self.hidden_probability = 0.5 if by_material else 0.9
        self.laser_power: Any = props.get("laser_power", None)
        if self.laser_power is not None:
            power = checks.number("laser_power", self.laser_power, positive=True, unit="watts")
            self.laser_power = power
            allowed = "left out without nlos_laser_sampling"
            checks.require("laser_power", self.laser_power, self.lights_a_point, allowed)
        super().__init__(props)

    def targets(self, hidden: list[mi.Shape], wall: list[mi.Shape]) -> list[mi.Shape]:
        """Surfaces that paths are sent to, with the wall if it is included."""
        return hidden + wall * self.targets_wall

    def capture_plan(
        self, scene: mi.Scene, sensor: mi.Sensor | None, wall: Any = None, mode: str | None = None
    ) -> ScanPlan:
        """Plan the scan of the scene's one laser.

        An exhaustive capture is a single one for each laser spot.
        """
        kind = self._kind(sensor) if mode is None else mode
        if kind == "exhaustive":
            allowed = (
                "'single' or 'confocal' to render; "
                "tofrender.capture(scene, mode='exhaustive') makes exhaustive captures"
            )
            checks.require("capture_type", kind, mode, allowed)
            require_clear_way(scene, sensor, self.laser_origin(scene, sensor))
            kind = "single"
        allowed = "true for confocal captures, whose laser lights one point after the other"
        samples = self.lights_a_point
        checks.require("nlos_laser_sampling", samples, samples or kind != "confocal", allowed)
        find_laser(scene)
        apply_meters(scene, sensor)
        plan = super().capture_plan(scene, sensor, wall)
        if self.lights_a_point:
            self._check_aim(plan.scan, kind, sensor)
            if self.shows_spot:
                beam = solid_angle(find_laser(scene))
                plan.scan.solid_angle = dr.opaque(mi.Float, beam)  # One kernel for all lasers
        plan.scan.follows_camera = kind == "confocal"
        if kind == "confocal" and sensor is not None:
            require_clear_way(scene, sensor, self.laser_origin(scene, sensor))
        return plan

    def laser_origin(self, scene: mi.Scene, sensor: mi.Sensor) -> np.ndarray:
        """Position of the scene's laser [m]."""
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
        """Return the capture type, by default the sensor's."""
        confocal = getattr(sensor, "confocal", None)
        if self.capture_type is None:
            return "confocal" if confocal else "single"
        differs = confocal is not None and confocal != (self.capture_type == "confocal")
        if differs:
            warn_no_effect("confocal", confocal, f"capture_type is {self.capture_type!r}")
        return self.capture_type

    @tracing_lock()
    def _check_aim(self, scan: Scan, kind: str, sensor: mi.Sensor | None) -> None:
        """Refuse a laser that misses the wall, or that is in its plane."""
        if kind == "single":
            require_aim(scan.scene)
            trace_laser_spot(scan.scene, scan.wall)
            beam = mi.Ray3f(*axis(find_laser(scan.scene)))
            require_smooth_spot(scan, first_surface(scan.scene, beam))
        elif sensor is not None:
            origin = axis(find_laser(scan.scene))[0]
            _, si = first_hits(scan.scene, sensor)
            require_smooth_spot(scan, si)
            cos = dr.dot(si.n, dr.normalize(origin - si.p))
            if not dr.any(si.is_valid() & (dr.abs(cos) > GRAZING)):
                where = np.array(origin).ravel().tolist()
                plane = "in the plane of what the sensor sees; must be before it"
                raise ValueError(f"laser: is at {where}, {plane}")

    def laser(
        self, scan: Scan, ray: mi.Ray3f, origin: mi.Point3f, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Any, Contribution | None]:
        """Make connections to the laser spot, or to the emitter itself."""
        if not self.lights_a_point:
            return LaserEmitter(scan, self.shows_spot), None
        scene, emitter = scan.scene, find_laser(scan.scene)
        source, forward = axis(emitter)

        def irradiance(d: mi.Vector3f, r: mi.Float) -> Any:
            lit = dr.zeros(mi.SurfaceInteraction3f)
            lit.p, lit.wavelengths = source + r * d, ray.wavelengths
            return mi.unpolarized_spectrum(emitter.sample_direction(lit, mi.Point2f(0.5))[1])

        confocal, towards = scan.follows_camera, forward
        if confocal:
            towards = dr.normalize(first_surface(scene, ray, active).p - source)
        beam, unit = mi.Ray3f(source, towards, 0, ray.wavelengths), mi.UnpolarizedSpectrum(1)

        def single(sampler: mi.Sampler, active: mi.Bool) -> Spot:
            spot = trace_beam(scan, beam, unit, active, source)
            if self.laser_power:
                spot.power *= self.laser_power * white(ray.wavelengths)
            else:  # Power along the beam's axis
                facing = irradiance(forward, dr.norm(spot.si.p - source))
                spot.power *= facing * dr.abs(spot.si.wi.z) * AREA
            return spot

        spot = single(sampler, active)
        power, seen = spot.power, None
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
        """Whether light of a single bounce counts."""
        return not (self.discard_direct_paths or self.use_nlos_only)


def _read_mitransient(props: mi.Properties) -> None:
    """Translate mitransient's own parameters, or warn that they have no effect here."""
    depth: Any = props.get("filter_depth", -1)
    if not isinstance(depth, int) or depth != -1:
        checks.integer("filter_depth", depth, 2, checks.MAX_DEPTH)
        free = props.get("filter_bounces", -1) == -1
        checks.require("filter_depth", depth, free, "left out; filter_bounces is given")
        props["filter_bounces"] = depth - 1
    name = "force_equal_illumination_scanning"
    equal = checks.boolean(name, props.get(name, True))
    checks.require(name, equal, equal, "True; all captures light the sensor's points")
    limit, fov = f"{HIDDEN_SAMPLING}_max_depth", "illumination_scan_fov"
    if props.get(limit, -1) != -1:
        checks.integer(limit, props[limit], 1, checks.MAX_DEPTH)
        warn_no_effect(limit, props[limit], "paths are sent from the relay wall only")
    if fov in props:
        checks.number(fov, props[fov], positive=True, unit="degrees")
        warn_no_effect(fov, props[fov], "the laser lights the sensor's points")


class LaserEmitter(SceneLights):
    """Next-event estimation of the scene's laser, with the paths of a scan that count."""

    def __init__(self, scan: Scan, counts_single_bounce: bool) -> None:
        super().__init__(scan.scene, None, scan.hide_emitters)
        self.scan, self.counts_single_bounce = scan, counts_single_bounce
        self.history = OffWallHistory(scan.wall) if scan.hidden_only else None

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """Connect as `SceneLights`, for the paths that count."""
        if not self.counts_single_bounce:
            active = active & (path.depth > 0)
        active = counted_lanes(self.scan, path, path.depth + 1, active)
        connection = super().connect(vertex, path, sampler, active)
        connection.length = connection.length if self.scan.counts_legs else mi.Float(0)
        first_opl = self.scan.first_opl
        if first_opl > 0:
            long_enough = path.opl + connection.length >= first_opl
            connection.active &= (path.depth > 0) | long_enough
        return connection

    def min_distance(self, p: mi.Point3f) -> mi.Float:
        """Return 0, as lengths need not count the leg from the laser."""
        return mi.Float(0)
