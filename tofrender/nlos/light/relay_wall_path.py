"""Base class of the integrators of non-line-of-sight scenes."""

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
    """Base class of integrators that look around a corner by way of a relay wall.

    A subclass defines the laser. Accepts the parameters of `TransientPath` except `light_samples`,
    and

    | parameter | default | meaning |
    |---|---|---|
    | `relay_wall` | see below | ids of the wall's shapes, separated by commas |
    | `hidden_shapes` | see below | ids of the target shapes of hidden-geometry sampling |
    | `use_nlos_only` | false | count only paths with a vertex off the wall |
    | `filter_bounces` | -1 | count only paths of so many surface points (3: wall, object, wall) |
    | `nlos_hidden_geometry_sampling` | true | sample directions from the wall to hidden geometry |
    | `account_first_and_last_bounces` | true | count the legs from laser and sensor to the wall |
    | `block_size` | 0 | for scalar variants only, as in Mitsuba; otherwise a warning |

    By default, the relay wall is the shape to which the sensor is attached. Without such a shape,
    the wall is the shape with the id "relay_wall". All other shapes are hidden geometry, except
    boundaries of media. Points of the hidden geometry are sampled by area. With `hidden_shapes`,
    only these shapes are sampled by area. The BSDF of the wall still finds the others, so that
    their light counts as well.

    If no shape is known to be the wall and sampling is requested by name, the shapes that the
    pixels see are the wall, and the remaining shapes are the targets. After a scene is loaded,
    `relay_wall` and `hidden_shapes` can be set to lists of shapes or ids.

    If paths connect to the laser spot, they also connect to it through mirrors and clear glass (see
    `nlos.light.specular`).
    """

    needs_lights = False
    follows_polarization = False
    starts_at_lights = True
    takes_light_samples = False
    shown = ("max_depth", "use_nlos_only", "filter_bounces", "samples_hidden", "counts_legs")
    counts_legs_by_default = True
    samples_hidden_by_default = True
    lights_a_point = True
    """Whether paths connect to the laser spot, instead of the emitter."""

    hidden_probability = 0.5
    """Probability of sampling a point of the hidden geometry at the wall."""

    def __init__(self, props: mi.Properties) -> None:
        # Read the shapes. A request by name also guides paths in scenes without a known wall
        self.relay_wall: Any = parse_ids("relay_wall", props.get("relay_wall", None))
        self.hidden_shapes: Any = parse_ids("hidden_shapes", props.get("hidden_shapes", None))
        self._samples_by_name = props.get(HIDDEN_SAMPLING, None) is True

        # Only scalar variants render in blocks
        block = props.get("block_size", 0)
        if block:
            warn_no_effect("block_size", block, "only scalar variants render in blocks")

        # Read which directions are sampled and which paths count
        self.use_nlos_only = flag(props, "use_nlos_only")
        self.samples_hidden = flag(props, HIDDEN_SAMPLING, self.samples_hidden_by_default)
        legs = "account_first_and_last_bounces"
        self.counts_legs = flag(props, legs, self.counts_legs_by_default)
        fits = self.samples_hidden or self.hidden_shapes is None
        allowed = f"left out without {HIDDEN_SAMPLING}"
        checks.require("hidden_shapes", props.get("hidden_shapes", None), fits, allowed)
        self.filter_bounces = checks.depth("filter_bounces", props.get("filter_bounces", -1))

        # Without legs, lengths start at the wall
        super().__init__(props)
        self.camera_unwarp |= not self.counts_legs

    def laser(
        self, scan: Scan, ray: mi.Ray3f, origin: mi.Point3f, sampler: mi.Sampler, active: mi.Bool
    ) -> tuple[Any, Contribution | None]:
        """Return the endpoint for camera rays, and light of the laser spot that the camera sees.

        Args:
            scan: The scan.
            ray: Camera rays.
            origin: Point from which lengths are counted.
            sampler: The sampler.
            active: Active lanes.

        Returns:
            The endpoint, and the contribution of the visible laser spot. The contribution is None
            if the endpoint finds this light.
        """
        raise TypeError(f"{type(self).__name__} must override laser(), which returns the endpoint")

    def laser_spot(self, scan: Scan, beam: Beam) -> LaserSpot:
        """Return connections to the spot of a beam, which continues through fog or mirrors."""
        if scan.space.scatters:
            beam = scatter_beam(scan, beam)
        elif scan.specular is not None:
            beam = follow_beam(scan, beam)
        return LaserSpot(scan, beam, self.limits().max_depth)

    def plan(self, scene, sensor=None, weight=None) -> ScanPlan:
        """Plan the scan of a sensor's rays, with relay wall and mode from the parameters."""
        return self.capture_plan(scene, sensor)

    def capture_modes(self, sensor: mi.Sensor | None) -> tuple[str, ...]:
        """Return the capture modes that the scene supports. The first mode is the default."""
        return ("confocal", "single", "exhaustive")

    def capture_plan(
        self, scene: mi.Scene, sensor: mi.Sensor | None, wall: Any = None, mode: str | None = None
    ) -> ScanPlan:
        """Plan a capture.

        Args:
            scene: The scene.
            sensor: The sensor.
            wall: Shapes of the relay wall, None to find the wall.
            mode: One of `capture_modes`, None for the default.
        """
        scan = self.scan(scene, sensor, self.wall(scene, sensor) if wall is None else wall)
        counts_spot = not self.use_nlos_only and self.filter_bounces in (-1, 1)
        return ScanPlan(scan, self.laser, self.limits(), counts_spot)

    def laser_origin(self, scene: mi.Scene, sensor: mi.Sensor) -> np.ndarray:
        """Return the position of the laser [m], which is the camera's position."""
        return position_of(sensor)

    def scan(self, scene: mi.Scene, sensor: mi.Sensor | None, wall: list[mi.Shape]) -> Scan:
        """Describe the scan of a sensor's rays.

        Raises:
            ValueError: Hidden geometry is missing, or the sensor is in water or glass.
        """
        # Is there any hidden geometry?
        surfaces = [s for s in scene.shapes() if not s.is_emitter()]
        if self.use_nlos_only and all(shape in wall for shape in surfaces):
            raise ValueError(
                "scene: hidden geometry is missing. All its shapes are part of the relay wall"
            )

        # Find the upward direction of the camera
        up = [0.0, 1.0, 0.0]
        if sensor is not None:
            up = pose(sensor)[:3, 1].tolist()

        # Lengths assume a sensor in air
        space = self.space(scene, sensor)
        if space.index != 1:
            raise ValueError(
                f"sensor: it is in glass or water of index {space.index:g}, which "
                f"{type(self).__name__} does not support. Move it into air"
            )

        # Prepare guiding to hidden geometry, with corner connections for three bounces
        solid = [s for s in surfaces if not is_boundary(s.bsdf())]
        guided = self._guided(scene, sensor, solid, wall) if self.samples_hidden else None
        three = self.filter_bounces in (-1, 3) and (self.max_depth < 0 or self.max_depth >= 3)
        corner = guided is not None and self.lights_a_point and three
        return Scan(
            scene=scene,
            space=space,
            wall=wall,
            up=up,
            guided=guided,
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
        """Return the scattering that samples hidden geometry, or None if nothing is sampled."""
        # On which shapes are paths guided? Without a wall, on the shapes that the sensor sees
        guided_shapes = wall
        if not wall and (self._samples_by_name or self.hidden_shapes is not None):
            guided_shapes = [s for s in seen_shapes(scene, sensor) if not s.is_emitter()]

        # Which shapes are targets?
        if self.hidden_shapes is None:
            target_shapes = [shape for shape in surfaces if shape not in guided_shapes]
        else:
            target_shapes = find_shapes(scene, self.hidden_shapes, "hidden_shapes")
            walls = [shape for shape in target_shapes if shape in guided_shapes]
            if walls:
                raise ValueError(
                    f"hidden_shapes = {walls[0].id()!r}: this shape is part of the relay wall. "
                    "Name other shapes"
                )

        # A scene that is one merged shape cannot be divided into wall and hidden geometry
        if guided_shapes and not wall and len(surfaces) == 1:
            warnings.warn(
                f"nlos_hidden_geometry_sampling: the scene is one shape, {surfaces[0].id()!r}. If "
                "relay wall and hidden geometry were merged, tofrender.load_scene(..., "
                "optimize=False) keeps them separate and has less noise",
                stacklevel=3,
            )
        if not guided_shapes or not (target_shapes or not wall):
            return None
        targets = Targets(scene, self.targets(target_shapes or surfaces, guided_shapes))
        return Guided(Materials(scene), targets, guided_shapes, self.hidden_probability)

    def targets(self, hidden: list[mi.Shape], wall: list[mi.Shape]) -> list[mi.Shape]:
        """Return the target surfaces of hidden-geometry sampling."""
        return hidden

    def limits(self, max_opl: Any = None) -> Limits:
        """Return the limits of `TransientPath`, with the depth that `filter_bounces` allows."""
        limits = super().limits(max_opl)
        if self.filter_bounces >= 0:
            # The laser spot counts as a surface point. An emitter does not
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
        """Return the radiance of the laser's light that the visible surface reflects once.

        Args:
            scan: The scan.
            ray: Camera rays.
            origin: Point from which lengths are counted.
            laser: Position of the laser.
            irradiance: Function of a direction from the laser and a distance [m]. It returns the
                irradiance [W/m^2] of a surface that faces the laser.
            sampler: The sampler.
            active: Active lanes.
        """
        # Find the visible surface and the direction to the laser
        si = first_surface(scan.scene, ray, active)
        to_laser = laser - si.p
        r = dr.norm(to_laser)
        d = to_laser / r
        seen = active & si.is_valid()

        # Attenuate the light on both legs
        transmittance = transmittance_between(scan.space, si, laser, sampler, seen)
        to_camera = dr.norm(si.p - origin)
        if scan.space.scatters:
            transmittance *= transmittance_between(scan.space, si, ray.o, sampler, seen, to_camera)

        # Evaluate the BSDF
        f = mi.unpolarized_spectrum(si.bsdf().eval(mi.BSDFContext(), si, si.to_local(d), seen))
        radiance = f * irradiance(-d, r) * transmittance

        # Count the legs in the path length
        opl = mi.Float(0) if self.camera_unwarp else to_camera
        opl += r if self.counts_legs else 0
        return Contribution(radiance, opl, seen & dr.any(radiance != 0))

    def wall(self, scene: mi.Scene, sensor: mi.Sensor | None) -> list[mi.Shape]:
        """Return the shapes of the relay wall, or [] if the wall is unknown and not required."""
        if self.relay_wall is not None:
            return find_relay_wall(scene, self.relay_wall)
        carrier = None if sensor is None else sensor.get_shape()

        # Compare pointers, because the Python objects differ
        if carrier is not None:
            return [s for s in scene.shapes() if (mi.ShapePtr(s) == mi.ShapePtr(carrier))[0]]
        if DEFAULT_ID in [shape.id() for shape in scene.shapes()] or self.use_nlos_only:
            return find_relay_wall(scene, DEFAULT_ID)
        return []


def flag(props: mi.Properties, name: str, default: bool = False) -> bool:
    """Read a boolean parameter of a plugin."""
    return checks.boolean(name, props.get(name, default))


def warn_no_effect(name: str, value: Any, reason: str) -> None:
    """Warn that a parameter has no effect."""
    warnings.warn(f"{name} = {value}: has no effect; {reason}", stacklevel=3)
