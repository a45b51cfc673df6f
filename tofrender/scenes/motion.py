"""Rigid motion of a scene's shapes, emitters and sensors, and the scene's poses at a time.

A point x of a part moves as

    x(t) = c + v t + R(ω t) (x - c),        velocity v + ω × (x - c) at t = 0,

with the velocity v, the angular velocity ω and the rotation center c.

Mitsuba's objects cannot store motions. Therefore the motions are stored in the scene's id, after
the scene's description.
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

FASTEST = 1e6  # Largest speed [m/s]; terms of second order in v / c are neglected
MOTIONS = "\nmotions "  # Text in a scene's id before the motions
TIME = "\ntime "  # Text in a scene's id before the time of the pose
KINDS = (mi.ObjectType.Shape, mi.ObjectType.Sensor, mi.ObjectType.Emitter)


@dataclass(frozen=True)
class Motion:
    """Rigid motion of a shape, an emitter or a sensor.

    Args:
        velocity: Velocity [m/s] of the rotation center, at most 1e6 m/s.
        angular_velocity: Axis of rotation times angular speed [rad/s], by the right-hand rule.
        rotation_center: A point of the axis at the time 0 [m]. The default is the part's own
            center: the center of a shape's bounding box, or the position of an emitter or a sensor.

    Raises:
        ValueError: If a component is not finite, or a speed is above the limit.

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
        """Whether the velocity or the angular velocity is not zero."""
        return any(self.velocity) or any(self.angular_velocity)

    @property
    def _axis_point(self) -> np.ndarray:
        """Return a point of the axis at the time 0 [m], or the origin without rotation."""
        if self.rotation_center is not None:
            return np.array(self.rotation_center)
        if any(self.angular_velocity):
            raise ValueError(
                "rotation_center is None, and only a scene knows the part's own center. Pass "
                "rotation_center, or read the motion with motions_of(scene)"
            )
        return np.zeros(3)

    def matrix(self, time_s: float) -> np.ndarray:
        """Return the transform (4, 4) from the pose at time 0 to the pose at `time_s` [s]."""
        # Rotation about the origin
        speed = float(np.linalg.norm(self.angular_velocity))
        rotation = np.eye(4)
        if speed > 0:
            axis = [component / speed for component in self.angular_velocity]
            degrees = float(np.degrees(np.fmod(speed * time_s, 2 * np.pi)))
            transform: Any = mi.ScalarTransform4d
            rotation = np.array(transform().rotate(axis, degrees).matrix)

        # Move the rotation center to the origin, rotate, and move it to its new position
        to_origin = np.eye(4)
        to_origin[:3, 3] = -self._axis_point
        from_origin = np.eye(4)
        from_origin[:3, 3] = self._axis_point + np.multiply(self.velocity, time_s)
        return from_origin @ rotation @ to_origin

    def affine(self) -> tuple[np.ndarray, np.ndarray]:
        """Return a and ω, so that a point x has the velocity a + ω × x at the time 0."""
        spin = np.array(self.angular_velocity)
        return np.array(self.velocity) - np.cross(spin, self._axis_point), spin

    def speed_at(self, bbox: Any) -> float:
        """Return the largest speed of the corners of a bounding box at the time 0 [m/s]."""
        box = mi.ScalarBoundingBox3f(bbox)
        a, spin = self.affine()
        corners = [np.array(box.corner(k)) for k in range(8)] if box.valid() else [np.zeros(3)]
        return max(float(np.linalg.norm(a + np.cross(spin, corner))) for corner in corners)


def moving(scene: mi.Scene, motions: Mapping[str, Motion]) -> mi.Scene:
    """Set the motions of a loaded scene's shapes, emitters and sensors.

    Args:
        scene: The scene. Its pictures show the pose at the time 0; see `posed` for other times.
        motions: Motions by the ids of shapes, instances, emitters and sensors. They replace all
            earlier motions. An area light moves with its shape.

    Returns:
        The same scene.

    Raises:
        ValueError: If an id is not in the scene, or the part cannot move.

    Example:
        >>> import mitsuba as mi, tofrender
        >>> scene = tofrender.load_scene(tofrender.cornell_box(), optimize=False)
        >>> scene = moving(scene, {"small-box": Motion(velocity=(0, 0, 1))})
        >>> motions_of(scene)["small-box"].velocity
        (0.0, 0.0, 1.0)
    """
    # Check the motions, and complete the rotation centers
    checks.instance("scene", scene, mi.Scene, "a loaded scene")
    parts = movable_parts(scene)
    completed: dict[str, Motion] = {}
    for name, motion in checks.mapping("motions", motions).items():
        checks.instance(f"motions[{name!r}]", motion, Motion, "a Motion")
        require_movable("motions", name, parts)
        completed[name] = _with_center(motion, parts[name])
        _require_slow(completed[name], parts[name])

    # Store the motions in the scene's id
    stored = {name: asdict(motion) for name, motion in completed.items() if motion.moves}
    if stored:
        _invert_again(scene, stored)
    base = scene.id().partition(MOTIONS)[0]
    scene.set_id(base + (MOTIONS + json.dumps(stored, sort_keys=True) if stored else ""))
    return scene


