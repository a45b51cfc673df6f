"""Every test starts under `llvm_ad_rgb` and leaves no other variant behind."""

import mitsuba as mi
import pytest
from helpers import browser, durations, selection, workers

import tofrender  # Picks the variant and registers the plugins

VARIANT = "llvm_ad_rgb"


def pytest_addoption(parser):
    durations.pytest_addoption(parser)
    selection.pytest_addoption(parser)
    parser.addoption(
        "--all-inputs",
        action="store_true",
        help="try all of tests/inputs, not a sample",
    )


pytest_configure = durations.pytest_configure


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Select; run tests of pages in a browser once more if they fail: a machine may be busy."""
    selection.pytest_collection_modifyitems(config, items)
    for item in filter(lambda each: isinstance(each, pytest.Function), items):
        if any(each is browser or each is browser.page for each in vars(item.module).values()):
            item.add_marker(pytest.mark.flaky(reruns=1))


pytest_testnodedown = selection.pytest_testnodedown
pytest_unconfigure = selection.pytest_unconfigure
pytest_sessionstart = workers.pytest_sessionstart
pytest_collection_finish = workers.pytest_collection_finish
pytest_xdist_auto_num_workers = workers.pytest_xdist_auto_num_workers


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

    They leave specular surfaces a fraction of a millimetre beside, see `test_lengths.py`, connect
    each vertex to one light point, see `test_light_samples.py`, and find the lamps that the camera
    sees, see `test_visible_emitters.py`.
    """
    monkeypatch.setattr(
        tofrender.integrators.passes.VisibleEmitters, "of", classmethod(lambda *_: None)
    )
    monkeypatch.setattr(
        tofrender.paths.scattering, "spawn_ray", lambda si, d, specular: si.spawn_ray(d)
    )
    lights = tofrender.paths.endpoints.scene_lights
    monkeypatch.setattr(lights, "points_that_pay", lambda *_: 1)
