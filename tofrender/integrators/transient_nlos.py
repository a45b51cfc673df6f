"""Integrator plugin `transient_nlos_path`: captures with a projector that is part of the scene."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from .. import checks
from ..lights import Connection, PathState, SceneLights
from ..relay_wall import is_on_relay_wall
from ..targets import Targets
from .relay_wall_path import Arrival, RelayWallPath, Scan

CAPTURE_TYPES = ("single", "confocal", "exhaustive")
MOST = 0.9
"""Probability of a target's point where the material is not asked to choose as often."""

AREA = 1.0
"""Area that a laser spot stands for [m^2], as in the plugin of the same name in mitransient."""


class TransientNLOSPath(RelayWallPath):
    """Non-line-of-sight captures as mitransient describes them (plugin `transient_nlos_path`).

    The scene's one emitter, a projector or spot, is the laser. With `nlos_laser_sampling` it lights
    a single point: in a single capture the one that it looks at, in a confocal capture the one that
    the camera ray meets, as if the emitter were turned there. The power that arrives is the
    irradiance at that point times one square metre, which falls with the distance of the laser, or
    `laser_power`, as of a real one. Besides those of `RelayWallPath`, with
    `account_first_and_last_bounces` false by default:

    | parameter | default | meaning |
    |---|---|---|
    | `capture_type` | "single" | or "confocal" (1 or 2); `capture` makes exhaustive ones |
    | `laser_power` | none | power that arrives on the wall, wherever it is lit [W] |
    | `nlos_laser_sampling` | false | connect to the lit point; else to the emitter |
    | `nlos_hidden_geometry_sampling` | false | as in `RelayWallPath` |
    | `nlos_hidden_geometry_sampling_do_rroulette` | false | also by material; else by area alone |
    | `nlos_hidden_geometry_sampling_includes_relay_wall` | false | the wall is a target, too |
    | `nlos_hidden_geometry_sampling_max_depth` | -1 | accepted: paths are sent from the wall only |
    | `discard_direct_paths` | false | drop paths of a single bounce |

    Unlike there, what something hides does not count, surfaces count from both sides, choosing
    between two samplings keeps the energy, 3 bounces are three, and a wall that meets the hidden
    geometry is found by its material, too: sampling by area alone would miss its light.

    Example:
        >>> integrator = mi.load_dict({"type": "transient_nlos_path", "capture_type": 2})
        >>> integrator.capture_type
        'confocal'
    """

    counts_legs_by_default = False

    def __init__(self, props: mi.Properties) -> None:
        kind: Any = props.get("capture_type", "single")
        if isinstance(kind, int) and not isinstance(kind, bool) and 1 <= kind <= 3:
            kind = CAPTURE_TYPES[kind - 1]
        kind = kind.lower() if isinstance(kind, str) else kind
        self.capture_type = checks.one_of("capture_type", kind, CAPTURE_TYPES)
        if self.capture_type == "exhaustive":
            raise ValueError(
                "capture_type = 'exhaustive': must be 'single' or 'confocal' here; "
                "tofrender.capture renders exhaustive captures"
            )
        hidden = "nlos_hidden_geometry_sampling"
        self.laser_sampling, self.discard_direct_paths, self.both, self.wall_too = (
            checks.boolean(name, props.get(name, False))
            for name in (
                "nlos_laser_sampling",
                "discard_direct_paths",
                f"{hidden}_do_rroulette",
                f"{hidden}_includes_relay_wall",
            )
        )
        checks.integer(f"{hidden}_max_depth", props.get(f"{hidden}_max_depth", -1), -1, 1 << 16)
        if hidden not in props:
            props[hidden] = False
        power = props.get("laser_power", None)
        if power is not None:
            power = checks.metres("laser_power", power, positive=True, unit="watts")
            if not self.laser_sampling:
                raise ValueError("laser_power: must be left out without nlos_laser_sampling")
        self.laser_power = power
        super().__init__(props)

    def aim_at(self, scene: mi.Scene, hidden: list[mi.Shape], wall: list[mi.Shape]) -> Targets:
        """Targets as the parameters say."""
        return Targets(scene, hidden + wall * self.wall_too, wall, 0.5 if self.both else MOST)

    def lights(self, scene: mi.Scene, sensor: mi.Sensor | None = None) -> Any:
        """The scan, once it is known that there is one laser."""
        if self.capture_type == "confocal" and not self.laser_sampling:
            raise ValueError(
                "nlos_laser_sampling = False: must be true for confocal captures, whose laser "
                "lights one point after the other"
            )
        emitters = scene.emitters()
        delta = mi.EmitterFlags.DeltaPosition
        if len(emitters) != 1 or not mi.has_flag(emitters[0].flags(), delta):
            kinds = ", ".join(e.class_name() for e in emitters) or "none"
            raise ValueError(f"emitters: {kinds}; must be one laser, a projector or a spot")
        scan = super().lights(scene, sensor)
        self._check_aim(scan)
        return scan

    def _check_aim(self, scan: Scan) -> None:
        """Refuse a laser that misses the wall."""
        if self.laser_sampling and self.capture_type == "single" and scan.wall:
            pose = scan.scene.emitters()[0].world_transform()
            ray = mi.Ray3f(pose @ mi.Point3f(0), dr.normalize(pose @ mi.Vector3f(0, 0, 1)))
            if not is_on_relay_wall(scan.scene.ray_intersect(ray), scan.wall)[0]:
                raise ValueError(
                    "laser: does not light the relay wall; must look at it, "
                    "and tofrender.focus_laser turns it there"
                )

    def laser(
        self, scan: Scan, ray: mi.Ray3f, origin: mi.Point3f, active: mi.Bool
    ) -> tuple[Any, Arrival | None]:
        """The lit point, or the emitter itself."""
        scene = scan.scene
        bounces = self.filter_bounces
        if not self.laser_sampling:
            wall = scan.wall if self.use_nlos_only else None
            return LaserItself(scene, wall, bounces, self.shows_spot, self.counts_legs), None
        emitter: Any = scene.emitters()[0]
        pose = emitter.world_transform()
        source, axis = pose @ mi.Point3f(0), dr.normalize(pose @ mi.Vector3f(0, 0, 1))

        def irradiance(d: mi.Vector3f, r: mi.Float) -> Any:
            lit = dr.zeros(mi.SurfaceInteraction3f)
            lit.p = source + r * d
            return mi.unpolarized_spectrum(emitter.sample_direction(lit, mi.Point2f(0.5))[1])

        def in_focus(d: mi.Vector3f, r: mi.Float) -> Any:
            return irradiance(axis, r)

        confocal = self.capture_type == "confocal"
        towards = dr.normalize(scene.ray_intersect(ray, active).p - source) if confocal else axis
        carried = mi.UnpolarizedSpectrum(1)
        spot = self.spot(scene, mi.Ray3f(source, towards), source, carried, active)
        r = dr.norm(spot.si.p - source)
        spot.power *= self.laser_power or in_focus(towards, r) * dr.abs(spot.si.wi.z) * AREA
        seen = None
        if self.shows_spot and not self.laser_power:
            light = in_focus if confocal else irradiance
            seen = self.from_laser(scene, ray, origin, source, light, active)
        return self.lit_point(scan, lambda sampler, active: spot), seen

    @property
    def shows_spot(self) -> bool:
        """Whether light of a single bounce counts."""
        return not (self.discard_direct_paths or self.use_nlos_only)


class LaserItself(SceneLights):
    """The scene's laser by ordinary connections, with the paths that count and their legs."""

    def __init__(
        self,
        scene: mi.Scene,
        wall: list[mi.Shape] | None,
        bounces: int,
        single: bool,
        counts_legs: bool,
    ) -> None:
        super().__init__(scene)
        self.wall, self.bounces = wall, bounces
        self.single, self.counts_legs = single, counts_legs

    def remember(self, memory: mi.Bool, si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        """Whether a vertex so far is off the wall."""
        return memory if self.wall is None else memory | (active & ~is_on_relay_wall(si, self.wall))

    def connect(
        self,
        si: mi.SurfaceInteraction3f,
        path: PathState,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Connection:
        """As in `SceneLights`, for the paths that count."""
        if self.wall is not None:
            active = active & path.memory
        if not self.single:
            active = active & (path.depth > 0)
        if self.bounces >= 0:
            active = active & (path.depth + 1 == self.bounces)
        em = super().connect(si, path, sampler, active)
        em.length = em.length if self.counts_legs else mi.Float(0)
        return em


for name in ("transient_nlos_path", "tofrender_transient_nlos_path"):
    mi.register_integrator(name, TransientNLOSPath)
