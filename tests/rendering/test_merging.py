"""Renders of other seeds, joined: one render with all samples, and refused what is not one."""

import dask.array
import numpy as np
import pytest
import xarray as xr
from helpers.films_in_parts import box, crop, differences, render
from helpers.refusals import refused
from helpers.standard_errors import bins_of, covered, is_calibrated
from helpers.support import with_film, with_integrator
from oracles.noise import paths, sphere, truth

from tofrender import load_zarr, merge, save_zarr

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")


@pytest.fixture(scope="module")
def parts() -> list[xr.Dataset]:
    return [render(box(), spp=8 << seed, seed=seed) for seed in range(4)]


@pytest.fixture(scope="module")
def noisy() -> list[xr.Dataset]:
    """Renders with error bars."""
    return [render(box(), spp=16 << seed, seed=seed, errors=True) for seed in range(3)]


def weighted(renders, name: str) -> np.ndarray:
    spp = np.array([float(each.attrs["spp"]) for each in renders])
    return (
        sum(n * each[name].values.astype(float) for n, each in zip(spp, renders, strict=True))
        / spp.sum()
    )


def test_samples_weigh_alike(parts):
    merged = merge(parts[:3])
    assert set(merged.data_vars) == {"transient", "steady"}
    for name in ("transient", "steady"):
        assert merged[name].dtype == np.float32
        assert merged[name].dims == parts[0][name].dims
        np.testing.assert_allclose(merged[name].values, weighted(parts[:3], name), rtol=1e-5)


def test_the_order_of_axes_does_not_matter(parts):
    turned = parts[1].isel(x=slice(None, None, -1), channel=[2, 0, 1]).transpose("opl", "x", ...)
    xr.testing.assert_identical(merge([parts[0], turned]), merge(parts[:2]))
    xr.testing.assert_identical(merge([turned, parts[0]]), merge(parts[1::-1]))
    late = [each.isel(opl=slice(20, None)) for each in parts[:2]]
    outside = 1 - sum(
        w * float(p["transient"].sum()) for w, p in zip((1, 2), late, strict=True)
    ) / (sum(w * float(p["steady"].sum()) for w, p in zip((1, 2), late, strict=True)))
    assert merge(late).attrs["energy_outside_window"] == pytest.approx(outside, abs=0.01)
    with refused(r"renders\[1\]: the labels along the axis x must be integers"):
        merge([parts[0], parts[1].coarsen(x=2).mean()])


def test_attributes_of_all(parts):
    merged, first = merge(parts[:3]), parts[0]
    assert (merged.attrs["spp"], merged.attrs["seed"]) == (8 + 16 + 32, "0, 1, 2")
    assert merged.attrs["complete"] == 1
    assert merge([first, parts[1].assign_attrs(complete=0)]).attrs["complete"] == 0
    assert set(merged.attrs) == set(first.attrs)
    for name in ("fingerprint", "integrator", "start_opl", "quantity", "units", "scene"):
        assert merged.attrs[name] == first.attrs[name]
    seconds = sum(each.attrs["render_seconds"] for each in parts[:3])
    assert merged.attrs["render_seconds"] == pytest.approx(seconds)
    outside = [each.attrs["energy_outside_window"] for each in parts[:3]]
    mean = np.average(outside, weights=[8, 16, 32])
    assert merged.attrs["energy_outside_window"] == pytest.approx(mean, rel=1e-6)


def test_what_is_joined_stays(parts):
    before = [each.copy(deep=True) for each in parts]
    merge(parts)
    for each, its in zip(parts, before, strict=True):
        xr.testing.assert_identical(each, its)


def test_joined_renders_join_on(parts):
    """Pairs of pairs are all four in any order, and a seed within a pair is known again."""
    left, right = merge(parts[:2]), merge(parts[2:])
    together, once = merge([left, right]), merge(parts)
    assert max(differences(merge(parts[::-1]), once).values()) < 1e-5
    once = once.drop_vars(["transient_error", "steady_error"])
    assert max(differences(together, once).values()) < 1e-5
    assert together.attrs["seed"] == "0, 1, 2, 3"
    with refused("seed = 1: is that of two"):
        merge([left, parts[1]])


def test_error_bars_are_joined(noisy):
    merged = merge(noisy)
    spp = np.array([16.0, 32.0, 64.0]) / 112
    for name in ("transient", "steady"):
        error = f"{name}_error"
        squares = [(w * each[error].values) ** 2 for w, each in zip(spp, noisy, strict=True)]
        top = float(merged[error].max())
        np.testing.assert_allclose(merged[error].values, np.sqrt(sum(squares)), atol=1e-5 * top)
        assert merged[error].dtype == np.float32
    assert float(merged["steady_error"].mean()) < float(noisy[-1]["steady_error"].mean())


