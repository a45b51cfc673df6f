"""Error bars: as often right as they say, and the same whichever way a render is carried out."""

import dataclasses
import itertools
import signal

import mitsuba as mi
import numpy as np
import pytest
from helpers.films_in_parts import box, differences, in_small_steps, render, watch_steps
from helpers.limits import lower
from helpers.parts import area_light, diffuse, plane, rotate, translate
from helpers.refusals import refused
from helpers.standard_errors import bins_of, covered, is_calibrated
from helpers.support import camera, film, scene
from oracles.films import disk_light_masses
from oracles.noise import paths, sphere, truth

from tofrender.rendering.errors import BATCHES, batches_of, seed_of
from tofrender.rendering.job import whole as all_samples
from tofrender.rendering.renderer import make_job
from tofrender.rendering.settings import RenderSettings
from tofrender.rendering.work_items import render_item
from tofrender.runtime import memory

pytestmark = pytest.mark.filterwarnings("ignore:.*of the energy arrives outside")


def gathered(films, where=slice(None), name: str = "transient") -> tuple:
    """Values and errors of some bins in all films."""
    both = (name, f"{name}_error")
    return tuple(np.concatenate([bins_of(film, n)[:, where] for film in films]) for n in both)


@pytest.fixture(scope="module")
def films():
    """Four seeds of the sphere, 256 pixels each."""
    return [render(sphere(), spp=256, errors=True, seed=seed) for seed in range(4)]


@pytest.mark.statistical
def test_where_many_paths_reach(films):
    """Bins of 10 contributions or more, in 1024 pixels.

    False alarms: two means at 4.5 sigma and a slack of 1 %, below 1.4e-5. Error bars that are 10 %
    too small or too large are found.
    """
    many = paths(256) >= 10
    assert many.sum() > 20
    values, errors = gathered(films, many)
    expected = truth()[many]
    assert is_calibrated(covered(values, errors, expected))
    for wrong in (0.9, 1.1):
        assert not is_calibrated(covered(values, wrong * errors, expected))
    assert not is_calibrated(covered(1.05 * values, errors, expected))


@pytest.mark.statistical
def test_where_few_paths_reach(films):
    """A bound for bins of few contributions, λ expected ones.

    A bin that none reached has the error 0, and does not hold the truth; that has the chance e^-λ.
    One that some reached holds it half of the time, by two errors 4 of 5 times: so the shares are
    at least 0.5 (1 - e^-λ) and 0.8 (1 - e^-λ), and from λ = 3 on at least 0.6 and 0.83.

    False alarms: each of some 60 shares, of 1024 pixels, is 5 sigma above its bound or more.
    """
    sparse = [render(sphere(), spp=16, errors=True, seed=seed) for seed in range(4)]
    for spp, renders in ((16, sparse), (256, films)):
        expected = paths(spp)
        values, errors = gathered(renders)
        assert (errors[values == 0] == 0).all()
        shares = covered(values, errors, truth()).mean(axis=0)
        reached = 1 - np.exp(-expected)
        some = (expected > 0.1) & (expected < 3)
        assert (shares[some] >= np.outer(reached[some], [0.45, 0.75])).all()
        more = (expected >= 3) & (expected < 10)
        assert (shares[more] >= [0.55, 0.8]).all()


def lamp(start: float) -> dict:
    """A disk light 1 m over a floor, seen from its edge's height at the point below its middle."""
    facing_down = translate(0, 0, 1) @ rotate((1, 0, 0), 180) @ mi.ScalarTransform4f().scale(0.6)
    light = {"type": "disk", "to_world": facing_down, "emitter": area_light(5.0)}
    return scene(
        {"floor": plane(bsdf=diffuse(0.5)), "light": light},
        camera(EYE, (0, 0, 0), film(16, 16, 12, start, 0.0125), fov=1e-3),
        max_depth=2,
    )


EYE = (2.0, 0.0, 0.9)  # Looks below the light


@pytest.mark.statistical
def test_of_an_area_light():
    """dE/dr of a disk, and E = π Le R² / (h² + R²), by closed form; false alarms as above.

    Points of one part are even, and so few that bins are a little wide: 69 % and 94 %.
    """
    edges = 1.0 + 0.0125 * np.arange(13)
    expected = 0.5 / np.pi * disk_light_masses(edges, 1.0, 0.6, 5.0)
    films = [
        render(lamp(float(np.hypot(*EYE[::2])) + 1.0), spp=256, errors=True, seed=seed)
        for seed in range(4)
    ]
    assert (expected > 0).all()
    whole = 0.5 * 5.0 * 0.6**2 / (1 + 0.6**2)
    for name, light in (("transient", expected), ("steady", whole)):
        values, errors = gathered(films, name=name)
        assert is_calibrated(covered(values, errors, light))
        assert not is_calibrated(covered(values, 0.8 * errors, light))


@pytest.mark.statistical
def test_that_are_resumed():
    """Two renders with 15 degrees of freedom each; false alarms as above."""
    films = []
    for seed in range(4):
        half = render(sphere(), spp=128, errors=True, seed=seed)
        films.append(render(sphere(), spp=256, errors=True, seed=seed, resume=half))
    many = paths(256) >= 10
    values, errors = gathered(films, many)
    assert films[0].attrs["spp"] == 256
    assert is_calibrated(covered(values, errors, truth()[many]), 2 * (BATCHES - 1))
    assert not is_calibrated(covered(values, 0.9 * errors, truth()[many]), 2 * (BATCHES - 1))


