"""Put drawn values into a scene: parameters, materials, poses, the camera, and its objects."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import mitsuba as mi
import numpy as np

from ..runtime.interface import NORMALS, POSITIONS, rows, set_rows
from ..runtime.tables import unknown
from ..scenes.parts import Dict, ref, rgb
from .varied import Varied

CAMERAS = ("perspective", "thinlens", "orthographic", "radiancemeter", "irradiancemeter", "distant")
IN_WORLD = CAMERAS[:3]  # Sensors with a pose that is a transform

UP = (0.0, 1.0, 0.0)  # Direction that is up in pictures by default

FILMS = ("film", "sampler")  # Parts of a sensor that all records share


def change(scene: Dict, sensor: int, varied: Iterable[Varied], drawn: Mapping[str, Any]) -> None:
    """Put drawn values into a scene.

    The order is: values, materials, poses, the camera, and at last the removal of objects.

    Args:
        scene: Scene as a dict, which is changed.
        sensor: Index of the camera that may be moved.
        varied: Varied quantities.
        drawn: Value of each quantity, by name.
    """
    # Group the quantities by target
    by_target: dict[str, list[tuple[Varied, Any]]] = {}
    for each in varied:
        by_target.setdefault(each.target, []).append((each, drawn[each.name]))

    # Set values, materials and poses
    for target, setter in SETTERS.items():
        for each, value in by_target.get(target, []):
            setter(scene, each, value)

    # Move the camera. Origin and target are set together
    if "camera" in by_target:
        _set_camera(scene, sensor, by_target["camera"])

    # Remove the objects that were not drawn
    for each, value in by_target.get("present", []):
        kept = value if isinstance(value, list) else [value]
        for name in each.part:
            _entry(f"vary.{each.name}.present", name, scene, name)
            if name not in kept:
                del scene[name]


def _set_path(scene: Dict, varied: Varied, value: Any) -> None:
    """Set a value that a path of names describes, such as `light.emitter.radiance`."""
    where = f"vary.{varied.name}.path"
    *parents, last = varied.part.split(".")

    # Follow the names to the part that contains the value
    part: Any = scene
    for key in parents:
        part = _entry(where, varied.part, part, key)
        if key in FILMS:
            raise ValueError(f"{where} = {varied.part!r}: {key} is the same in all records")

    # Assign the value in the form of the old value
    part[last] = _like(where, varied, _entry(where, varied.part, part, last), value)


def _set_reflectance(scene: Dict, varied: Varied, value: Any) -> None:
    """Set the reflectance of a material, or of the material of an object."""
    where, material = _target(scene, varied)

    # Find the inner material of an object or of `twosided`
    while isinstance(material, dict) and "reflectance" not in material:
        inner = [part for part in material.values() if isinstance(part, dict)]
        reference = next((part for part in inner if _is_reference(part)), None)
        if reference is not None:
            raise ValueError(
                f"{where}: uses the material {reference.get('id')!r}, which others may use too; "
                "must be that"
            )
        material = next((p for p in inner if "reflectance" in p or "bsdf" in p), None)
    if not isinstance(material, dict):
        raise ValueError(f"{where}: has no reflectance; must be a material")

    # Assign the color, or multiply the old color by the draw
    old = material["reflectance"]
    color = np.broadcast_to(np.asarray(value, float), 3)
    if varied.times:
        if not isinstance(old, dict) or old.get("type") != "rgb":
            raise ValueError(f"{where}: times needs a color, type rgb")
        color = np.clip(color * np.asarray(old["value"], float), 0, 1)
    material["reflectance"] = rgb(color.tolist())


def _set_material(scene: Dict, varied: Varied, value: str) -> None:
    """Give an object the material with the drawn name."""
    where, shape = _target(scene, varied)
    if not isinstance(shape, dict):
        raise ValueError(f"{where}: is a ready-made mesh; must be an object of a dict")
    if not isinstance(scene.get(value), dict):
        known = [n for n, v in scene.items() if isinstance(v, dict) and "type" in v]
        raise ValueError(unknown(f"vary.{varied.name}.values = {value!r}", value, known))

    # Replace the old material by a reference
    for name, part in list(shape.items()):
        if name == "bsdf" or (_is_reference(part) and name not in ("emitter", "sensor")):
            del shape[name]
    shape["bsdf"] = ref(value)


def _set_pose(scene: Dict, varied: Varied, value: Any) -> None:
    """Move, turn or scale an object."""
    where, shape = _target(scene, varied)
    if not isinstance(shape, dict | mi.Mesh):
        raise ValueError(f"{where}: is no object; must be a shape or a light")

    # A point light has a position only
    if isinstance(shape, dict) and "position" in shape and "to_world" not in shape:
        if varied.target not in ("move", "position"):
            raise ValueError(f"{where}: is a point; must be an object with a size")
        origin = np.asarray(shape["position"], float) if varied.target == "move" else 0
        shape["position"] = (np.asarray(value, float) + origin).tolist()
        return

    # Build the transform in world space
    middle = _middle(shape)
    matrix = np.eye(4)
    if varied.target in ("move", "position"):
        matrix[:3, 3] = np.asarray(value, float) - (middle if varied.target == "position" else 0)
    else:
        # Rotate or scale about a fixed point
        linear = mi.ScalarTransform4f()
        if varied.target == "turn":
            linear = linear.rotate(list(varied.axis), value)
        else:
            linear = linear.scale(np.broadcast_to(np.asarray(value, float), 3).tolist())
        around = np.asarray(varied.around if varied.around is not None else middle, float)
        matrix[:3, :3] = np.array(linear.matrix, dtype=np.float64)[:3, :3]
        matrix[:3, 3] = around - matrix[:3, :3] @ around

    # Apply the transform after the object's own transform
    if isinstance(shape, dict):
        to_world = matrix @ _matrix(shape.get("to_world"))
        shape["to_world"] = mi.ScalarTransform4f(to_world.tolist())
    else:
        _transform_mesh(shape, matrix)


def _set_camera(scene: Dict, sensor: int, changes: list[tuple[Varied, Any]]) -> None:
    """Set the origin, the target and the field of view of a camera."""
    where = f"vary.{changes[0][0].name}.camera"
    cameras = [part for part in scene.values() if isinstance(part, dict) and _is_camera(part)]
    if not sensor < len(cameras) or cameras[sensor]["type"] not in IN_WORLD:
        raise ValueError(f"{where}: the scene has no camera that can be moved")
    camera = cameras[sensor]
    values = {each.part: value for each, value in changes}

    # Set the field of view
    if "fov" in values:
        if camera["type"] == "orthographic":
            raise ValueError(f"{where} = 'fov': the scene's camera is orthographic")
        camera.pop("focal_length", None)
        camera["fov"] = values["fov"]

    # Aim the camera
    if "origin" in values or "target" in values:
        up = next((each.up for each, _ in changes if each.up is not None), None)
        matrix = _aimed(where, _matrix(camera.get("to_world")), values, up)
        camera["to_world"] = mi.ScalarTransform4f(matrix.tolist())


def _aimed(
    where: str, matrix: np.ndarray, values: Mapping[str, Any], up: Sequence[float] | None
) -> np.ndarray:
    """Return a camera's transform with another origin and target.

    The scale and the roll stay. The roll is the angle of the camera about its viewing direction,
    and it is 0 when the direction `UP` is up in the picture. With `up`, the roll is 0 for that
    direction.
    """
    origin = np.asarray(values.get("origin", matrix[:3, 3]), float)
    moved = matrix.copy()
    moved[:3, 3] = origin

    # Without a new target and a new roll, the camera keeps its direction of view
    if "target" not in values and up is None:
        return moved

    # Aim the camera; the picture is upright
    direction = matrix[:3, 2]
    if "target" in values:
        direction = np.asarray(values["target"], float) - origin
    upright = _upright(direction, UP if up is None else up)
    if upright is None:
        raise ValueError(
            f"{where}: the viewing direction {direction.tolist()} has no length, or it is parallel "
            f"to up = {list(UP if up is None else up)}. Choose another up, origin or target"
        )

    # Add the scale and the roll that the camera has
    before = _upright(matrix[:3, 2], UP)
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    scale[0] *= np.sign(np.linalg.det(matrix[:3, :3]))
    own = np.diag(scale)
    if up is None and before is not None:
        own = before.T @ matrix[:3, :3]
    moved[:3, :3] = upright @ own
    return moved


def _upright(direction: np.ndarray, up: Sequence[float]) -> np.ndarray | None:
    """Return axes x, y, z of a camera that looks along `direction`, as `look_at` has them.

    The result is None if the direction is 0 or parallel to `up`.
    """
    side = np.cross(up, direction)
    if np.linalg.norm(side) < 1e-6:
        return None
    forward = direction / np.linalg.norm(direction)
    left = side / np.linalg.norm(side)
    return np.stack([left, np.cross(forward, left), forward], axis=1)


SETTERS = {"path": _set_path, "reflectance": _set_reflectance, "material": _set_material}
SETTERS |= dict.fromkeys(("scale", "turn", "position", "move"), _set_pose)
"""Functions that change a scene, in the order in which they are called."""


def copied(value: Any) -> Any:
    """Copy a dict or a list, with all dicts and lists that it contains."""
    if isinstance(value, Mapping):
        return {name: copied(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [copied(part) for part in value]
    return value


def _target(scene: Dict, varied: Varied) -> tuple[str, Any]:
    """Return the name of a varied part for messages, and the part."""
    where = f"vary.{varied.name}.{varied.target}"
    return f"{where} = {varied.part!r}", _entry(where, varied.part, scene, varied.part)


def _entry(where: str, path: str, part: Any, key: str) -> Any:
    """Return an entry of a dict. Raise an error for a key that the dict does not contain."""
    if not isinstance(part, dict):
        raise ValueError(f"{where} = {path!r}: the part before {key!r} contains no further parts")
    if key not in part:
        raise ValueError(unknown(f"{where} = {path!r}: {key}", key, list(part)))
    return part[key]


def _like(where: str, varied: Varied, old: Any, value: Any) -> Any:
    """Convert a drawn value to the type of the value that it replaces.

    With `times`, the result is the product of both values. A single number replaces all numbers
    of a list.
    """
    # Numbers of a color
    if isinstance(old, dict) and old.get("type") == "rgb" and _is_numeric(value):
        return rgb(_like(where, varied, old["value"], value))

    # A number or a list of numbers
    if _is_numeric(old) and _is_numeric(value):
        before = np.asarray(old, float)
        numbers = np.asarray(value, float)
        if numbers.ndim and numbers.shape != before.shape:
            raise ValueError(
                f"{where} = {varied.part!r}: has {before.size} numbers, {numbers.size} are drawn"
            )
        with np.errstate(over="ignore"):
            new = np.broadcast_to(numbers, before.shape) * (before if varied.times else 1)
        if not np.isfinite(new).all():
            raise ValueError(f"{where} = {varied.part!r}: becomes {new.tolist()}; must be finite")
        whole = isinstance(old, int) and bool(new == np.round(new))
        return int(new) if whole else new.tolist()

    # Text, or True and False
    same = isinstance(old, str) and isinstance(value, str)
    same |= isinstance(old, bool) and isinstance(value, bool)
    if same and not varied.times:
        return value
    kind = type(old).__name__ if not isinstance(old, dict) else "a table"
    raise ValueError(f"{where} = {varied.part!r}: is {kind}, and cannot become {value!r}")


def _is_numeric(value: Any) -> bool:
    """Return whether a value is a number or a list of numbers."""
    entries = value if isinstance(value, list | tuple) else [value]
    return all(isinstance(n, int | float) and not isinstance(n, bool) for n in entries)


def _is_reference(part: Any) -> bool:
    """Return whether a part refers to another part of the scene."""
    return isinstance(part, dict) and part.get("type") == "ref"


def _is_camera(part: Mapping[str, Any]) -> bool:
    """Return whether a plugin is a sensor."""
    kind = str(part.get("type"))
    return kind in CAMERAS or kind.endswith(("camera", "meter"))


def _matrix(transform: Any) -> np.ndarray:
    """Return the matrix (4, 4) of a transform. None is the identity."""
    if transform is None:
        return np.eye(4)
    return np.array(transform.matrix, dtype=np.float64).reshape(4, 4)


def _middle(shape: Any) -> np.ndarray:
    """Return the position of an object [m].

    The position of an object in a dict is its `center`, or its own origin. The position of a loaded
    mesh is the center of its bounding box.
    """
    if isinstance(shape, dict):
        local = np.append(np.asarray(shape.get("center", [0.0, 0.0, 0.0]), float), 1)
        return (_matrix(shape.get("to_world")) @ local)[:3]
    box: Any = shape.bbox()
    return (np.ravel(np.array(box.min, float)) + np.ravel(np.array(box.max, float))) / 2


def _transform_mesh(mesh: Any, matrix: np.ndarray) -> None:
    """Transform a loaded mesh in place. No other scene may use the mesh."""
    parameters = mi.traverse(mesh)
    linear = matrix[:3, :3]
    shift = matrix[:3, 3]
    set_rows(parameters, POSITIONS, rows(parameters, POSITIONS) @ linear.T + shift)

    # Normals transform with the inverse transpose
    normals = rows(parameters, NORMALS)
    if normals.size:
        turned = normals @ np.linalg.inv(linear)
        turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-30)
        set_rows(parameters, NORMALS, turned)
    parameters.update()
