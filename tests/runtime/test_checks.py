"""Checks of arguments: what they let through, and the one line that they say otherwise."""

import math
import time
import timeit
from pathlib import Path

import numpy as np
import pytest
from helpers.support import refused

from tofrender.runtime import checks


@pytest.mark.parametrize(
    ("value", "options", "allowed"),
    [
        (math.nan, {}, ""),
        ("3", {"unit": "degrees"}, " of degrees"),
        (True, {"unit": "watts", "positive": True}, " of watts above 0"),
        (0, {"positive": True, "high": 1}, " above 0 and at most 1"),
        (1.1, {"positive": True, "high": 1}, " above 0 and at most 1"),
        (-0.1, {"low": 0, "high": 1}, " from 0 to 1"),
        (1.1, {"low": 0, "high": 1}, " from 0 to 1"),
        (-1, {"low": 0}, " at least 0"),
        (4, {"high": 3}, " at most 3"),
    ],
)
def test_number_says_what_is_allowed(value, options, allowed):
    with pytest.raises(ValueError, match=r"^x = ") as error:
        checks.number("x", value, **options)
    assert str(error.value) == f"x = {value!r}: must be a finite number{allowed}"


@pytest.mark.parametrize("value", [0, 1, np.float32(0.5), np.int64(1)])
def test_number_takes_both_ends(value):
    found = checks.number("x", value, low=0, high=1)
    assert found == float(value)
    assert type(found) is float


@pytest.mark.parametrize("shape", [(), (7,), (2, 3, 4, 5)])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_finite_finds_each_value_that_is_not(shape, bad, dtype):
    values = np.full(shape, np.finfo(dtype).max, dtype)  # Their sum is not finite, they are
    assert checks.finite("light", values) is values
    place = tuple(size - 1 for size in shape)
    values[place] = bad
    with pytest.raises(ValueError, match=rf"^light: 1 of {values.size} values are not") as error:
        checks.finite("light", values)
    assert f"the first is {bad:g} at {list(place)}" in str(error.value)
    several = np.zeros((4, 5, 6), dtype)
    several[1, 2, 3], several[1, 4, 0], several[3, 0, 0] = bad, -math.inf, math.nan
    with pytest.raises(ValueError, match=rf"3 of 120 .* the first is {bad:g} at \[1, 2, 3\]"):
        checks.finite("light", several)


def test_finite_takes_integers_and_nothing():
    assert checks.finite("counts", np.ones(3, np.int32)).sum() == 3
    assert checks.finite("nothing", np.ones((3, 0))).shape == (3, 0)


def test_finite_is_quick():
    """By processor time, beside what NumPy takes for a sum."""
    values = np.ones(1 << 24, np.float32)

    def seconds(function):
        return min(timeit.repeat(function, timer=time.process_time, number=1, repeat=5))

    assert seconds(lambda: checks.finite("light", values)) < 8 * seconds(values.sum)


@pytest.mark.parametrize("value", [3, None, True, b"a.npz", "", "a\0b", ["a.npz"]])
def test_path_takes_names_only(value):
    said = r"^path = .*: must be (text or an os.PathLike|a name in)"
    refused(said, checks.path, "path", value)
    assert checks.path("path", "a/b.npz") == checks.path("path", Path("a", "b.npz"))
