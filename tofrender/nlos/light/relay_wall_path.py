"""Base of the integrators of non-line-of-sight scenes: wall, hidden geometry, bounces, legs."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...films.contribution import Contribution
from ...integrators.transient_path import TransientPath
from ...paths.records import Limits
from ...paths.scattering import Materials
from ...paths.space import transmittance_between
from ...paths.surfaces import first_surface, is_boundary
from ...runtime import checks
from ...runtime.interface import pose
from ..device.laser import position_of
from ..device.relay_wall import DEFAULT_ID, find_relay_wall, find_shapes, parse_ids, seen_shapes
from .corner import walked_weight
from .guided import Guided, Targets
from .laser_spot import LaserSpot, follow_beam, scatter_beam
from .scan import Beam, Scan
from .scan_plan import ScanPlan
from .specular_surfaces import Specular

HIDDEN_SAMPLING = "nlos_hidden_geometry_sampling"


class RelayWallPath(TransientPath):
    """Base of the integrators that see around a corner by a relay wall.

    A subclass defines the laser. Besides the parameters of `TransientPath`, without
    `light_samples`:

    | parameter | default | meaning |
    |---|---|---|
    | `relay_wall` | see below | ids of the wall's shapes, separated by commas |
    | `hidden_shapes` | see below | ids of the shapes that hidden-geometry sampling aims at |
    | `use_nlos_only` | false | count only paths with a vertex off the wall |
    | `filter_bounces` | -1 | count only paths of so many surface points (3: wall, object, wall) |
    | `nlos_hidden_geometry_sampling` | true | send paths from the wall to hidden geometry, too |
    | `account_first_and_last_bounces` | true | count the legs from laser and sensor to the wall |
    | `block_size` | 0 | as in Mitsuba: for scalar variants only, else a warning |

    The wall is by default the shape that the sensor is a child of, else the one that is called
    "relay_wall". Everything else but boundaries of media is hidden geometry, whose points are
    sampled by area, unless `hidden_shapes` says which of it: light of the others counts as well,
    but by the wall's material alone. Where nothing says which shape is the wall, and sampling is
    requested by name, paths are sent from the shapes that the camera's pixels look at to the
    others. After a load, `relay_wall` and `hidden_shapes` can be set to lists of shapes or ids.

    Where paths connect to the laser spot, they also do so by way of mirrors and clear glass, see
    `nlos.light.specular`.
    """

    needs_lights = False
    follows_polarisation = False
    starts_at_lights = True
    takes_light_samples = False
    shown = ("max_depth", "use_nlos_only", "filter_bounces", "samples_hidden", "counts_legs")
    counts_legs_by_default = samples_hidden_by_default = True
    lights_a_point = True
    """Whether paths connect to the laser spot, rather than to the emitter itself."""

    hidden_probability = 0.5
    """Probability with which a path leaves the wall towards a point of the hidden geometry."""

    def __init__(self, props: mi.Properties) -> None:
        self.relay_wall: Any = parse_ids("relay_wall", props.get("relay_wall", None))
        self.hidden_shapes: Any = parse_ids("hidden_shapes", props.get("hidden_shapes", None))
        self._samples_by_name = props.get(HIDDEN_SAMPLING, None) is True
        block = props.get("block_size", 0)
        if block:
            warn_no_effect("block_size", block, "only scalar variants render in blocks")
        self.use_nlos_only = flag(props, "use_nlos_only")
        self.samples_hidden = flag(props, HIDDEN_SAMPLING, self.samples_hidden_by_default)
        legs = "account_first_and_last_bounces"
        self.counts_legs = flag(props, legs, self.counts_legs_by_default)
        fits = self.samples_hidden or self.hidden_shapes is None
        allowed = f"left out without {HIDDEN_SAMPLING}"
        checks.require("hidden_shapes", props.get("hidden_shapes", None), fits, allowed)
        self.filter_bounces = checks.depth("filter_bounces", props.get("filter_bounces", -1))
        super().__init__(props)
        self.camera_unwarp |= not self.counts_legs

    def laser(
        self, scan: Scan, ray: mi.Ray3f, origin: mi.Point3f, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Any, Contribution | None]:
        """Make the endpoint of camera rays, whose lengths start at `origin`.

        Returns it, and radiance of the laser spot that the camera sees if it does not find that.
        """
        raise TypeError(f"{type(self).__name__}: must define laser, what its paths connect to")

    def laser_spot(self, scan: Scan, beam: Beam) -> LaserSpot:
        """Make connections to the spot of a beam."""
        if scan.space.scatters:
            beam = scatter_beam(scan, beam)
        elif scan.specular is not None:
            beam = follow_beam(scan, beam)
        return LaserSpot(scan, beam, self.limits().max_depth)

    def plan(self, scene, sensor=None, weight=None) -> ScanPlan:
        """Plan the scan of a sensor's rays, with relay wall and mode as the parameters say."""
        return self.capture_plan(scene, sensor)

    def capture_modes(self, sensor: mi.Sensor | None) -> tuple[str, ...]:
        """Return the modes of capture that the scene allows; the first one is the default."""
        return ("confocal", "single", "exhaustive")

    def capture_plan(
        self, scene: mi.Scene, sensor: mi.Sensor | None, wall: Any = None, mode: str | None = None
    ) -> ScanPlan:
        """Plan a capture with a wall, a list of shapes, in one of its `capture_modes`."""
        scan = self.scan(scene, sensor, self.wall(scene, sensor) if wall is None else wall)
        counts_spot = not self.use_nlos_only and self.filter_bounces in (-1, 1)
        return ScanPlan(scan, self.laser, self.limits(), counts_spot)

    def laser_origin(self, scene: mi.Scene, sensor: mi.Sensor) -> np.ndarray:
        """Position of the laser [m], with the camera."""
        return position_of(sensor)

    def scan(self, scene: mi.Scene, sensor: mi.Sensor | None, wall: list[mi.Shape]) -> Scan:
        """Describe the scan of a sensor's rays."""
        surfaces = [s for s in scene.shapes() if not s.is_emitter()]
        if self.use_nlos_only and all(shape in wall for shape in surfaces):
            raise ValueError("scene: has no hidden geometry; all its shapes are the relay wall")
        up = [0.0, 1.0, 0.0]
        if sensor is not None:
            up = pose(sensor)[:3, 1].tolist()
        space = self.space(scene, sensor)
        if space.index != 1:
            rule = f"must be in air, lengths of {type(self).__name__} would be too short"
            raise ValueError(f"sensor: is in glass or water of index {space.index:g}; {rule}")
        solid = [s for s in surfaces if not is_boundary(s.bsdf())]
        guided = self._guided(scene, sensor, solid, wall) if self.samples_hidden else None
        three = self.filter_bounces in (-1, 3) and (self.max_depth < 0 or self.max_depth >= 3)
        corner = guided is not None and self.lights_a_point and three
        return Scan(
            scene,
            space,
            wall,
            up,
            guided,
            hidden_only=self.use_nlos_only,
            bounces=self.filter_bounces,
            counts_legs=self.counts_legs,
            hide_emitters=self.hide_emitters,
            specular=Specular.of(scene, space) if self.lights_a_point else None,
            mis_weight=partial(walked_weight, guided) if corner else None,
        )

    def _guided(
        self, scene: mi.Scene, sensor: Any, surfaces: list[mi.Shape], wall: list[mi.Shape]
    ) -> Guided | None:
        """Make the scattering that sends paths to hidden geometry, None where nothing is sent."""
        senders = wall
        if not wall and (self._samples_by_name or self.hidden_shapes is not None):
            senders = [s for s in seen_shapes(scene, sensor) if not s.is_emitter()]
        if self.hidden_shapes is None:
            aims = [shape for shape in surfaces if shape not in senders]
        else:
            aims = find_shapes(scene, self.hidden_shapes, "hidden_shapes")
            walls = [shape for shape in aims if shape in senders]
            if walls:
                problem = "is the relay wall; must be other shapes"
                raise ValueError(f"hidden_shapes = {walls[0].id()!r}: {problem}")
        if senders and not wall and len(surfaces) == 1:
            warnings.warn(
                f"nlos_hidden_geometry_sampling: the scene is one shape, {surfaces[0].id()!r}; if "
                "that is relay wall and hidden geometry merged, tofrender.load_scene(..., "
                "optimize=False) keeps them apart and has less noise",
                stacklevel=3,
            )
        if not senders or not (aims or not wall):
            return None
        targets = Targets(scene, self.targets(aims or surfaces, senders))
        return Guided(Materials(scene), targets, senders, self.hidden_probability)

    def targets(self, hidden: list[mi.Shape], wall: list[mi.Shape]) -> list[mi.Shape]:
        """Surfaces that paths are sent to."""
        return hidden

    def limits(self, max_opl: Any = None) -> Limits:
        """Limits of the base, and no paths longer than those that `filter_bounces` counts."""
        limits = super().limits(max_opl)
        if self.filter_bounces >= 0:
            # The laser spot is a surface point, too; the laser itself is not
            segments = self.filter_bounces + (0 if self.lights_a_point else 1)
            bounded = min(self.max_depth, max(segments, 1))
            limits.max_depth = segments if self.max_depth < 0 else bounded
        return limits

    def single_bounce(
        self,
        scan: Scan,
        ray: mi.Ray3f,
        origin: mi.Point3f,
        laser: mi.Point3f,
        irradiance: Callable[[mi.Vector3f, mi.Float], Any],
        sampler: mi.Sampler,
        active: mi.Bool,
    ) -> Contribution:
        """Radiance of the laser's light reflected by the surface that the camera sees.

        `irradiance` is that of a surface facing the laser [W/m^2], by direction and distance.
        """
        si = first_surface(scan.scene, ray, active)
        to_laser = laser - si.p
        r = dr.norm(to_laser)
        d = to_laser / r
        seen = active & si.is_valid()
        transmittance = transmittance_between(scan.space, si, laser, sampler, seen)
        to_camera = dr.norm(si.p - origin)
        if scan.space.scatters:
            transmittance *= transmittance_between(scan.space, si, ray.o, sampler, seen, to_camera)
        f = mi.unpolarized_spectrum(si.bsdf().eval(mi.BSDFContext(), si, si.to_local(d), seen))
        radiance = f * irradiance(-d, r) * transmittance
        opl = mi.Float(0) if self.camera_unwarp else to_camera
        opl += r if self.counts_legs else 0
        return Contribution(radiance, opl, seen & dr.any(radiance != 0))

    def wall(self, scene: mi.Scene, sensor: mi.Sensor | None) -> list[mi.Shape]:
        """Find the relay wall; none where it is not needed and nothing says which it is."""
        if self.relay_wall is not None:
            return find_relay_wall(scene, self.relay_wall)
        carrier = None if sensor is None else sensor.get_shape()
        if carrier is not None:  # Compare pointers: the Python objects differ
            return [s for s in scene.shapes() if (mi.ShapePtr(s) == mi.ShapePtr(carrier))[0]]
        if DEFAULT_ID in [shape.id() for shape in scene.shapes()] or self.use_nlos_only:
            return find_relay_wall(scene, DEFAULT_ID)
        return []


def flag(props: mi.Properties, name: str, default: bool = False) -> bool:
    """Read a parameter that is true or false."""
    return checks.boolean(name, props.get(name, default))


def warn_no_effect(name: str, value: Any, reason: str) -> None:
    """Warn of a parameter that changes nothing."""
    warnings.warn(f"{name} = {value}: has no effect; {reason}", stacklevel=3)
