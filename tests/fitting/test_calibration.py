"""Calibration of multi-zone sensors: derivatives, true values, standard errors, errors."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from helpers.refusals import refused
from helpers.support import ALPHA
from scipy import stats

from tofrender import SampledPulse
from tofrender.fitting import calibrate
from tofrender.fitting.calibration import PARAMETERS, _Problem
from tofrender.sensors import MultiZone
from tofrender.sensors.multi_zone import Light
from tofrender.signals.pulses import KnotPulse

OPL = 0.4 + 0.01 * (np.arange(70) + 0.5)
KNOTS = np.array([-0.05, 0.0, 0.04, 0.12, 0.3])
TRUE = MultiZone(
    centers=np.array([[0.16, 0.03], [-0.14, -0.02]]),
    sizes=np.array([[0.25, 0.3], [0.2, 0.24]]),
    gains=np.array([4e6, 7e6]),
    starts_opl=np.array([0.3, 0.32]),
    floors=np.array([30.0, 50.0]),
    pulse=KnotPulse(KNOTS, [0.2, 1.0, 0.5, 0.1, 0.01]),
    bins=24,
    bin_width_opl=0.04,
    blur=0.03,
    shift=(0.01, -0.015),
    scale=(1.04, 0.97),
    crosstalk=0.03,
)
GUESS = replace(
    TRUE,
    gains=np.ones(2),
    starts_opl=np.array([0.31, 0.31]),
    floors=np.zeros(2),
    pulse=KnotPulse(KNOTS, [0.1, 1.0, 0.4, 0.2, 0.02]),
    bin_width_opl=0.0405,
    blur=0.02,
    shift=(0.0, 0.0),
    scale=(1.0, 1.0),
    crosstalk=0.01,
)


def views(poses: int, seed: int = 1, **parts: float) -> dict[str, xr.Dataset]:
    """Return renders of two parts in which each pixel has light at a random place."""
    rng = np.random.default_rng(seed)
    rows, columns = 7, 8
    light = np.zeros((poses, rows, columns, OPL.size))
    place = rng.integers(5, 50, (poses, rows, columns))
    np.put_along_axis(light, place[..., None], rng.uniform(0.5, 1.5, place.shape)[..., None], -1)
    left = rng.uniform(size=(poses, rows, columns, 1)) < 0.4
    tan_x = 0.36 * (1 - 2 * (np.arange(columns) + 0.5) / columns)
    tan_y = 0.3 * (1 - 2 * (np.arange(rows) + 0.5) / rows)
    coords = {"tan_x": ("x", tan_x), "tan_y": ("y", tan_y), "opl": OPL}
    coords["channel"] = ["L"]
    dims = ("pose", "y", "x", "opl", "channel")

    def part(values: np.ndarray) -> xr.Dataset:
        film = {"transient": (dims, values[..., None])}
        attrs = {"quantity": "radiance per bin", "bin_width_opl": float(OPL[1] - OPL[0])}
        return xr.Dataset(film, coords, attrs)

    return {"block": part(light * left), "cloth": part(light * ~left)}


def joined(parts: dict[str, xr.Dataset], cloth: float) -> xr.Dataset:
    light = parts["block"]["transient"] + cloth * parts["cloth"]["transient"]
    return parts["block"].assign(transient=light)


def test_derivatives_are_those_of_differences():
    parts = views(3)
    lights = {name: Light.of(each) for name, each in parts.items()}
    counts = TRUE.measure(joined(parts, 1.6))["counts"].values.astype(float)
    problem = _Problem(GUESS, lights, counts, list(PARAMETERS), 0.05, slice(2, 22))
    x = problem.start + 0.01 * np.random.default_rng(0).standard_normal(problem.start.size)
    found = problem.jacobian(x)
    step = 1e-5
    for k, label in enumerate(problem.labels):
        change = np.zeros_like(x)
        change[k] = step
        after, before = (problem.residuals(x + sign * change) for sign in (1, -1))
        expected = (after - before) / (2 * step)
        scale = np.abs(expected).max()
        assert scale > 0, label
        np.testing.assert_allclose(found[:, k], expected, atol=1e-5 * scale, err_msg=label)


def test_true_values_are_found():
    parts = views(8)
    counts = TRUE.expected(joined(parts, 1.6))["counts"].values
    found = calibrate(GUESS, parts, counts)
    assert found.albedos == pytest.approx({"block": 1.0, "cloth": 1.6}, rel=1e-3)
    for name in PARAMETERS:
        if name != "pulse":
            expected, value = (np.ravel(getattr(each, name)) for each in (TRUE, found.sensor))
            np.testing.assert_allclose(value, expected, rtol=3e-3, atol=3e-4, err_msg=name)
    np.testing.assert_allclose(found.sensor.pulse.values, TRUE.pulse.values, rtol=0.01)


def test_standard_errors_are_those_of_photon_noise():
    """Errors of many calibrations, divided by their standard errors, have the variance 1."""
    parts = views(6)
    names = ["gains", "starts_opl", "floors", "crosstalk"]
    kept = replace(TRUE, crosstalk=0.02)
    scores = []
    for seed in range(12):
        counts = TRUE.measure(joined(parts, 1.6), seed=seed)["counts"].values
        found = calibrate(kept, parts, counts, parameters=names, relative_error=0.0)
        true = np.concatenate([TRUE.gains, TRUE.starts_opl, TRUE.floors, [0.03, 1.6]])
        scores.append((found.values.values - true) / found.standard_errors.values)
        assert 0.8 < found.chi_square < 1.2
    for k, label in enumerate(found.values["parameter"].values):
        chi = float((np.array(scores)[:, k] ** 2).sum())
        tail = min(stats.chi2.cdf(chi, 12), stats.chi2.sf(chi, 12))
        assert tail > ALPHA, label
    assert found.correlation.shape == (8, 8)
    np.testing.assert_allclose(np.diag(found.correlation), 1.0)
    first, second, value = found.most_correlated(1)[0]
    assert abs(value) == pytest.approx(np.abs(np.triu(found.correlation, 1)).max())
    assert first != second


def test_what_is_not_fitted_stays():
    parts = views(4)
    counts = TRUE.expected(joined(parts, 1.0))["counts"].values
    found = calibrate(TRUE, joined(parts, 1.0), counts, parameters=["gains"])
    assert found.sensor.starts_opl.tolist() == TRUE.starts_opl.tolist()
    assert found.values["parameter"].values.tolist() == ["gains[0]", "gains[1]"]
    np.testing.assert_allclose(found.sensor.gains, TRUE.gains, rtol=1e-6)


def test_bins_that_are_not_compared_do_not_count():
    parts = joined(views(4), 1.0)
    counts = TRUE.expected(parts)["counts"].values
    counts[..., 20:] = 9e9
    found = calibrate(TRUE, parts, counts, parameters=["gains", "floors"], last_bin=19)
    np.testing.assert_allclose(found.sensor.gains, TRUE.gains, rtol=1e-4)
    assert found.residuals["bin"].values.tolist() == list(range(20))


def test_ill_posed_sets_are_refused():
    parts = views(4)
    counts = TRUE.expected(joined(parts, 1.0))["counts"].values
    same = {"block": parts["block"], "copy": parts["block"], "cloth": parts["cloth"]}
    with refused("albedo copy.*separately"):
        calibrate(GUESS, same, counts)
    dark = replace(TRUE, centers=np.array([[0.16, 0.03], [-3.0, 0.0]]), crosstalk=0.0)
    with refused("zone 1 receives no light"):
        calibrate(dark, joined(parts, 1.0), counts)
    far = replace(TRUE, pulse=KnotPulse([*KNOTS, 5.0, 6.0], [*TRUE.pulse.values, 1e-3, 1e-3]))
    with refused(r"pulse\[6\].*separately"):
        calibrate(far, joined(parts, 1.0), counts)
    nothing = parts["cloth"].assign(transient=0 * parts["cloth"]["transient"])
    with refused("do not depend on albedo black"):
        calibrate(GUESS, parts | {"black": nothing}, counts)
    one = joined(views(1), 1.0)
    with refused("bins do not determine"):
        few = TRUE.expected(one)["counts"].values
        calibrate(GUESS, one, few, first_bin=8, last_bin=10)


def test_wrong_arguments_are_refused():
    parts = views(4)
    scene = joined(parts, 1.0)
    counts = TRUE.expected(scene)["counts"].values
    sampled = replace(TRUE, pulse=SampledPulse([1.0], 0.0, 0.1))
    other = parts | {"cloth": parts["cloth"].isel(opl=slice(0, 50))}
    for words, call in {
        "knots": lambda: calibrate(sampled, scene, counts),
        "parameters": lambda: calibrate(TRUE, scene, counts, parameters=["gain"]),
        "list of names": lambda: calibrate(TRUE, scene, counts, parameters="gains"),
        "histograms": lambda: calibrate(TRUE, scene, counts[:2]),
        "0 or more": lambda: calibrate(TRUE, scene, -counts),
        "finite": lambda: calibrate(TRUE, scene, counts * np.nan),
        "MultiZone": lambda: calibrate("tmf8820", scene, counts),
        "renders": lambda: calibrate(TRUE, {}, counts),
        "other pixels or bins": lambda: calibrate(TRUE, other, counts),
        "last_bin": lambda: calibrate(TRUE, scene, counts, last_bin=24),
        "first_bin": lambda: calibrate(TRUE, scene, counts, first_bin=9, last_bin=8),
        "relative_error": lambda: calibrate(TRUE, scene, counts, relative_error=-0.1),
    }.items():
        with refused(words):
            call()
