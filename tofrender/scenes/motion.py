"""Motion of a scene's shapes, lamps and sensors: how it is stored, and poses at a time.

The motion of each part is rigid: a point x of it moves as

    x(t) = c + v t + R(ω t) (x - c),        velocity v + ω × (x - c) at t = 0,

with the velocity v, the angular velocity ω and the rotation center c.

Mitsuba's objects have no place for it, so the scene's id stores it, behind the scene's description.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ..runtime import checks
from ..runtime.backend import tracing_lock
from ..runtime.interface import NORMALS, POSITIONS, like, name_of, pose_name, vectors
from .nodes import is_kind

FASTEST = 1e6  # largest speed [m/s]; relativistic terms, of (v / c)², are left out
MOTIONS, TIME = "\nmotions ", "\ntime "  # what precedes motions and the pose's time in scene ids
KINDS = (mi.ObjectType.Shape, mi.ObjectType.Sensor, mi.ObjectType.Emitter)


@dataclass(frozen=True)
class Motion:
    """Rigid motion of a shape, a lamp or a sensor.

    Args:
        velocity: Velocity [m/s] of the rotation center, at most 1e6 m/s.
        angular_velocity: Axis of rotation times angular speed [rad/s]; by the right-hand rule.
        rotation_center: Point of the axis at the time 0 [m]; by default the part's own center. This
            is the center of a shape's bounding box, and the position of a lamp or a sensor.

    Raises:
        ValueError: A component is not finite, or a speed above the limit.

    Example:
        >>> Motion(velocity=(0, 0, 2)).velocity
        (0.0, 0.0, 2.0)
    """

    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angular_velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation_center: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        for name, unit in (("velocity", "m/s"), ("angular_velocity", "rad/s")):
            value = tuple(checks.point(name, getattr(self, name)))
            slow = float(np.linalg.norm(value)) <= FASTEST
            checks.require(name, value, slow, f"at most {FASTEST:g} {unit} in all")
            object.__setattr__(self, name, value)

        if self.rotation_center is not None:
            center = tuple(checks.point("rotation_center", self.rotation_center))
            object.__setattr__(self, "rotation_center", center)

    @property
    def moves(self) -> bool:
        """Whether anything moves."""
        return any(self.velocity) or any(self.angular_velocity)

    @property
    def _axis_point(self) -> np.ndarray:
        """Point of the axis at the time 0 [m]; any point if nothing rotates."""
        if self.rotation_center is not None:
            return np.array(self.rotation_center)
        if any(self.angular_velocity):
            raise ValueError(
                "rotation_center is None, and only a scene knows the part's own center. Pass "
                "rotation_center, or read the motion with motions_of(scene)"
            )
        return np.zeros(3)

    def matrix(self, time_s: float) -> np.ndarray:
        """Return the transform from the pose at 0 to that at a time [s], shape (4, 4)."""
        speed = float(np.linalg.norm(self.angular_velocity))
        rotation = np.eye(4)
        if speed > 0:
            axis = [component / speed for component in self.angular_velocity]
            degrees = float(np.degrees(np.fmod(speed * time_s, 2 * np.pi)))
            transform: Any = mi.ScalarTransform4d
            rotation = np.array(transform().rotate(axis, degrees).matrix)
        there, back = np.eye(4), np.eye(4)
        there[:3, 3] = self._axis_point + np.multiply(self.velocity, time_s)
        back[:3, 3] = -self._axis_point
        return there @ rotation @ back

    def affine(self) -> tuple[np.ndarray, np.ndarray]:
        """Return a and ω of the velocity a + ω × x at a point x, at the time 0."""
        spin = np.array(self.angular_velocity)
        return np.array(self.velocity) - np.cross(spin, self._axis_point), spin

    def speed_at(self, bbox: Any) -> float:
        """Return the largest speed of a corner of a bounding box, at the time 0 [m/s]."""
        box, (a, spin) = mi.ScalarBoundingBox3f(bbox), self.affine()
        corners = [np.array(box.corner(k)) for k in range(8)] if box.valid() else [np.zeros(3)]
        return max(float(np.linalg.norm(a + np.cross(spin, corner))) for corner in corners)


def moving(scene: mi.Scene, motions: Mapping[str, Motion]) -> mi.Scene:
    """Set the motions of a loaded scene's shapes, lamps and sensors.

    Args:
        scene: The scene; its pictures are those of the time 0, see `posed`.
        motions: Motions by the ids of shapes, instances, lamps and sensors; they replace all
            earlier ones. An area light moves with its shape.

    Returns:
        The same scene.

    Raises:
        ValueError: An id is not in the scene, or names what cannot move; one line.

    Example:
        >>> import mitsuba as mi, tofrender
        >>> scene = tofrender.load_scene(tofrender.cornell_box(), optimize=False)
        >>> scene = moving(scene, {"small-box": Motion(velocity=(0, 0, 1))})
        >>> motions_of(scene)["small-box"].velocity
        (0.0, 0.0, 1.0)
    """
    checks.instance("scene", scene, mi.Scene, "a loaded scene")
    known = movable_parts(scene)
    given: dict[str, Motion] = {}
    for name, motion in checks.mapping("motions", motions).items():
        checks.instance(f"motions[{name!r}]", motion, Motion, "a Motion")
        require_movable("motions", name, known)
        given[name] = _with_center(motion, known[name])
        _require_slow(given[name], known[name])
    stored = {name: asdict(motion) for name, motion in given.items() if motion.moves}
    if stored:
        _invert_again(scene, stored)
    base = scene.id().partition(MOTIONS)[0]
    scene.set_id(base + (MOTIONS + json.dumps(stored, sort_keys=True) if stored else ""))
    return scene


def _invert_again(scene: mi.Scene, names: Iterable[str]) -> None:
    """Let Mitsuba invert transforms as it does at the end of a pose, which then changes no bit."""
    params = mi.traverse(scene)
    with tracing_lock():
        for key in (f"{name}.to_world" for name in names):
            if key in params:
                params.set_dirty(key)
        params.update()


def moved(scene: mi.Scene) -> str:
    """Return the part of a scene's id that tells its motions and pose, which fingerprints have."""
    return "".join(scene.id().partition(MOTIONS)[1:])


