"""The closed forms of gradients: numbers of section 9, and the table of docs/gradients.md."""

import math
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.gradient_cases import TABLE
from oracles import films as oracles, gradients as forms

from benchmarks.misuka_sphere import FREQUENCIES, closed_form
from tofrender.integrators.derivatives import MOST_KEPT

Z = np.array([0.0, 0.0, 1.0])
LAMP = (0.5, 0.0, 2.0)


def central(function, x: float, step: float) -> np.ndarray:
    """Differences of fourth order."""
    near, far = (function(x + s * step) - function(x - s * step) for s in (1, 2))
    return (8 * near - far) / (12 * step)


@pytest.mark.parametrize("radius", [0.7, 1.2])
def test_g2_inside(radius):
    orders = [
        forms.derived(lambda R, n=n: forms.inside_sphere(R, 0.8, 2.0, n), radius) for n in range(3)
    ]
    totals = np.array([[np.zeros(2)] * 2] + [[o.moments(), o.d_moments()] for o in orders])
    for n, (bounce, change) in enumerate(np.diff(totals, axis=0)):
        assert bounce[0] == pytest.approx(oracles.sphere_bounce_total(n, radius, 0.8, 2.0))
        assert bounce[1] / bounce[0] == pytest.approx(radius * (2 + 4 * n / 3))
        assert change == pytest.approx([-2 * bounce[0] / radius, -bounce[1] / radius])


def floor(z, fov: float = 20):
    return forms.lit_plane(forms.View((0, 0, 2), (0, 0, 0), fov), z * Z, Z, LAMP, 1.0, 0.5)


def under_ceiling(z):
    view = forms.View((0, 0, 2), (0, 0, 0), 20)
    return forms.corridor(view, z, 3.0, LAMP, 1.0, (0.5, 0.4))


@pytest.mark.parametrize(
    ("form", "theta", "expected"),
    [
        (partial(floor, fov=1e-6), 0.0, [0.03312451, 0.06296146]),
        (floor, 0.0, [0.03250383, 0.06257378]),
        (under_ceiling, 0.0, [0.03571043, 0.06998518]),
        (lambda R: forms.sphere_light(R, 2.0, 0.6, 3.0, 0.7, 0.0), 0.5, [0.315, 0.45249487]),
    ],
    ids=["g1, one ray", "g1, film", "g1, with a ceiling", "g2, sphere light"],
)
def test_changes_of_sum_and_moment(form, theta, expected):
    light = forms.derived(form, theta)
    assert light.d_moments() == pytest.approx(expected, abs=3e-8)
    if theta:
        assert light.moments() == pytest.approx([0.07875, 0.12876281], abs=1e-8)


def test_g3():
    straight = forms.derived(lambda n: forms.slab(n, 0.3, 0.0, 0.0, 1.0, 2), 1.5)
    assert straight.d_light == pytest.approx([-0.24576, 0.009043968])
    assert straight.d_opl == pytest.approx([0.3, 0.9])
    assert straight.light[0] == pytest.approx(oracles.slab_order(0, 1.5, 1.0))
    tilted = forms.derived(
        lambda n: forms.slab(n, 0.3, math.sin(math.radians(40)), 0.0, 1.0, 3), 1.5
    )
    assert tilted.d_opl[0] == pytest.approx(0.25734388, abs=1e-8)
    assert tilted.light == pytest.approx([0.91062428, 0.0019046309, 3.98366e-6], rel=1e-6)


def test_g4():
    phasor = forms.Phasor(20e6)
    z, change = (
        getattr(phasor, what)(forms.derived(lambda z: forms.seen_in_mirror(z, 2.0, 1.0, 3.0), 0.0))
        for what in ("value", "derivative")
    )
    phase = (z[0] * change[1] - z[1] * change[0]) / (z @ z)
    assert phase == pytest.approx(-0.83833801, abs=1e-8)


@pytest.mark.parametrize("x", [-0.3, 0.02, 0.25])
def test_g6(x):
    one = forms.Arrived(np.array([2.0]), np.array([1.0]), np.zeros(1), np.zeros(1))
    s = 0.1
    p = math.exp(-0.5 * (x / s) ** 2) / math.sqrt(2 * math.pi)
    assert forms.Gate(1 + x, s).by_width(one) == pytest.approx([2 * p / s * (x * x / s**3 - 1 / s)])
    for of, within in (
        (partial(forms.Gate, 1 + x), 1e-6),
        (partial(forms.Bins, 1 + x, 0.05, 1), 1e-8),
    ):
        found = central(lambda s, of=of: of(s).value(one), s, 1e-4)
        assert of(s).by_width(one) == pytest.approx(found, abs=within)


PAGE = Path(__file__).parents[2] / "docs/gradients.md"
TENTH_OF_A_PERCENT, STANDARD_ERRORS, ROUNDING = 1e-3, 3, 2e-4


def table() -> dict[tuple[str, str, str], list[str]]:
    """Parameter, scene and measure -> closed form, forward and reverse, as text."""
    text = PAGE.read_text(encoding="utf-8")
    lines = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    start = next(k for k, cells in enumerate(lines) if cells[:2] == ["parameter", "scene"])
    end = next(k for k, cells in enumerate(lines) if cells[0] == "misuka")
    return {tuple(cells[:3]): cells[3:6] for cells in lines[start + 1 : end]}


def read(cell: str) -> tuple[float, float]:
    """A number and its standard error, of 0.0325040(12)."""
    digits, error = re.fullmatch(r"(-?[\d.]+)(?:\((\d+)\))?", cell).groups()
    return float(digits), int(error or 0) * 10.0 ** -len(digits.partition(".")[2])


def test_the_page_has_all_rows():
    rows = {(case.row, case.scene, what) for case in TABLE for what in case.weights()}
    assert set(table()) == rows
    assert len({row for row, _, _ in rows}) == 10


@pytest.mark.parametrize("case", TABLE, ids=lambda case: case.name)
def test_rows_of_the_page_are_the_closed_forms(case):
    _, change = case.expected()
    for what, weights in case.weights().items():
        exact = float(weights @ change)
        form, *found = map(read, table()[case.row, case.scene, what])
        assert form[0] == pytest.approx(exact, rel=1e-5)
        for value, error in found:
            off = abs(value - exact)
            assert off < TENTH_OF_A_PERCENT * abs(exact)
            assert off < STANDARD_ERRORS * error + ROUNDING * abs(exact)


def test_the_page_says_how_long_paths_may_be():
    assert f"`max_depth` from 1 to {MOST_KEPT}" in PAGE.read_text(encoding="utf-8")


def test_rows_of_misuka_are_its_scenes():
    text = PAGE.read_text(encoding="utf-8")
    found = [
        (row["by"], row["of"], row["bands"], f"{closed_form(row['by'])[row['of']]:.6g}")
        for row in re.finditer(
            r"^\| (?P<by>radius|albedo) \| (?P<of>sum|moment) \| (?P<bands>[\d, ]+) \|", text, re.M
        )
    ]
    assert len(found) == 4 * len(FREQUENCIES)
    for cells in found:
        assert cells[2] in FREQUENCIES
        assert "| " + " | ".join(cells) + " |" in text