def _invert_again(scene: mi.Scene, names: Iterable[str]) -> None:
    """Let Mitsuba recompute inverse transforms of parts.

    Mitsuba also recomputes them at the end of a pose. After this function, the scene is bitwise
    equal before and after a pose.
    """
    params = mi.traverse(scene)
    with tracing_lock():
        for key in (f"{name}.to_world" for name in names):
            if key in params:
                params.set_dirty(key)
        params.update()


def moved(scene: mi.Scene) -> str:
    """Return the part of a scene's id with motions and the time of the pose, for fingerprints."""
    return "".join(scene.id().partition(MOTIONS)[1:])


def motions_of(scene: mi.Scene) -> dict[str, Motion]:
    """Return the motions of a scene's moving parts at the time of its pose, by id."""
    checks.instance("scene", scene, mi.Scene, "a loaded scene")
    text, _, time = scene.id().partition(MOTIONS)[2].partition(TIME)
    found = {name: Motion(**each) for name, each in json.loads(text or "{}").items()}
    seconds = float(time or 0)
    return {name: _later(motion, seconds) for name, motion in found.items()}


def _later(motion: Motion, time_s: float) -> Motion:
    """Return the motion of a part in the pose at a time [s], with the moved rotation center."""
    if motion.rotation_center is None:
        return motion
    center = np.add(motion.rotation_center, np.multiply(motion.velocity, time_s))
    return replace(motion, rotation_center=tuple(float(x) for x in center))


def _with_center(motion: Motion, part: Any) -> Motion:
    """Return the motion of a part, with the part's own center if the rotation center is missing."""
    if motion.rotation_center is not None or not any(motion.angular_velocity):
        return motion

    # The center of the bounding box, or the position
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
    """Move a scene to its pose at a time [s], and back when the `with` block ends.

    Example:
        >>> import tofrender
        >>> scene = tofrender.load_scene("cornell_box", width=8, height=8, optimize=False)
        >>> scene = moving(scene, {"small-box": Motion(velocity=(0, 0, 1))})
        >>> with posed(scene, 0.1):
        ...     later = tofrender.render(scene, spp=1, window=(3.5, 15.0))
    """
    time_s = checks.number("time_s", time_s, unit="seconds")
    motions = motions_of(scene)
    before = scene.id()
    if time_s == 0 or not motions:
        yield scene
        return
    if TIME in before:
        raise RuntimeError(
            "posed(): the scene is already posed. Leave the other `with posed(...)` block first"
        )
    changes = {name: motion.matrix(time_s) for name, motion in motions.items()}
    with placed(scene, changes):
        scene.set_id(f"{before}{TIME}{time_s!r}")
        try:
            yield scene
        finally:
            scene.set_id(before)


@contextmanager
def placed(scene: mi.Scene, changes: Mapping[str, np.ndarray]) -> Iterator[None]:
    """Apply transforms to parts of a scene, and undo them at the end of the block.

    Args:
        scene: A loaded scene.
        changes: Transforms in world space (4, 4), by the ids of the parts.
    """
    # Move the parts, and keep copies of the parameters
    params = mi.traverse(scene)
    kept = {}
    with tracing_lock():
        for name, change in changes.items():
            for key, moved in _moved(params, name, change):
                kind: Any = type(params[key])
                kept[key] = kind(params[key])
                params[key] = moved
        params.update()

    # Move the parts back at the end, even after an error
    try:
        yield
    finally:
        with tracing_lock():
            for key, value in kept.items():
                params[key] = value
            params.update()


