"""Problems a2.confocal and a2.area_spot: confocal path tracing."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

import drjit as dr
import mitsuba as mi
from relay_wall import is_on_relay_wall
from transient_path import TransientPath


class ConfocalTransientIntegrator(TransientPath):
    """Laser and camera along the same ray, into the time bins of a film.

    Each camera ray is also a laser beam. The point p that it hits first receives the power Φ and is
    the light source for all further vertices: a point light with the directions in which the wall's
    material reflects the beam. A path leads from the laser to p, through the hidden scene, back to
    p, and to the camera. All four parts are included in its length.

    The radiance of a point that is lit by a beam is not finite. Therefore light on the direct path
    from laser to p to camera is left out. Emitters of the scene are ignored.

    Parameters in addition to those of `TransientPath`:

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 8 | longest path in segments from the camera to the laser spot: 3 is camera, \
p, hidden point, p |
    | `power` | 1.0 | power Φ that arrives at p, the cosine included [W] |
    | `relay_wall` | "relay_wall" | ids of the wall's shapes, separated by commas |
    | `use_nlos_only` | false | count only paths with a vertex that is not on the relay wall |
    | `spot_sigma` | 0.0 | bonus a2.area_spot: width of the beam [rad], 0 for a point |

    With `spot_sigma` = s > 0 the beam has a width. It leaves the camera in the directions (x, y, 1)
    of a frame with the camera ray as its third axis. x and y are independent and normally
    distributed around 0 with the standard deviation tan(s). The beam lights a spot instead of the
    point p, and carries the power Φ in all.
    """

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
        """Follow paths that start at the wall, and connect their vertices to the laser spot.

        Args:
            scene: The scene.
            sampler: Random numbers.
            ray: Camera rays, which are also laser beams.
            deposit: As for `TransientPath.sample`.
            origin: Positions of camera and laser; lengths start and end there.
            active: Lanes to trace.

        Returns:
            Radiance summed over all lengths, and the mask of the rays that hit a surface.
        """
        raise NotImplementedError("a2.confocal: ConfocalTransientIntegrator.sample")


mi.register_integrator("confocal_transient_path", ConfocalTransientIntegrator)
