"""Every test starts under one variant, `llvm_ad_rgb`, and leaves no other behind.

`TOFRENDER_TEST_VARIANT=cuda_ad_rgb` runs the tests on a GPU, save those that name a variant.
"""

import functools
import math
import os

import mitsuba as mi
import pytest
import typer
from helpers import browser
from hypothesis import HealthCheck, settings

import tofrender  # Picks the variant and registers the plugins

VARIANT = os.environ.get("TOFRENDER_TEST_VARIANT", "llvm_ad_rgb")

tofrender.integrators.passes.STEP_S = math.inf  # Steps are as many on a slow machine
tofrender.integrators.passes.CUDA_STEP = 1  # ... and on a GPU
typer.main.get_command = functools.cache(typer.main.get_command)  # Built once, not at each call

settings.register_profile(
    "same on all machines",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("same on all machines")


def pytest_collection_modifyitems(items):
    """Run tests of pages in a browser once more if they fail: a machine may be busy."""
    for item in filter(lambda each: isinstance(each, pytest.Function), items):
        if any(each is browser or each is browser.page for each in vars(item.module).values()):
            item.add_marker(pytest.mark.flaky(reruns=1))


@pytest.fixture(autouse=True)
def _variant():
    """Start each test under the same variant, whatever the test before it did."""
    if mi.variant() != VARIANT:
        mi.set_variant(VARIANT)
    yield
    if mi.variant() != VARIANT:
        mi.set_variant(VARIANT)


@pytest.fixture
def mitsubas_steps(monkeypatch):
    """Let paths go as Mitsuba's do, so that our pictures are Mitsuba's to float rounding.

    They leave specular surfaces a fraction of a millimeter beside, see `test_lengths.py`, connect
    each vertex to one light point, see `test_light_samples.py`, find the lamps that the camera
    sees, see `test_visible_emitters.py`, and no caustics, see `test_caustics.py`.
    """
    passes = tofrender.integrators.passes
    no_caustics = classmethod(lambda cls, tracer, *_: cls(tracer))
    monkeypatch.setattr(passes.Caustics, "of", no_caustics)
    monkeypatch.setattr(passes.ExtraRays, "of", classmethod(lambda *_: None))
    monkeypatch.setattr(
        tofrender.paths.scattering, "spawn_ray", lambda si, d, specular: si.spawn_ray(d)
    )
    lights = tofrender.paths.endpoints.scene_lights
    monkeypatch.setattr(lights, "points_that_pay", lambda *_: 1)


@pytest.fixture
def no_work(monkeypatch):
    """Fail if anything is rendered, reconstructed or tested, or if a film allocates its bins."""

    def never(*_, **__):
        raise AssertionError("work has started")

    for place in (
        "rendering.work_items.steps",
        "rendering.strategies.steps",
        "nlos.capturing.steps",
        "nlos.reconstruction.methods.backproject",
        "integrators.passes.steps",
        "integrators.render_loop.steps",
        "films.transient.TransientHDRFilm.prepare",
        "films.phasor.PhasorHDRFilm.prepare",
        "sampling.chi_square.chi_square_test",
    ):
        monkeypatch.setattr(f"tofrender.{place}", never)
    return never