@pytest.mark.parametrize(
    ("spp", "count"), [(16, 16), (32, 16), (4096, 16), (8, 8), (24, 8), (4, 4), (12, 4), (100, 4)]
)
def test_numbers_of_parts(spp, count):
    assert batches_of(spp) == count
    assert BATCHES == 16


@pytest.mark.parametrize("spp", [1, 2, 3, 6, 10, 4097])
def test_samples_that_cannot_be_divided_are_refused(spp):
    for work in (lambda: batches_of(spp), lambda: render(box(), spp=spp, errors=True)):
        with refused(f"spp = {spp}: must be"):
            work()


def test_parts_have_seeds_of_their_own():
    seeds = [
        int(seed_of(seed, first, part)[0])
        for seed, first, part in itertools.product(range(8), (0, 16, 64), range(16))
    ]
    assert len(set(seeds)) == len(seeds)


def test_the_mean_is_that_of_the_parts():
    """Each part is a render of its own, and the errors are theirs by NumPy."""
    whole = render(box(), spp=16, errors=True)
    job = make_job(RenderSettings(box(), spp=1))
    parts = []
    for part in range(16):
        settings = dataclasses.replace(job.settings, seed=int(seed_of(0, 0, part)[0]))
        alone = dataclasses.replace(job, settings=settings)
        parts.append(render_item(alone, all_samples(job), progress=False).arrays)
    assert whole.attrs["spp"] == 16
    for name in ("transient", "steady"):
        found = whole[f"{name}_error"]
        assert (found.dims, found.dtype) == (whole[name].dims, np.float32)
        values = np.stack([part[name] for part in parts]).astype(float)
        top = whole[name].values.max()
        np.testing.assert_allclose(whole[name].values, values.mean(axis=0), atol=1e-5 * top)
        error = values.std(axis=0, ddof=1) / 4
        np.testing.assert_allclose(found.values, error, atol=1e-4 * top)


def stopped(monkeypatch, part: int, **options):
    """Stop a render in the first step of a part."""
    parts = itertools.count()

    def look(number):
        if number == 0 and next(parts) == part:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        in_small_steps(patch, 12 * 9)
        watch_steps(patch, look)
        return render(box(), errors=True, **options)


@pytest.mark.parametrize("spp", [32, 64])
def test_ctrl_c_returns_the_parts_that_are_finished(monkeypatch, spp):
    with pytest.warns(UserWarning, match="interrupted: returning"):
        found = stopped(monkeypatch, 5, spp=spp)
    parts = 6 if spp == 32 else 5
    assert (found.attrs["complete"], found.attrs["spp"]) == (0, parts * spp // 16)
    whole = render(box(), spp=256, errors=True)
    ratio = float(found["steady"].mean() / whole["steady"].mean())
    assert ratio == pytest.approx(1, abs=0.1)
    assert float(found["steady_error"].mean()) > float(whole["steady_error"].mean())


def test_one_part_has_no_errors(monkeypatch):
    with refused("1 of 16 batches", KeyboardInterrupt):
        stopped(monkeypatch, 0, spp=32)


@pytest.mark.parametrize(("spp", "part"), [(32, 0), (32, 7), (64, 0), (64, 7)])
def test_a_checkpoint_goes_on(monkeypatch, tmp_path, capsys, spp, part):
    path = tmp_path / "box.npz"
    whole = render(box(), spp=spp, errors=True)
    with pytest.raises((KeyboardInterrupt, UserWarning), match="interrupted"):
        stopped(monkeypatch, part, spp=spp, checkpoint=path)
    found = render(box(), spp=spp, errors=True, checkpoint=path)
    done = spp // 16 * (part + 1) if spp == 32 else spp // 16 * part + 2
    assert f"resuming from {done} of {spp}" in capsys.readouterr().out
    assert max(differences(found, whole).values()) < 1e-4
    with refused("was made with errors"):
        render(box(), spp=spp, checkpoint=path)


@pytest.mark.parametrize("errors", [False, True])
def test_only_alike_goes_on(errors):
    earlier = render(box(), spp=16, errors=not errors)
    with refused(r"^resume: was rendered with errors = "):
        render(box(), spp=32, errors=errors, resume=earlier)


def test_error_bars_of_light_that_lands_anywhere():
    options = {"integrator": "transient_bdpt", "errors": True}
    found, other = (render(box(), spp=64, seed=seed, **options) for seed in (0, 1))
    error = np.hypot(found["steady_error"], other["steady_error"])
    off = np.abs(found["steady"] - other["steady"])
    lit = other["steady"] > 0
    assert 0.5 < float((off <= error).where(lit).mean()) < 0.85


def test_error_bars_need_memory(monkeypatch):
    size = memory.film_bytes(9, 12, 40, 3)
    lower(monkeypatch, reserved_memory=0, available_memory=3 * size // 2)
    assert render(box()).attrs["complete"] == 1
    with refused("takes", MemoryError):
        render(box(), spp=16, errors=True)
