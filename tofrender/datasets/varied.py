"""Quantities that vary from record to record: a part of the scene and its distribution."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..runtime import checks
from ..runtime.tables import boolean, known_keys, text, unknown
from .distributions import KEYS, Distribution, parse_distribution

TARGETS: dict[str, tuple[str, ...]] = {
    "argument": (),
    "parameter": (),
    "path": ("times",),
    "camera": ("up",),
    "move": (),
    "position": (),
    "turn": ("axis", "around"),
    "scale": ("around",),
    "reflectance": ("times",),
    "material": (),
    "present": (),
}
"""Kinds of parts of a scene that can be varied, and the additional keys of each kind."""

REPEATABLE = ("turn", "move", "scale", "present")
"""Targets that several quantities with the same part may have."""

CAMERA = ("origin", "target", "fov")
"""Properties of the camera that can be varied."""

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
RESERVED = (
    "record",
    "y",
    "x",
    "opl",
    "channel",
    "xyz",
    "frequency",
    "part",
    "transient",
    "steady",
    "noisy",
    "phasor",
    "depth",
    "normals",
    "capture",
    "hidden_depth",
    "made_with",
    "attempt",
    "energy_outside_window",
    "render_seed",
    "time",
    "wall_x",
    "wall_y",
    "laser_x",
    "laser_y",
)
"""Names of arrays and axes. Quantities cannot have these names."""


@dataclass(frozen=True)
class Varied:
    """Quantity that is varied."""

    name: str
    target: str  # one of `TARGETS`
    part: Any  # argument, path, object or material that is varied; a list of names for `present`
    distribution: Distribution  # distribution of the values
    times: bool = False  # whether the draw multiplies the value of the scene
    up: Sequence[float] | None = None  # direction that is up in pictures; None for the default
    axis: Sequence[float] = (0.0, 1.0, 0.0)  # axis of an object's rotation
    # fixed point of a rotation or scale [m]; None for the position of the object
    around: Sequence[float] | None = None

    @property
    def is_vector(self) -> bool:
        """Whether a draw is a point or a vector in space."""
        of_camera = self.target == "camera" and self.part != "fov"
        in_space = of_camera or self.target in ("move", "position")
        return in_space and self.distribution.length == 3


def parse_varied(name: str, given: Any) -> Varied:
    """Read the table `vary.NAME` of a quantity.

    Args:
        name: Name of the quantity.
        given: The table.

    Raises:
        ValueError: The name or a key of the table is wrong.
    """
    # Check the name
    where = f"vary.{name}"
    if not NAME.fullmatch(name):
        raise ValueError(f"vary.{name!r}: must be a name of letters, digits and _")
    if name in RESERVED or name.startswith(("capture_", "sensor_")):
        raise ValueError(f"{where}: must have another name, which no array of the data set has")
    checks.require(where, given, isinstance(given, Mapping), "a table")

    # Find the target. There must be exactly one
    targets = [target for target in TARGETS if target in given]
    kind = given.get("distribution")
    if len(targets) != 1:
        keys = {"distribution", *(key for extra in TARGETS.values() for key in extra)}
        keys |= set(KEYS.get(kind, ())) if isinstance(kind, str) else set()
        for key in given:  # An unknown key may be a misspelled target
            if key not in keys and key not in TARGETS:
                raise ValueError(unknown(f"{where}.{key}", key, TARGETS))
        found = f"has {' and '.join(targets)}" if targets else "says not what is varied"
        raise ValueError(f"{where}: {found}; must have one of {', '.join(TARGETS)}")
    target = targets[0]

    # Check the distribution and the keys
    checks.one_of(f"{where}.distribution", kind, KEYS)
    known_keys(where, given, (target, "distribution", *TARGETS[target], *KEYS[str(kind)]))
    if (kind == "subset") != (target == "present") and kind != "choice":
        allowed = "subset or choice" if target == "present" else "another than subset"
        raise ValueError(f"{where}.distribution = {kind!r}: must be {allowed} with {target}")

    # Read the part and the additional keys
    read_part = _names if target == "present" else text
    part = read_part(f"{where}.{target}", given[target])
    readers = {"times": boolean, "up": _direction, "axis": _direction, "around": checks.point}
    extra = {n: readers[n](f"{where}.{n}", given[n]) for n in TARGETS[target] if n in given}
    found = Varied(name, target, part, parse_distribution(where, given), **extra)
    _require_fit(where, found, str(kind))
    return found


def _names(name: str, value: Any) -> list[str]:
    """Return a list of object names. Raise a ValueError if the list is empty or repeats a name."""
    right = isinstance(value, list | tuple) and value and all(isinstance(v, str) for v in value)
    checks.require(name, value, right and len(set(value)) == len(value), "a list of objects' names")
    return list(value)


def _direction(name: str, value: Any) -> list[float]:
    """Check a direction, which must not be zero."""
    found = checks.point(name, value)
    if not any(found):
        raise ValueError(f"{name} = {value!r}: must not be zero")
    return found


LENGTHS: dict[str, tuple[tuple[int, ...], str]] = {
    "move": ((3,), "3 numbers, meters"),
    "position": ((3,), "3 numbers, meters"),
    "turn": ((0,), "a number, degrees"),
    "scale": ((0, 3), "a number or 3"),
    "reflectance": ((0, 3), "a number or 3"),
}
"""Allowed lengths of a draw as in `Distribution.length`, and their description."""


def _require_fit(where: str, varied: Varied, kind: str) -> None:
    """Raise a ValueError if length, values or bounds of a distribution do not fit the target."""
    # Check the length of a draw
    target = varied.target
    distribution = varied.distribution
    lengths, allowed = LENGTHS.get(target, (None, ""))
    if target == "camera":
        checks.one_of(f"{where}.camera", varied.part, CAMERA)
        lengths, allowed = ((0,), "a number") if varied.part == "fov" else LENGTHS["move"]
    if lengths is not None and distribution.length not in lengths:
        raise ValueError(f"{where}.distribution = {kind!r}: must give {allowed}")

    # Check the names of materials and objects
    values = distribution.values
    if target == "material" and (
        values is None or not all(isinstance(value, str) and value for value in values)
    ):
        raise ValueError(f"{where}.distribution = {kind!r}: must be a choice of materials' names")
    if target == "present" and values is not None:
        for value in values:
            for name in value if isinstance(value, list) else [value]:
                if name not in varied.part:
                    raise ValueError(unknown(f"{where}.values = {name!r}", name, varied.part))

    # Check the bounds
    low, high = distribution.bounds
    quantity = varied.part if target == "camera" else target
    ranges = {"fov": (0.0, 180.0), "scale": (0.0, float("inf")), "reflectance": (0.0, 1.0)}
    least, most = ranges.get(str(quantity), (float("-inf"), float("inf")))
    if varied.times:
        least = 0.0
        most = float("inf")
    strict = quantity in ("fov", "scale")
    below = low <= least if strict else low < least
    above = high >= most if quantity == "fov" else high > most
    if below or above:
        side = f"above {least:g}" if strict else f"from {least:g}"
        side += f" to {most:g}" if most < float("inf") else ""
        raise ValueError(
            f"{where}.{target} = {varied.part!r}: is drawn from {low:g} to {high:g}; must be {side}"
        )
