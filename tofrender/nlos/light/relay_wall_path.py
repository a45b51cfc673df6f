# pyright: reportArgumentType=false, reportCallIssue=false
"""What the integrators of non-line-of-sight scenes share: wall, hidden geometry, bounces, legs."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, cast

import drjit as dr
import mitsuba as mi
import numpy as np

from ...films.contribution import Contribution
from ...integrators.transient_path import TransientPath
from ...paths.between import arriving
from ...paths.guided import Guided, Targets
from ...paths.records import Limits
from ...paths.scattering import Materials
from ...paths.surfaces import first_surface, is_boundary
from ...runtime import checks
from ..device.laser import place_of
from ..device.relay_wall import (
    DEFAULT_ID,
    find_relay_wall,
    find_shapes,
    parse_ids,
    seen_shapes,
)
from .corner import CornerShare
from .laser_in_media import LaserInMedia
from .laser_spot import LaserSpot, Spot
from .scan import Beam, Scan, ScanPlan

HIDDEN_SHARE = 0.5
"""Probability with which a path leaves the wall towards a point of the hidden geometry."""


class RelayWallPath(TransientPath):
    """Base of the integrators that see around a corner by a relay wall.

    A subclass says in `laser` what lights the scene. Besides those of `TransientPath`, without
    `light_samples`:

    | parameter | default | meaning |
    |---|---|---|
    | `relay_wall` | see below | ids of the wall's shapes, separated by commas |
    | `hidden_shapes` | see below | ids of the shapes that hidden-geometry sampling aims at |
    | `use_nlos_only` | false | count only paths that have met something else than the wall |
    | `filter_bounces` | -1 | count only paths of so many surface points (3: wall, object, wall) |
    | `nlos_hidden_geometry_sampling` | true | send paths from the wall to hidden geometry, too |
    | `account_first_and_last_bounces` | true | count the legs from laser and sensor to the wall |
    | `block_size` | 0 | as in Mitsuba: for scalar variants only, else a warning |

    The wall is by default the shape that the sensor is a child of, else the one that is called
    "relay_wall". Everything else but boundaries of media is hidden geometry, whose points are
    chosen by area, unless `hidden_shapes` says which of it: light of the others counts as well, but
    by the wall's material alone. Where nothing says which shape is the wall, and sampling is asked
    for by name, paths are sent from the shapes that the camera's pixels look at to the others.
    After a load, `relay_wall` and `hidden_shapes` can be set to lists of shapes or ids.
    """

    needs_lights = False
    follows_polarisation = False
    starts_at_lights = True
    takes_light_samples = False
    counts_legs_by_default = True

    def __init__(self, props: mi.Properties) -> None:
        self.relay_wall, self.hidden_shapes = (
            cast(Any, parse_ids(name, props.get(name, None)))
            for name in ("relay_wall", "hidden_shapes")
        )
        self._sampling_is_asked_for = props.get("nlos_hidden_geometry_sampling", None) is True
        block = props.get("block_size", 0)
        if block:
            warnings.warn(
                f"block_size = {block}: has no effect; only scalar variants render in blocks",
                stacklevel=2,
            )
        self.use_nlos_only, self.samples_hidden, self.counts_legs = (
            checks.boolean(name, props.get(name, default))
            for name, default in (
                ("use_nlos_only", False),
                ("nlos_hidden_geometry_sampling", True),
                ("account_first_and_last_bounces", self.counts_legs_by_default),
            )
        )
        if self.hidden_shapes is not None and not self.samples_hidden:
            raise ValueError(
                f"hidden_shapes = {props['hidden_shapes']!r}: must be left out without "
                "nlos_hidden_geometry_sampling"
            )
        self.filter_bounces = _bounces("filter_bounces", props.get("filter_bounces", -1))
        super().__init__(props)
        self.camera_unwarp |= not self.counts_legs

    lights_a_point = True
    """Whether paths connect to the lit point, rather than to the emitter itself."""

    def laser(
        self,
        scan: Scan,
        ray: mi.Ray3f,
        origin: mi.Point3f,
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> tuple[Any, Contribution | None]:
        """What the paths of camera rays connect to; their lengths start at `origin`.

        Returns:
            An endpoint, and what the camera sees of the lit point itself, if the endpoint does not
            find that.
        """
        raise TypeError(f"{type(self).__name__}: must define laser, what its paths connect to")

    def lit_point(self, scan: Scan, beam: Beam) -> LaserSpot:
        """Connections to where a beam lands."""
        told = (
            *(scan.scene, beam, scan.wall, self.use_nlos_only, self.filter_bounces, scan.share),
            self.hide_emitters,
        )
        if not scan.space.scatters:
            return LaserSpot(*told)
        scattering = scan.space.scattering(Materials(scan.scene))
        more = {"scattering": scattering, "counts_legs": self.counts_legs}
        return LaserInMedia(*told, space=scan.space, **more)

    def plan(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None = None,
        weight: Any = None,
        wall: list[mi.Shape] | None = None,
    ) -> ScanPlan:
        """The scan of a sensor's rays; the relay wall is by default as the parameters say."""
        scan = self.scan(scene, sensor, self.wall(scene, sensor) if wall is None else wall)
        return ScanPlan(scan, self.laser, self.limits(), self.counts_spot)

    def require_mode(self, mode: str) -> None:
        """Refuse a mode of capture that this integrator has not.

        Raises:
            ValueError: One line with the mode and those that there are.
        """

    def capture_plan(
        self, scene: mi.Scene, sensor: mi.Sensor, wall: list[mi.Shape], mode: str
    ) -> ScanPlan:
        """The plan of a capture in a mode that `require_mode` has let pass."""
        return self.plan(scene, sensor, wall=wall)

    def laser_origin(self, scene: mi.Scene, sensor: mi.Sensor) -> np.ndarray:
        """Where the laser is [m]: with the camera."""
        return place_of(sensor)

    def scan(self, scene: mi.Scene, sensor: mi.Sensor | None, wall: list[mi.Shape]) -> Scan:
        """What is scanned."""
        surfaces = [s for s in scene.shapes() if not s.is_emitter()]
        if self.use_nlos_only and all(shape in wall for shape in surfaces):
            raise ValueError("scene: has no hidden geometry; all its shapes are the relay wall")
        up = [0.0, 1.0, 0.0]
        if sensor is not None:
            up = np.array(sensor.world_transform().matrix).reshape(4, 4)[:3, 1].tolist()
        space = self.space(scene, sensor)
        if space.index != 1:
            raise ValueError(
                f"sensor: is in glass or water of index {space.index:g}; must be in air, lengths "
                f"of {type(self).__name__} would be too short"
            )
        solid = [s for s in surfaces if not is_boundary(s.bsdf())]
        scan = Scan(scene, space, wall, up, self._guided(scene, sensor, solid, wall))
        scan.hide_emitters = self.hide_emitters
        if scan.guided and self.lights_a_point and self._counts_three():
            scan.share = CornerShare(scan.guided)
        return scan

    def _guided(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | None,
        surfaces: list[mi.Shape],
        wall: list[mi.Shape],
    ) -> Guided | None:
        """The scattering that sends paths to hidden geometry, None where nothing is sent."""
        if not self.samples_hidden:
            return None
        senders = wall
        if not wall and (self._sampling_is_asked_for or self.hidden_shapes is not None):
            senders = [s for s in seen_shapes(scene, sensor) if not s.is_emitter()]
        aims = self._aims(scene, surfaces, senders)
        if senders and not wall and len(surfaces) == 1:
            _tell_of_one_shape(surfaces[0])
        if not senders or not (aims or not wall):
            return None
        shapes, share = self.aim_at(aims or surfaces, senders)
        return Guided(Materials(scene), Targets(scene, shapes), senders, share)

    def _aims(
        self, scene: mi.Scene, surfaces: list[mi.Shape], senders: list[mi.Shape]
    ) -> list[mi.Shape]:
        """What hidden-geometry sampling aims at."""
        if self.hidden_shapes is None:
            return [shape for shape in surfaces if shape not in senders]
        found = find_shapes(scene, self.hidden_shapes, "hidden_shapes")
        for shape in found:
            if shape in senders:
                raise ValueError(
                    f"hidden_shapes = {shape.id()!r}: is the relay wall; must be other shapes"
                )
        return found

    def aim_at(self, hidden: list[mi.Shape], wall: list[mi.Shape]) -> tuple[list[mi.Shape], float]:
        """Which surfaces paths are sent to, and with which probability."""
        return hidden, HIDDEN_SHARE

    def limits(self, last_opl: Any = None) -> Limits:
        """Paths need not be longer than those that `filter_bounces` counts."""
        limits = super().limits(last_opl)
        if self.filter_bounces >= 0:
            # The lit point is a surface point, too; the laser itself is not
            segments = self.filter_bounces + (0 if self.lights_a_point else 1)
            bounded = min(self.max_depth, max(segments, 1))
            limits.max_depth = segments if self.max_depth < 0 else bounded
        return limits

    @property
    def counts_spot(self) -> bool:
        """Whether the lit point counts where the camera sees it."""
        return not self.use_nlos_only and self.filter_bounces in (-1, 1)

    def _counts_three(self) -> bool:
        """Whether paths of three bounces count."""
        return self.filter_bounces in (-1, 3) and (self.max_depth < 0 or self.max_depth >= 3)

    def spot(self, scene: mi.Scene, ray: mi.Ray3f, origin: Any, power: Any, active: Any) -> Spot:
        """Where a beam lands; its length counts as `account_first_and_last_bounces` says."""
        spot = Spot.of_beam(scene, ray, power, active, origin)
        spot.distance = spot.distance if self.counts_legs else mi.Float(0)
        return spot

    def from_laser(
        self,
        scan: Scan,
        ray: mi.Ray3f,
        origin: mi.Point3f,
        laser: mi.Point3f,
        irradiance: Callable[[mi.Vector3f, mi.Float], Any],
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Contribution:
        """Light that comes straight back from the surface that the camera sees.

        `irradiance` takes the direction from the laser's place and the distance, and gives the
        irradiance of a surface that faces the laser [W/m^2].
        """
        si = first_surface(scan.scene, ray, active)
        to_laser = laser - si.p
        r = dr.norm(to_laser)
        d = to_laser / r
        seen = active & si.is_valid()
        arrives = arriving(scan.space, si, laser, sampler, seen)
        if scan.space.scatters:
            arrives *= arriving(scan.space, si, ray.o, sampler, seen, dr.norm(si.p - origin))
        f = mi.unpolarized_spectrum(si.bsdf().eval(mi.BSDFContext(), si, si.to_local(d), seen))
        radiance = f * irradiance(-d, r) * arrives
        opl = mi.Float(0) if self.camera_unwarp else dr.norm(si.p - origin)
        opl += r if self.counts_legs else 0
        return Contribution(radiance, opl, seen & dr.any(radiance != 0))

    def wall(self, scene: mi.Scene, sensor: mi.Sensor | None) -> list[mi.Shape]:
        """The relay wall; none where nobody asks for it and nothing says which it is."""
        if self.relay_wall is not None:
            return find_relay_wall(scene, self.relay_wall)
        carrier = None if sensor is None else sensor.get_shape()
        if carrier is not None:  # The scene's own object for it, which compares
            return [s for s in scene.shapes() if (mi.ShapePtr(s) == mi.ShapePtr(carrier))[0]]
        if DEFAULT_ID in [shape.id() for shape in scene.shapes()] or self.use_nlos_only:
            return find_relay_wall(scene, DEFAULT_ID)
        return []

    def to_string(self) -> str:
        """The integrator's parameters."""
        names = ("max_depth", "use_nlos_only", "filter_bounces", "samples_hidden", "counts_legs")
        values = ", ".join(f"{name} = {getattr(self, name)!r}" for name in names)
        return f"{type(self).__name__}[{values}]"


def _tell_of_one_shape(shape: mi.Shape) -> None:
    """Warn that a load may have merged the wall with what it hides."""
    warnings.warn(
        f"nlos_hidden_geometry_sampling: the scene is one shape, {shape.id()!r}; if that is relay "
        "wall and hidden geometry merged, tofrender.load_scene(..., optimize=False) keeps them "
        "apart and has less noise",
        stacklevel=4,
    )


def _bounces(name: str, value: Any) -> int:
    """A number of bounces, or -1 for all."""
    try:
        bounces = checks.integer(name, value, -1, checks.MAX_DEPTH)
    except ValueError:
        bounces = 0
    if bounces == 0:
        raise ValueError(f"{name} = {checks.quote(value)}: must be -1 (all) or an integer from 1")
    return bounces
