"""What is drawn: right distributions, and of each record its own, whatever else is drawn."""

import math

import numpy as np
import pytest
from scipy import stats

from tofrender.datasets.dataset_config import read_config
from tofrender.datasets.distributions import parse_distribution
from tofrender.datasets.randomness import Source

COUNT = 4000
LEAST_P = 1e-5  # Draws never change: a test that passes once passes always


def drawn(seed: int = 0, **table: object) -> np.ndarray:
    """Draws of many records."""
    distribution = parse_distribution("vary.x", table)
    return np.array([distribution.draw(Source(seed, k, "x")) for k in range(COUNT)])


def truncated(mean: float, deviation: float, low: float, high: float) -> stats.rv_continuous:
    edges = (low - mean) / deviation, (high - mean) / deviation
    return stats.truncnorm(*edges, loc=mean, scale=deviation)


def normal(*numbers: float) -> dict[str, float]:
    return dict(zip(("mean", "deviation", "low", "high"), numbers, strict=False))


CASES = {
    "uniform": ({"low": -2.0, "high": 3.0}, stats.uniform(-2, 5)),
    "log_uniform": ({"low": 0.1, "high": 10.0}, stats.loguniform(0.1, 10)),
    "normal": (normal(1.0, 0.5), stats.norm(1, 0.5)),
    "normal with limits": (normal(1.0, 0.5, 0.9, 2.0), truncated(1, 0.5, 0.9, 2)),
    "normal, a tail": (normal(0.0, 1.0, 9.0, 12.0), truncated(0, 1, 9, 12)),
    "normal, the other tail": (normal(0.0, 1.0, -12.0, -9.0), truncated(0, 1, -12, -9)),
}


@pytest.mark.parametrize("name", CASES)
def test_numbers_have_their_distribution(name):
    table, expected = CASES[name]
    values = drawn(distribution=name.split()[0].strip(","), **table)
    assert stats.kstest(values, expected.cdf).pvalue > LEAST_P
    low, high = table.get("low", -math.inf), table.get("high", math.inf)
    assert low <= values.min()
    assert values.max() <= high


def test_a_wrong_distribution_is_seen():
    values = drawn(distribution="uniform", low=0.0, high=1.0)
    assert stats.kstest(values, stats.uniform(0, 1.05).cdf).pvalue < LEAST_P


def test_entries_of_a_list_are_independent():
    values = drawn(distribution="uniform", low=[0, 5, -1], high=[1, 5, 1])
    assert (values[:, 1] == 5).all()
    for column, (start, width) in ((0, (0, 1)), (2, (-1, 2))):
        assert stats.kstest(values[:, column], stats.uniform(start, width).cdf).pvalue > LEAST_P
    assert abs(np.corrcoef(values[:, 0], values[:, 2])[0, 1]) < 5 / math.sqrt(COUNT)


def test_choices_have_their_weights():
    values = drawn(distribution="choice", values=["a", "b", "c"], weights=[1, 0, 3])
    counts = [int((values == name).sum()) for name in "abc"]
    assert counts[1] == 0
    expected = [COUNT / 4, 3 * COUNT / 4]
    assert stats.chisquare([counts[0], counts[2]], expected).pvalue > LEAST_P


def test_points_are_even_on_a_cap():
    table = {"center": [1.0, 2.0, 3.0], "radius": [2.0, 4.0], "angle": 60}
    rays = drawn(distribution="on_sphere", axis=[1.0, -2.0, -2.0], **table) - [1, 2, 3]
    lengths = np.linalg.norm(rays, axis=1)
    assert stats.kstest(lengths, stats.uniform(2, 2).cdf).pvalue > LEAST_P
    cos = rays @ np.array([1, -2, -2]) / 3 / lengths
    assert stats.kstest(cos, stats.uniform(0.5, 0.5).cdf).pvalue > LEAST_P  # By area
    mean = (rays / lengths[:, None]).mean(axis=0)
    np.testing.assert_allclose(mean, 0.75 * np.array([1, -2, -2]) / 3, atol=0.03)


def test_spheres_are_even_all_around():
    points = drawn(distribution="on_sphere", radius=1.5)
    assert np.allclose(np.linalg.norm(points, axis=1), 1.5)
    for column in range(3):
        assert stats.kstest(points[:, column], stats.uniform(-1.5, 3).cdf).pvalue > LEAST_P


def test_subsets_are_even():
    distribution = parse_distribution(
        "vary.x", {"distribution": "subset", "present": ["a", "b", "c"], "least": 1}
    )
    found = [distribution.draw(Source(0, k, "x")) for k in range(COUNT)]
    sizes = [sum(len(each) == n for each in found) for n in (1, 2, 3)]
    assert stats.chisquare(sizes).pvalue > LEAST_P
    pairs = [sum(each == pair for each in found) for pair in (["a", "b"], ["a", "c"], ["b", "c"])]
    assert sum(pairs) == sizes[1]
    assert stats.chisquare(pairs).pvalue > LEAST_P


LAMP = {"path": "light.emitter.radiance", "distribution": "uniform", "low": 0, "high": 1}
TURN = {"turn": "small-box", "distribution": "normal", "mean": 0, "deviation": 9}


def config(records: int = 10, seed: int = 0, **vary: dict) -> object:
    outputs = {"steady": True}
    given = {"records": records, "seed": seed, "scene": "cornell_box", "outputs": outputs}
    return read_config(given | {"vary": vary})


def test_draws_depend_on_seed_record_and_name_only():
    both = config(lamp=LAMP, turn=TURN)
    draws = [both.draw(k) for k in range(10)]
    assert [both.draw(k) for k in reversed(range(10))] == draws[::-1]
    assert [config(records=999, lamp=LAMP, turn=TURN).draw(k) for k in range(10)] == draws
    assert [config(turn=TURN, lamp=LAMP).draw(k)["lamp"] for k in range(10)] == [
        draw["lamp"] for draw in draws
    ]
    assert [config(lamp=LAMP).draw(k)["lamp"] for k in range(10)] == [d["lamp"] for d in draws]
    others = [
        config(seed=1, lamp=LAMP).draw(3)["lamp"],
        config(lamp=LAMP).draw(4)["lamp"],
        config(lamp=LAMP).draw(3, attempt=1)["lamp"],
        config(lump=LAMP).draw(3)["lump"],
    ]
    assert len({draws[3]["lamp"], *others}) == 5


def test_one_limit_alone():
    draws = [config(turn=TURN | {"high": -5}).draw(k)["turn"] for k in range(10)]
    assert max(draws) < -5


def test_seeds_of_renders_differ():
    found = config(lamp=LAMP)
    seeds = {found.render_seed(k, a, use) for k in range(50) for a in (0, 1) for use in ("", "n")}
    assert len(seeds) == 200
    assert all(0 <= seed < 1 << 32 for seed in seeds)


def test_numbers_never_change():
    """Data sets that exist can be made again by later versions."""
    numbers = [Source(7, 3, "lamp", attempt).number(i) for attempt in (0, 1) for i in (0, 5)]
    expected = [0.9271859977895812, 0.6183012616215037, 0.04589378911801412, 0.7014382956517834]
    assert numbers == expected
    assert Source(7, 3, "[render]").integer() == 1157251969
