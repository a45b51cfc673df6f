"""Describe and load the scene of a record: its source with the drawn values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import mitsuba as mi

from ..runtime import checks
from ..runtime.tables import known_keys
from ..scenes import BUILT_IN
from ..scenes.as_dict import scene_as_dict
from ..scenes.loading import load_scene
from ..scenes.parts import Dict, pose
from ..scenes.transient_integrators import transient_integrator_for
from .changes import change, copied
from .dataset_config import Config

TO_WORLD = ("position", "axis", "angle", "scale")


def scene_of(config: Config, drawn: Mapping[str, Any]) -> Dict:
    """Return the scene of a record as a dict for `mi.load_dict`.

    Args:
        config: Description of the data set.
        drawn: Drawn values, by name.

    Raises:
        ValueError: The drawn values do not fit the scene.
    """
    scene = _source(config, drawn)

    # Add the materials and objects of the configuration
    for table, parts in (("materials", config.materials), ("objects", config.objects)):
        for name, description in parts.items():
            if name in scene:
                raise ValueError(f"{table}.{name}: the scene has one already; must have a new name")
            scene[name] = _described(f"{table}.{name}", description, config.folder)

    # Put the drawn values into the scene
    change(scene, config.sensor, config.varied.values(), drawn)
    return scene


def _source(config: Config, drawn: Mapping[str, Any]) -> Dict:
    """Return the scene as a dict, with drawn arguments and parameters only."""
    given = {
        kind: {v.part: drawn[v.name] for v in config.varied.values() if v.target == kind}
        for kind in ("argument", "parameter")
    }

    # A built-in scene
    if isinstance(config.scene, str):
        arguments = config.arguments | given["argument"]
        try:
            return BUILT_IN[config.scene](**arguments)
        except TypeError as error:
            raise ValueError(f"arguments: {' '.join(str(error).split())}") from None

    # An XML file, or a dict
    if isinstance(config.scene, Path):
        return scene_as_dict(config.scene, config.parameters | given["parameter"])
    return copied(config.scene)


def _described(where: str, given: Mapping[str, Any], folder: Path) -> Dict:
    """Convert the description of an object or a material to a dict for Mitsuba.

    The table `to_world` becomes a transform, and names of files become absolute.
    """
    found: Dict = dict(given)
    for name, value in given.items():
        if name == "to_world" and isinstance(value, Mapping):
            found[name] = _transform(f"{where}.to_world", value)
        elif isinstance(value, Mapping):
            found[name] = _described(f"{where}.{name}", value, folder)
        elif name == "filename" and isinstance(value, str) and (folder / value).exists():
            found[name] = str(folder / value)
    return found


def _transform(where: str, given: Mapping[str, Any]) -> Any:
    """Check a table of position [m], axis, angle [degrees] and scale; return the transform."""
    known_keys(where, given, TO_WORLD)
    scale = given.get("scale", 1.0)
    scale = scale if isinstance(scale, Sequence) else [scale] * 3
    return pose(
        checks.point(f"{where}.position", given.get("position", [0, 0, 0])),
        checks.point(f"{where}.axis", given.get("axis", [0, 1, 0])),
        checks.number(f"{where}.angle", given.get("angle", 0.0), unit="degrees"),
        checks.point(f"{where}.scale", scale),
    )


def load(scene: Dict, config: Config) -> mi.Scene:
    """Load a scene with the settings of the configuration."""
    settings = dict(config.settings)
    capture = config.outputs.capture
    if capture is not None and capture.grid is not None:
        settings["width"], settings["height"] = capture.grid
    loaded = load_scene(scene, optimize=capture is None, **settings)

    # Phasors need an integrator of this package. It gets the depth of the scene's integrator
    own = loaded.integrator()
    if config.outputs.phasor and getattr(own, "traits", None) is None:
        settings["integrator"] = transient_integrator_for(own)
        loaded = load_scene(scene, optimize=capture is None, **settings)
    return loaded
