"""Checks of arguments: each refuses a bad value in one line, `name = value: must be ...`."""

from .addresses import MAX_NAME, MAX_PATH, address, path
from .arrays import finite, finite_parts, real_array
from .kinds import boolean, function, instance, mapping, one_of, text
from .messages import LISTED, LONGEST, kind_of, listed, printable, shown
from .numbers import (
    MAX_BINS,
    MAX_DEPTH,
    MAX_OPL,
    MAX_SEED,
    MAX_SIZE,
    MAX_SPP,
    depth,
    depth_of_bounces,
    integer,
    metres,
    number,
    place,
    resolved,
    width,
)

__all__ = [
    "LISTED",
    "LONGEST",
    "MAX_BINS",
    "MAX_DEPTH",
    "MAX_NAME",
    "MAX_OPL",
    "MAX_PATH",
    "MAX_SEED",
    "MAX_SIZE",
    "MAX_SPP",
    "address",
    "boolean",
    "depth",
    "depth_of_bounces",
    "finite",
    "finite_parts",
    "function",
    "instance",
    "integer",
    "kind_of",
    "listed",
    "mapping",
    "metres",
    "number",
    "one_of",
    "path",
    "place",
    "printable",
    "real_array",
    "resolved",
    "shown",
    "text",
    "width",
]
