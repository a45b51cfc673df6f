"""Distributions that quantities of a data set are drawn from, and the check of each.

A draw is plain: a number, a list of numbers, text, or a list of names.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from ..runtime import checks
from .randomness import Source

Draw = Any
INFINITE = (-math.inf, math.inf)


class Distribution(Protocol):
    """What a quantity is drawn from."""

    def draw(self, source: Source) -> Draw:
        """The value of a record."""
        ...

    def bounds(self) -> tuple[float, float]:
        """Least and largest number that can be drawn; infinite if there is none."""
        ...

    def length(self) -> int | None:
        """How many numbers a draw has, 0 for a single one that is no list, None for others."""
        ...


Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Spread:
    """Numbers, each drawn by itself: `uniform`, `log_uniform` or `normal`.

    Attributes:
        quantile: Gives the value of a number in (0, 1), by the parameters of that entry.
        parameters: For each entry, its own.
        ranges: For each entry, least and largest value.
        single: Whether a draw is a number, not a list.
    """

    quantile: Callable[..., float]
    parameters: tuple[Numbers, ...]
    ranges: tuple[tuple[float, float], ...]
    single: bool

    def draw(self, source: Source) -> Draw:
        """A number, or a list of them."""
        values = [
            min(max(self.quantile(source.number(i), *each), low), high)
            for i, (each, (low, high)) in enumerate(zip(self.parameters, self.ranges, strict=True))
        ]
        return values[0] if self.single else values

    def bounds(self) -> tuple[float, float]:
        """Of all entries."""
        return min(low for low, _ in self.ranges), max(high for _, high in self.ranges)

    def length(self) -> int | None:
        """Number of entries."""
        return 0 if self.single else len(self.parameters)


@dataclass(frozen=True)
class Choice:
    """One of some values, each by its weight: `choice`, and `fixed` with a single one."""

    values: tuple[Any, ...]
    weights: Numbers

    def draw(self, source: Source) -> Draw:
        """One of the values."""
        left = source.number() * math.fsum(self.weights)
        for value, weight in zip(self.values, self.weights, strict=True):
            left -= weight
            if left < 0:
                return value
        return next(v for v, w in zip(self.values[::-1], self.weights[::-1], strict=True) if w)

    def bounds(self) -> tuple[float, float]:
        """Of all numbers among the values."""
        found = [n for v in self.values for n in (v if isinstance(v, list) else [v])]
        numbers = [n for n in found if isinstance(n, int | float) and not isinstance(n, bool)]
        return (min(numbers), max(numbers)) if numbers else INFINITE

    def length(self) -> int | None:
        """The same of all values, None where they differ."""
        kinds = {_length(value) for value in self.values}
        return kinds.pop() if len(kinds) == 1 else None


@dataclass(frozen=True)
class OnSphere:
    """A point on a sphere around a centre, or on a cap of it, uniform by area.

    Attributes:
        center: Of the sphere [m].
        radius: Least and largest radius [m], uniform between.
        axis: Unit vector to the middle of the cap.
        angle: Largest angle to the axis [degrees]; 180 is the whole sphere.
    """

    center: Numbers
    radius: tuple[float, float]
    axis: Numbers
    angle: float

    def draw(self, source: Source) -> Draw:
        """A point [m]."""
        low, high = self.radius
        r = low + (high - low) * source.number(2)
        cos = 1 - source.number(0) * (1 - math.cos(math.radians(self.angle)))
        sin, phi = math.sqrt(max(0.0, 1 - cos * cos)), 2 * math.pi * source.number(1)
        one, other = _perpendicular(self.axis)
        along = sin * math.cos(phi), sin * math.sin(phi), cos
        return [
            c + r * (along[0] * u + along[1] * v + along[2] * w)
            for c, u, v, w in zip(self.center, one, other, self.axis, strict=True)
        ]

    def bounds(self) -> tuple[float, float]:
        """None are known."""
        return INFINITE

    def length(self) -> int | None:
        """Three coordinates."""
        return 3


@dataclass(frozen=True)
class Subset:
    """Some of the names: how many is uniform, and so is which."""

    names: tuple[str, ...]
    least: int
    most: int

    def draw(self, source: Source) -> Draw:
        """The names, in their order."""
        count = self.least + int(source.number(0) * (self.most - self.least + 1))
        ranks = {name: source.number(1 + i) for i, name in enumerate(self.names)}
        chosen = sorted(self.names, key=ranks.__getitem__)[:count]
        return [name for name in self.names if name in chosen]

    def bounds(self) -> tuple[float, float]:
        """There are no numbers."""
        return INFINITE

    def length(self) -> int | None:
        """There are no numbers."""
        return None


# --------------------------------------------------------------------------- from a table of a file


def parse_distribution(where: str, table: Mapping[str, Any]) -> Distribution:
    """The distribution of a table `vary.NAME`, of which `where` is the name.

    Raises:
        ValueError: One line with the key, its value and what is allowed.

    Example:
        >>> uniform = {"distribution": "uniform", "low": 1, "high": 3}
        >>> 1 < parse_distribution("vary.lamp", uniform).draw(Source(0, 0, "lamp")) < 3
        True
    """
    kind = table.get("distribution")
    return _PARSERS[checks.one_of(f"{where}.distribution", kind, _PARSERS)](where, table)


def _uniform(where: str, table: Mapping[str, Any]) -> Distribution:
    low, high, single = _both(where, table)
    parameters = tuple(zip(low, high, strict=True))
    return Spread(lambda u, a, b: a + u * (b - a), parameters, parameters, single)


def _log_uniform(where: str, table: Mapping[str, Any]) -> Distribution:
    low, high, single = _both(where, table)
    if min(low) <= 0:
        raise ValueError(f"{where}.low = {table['low']!r}: must be above 0 with log_uniform")
    parameters = tuple(zip(low, high, strict=True))
    return Spread(lambda u, a, b: a * (b / a) ** u, parameters, parameters, single)


def _normal(where: str, table: Mapping[str, Any]) -> Distribution:
    """By the inverse of the distribution between the limits, so no draw is thrown away."""
    from scipy.special import ndtr, ndtri

    given = {name: table.get(name) for name in ("mean", "deviation")}
    given |= {name: table[name] for name in ("low", "high") if name in table}
    entries = {name: _numbers(f"{where}.{name}", value) for name, value in given.items()}
    count = max(map(len, entries.values()))
    single = not any(isinstance(value, list | tuple) for value in given.values())
    for name, limit in (("low", -math.inf), ("high", math.inf)):
        entries.setdefault(name, (limit,))
    wide = {n: _as_many(f"{where}.{n}", given.get(n), v, count) for n, v in entries.items()}
    parameters = []
    for mean, deviation, low, high in zip(*wide.values(), strict=True):
        if not deviation > 0:
            raise ValueError(f"{where}.deviation = {table['deviation']!r}: must be above 0")
        if not low < high:
            raise ValueError(f"{where}.low = {table['low']!r}: must be below high")
        side = -1.0 if low > mean else 1.0  # Tails are precise on the low side only
        edges = sorted(side * (limit - mean) / deviation for limit in (low, high))
        first, last = (float(ndtr(edge)) for edge in edges)
        if not first < last:
            raise ValueError(f"{where}.low = {table.get('low')!r}: is too far from the mean")
        parameters.append((mean, side * deviation, first, last))
    ranges = tuple(zip(wide["low"], wide["high"], strict=True))

    def quantile(u: float, mean: float, deviation: float, first: float, last: float) -> float:
        return mean + deviation * float(ndtri(first + u * (last - first)))

    return Spread(quantile, tuple(parameters), ranges, single)


def _choice(where: str, table: Mapping[str, Any]) -> Distribution:
    values = table.get("values")
    if not isinstance(values, list | tuple) or not values:
        raise ValueError(f"{where}.values = {values!r}: must be a list of one value or more")
    kept = tuple(_plain(f"{where}.values", value) for value in values)
    weights = table.get("weights", [1.0] * len(kept))
    found = _numbers(f"{where}.weights", weights)
    right = isinstance(weights, list | tuple) and len(found) == len(kept)
    if not right or min(found) < 0 or not sum(found) > 0:
        raise ValueError(
            f"{where}.weights = {weights!r}: must be {len(kept)} numbers from 0, not all 0"
        )
    return Choice(kept, found)


def _fixed(where: str, table: Mapping[str, Any]) -> Distribution:
    if "value" not in table:
        raise ValueError(f"{where}.value: must be given with fixed")
    return Choice((_plain(f"{where}.value", table["value"]),), (1.0,))


def _on_sphere(where: str, table: Mapping[str, Any]) -> Distribution:
    center = checks.point(f"{where}.center", table.get("center", [0.0, 0.0, 0.0]))
    radius = _numbers(f"{where}.radius", table.get("radius"))
    least, most = min(radius), max(radius)
    if least <= 0 or list(radius) not in ([most], [least, most]):
        raise ValueError(
            f"{where}.radius = {table['radius']!r}: must be above 0, or [least, largest]"
        )
    axis = checks.point(f"{where}.axis", table.get("axis", [0.0, 1.0, 0.0]))
    norm = math.hypot(*axis)
    if not norm > 0:
        raise ValueError(f"{where}.axis = {table['axis']!r}: must not be zero")
    angle = table.get("angle", 180.0)
    angle = checks.number(f"{where}.angle", angle, unit="degrees", positive=True, high=180)
    unit = tuple(a / norm for a in axis)
    return OnSphere(tuple(center), (least, most), unit, angle)


def _subset(where: str, table: Mapping[str, Any]) -> Distribution:
    names = tuple(table.get("present", ()))
    least = checks.integer(f"{where}.least", table.get("least", 0), 0, len(names))
    most = checks.integer(f"{where}.most", table.get("most", len(names)), least, len(names))
    return Subset(names, least, most)


KEYS: dict[str, tuple[str, ...]] = {
    "uniform": ("low", "high"),
    "log_uniform": ("low", "high"),
    "normal": ("mean", "deviation", "low", "high"),
    "choice": ("values", "weights"),
    "fixed": ("value",),
    "on_sphere": ("center", "radius", "axis", "angle"),
    "subset": ("least", "most"),
}
"""The keys of each distribution."""

_PARSERS = {
    "uniform": _uniform,
    "log_uniform": _log_uniform,
    "normal": _normal,
    "choice": _choice,
    "fixed": _fixed,
    "on_sphere": _on_sphere,
    "subset": _subset,
}


# -------------------------------------------------------------------------------------- its parts


def _both(where: str, table: Mapping[str, Any]) -> tuple[Numbers, Numbers, bool]:
    """Lows, highs, and whether they are for a single number."""
    given = [table.get("low"), table.get("high")]
    low, high = (_numbers(f"{where}.{n}", v) for n, v in zip(("low", "high"), given, strict=True))
    count = max(len(low), len(high))
    low = _as_many(f"{where}.low", given[0], low, count)
    high = _as_many(f"{where}.high", given[1], high, count)
    pairs = list(zip(low, high, strict=True))
    if any(a > b for a, b in pairs) or all(a == b for a, b in pairs):  # A coordinate may be fixed
        raise ValueError(f"{where}.low = {given[0]!r}: must be below high = {given[1]!r}")
    return low, high, not any(isinstance(value, list | tuple) for value in given)


def _numbers(where: str, value: Any) -> Numbers:
    """A number or a list of them, as a tuple."""
    if not isinstance(value, list | tuple):
        return (checks.number(where, value),)
    if not value:
        raise ValueError(f"{where} = []: must be a number or a list of numbers")
    return tuple(checks.number(where, each) for each in value)


def _as_many(where: str, given: Any, found: Numbers, count: int) -> Numbers:
    """As many numbers as the other keys have."""
    if len(found) not in (1, count):
        raise ValueError(f"{where} = {given!r}: must have {count} numbers, as other keys have")
    return found * count if len(found) == 1 else found


def _plain(where: str, value: Any) -> Any:
    """A value that may be drawn: a number, text, True or False, or a list of numbers or names."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, list | tuple):
        if all(isinstance(each, str) for each in value):
            return list(value)
        return [_plain_number(where, each) for each in value]
    return _plain_number(where, value)


def _plain_number(where: str, value: Any) -> float | int:
    number = checks.number(where, value)
    return int(value) if isinstance(value, int) else number


def _length(value: Any) -> int | None:
    if isinstance(value, list):
        return len(value) if value and not isinstance(value[0], str) else None
    return None if isinstance(value, str | bool) else 0


def _perpendicular(axis: Sequence[float]) -> tuple[Numbers, Numbers]:
    """Two unit vectors that make a frame with a third (Duff et al. 2017)."""
    x, y, z = axis
    sign = math.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    return (1 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)
