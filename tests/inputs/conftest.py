"""What the tests of bad input share."""

import pytest

import tofrender
from tofrender.integrators import passes, render_loop
from tofrender.nlos import capturing
from tofrender.nlos.reconstruction import methods
from tofrender.rendering import strategies, work_items


@pytest.fixture
def no_work(monkeypatch):
    """Fail if anything is rendered or reconstructed."""

    def never(*_, **__):
        raise AssertionError("work has started")

    for module in (work_items, strategies, capturing, passes, render_loop):
        monkeypatch.setattr(module, "steps", never)
    monkeypatch.setattr(methods, "backproject", never)
    monkeypatch.setattr(tofrender.TransientHDRFilm, "prepare", never)
    return never