def motions_of(scene: mi.Scene) -> dict[str, Motion]:
    """Return the motions of a scene's parts at the time of its pose, by id; empty if at rest."""
    checks.instance("scene", scene, mi.Scene, "a loaded scene")
    text, _, time = scene.id().partition(MOTIONS)[2].partition(TIME)
    found = {name: Motion(**each) for name, each in json.loads(text or "{}").items()}
    seconds = float(time or 0)
    return {name: _later(motion, seconds) for name, motion in found.items()}


def _later(motion: Motion, time_s: float) -> Motion:
    """Return the motion of a pose at a later time."""
    if motion.rotation_center is None:
        return motion
    center = np.add(motion.rotation_center, np.multiply(motion.velocity, time_s))
    return replace(motion, rotation_center=tuple(float(x) for x in center))


def _with_center(motion: Motion, part: Any) -> Motion:
    """Return the motion of a part, with the part's own center if it rotates and has no other."""
    if motion.rotation_center is not None or not any(motion.angular_velocity):
        return motion
    if isinstance(part, mi.Shape):
        box = mi.ScalarBoundingBox3f(part.bbox())
        center = np.ravel(np.array(box.center(), dtype=float))
    else:
        params: Any = mi.traverse(part)
        pose = pose_name(params)
        if pose is None:
            center = np.ravel(np.array(params["position"], dtype=float))
        else:
            center = np.array(params[pose].matrix, dtype=float).reshape(4, 4)[:3, 3]
    return replace(motion, rotation_center=tuple(float(x) for x in center))


@contextmanager
def posed(scene: mi.Scene, time_s: float) -> Iterator[mi.Scene]:
    """Move a scene to its pose at a time [s], and back at the end.

    Example:
        >>> import tofrender
        >>> scene = tofrender.load_scene("cornell_box", width=8, height=8, optimize=False)
        >>> scene = moving(scene, {"small-box": Motion(velocity=(0, 0, 1))})
        >>> with posed(scene, 0.1):
        ...     later = tofrender.render(scene, spp=1, window=(3.5, 15.0))
    """
    time_s = checks.number("time_s", time_s, unit="seconds")
    motions, before = motions_of(scene), scene.id()
    if time_s == 0 or not motions:
        yield scene
        return
    if TIME in before:
        raise RuntimeError("posed: the scene is in another pose already; must end that first")
    changes = {name: motion.matrix(time_s) for name, motion in motions.items()}
    with placed(scene, changes):
        scene.set_id(f"{before}{TIME}{time_s!r}")
        try:
            yield scene
        finally:
            scene.set_id(before)


