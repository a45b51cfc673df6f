"""Distributions of the quantities of a data set.

A draw is a number, a list of numbers, text, or a list of names. Draws are quantiles of the numbers
of a `Source`. Draws are never rejected, so that equal seeds always give equal data sets.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..runtime import checks
from .randomness import Source

Numbers = tuple[float, ...]
Table = Mapping[str, Any]
INFINITE = (-math.inf, math.inf)


@dataclass(frozen=True)
class Distribution:
    """The distribution of one quantity."""

    draw: Callable[[Source], Any]  # returns the value of a record
    # count of numbers in a draw; 0 for a number that is not a list, None for text and names
    length: int | None = None
    bounds: tuple[float, float] = INFINITE  # least and largest number that can be drawn
    values: tuple[Any, ...] | None = None  # all values of a choice; None for other distributions


def parse_distribution(where: str, table: Table) -> Distribution:
    """Read the distribution of a varied quantity.

    Args:
        where: Name of the table for messages, `vary.NAME`.
        table: Table of the quantity.

    Raises:
        ValueError: The distribution is unknown, or one of its parameters is wrong.
    """
    kind = checks.one_of(f"{where}.distribution", table.get("distribution"), _KINDS)
    parse, _ = _KINDS[kind]
    return parse(where, table)


def _uniform(where: str, table: Table) -> Distribution:
    """Return a uniform distribution from `low` to `high`."""
    ranges, single = _ranges(where, table)
    return _of_entries(lambda u, a, b: a + u * (b - a), ranges, ranges, single)


def _log_uniform(where: str, table: Table) -> Distribution:
    """Return a distribution of values whose logarithm is uniform."""
    ranges, single = _ranges(where, table)
    least = min(low for low, _ in ranges)
    checks.require(f"{where}.low", table["low"], least > 0, "above 0 with log_uniform")
    return _of_entries(lambda u, a, b: a * (b / a) ** u, ranges, ranges, single)


def _normal(where: str, table: Table) -> Distribution:
    """Return a normal distribution, truncated to `low` and `high` if these are set."""
    from scipy.special import ndtr, ndtri

    # Read the parameters, and repeat single numbers
    given = {name: table.get(name) for name in ("mean", "deviation")}
    given |= {name: table[name] for name in ("low", "high") if name in table}
    entries = {name: _numbers(f"{where}.{name}", value) for name, value in given.items()}
    count = max(map(len, entries.values()))
    single = not any(isinstance(value, list | tuple) for value in given.values())
    for name, limit in zip(("low", "high"), INFINITE, strict=True):
        entries.setdefault(name, (limit,))
    wide = {n: _repeated(f"{where}.{n}", given.get(n), v, count) for n, v in entries.items()}

    # Find the probabilities of the limits
    parameters = []
    columns = [wide[name] for name in ("mean", "deviation", "low", "high")]
    for mean, deviation, low, high in zip(*columns, strict=True):
        checks.require(f"{where}.deviation", table["deviation"], deviation > 0, "above 0")
        checks.require(f"{where}.low", table.get("low"), low < high, "below high")
        side = -1.0 if low > mean else 1.0  # `ndtr` is precise in the lower tail only
        edges = sorted(side * (limit - mean) / deviation for limit in (low, high))
        first, last = (float(ndtr(edge)) for edge in edges)
        if not first < last:
            raise ValueError(f"{where}.low = {table.get('low')!r}: is too far from the mean")
        parameters.append((mean, side * deviation, first, last))

    def quantile(u: float, mean: float, deviation: float, first: float, last: float) -> float:
        return mean + deviation * float(ndtri(first + u * (last - first)))

    return _of_entries(
        quantile, parameters, list(zip(wide["low"], wide["high"], strict=True)), single
    )


def _of_entries(
    quantile: Callable[..., float],
    parameters: Sequence[Numbers],
    ranges: Sequence[tuple[float, float]],
    single: bool,
) -> Distribution:
    """Return a distribution with independent entries.

    Args:
        quantile: Quantile function. Its arguments are a number in (0, 1) and the parameters.
        parameters: Parameters of each entry.
        ranges: Smallest and largest value of each entry.
        single: Whether a draw is a number instead of a list.
    """

    def draw(source: Source) -> float | list[float]:
        values = [
            min(max(quantile(source.number(i), *each), low), high)
            for i, (each, (low, high)) in enumerate(zip(parameters, ranges, strict=True))
        ]
        return values[0] if single else values

    bounds = min(low for low, _ in ranges), max(high for _, high in ranges)
    return Distribution(draw, 0 if single else len(parameters), bounds)


def _choice(where: str, table: Table) -> Distribution:
    """Return a choice among `values`, with probabilities proportional to `weights`."""
    given = table.get("values")
    if not isinstance(given, list | tuple) or not given:
        raise ValueError(f"{where}.values = {given!r}: must be a list of one value or more")
    values = tuple(_plain(f"{where}.values", value) for value in given)

    # Weights are equal by default
    given_weights = table.get("weights", [1.0] * len(values))
    weights = _numbers(f"{where}.weights", given_weights)
    right = isinstance(given_weights, list | tuple) and len(weights) == len(values)
    right = right and min(weights) >= 0 and sum(weights) > 0
    allowed = f"{len(values)} numbers from 0, not all 0"
    checks.require(f"{where}.weights", given_weights, right, allowed)
    return _one_of(values, weights)


def _one_of(values: tuple[Any, ...], weights: Numbers) -> Distribution:
    """Return a choice among values that have been checked."""

    def draw(source: Source) -> Any:
        left = source.number() * math.fsum(weights)
        for value, weight in zip(values, weights, strict=True):
            left -= weight
            if left < 0:
                return value
        # Rounding has left a remainder: return the last value with a weight above 0
        return next(v for v, w in zip(values[::-1], weights[::-1], strict=True) if w)

    # Bounds of the numbers, if there are numbers
    entries = [n for v in values for n in (v if isinstance(v, list) else [v])]
    numbers = [n for n in entries if isinstance(n, int | float) and not isinstance(n, bool)]
    bounds = (min(numbers), max(numbers)) if numbers else INFINITE
    lengths = {_length(value) for value in values}
    return Distribution(draw, lengths.pop() if len(lengths) == 1 else None, bounds, values)


def _fixed(where: str, table: Table) -> Distribution:
    """Return a distribution with the same value in all records."""
    if "value" not in table:
        raise ValueError(f"{where}.value: must be given with fixed")
    return _one_of((_plain(f"{where}.value", table["value"]),), (1.0,))


def _subset(where: str, table: Table) -> Distribution:
    """Return random subsets of names. All sizes, and all subsets of a size, are equally likely."""
    names = tuple(table.get("present", ()))
    least = checks.integer(f"{where}.least", table.get("least", 0), 0, len(names))
    most = checks.integer(f"{where}.most", table.get("most", len(names)), least, len(names))

    def draw(source: Source) -> list[str]:
        count = least + int(source.number(0) * (most - least + 1))
        ranks = {name: source.number(1 + i) for i, name in enumerate(names)}
        chosen = sorted(names, key=ranks.__getitem__)[:count]
        return [name for name in names if name in chosen]

    return Distribution(draw)


def _on_sphere(where: str, table: Table) -> Distribution:
    """Return points on a sphere or on a cap of it, uniform by area, with a uniform radius."""
    # Check center and radius
    center = checks.point(f"{where}.center", table.get("center", [0.0, 0.0, 0.0]))
    radius = _numbers(f"{where}.radius", table.get("radius"))
    low = min(radius)
    high = max(radius)
    valid = low > 0 and list(radius) in ([high], [low, high])
    checks.require(f"{where}.radius", table.get("radius"), valid, "above 0, or [least, largest]")

    # Check axis and angle of the cap
    axis = checks.point(f"{where}.axis", table.get("axis", [0.0, 1.0, 0.0]))
    norm = math.hypot(*axis)
    if not norm > 0:
        raise ValueError(f"{where}.axis = {table['axis']!r}: must not be zero")
    angle = table.get("angle", 180.0)
    angle = checks.number(f"{where}.angle", angle, unit="degrees", positive=True, high=180)
    unit = [a / norm for a in axis]
    first, second = _perpendicular(unit)

    def draw(source: Source) -> list[float]:
        # Sample radius and direction, and rotate the direction to the axis
        r = low + (high - low) * source.number(2)
        cos = 1 - source.number(0) * (1 - math.cos(math.radians(angle)))
        sin = math.sqrt(max(0.0, 1 - cos * cos))
        phi = 2 * math.pi * source.number(1)
        local = sin * math.cos(phi), sin * math.sin(phi), cos
        return [
            c + r * (local[0] * u + local[1] * v + local[2] * w)
            for c, u, v, w in zip(center, first, second, unit, strict=True)
        ]

    return Distribution(draw, 3)


def _perpendicular(axis: Sequence[float]) -> tuple[Numbers, Numbers]:
    """Return two unit vectors that form an orthonormal frame with `axis` (Duff et al. 2017)."""
    x, y, z = axis
    sign = math.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    return (1 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


_KINDS: dict[str, tuple[Callable[[str, Table], Distribution], tuple[str, ...]]] = {
    "uniform": (_uniform, ("low", "high")),
    "log_uniform": (_log_uniform, ("low", "high")),
    "normal": (_normal, ("mean", "deviation", "low", "high")),
    "choice": (_choice, ("values", "weights")),
    "fixed": (_fixed, ("value",)),
    "on_sphere": (_on_sphere, ("center", "radius", "axis", "angle")),
    "subset": (_subset, ("least", "most")),
}
KEYS = {name: keys for name, (_, keys) in _KINDS.items()}
"""Keys of each distribution."""


def _ranges(where: str, table: Table) -> tuple[list[tuple[float, float]], bool]:
    """Return low and high of each entry, and whether a draw is a number instead of a list."""
    # Read both keys, and repeat single numbers
    given = [table.get("low"), table.get("high")]
    low, high = (_numbers(f"{where}.{n}", v) for n, v in zip(("low", "high"), given, strict=True))
    count = max(len(low), len(high))
    low = _repeated(f"{where}.low", given[0], low, count)
    high = _repeated(f"{where}.high", given[1], high, count)

    # Entries of a list may be fixed, but not all of them
    pairs = list(zip(low, high, strict=True))
    if any(a > b for a, b in pairs) or all(a == b for a, b in pairs):
        raise ValueError(f"{where}.low = {given[0]!r}: must be below high = {given[1]!r}")
    return pairs, not any(isinstance(value, list | tuple) for value in given)


def _numbers(where: str, value: Any) -> Numbers:
    """Check a number or a list of numbers, and return a tuple."""
    if not isinstance(value, list | tuple):
        return (checks.number(where, value),)
    if not value:
        raise ValueError(f"{where} = []: must be a number or a list of numbers")
    return tuple(checks.number(where, each) for each in value)


def _repeated(where: str, given: Any, numbers: Numbers, count: int) -> Numbers:
    """Return `count` numbers. A single number is repeated."""
    if len(numbers) not in (1, count):
        raise ValueError(f"{where} = {given!r}: must have {count} numbers, as other keys have")
    return numbers * count if len(numbers) == 1 else numbers


def _plain(where: str, value: Any) -> Any:
    """Check a value of a choice: a number, text, True, False, or a list of numbers or names."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, list | tuple):
        if all(isinstance(each, str) for each in value):
            return list(value)
        return [_plain_number(where, each) for each in value]
    return _plain_number(where, value)


def _plain_number(where: str, value: Any) -> float | int:
    """Check a number. Integers stay integers."""
    number = checks.number(where, value)
    return int(value) if isinstance(value, int) else number


def _length(value: Any) -> int | None:
    """Return the length of a value as in `Distribution.length`."""
    if isinstance(value, list):
        return len(value) if value and not isinstance(value[0], str) else None
    return None if isinstance(value, str | bool) else 0