def test_of_four_or_more_the_scatter_tells(parts):
    """Weighted by samples: a part's variance goes as 1 / spp."""
    merged = merge(parts)
    shares = np.array([8.0, 16.0, 32.0, 64.0]) / 120
    for name in ("transient", "steady"):
        mean = weighted(parts, name)
        scatter = sum(
            w * (each[name].values - mean) ** 2 for w, each in zip(shares, parts, strict=True)
        )
        top = float(merged[f"{name}_error"].max())
        np.testing.assert_allclose(
            merged[f"{name}_error"].values, np.sqrt(scatter / 3), atol=1e-4 * top
        )


def test_fewer_without_error_bars_have_none(parts, noisy):
    assert set(merge(parts[:3]).data_vars) == {"transient", "steady"}
    other = render(box(), spp=8, seed=9)
    assert set(merge([noisy[0], other]).data_vars) == {"transient", "steady"}


@pytest.mark.statistical
def test_the_scatter_is_calibrated():
    """Of eight renders with different samples, in 1024 pixels; false alarms 1.4e-5.

    Without the weights, scatter would be too large by a fifth here: that is found.
    """
    spp = [64, 32, 32, 16, 64, 64, 32, 96]
    many = paths(16) >= 2
    values, errors, plain = [], [], []
    for group in range(4):
        renders = [render(sphere(), spp=count, seed=10 * group + k) for k, count in enumerate(spp)]
        merged = merge(renders)
        values.append(bins_of(merged)[:, many])
        errors.append(bins_of(merged, "transient_error")[:, many])
        alone = np.stack([bins_of(each)[:, many] for each in renders])
        plain.append(alone.std(axis=0, ddof=1) / np.sqrt(len(spp)))
    values, errors, plain = map(np.concatenate, (values, errors, plain))
    assert is_calibrated(covered(values, errors, truth()[many]), 7)
    assert not is_calibrated(covered(values, plain, truth()[many]), 7)
    assert not is_calibrated(covered(values, 0.85 * errors, truth()[many]), 7)


def spoilt(parts) -> list[xr.Dataset]:
    return [parts[0], parts[1].assign(steady=parts[1]["steady"] * np.float32("nan"))]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda parts: [], "renders: has 0; must have two or more"),
        (lambda parts: parts[:1], "renders: has 1; must have two or more"),
        (lambda parts: [*parts[:2], parts[0]], "seed = 0: is that of two renders"),
        (lambda parts: [parts[0], {"spp": 1}], r"renders\[1\]: expected .*, found dict"),
        (lambda parts: spoilt(parts), "steady: 324 of 324 values"),
        (
            lambda parts: [parts[0], parts[1].assign_attrs(variant="llvm_ad_mono")],
            r"renders\[1\]: has variant = 'llvm_ad_mono'",
        ),
    ],
)
def test_what_cannot_be_joined(parts, change, text):
    with refused(text):
        merge(change(parts))


@pytest.mark.parametrize(
    ("described", "options", "text"),
    [
        (lambda: box(light="flash"), {}, "start_opl = 6.0; must be 3.5"),
        (lambda: box(light="flash", start_opl=3.5), {}, "fingerprint = "),
        (lambda: box(max_depth=5), {}, "max_depth = 5; must be 4"),
        (lambda: box(14, 9), {}, "film_width = 14; must be 12"),
        (lambda: box(temporal_bins=50), {}, "opl"),
        (lambda: box(bin_width_opl=0.2), {}, "bin_width_opl = 0.2; must be 0.3"),
        (box, {"window": (3.0, 15.0)}, "start_opl = 3.0; must be 3.5"),
        (box, {"integrator": "path_tracer_nee"}, "PathTracerNEE"),
        (box, {"sampler": "independent"}, "sampler = 'IndependentSampler'"),
        (lambda: with_integrator(box(), pulse_width_opl=0.1), {}, "pulse = "),
        (lambda: with_film(box(), **crop(2, 0, 10, 9)), {}, ""),
    ],
)
def test_another_render(parts, described, options, text):
    other = render(described(), seed=7, **options)
    with refused(rf"^renders\[2\]: (has|the axis) .*{text}"):
        merge([parts[0], parts[1], other])


def test_films_on_disk_stay_there(parts, tmp_path):
    films = [save_zarr(each, tmp_path / f"{number}.zarr") for number, each in enumerate(parts)]
    merged = merge(films)
    assert isinstance(merged["transient"].data, dask.array.Array)
    assert max(differences(merged, merge(parts)).values()) < 1e-5
    saved = save_zarr(merged, tmp_path / "all.zarr")
    assert max(differences(load_zarr(tmp_path / "all.zarr"), merge(parts)).values()) < 1e-5
    assert saved.attrs == merged.attrs
    mixed = merge([films[0], *parts[1:]])
    assert max(differences(mixed, merge(parts)).values()) < 1e-5