@contextmanager
def placed(scene: mi.Scene, changes: Mapping[str, np.ndarray]) -> Iterator[None]:
    """Apply transforms of the world (4, 4) to parts of a scene, by id, and undo them at the end."""
    params = mi.traverse(scene)
    kept = {}
    with tracing_lock():
        for name, change in changes.items():
            for key, moved in _moved(params, name, change):
                kind: Any = type(params[key])
                kept[key] = kind(params[key])
                params[key] = moved
        params.update()
    try:
        yield
    finally:
        with tracing_lock():
            for key, value in kept.items():
                params[key] = value
            params.update()


def _moved(params: Any, name: str, change: np.ndarray) -> Iterator[tuple[str, Any]]:
    """Return parameters of a part that a transform of the world changes, by key."""
    transform: Any = mi.Transform4f
    matrix = transform(mi.Matrix4f(change.tolist()))
    dr.make_opaque(matrix)  # One kernel for all poses
    key = f"{name}.to_world"
    if key in params:
        kind: Any = type(params[key])
        before = np.array(params[key].matrix, dtype=float).reshape(4, 4)
        moved = kind(mi.Matrix4f((change @ before).tolist()))
        dr.make_opaque(moved)
        yield key, moved
    key = f"{name}.position"
    if key in params:
        moved = matrix @ mi.Point3f(params[key])
        dr.make_opaque(moved)
        yield key, moved
    for names, kind in ((POSITIONS, mi.Point3f), (NORMALS, mi.Normal3f)):
        key = name_of(params, names, f"{name}.")
        if key is not None and dr.width(params[key]):
            moved = like(params[key], dr.ravel(matrix @ vectors(params[key], kind)))
            dr.make_opaque(moved)
            yield key, moved


def take_motions(state: Any) -> dict[str, Motion]:
    """Remove motions from a parsed scene, whose plugins do not know them, and return them by id.

    The properties of shapes, lamps and sensors are `velocity`, `angular_velocity` and
    `rotation_center`, which needs one of the others.
    """
    found: dict[str, Motion] = {}
    for number, node in enumerate(state.nodes):
        props, names = node.props, [each.name for each in fields(Motion)]
        if "velocity" not in props and "angular_velocity" not in props:
            continue
        if not any(is_kind(node, kind) for kind in KINDS):
            raise ValueError(
                f"{props.plugin_name()}: has a velocity; only shapes, lamps, sensors may"
            )
        given = {name: props[name] for name in names if name in props}
        for name in given:
            del props[name]
        if not props.id():
            props.set_id(f"moving_{number}")
        try:
            found[props.id()] = Motion(**given)
        except ValueError as error:
            raise ValueError(f"{props.id()}: {error}") from None
    return {name: motion for name, motion in found.items() if motion.moves}


def movable_parts(scene: mi.Scene) -> dict[str, Any]:
    """Return the parts of a scene by id: shapes, lamps that are no surface, and sensors."""
    parts = [*scene.emitters(), *scene.sensors(), *scene.shapes()]
    return {each.id(): each for each in parts if each.id()}


def require_movable(argument: str, name: str, known: Mapping[str, Any]) -> None:
    """Refuse ids that are not in the scene, and parts whose pose cannot change."""
    allowed = checks.join_names([each for each in known if not each.startswith("__")])
    merged = "; shapes that share a material are one unless loaded with optimize=False"
    checks.require(argument, name, name in known, f"an id of the scene, one of {allowed}{merged}")
    part = known[name]
    if isinstance(part, mi.Emitter):
        flags = part.flags()
        at_infinity = mi.has_flag(flags, mi.EmitterFlags.Infinite)
        checks.require(argument, name, not at_infinity, "no lamp at infinity, which is at rest")
        on_shape = mi.has_flag(flags, mi.EmitterFlags.Surface)
        checks.require(argument, name, not on_shape, "the shape of that lamp")
    params = mi.traverse(part)
    has_pose = pose_name(params) or name_of(params, ("position", *POSITIONS))
    checks.require(argument, name, has_pose, f"no {part.class_name()}, whose pose is fixed")
    if isinstance(part, mi.Shape):
        medium = part.interior_medium()
        grid = medium is not None and not medium.is_homogeneous()
        checks.require(argument, name, not grid, "no shape with a medium on a grid, which is fixed")


def _require_slow(motion: Motion, part: Any) -> None:
    """Refuse a shape that moves too fast at some point."""
    if isinstance(part, mi.Shape):
        slow = motion.speed_at(part.bbox()) <= FASTEST
        checks.require("motions", part.id(), slow, f"of speeds up to {FASTEST:g} m/s")