def _moved(params: Any, name: str, change: np.ndarray) -> Iterator[tuple[str, Any]]:
    """Yield key and new value of each parameter of a part that a transform (4, 4) changes."""
    # Opaque values are inputs of kernels, so all poses share one kernel
    transform: Any = mi.Transform4f
    matrix = transform(mi.Matrix4f(change.tolist()))
    dr.make_opaque(matrix)

    # The transform of a shape, an emitter or a sensor
    key = f"{name}.to_world"
    if key in params:
        kind: Any = type(params[key])
        before = np.array(params[key].matrix, dtype=float).reshape(4, 4)
        moved = kind(mi.Matrix4f((change @ before).tolist()))
        dr.make_opaque(moved)
        yield key, moved

    # The position of a point emitter
    key = f"{name}.position"
    if key in params:
        moved = matrix @ mi.Point3f(params[key])
        dr.make_opaque(moved)
        yield key, moved

    # The vertices of a mesh
    for names, kind in ((POSITIONS, mi.Point3f), (NORMALS, mi.Normal3f)):
        key = name_of(params, names, f"{name}.")
        if key is not None and dr.width(params[key]):
            moved = like(params[key], dr.ravel(matrix @ vectors(params[key], kind)))
            dr.make_opaque(moved)
            yield key, moved


def take_motions(state: Any) -> dict[str, Motion]:
    """Remove the motions from a parsed scene, and return them by id.

    The properties of shapes, emitters and sensors are `velocity`, `angular_velocity` and
    `rotation_center`. A `rotation_center` alone is not a motion. The properties are removed because
    Mitsuba's plugins do not support them.
    """
    found: dict[str, Motion] = {}
    for index, node in enumerate(state.nodes):
        # Does this node move, and may it move?
        props = node.props
        if "velocity" not in props and "angular_velocity" not in props:
            continue
        if not any(is_kind(node, kind) for kind in KINDS):
            raise ValueError(
                f"{props.plugin_name()}: only shapes, emitters and sensors can move. Remove its "
                "velocity"
            )

        # Move the properties to a motion; parts without an id get one
        motion = {each.name: props[each.name] for each in fields(Motion) if each.name in props}
        for name in motion:
            del props[name]
        if not props.id():
            props.set_id(f"moving_{index}")
        try:
            found[props.id()] = Motion(**motion)
        except ValueError as error:
            raise ValueError(f"{props.id()}: {error}") from None
    return {name: motion for name, motion in found.items() if motion.moves}


def movable_parts(scene: mi.Scene) -> dict[str, Any]:
    """Return the shapes, emitters and sensors of a scene that have an id, by id."""
    parts = [*scene.emitters(), *scene.sensors(), *scene.shapes()]
    return {each.id(): each for each in parts if each.id()}


def require_movable(argument: str, name: str, known: Mapping[str, Any]) -> None:
    """Raise a ValueError if an id is not in the scene, or if a part cannot move."""
    allowed = checks.join_names([each for each in known if not each.startswith("__")])
    merged = "; Mitsuba merges shapes that share a material unless loaded with optimize=False"
    checks.require(argument, name, name in known, f"an id of the scene, one of {allowed}{merged}")

    # Emitters at infinity are fixed, and area lights move with their shape
    part = known[name]
    if isinstance(part, mi.Emitter):
        flags = part.flags()
        if mi.has_flag(flags, mi.EmitterFlags.Infinite):
            raise ValueError(f"{argument} = {name!r}: emitters at infinity cannot move. Remove it")
        if mi.has_flag(flags, mi.EmitterFlags.Surface):
            raise ValueError(f"{argument} = {name!r}: an area light. Use the id of its shape")

    # Does the part have a pose that can change?
    params = mi.traverse(part)
    if not (pose_name(params) or name_of(params, ("position", *POSITIONS))):
        raise ValueError(
            f"{argument} = {name!r}: the pose of a {part.class_name()} is fixed. Remove it"
        )

    # The grid of a medium would not move with the shape
    if isinstance(part, mi.Shape):
        medium = part.interior_medium()
        if medium is not None and not medium.is_homogeneous():
            raise ValueError(
                f"{argument} = {name!r}: a shape with a medium on a grid cannot move. Use a "
                "homogeneous medium"
            )


def _require_slow(motion: Motion, part: Any) -> None:
    """Raise a ValueError if a corner of a shape's bounding box is faster than `FASTEST`."""
    if isinstance(part, mi.Shape):
        slow = motion.speed_at(part.bbox()) <= FASTEST
        checks.require("motions", part.id(), slow, f"of speeds up to {FASTEST:g} m/s")
