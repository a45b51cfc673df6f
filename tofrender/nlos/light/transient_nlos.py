# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false
"""Integrator plugin `transient_nlos_path`: captures with a projector that is part of the scene."""

from __future__ import annotations

import warnings
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...films.contribution import Contribution
from ...paths.endpoints import SceneLights
from ...paths.records import Connection, Path, Vertex
from ...paths.surfaces import first_surface, is_on
from ...runtime import checks
from ...runtime.backend import tracing_lock
from ...signals.illuminants import white
from ..device.laser import (
    GRAZING,
    axis,
    find_laser,
    follow_meters,
    place_of,
    require_aim,
    solid_angle,
)
from ..device.relay_wall import first_hits, is_on_relay_wall
from .laser_in_media import require_clear_way
from .laser_spot import Spot
from .relay_wall_path import RelayWallPath
from .scan import Scan, ScanPlan

CAPTURE_TYPES = ("single", "confocal", "exhaustive")
MOST = 0.9
"""Probability of a target's point where the material is not asked to choose as often."""

AREA = 1.0
"""Area that a laser spot stands for [m^2], as in the plugin of the same name in mitransient."""


class TransientNLOSPath(RelayWallPath):
    """Non-line-of-sight captures as mitransient describes them (plugin `transient_nlos_path`).

    The scene's one emitter, a projector or spot, is the laser; an `nlos_capture_meter` can say
    where it is. With `nlos_laser_sampling` it lights a single point: in a single capture the one
    that it looks at, in a confocal capture the one that the camera ray meets, as if the emitter
    were turned there. A lit point stands for one square metre: the power that arrives is the
    irradiance at that point times 1 m^2, which falls with the distance of the laser, or
    `laser_power` [W], as of a real one. All bounces are of that power. Light of a single bounce is
    that of a beam of that power, so that it is brighter than the emitter's own by 1 m^2 over the
    beam's footprint: 10^4 times for 0.2 degrees at 2.8 m. Without `nlos_laser_sampling` all bounces
    have the emitter's own power. Besides the parameters of `RelayWallPath`, with
    `account_first_and_last_bounces` false by default:

    | parameter | default | meaning |
    |---|---|---|
    | `capture_type` | "single" | "confocal" or "exhaustive" (1, 2, 3), which needs `capture` |
    | `laser_power` | none | power that arrives on the wall, wherever it is lit [W] |
    | `nlos_laser_sampling` | false | connect to the lit point; else to the emitter |
    | `nlos_hidden_geometry_sampling` | false | as in `RelayWallPath` |
    | `nlos_hidden_geometry_sampling_do_rroulette` | false | also by material; else by area alone |
    | `nlos_hidden_geometry_sampling_includes_relay_wall` | false | the wall is a target, too |
    | `nlos_hidden_geometry_sampling_max_depth` | -1 | a warning: paths leave the wall only |
    | `discard_direct_paths` | false | drop paths of a single bounce |
    | `filter_depth` | -1 | one more than `filter_bounces`, instead of it |
    | `force_equal_illumination_scanning` | true | exhaustive captures light the sensor's points |
    | `illumination_scan_fov` | 20 | a warning: there are no others |

    Unlike there, light of a single bounce is shown unless `discard_direct_paths` drops it, what
    something hides does not count, surfaces count from both sides, choosing
    between two samplings keeps the energy, 3 bounces are three, and a wall that meets the hidden
    geometry is found by its material, too: sampling by area alone would miss its light.

    Example:
        >>> integrator = mi.load_dict({"type": "transient_nlos_path", "capture_type": 2})
        >>> integrator.capture_type
        'confocal'
    """

    counts_legs_by_default = False

    def __init__(self, props: mi.Properties) -> None:
        kind: Any = props.get("capture_type", None)
        if isinstance(kind, int) and not isinstance(kind, bool) and 1 <= kind <= 3:
            kind = CAPTURE_TYPES[kind - 1]
        kind = kind.lower() if isinstance(kind, str) else kind
        self.capture_type: str | None = kind
        self._type_is_given = kind is not None
        if kind is not None:
            checks.one_of("capture_type", kind, CAPTURE_TYPES)
        _peers_parameters(props)
        hidden = "nlos_hidden_geometry_sampling"
        self.laser_sampling, self.discard_direct_paths, self.with_roulette, self.wall_too = (
            checks.boolean(name, props.get(name, False))
            for name in (
                "nlos_laser_sampling",
                "discard_direct_paths",
                f"{hidden}_do_rroulette",
                f"{hidden}_includes_relay_wall",
            )
        )
        if hidden not in props:
            props[hidden] = False
        power = props.get("laser_power", None)
        if power is not None:
            power = checks.number("laser_power", power, positive=True, unit="watts")
            if not self.laser_sampling:
                raise ValueError("laser_power: must be left out without nlos_laser_sampling")
        self.laser_power = power
        super().__init__(props)

    def aim_at(self, hidden: list[mi.Shape], wall: list[mi.Shape]) -> tuple[list[mi.Shape], float]:
        """As the parameters say."""
        return hidden + wall * self.wall_too, 0.5 if self.with_roulette else MOST

    @property
    def lights_a_point(self) -> bool:
        """With laser sampling."""
        return self.laser_sampling

    def plan(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None = None,
        weight: Any = None,
        wall: list[mi.Shape] | None = None,
        capture_type: str | None = None,
    ) -> ScanPlan:
        """The scan, once it is known that there is one laser.

        The wall and the capture type, "single" or "confocal", are by default as the parameters say.
        """
        kind = self._kind(sensor) if capture_type is None else capture_type
        if kind == "exhaustive":
            raise ValueError(
                "capture_type = 'exhaustive': must be 'single' or 'confocal' to render; "
                "tofrender.capture(scene, mode='exhaustive') makes exhaustive captures"
            )
        if kind == "confocal" and not self.laser_sampling:
            raise ValueError(
                "nlos_laser_sampling = False: must be true for confocal captures, whose laser "
                "lights one point after the other"
            )
        find_laser(scene)
        follow_meters(scene, sensor)
        plan = super().plan(scene, sensor, weight, wall)
        if self.laser_sampling:
            self._check_aim(plan.scan, kind, sensor)
            if self.shows_spot:
                beam = solid_angle(find_laser(scene))
                plan.scan.solid_angle = dr.opaque(mi.Float, beam)  # One kernel for all lasers
        plan.scan.follows_camera = kind == "confocal"
        if kind == "confocal" and sensor is not None:
            require_clear_way(scene, sensor, self.laser_origin(scene, sensor))
        return plan

    def capture_plan(
        self, scene: mi.Scene, sensor: mi.Sensor, wall: list[mi.Shape], mode: str
    ) -> ScanPlan:
        """The plan of a capture; an exhaustive one is a single one for each laser point."""
        if mode == "exhaustive":
            require_clear_way(scene, sensor, self.laser_origin(scene, sensor))
        kind = "confocal" if mode == "confocal" else "single"
        return self.plan(scene, sensor, wall=wall, capture_type=kind)

    def laser_origin(self, scene: mi.Scene, sensor: mi.Sensor) -> np.ndarray:
        """Where the scene's laser is [m]."""
        return place_of(find_laser(scene))

    def _kind(self, sensor: mi.Sensor | None) -> str:
        """The capture type; if none is given, the sensor may know it."""
        stated = getattr(sensor, "confocal", None)
        if self.capture_type is None:
            return "confocal" if stated else "single"
        differs = stated is not None and stated != (self.capture_type == "confocal")
        if differs and self._type_is_given:
            _no_effect("confocal", stated, f"capture_type is {self.capture_type!r}")
        return self.capture_type

    @tracing_lock()
    def _check_aim(self, scan: Scan, kind: str, sensor: mi.Sensor | None) -> None:
        """Refuse a laser that misses the wall, or that is in its plane."""
        origin, direction = axis(find_laser(scan.scene))
        if kind == "single":
            require_aim(scan.scene)
            si = first_surface(scan.scene, mi.Ray3f(origin, direction))
            lit = is_on_relay_wall(si, scan.wall) if scan.wall else si.is_valid()
            if not lit[0]:
                raise ValueError(
                    "laser: does not light the relay wall; must look at it, "
                    "and tofrender.focus_laser turns it there"
                )
        elif sensor is not None:
            _, si = first_hits(scan.scene, sensor)
            cos = dr.dot(si.n, dr.normalize(origin - si.p))
            if not dr.any(si.is_valid() & (dr.abs(cos) > GRAZING)):
                raise ValueError(
                    f"laser: is at {np.array(origin).ravel().tolist()}, in the plane of what the "
                    "sensor sees; must be before it"
                )

    def laser(
        self,
        scan: Scan,
        ray: mi.Ray3f,
        origin: mi.Point3f,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> tuple[Any, Contribution | None]:
        """The lit point, or the emitter itself."""
        scene = scan.scene
        bounces = self.filter_bounces
        if not self.laser_sampling:
            wall = scan.wall if self.use_nlos_only else None
            more = (self.shows_spot, self.counts_legs, self.hide_emitters, scan.first_opl)
            return LaserItself(scene, wall, bounces, *more), None
        emitter = find_laser(scene)
        source, forward = axis(emitter)

        def irradiance(d: mi.Vector3f, r: mi.Float) -> Any:
            lit = dr.zeros(mi.SurfaceInteraction3f)
            lit.p, lit.wavelengths = source + r * d, ray.wavelengths
            return mi.unpolarized_spectrum(emitter.sample_direction(lit, mi.Point2f(0.5))[1])

        confocal = scan.follows_camera
        towards = (
            dr.normalize(first_surface(scene, ray, active).p - source) if confocal else forward
        )
        beam, carried = mi.Ray3f(source, towards, 0, ray.wavelengths), mi.UnpolarizedSpectrum(1)

        def single(sampler: mi.Sampler, active: mi.Bool) -> Spot:
            spot = self.spot(scene, beam, source, carried, active)
            if self.laser_power:
                spot.power *= self.laser_power * white(ray.wavelengths)
            else:  # What the beam's axis carries
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

            seen = self.from_laser(scan, ray, origin, source, light, sampler, active)
        return self.lit_point(scan, scan.hold(single, spot)), seen

    @property
    def shows_spot(self) -> bool:
        """Whether light of a single bounce counts."""
        return not (self.discard_direct_paths or self.use_nlos_only)


def _peers_parameters(props: mi.Properties) -> None:
    """Read mitransient's parameters that ours are not, or warn that they do nothing here."""
    depth: Any = props.get("filter_depth", -1)
    if not isinstance(depth, int) or depth != -1:
        checks.integer("filter_depth", depth, 2, checks.MAX_DEPTH)
        if props.get("filter_bounces", -1) != -1:
            raise ValueError(f"filter_depth = {depth}: must be left out; filter_bounces is given")
        props["filter_bounces"] = depth - 1
    equal = "force_equal_illumination_scanning"
    if not checks.boolean(equal, props.get(equal, True)):
        raise ValueError(f"{equal} = False: must be True; all captures light the sensor's points")
    limit = "nlos_hidden_geometry_sampling_max_depth"
    if props.get(limit, -1) != -1:
        checks.integer(limit, props[limit], 1, checks.MAX_DEPTH)
        _no_effect(limit, props[limit], "paths are sent from the relay wall only")
    if "illumination_scan_fov" in props:
        fov = props["illumination_scan_fov"]
        checks.number("illumination_scan_fov", fov, positive=True, unit="degrees")
        _no_effect("illumination_scan_fov", fov, "the laser lights the sensor's points")


def _no_effect(name: str, value: Any, why: str) -> None:
    warnings.warn(f"{name} = {value}: has no effect; {why}", stacklevel=3)


class LaserItself(SceneLights):
    """The scene's laser by ordinary connections, with the paths that count and their legs.

    Args:
        scene: The scene.
        wall: The relay wall if only paths count that have met something else, else None.
        bounces: Count only paths of so many surface points; -1 means all.
        single: Whether light of a single bounce counts.
        counts_legs: Whether the leg from the laser counts in lengths.
        hide_emitters: As in `Unseen`.
        first_opl: Length before which light of a single bounce does not count [m].
    """

    def __init__(
        self,
        scene: mi.Scene,
        wall: list[mi.Shape] | None,
        bounces: int,
        single: bool,
        counts_legs: bool,
        hide_emitters: bool,
        first_opl: float,
    ) -> None:
        super().__init__(scene, None, hide_emitters)
        self.wall, self.bounces = wall, bounces
        self.single, self.counts_legs, self.first_opl = single, counts_legs, first_opl

    def memory(self) -> Any:
        """Whether a vertex so far is off the wall, 0 or 1, if that matters."""
        return None if self.wall is None else mi.UInt32(0)

    def remember(self, path: Path, vertex: Vertex, active: mi.Bool) -> Any:
        """Whether a vertex so far is off the wall."""
        if self.wall is None:
            return path.memory
        return dr.select(active & ~is_on(vertex.si, self.wall), mi.UInt32(1), path.memory)

    def connect(
        self, vertex: Vertex, path: Path, sampler: mi.Sampler, active: mi.Bool
    ) -> Connection:
        """As in `SceneLights`, for the paths that count."""
        if self.wall is not None:
            active = active & (path.memory != 0)
        if not self.single:
            active = active & (path.depth > 0)
        if self.bounces >= 0:
            active = active & (path.depth + 1 == self.bounces)
        link = super().connect(vertex, path, sampler, active)
        link.length = link.length if self.counts_legs else mi.Float(0)
        if self.first_opl > 0:
            link.active &= (path.depth > 0) | (path.opl + link.length >= self.first_opl)
        return link

    def nearest(self, p: mi.Point3f) -> mi.Float:
        """No bound: the leg from the laser may not count."""
        return mi.Float(0)
