"""`tofrender warp`: a figure and a verdict, status 1 for a wrong density."""

import numpy as np
import pytest
from helpers.commands import run
from PIL import Image

from tofrender import sampling
from tofrender.sampling.table import WARPS
from tofrender.sampling.warps import square_to_tent_pdf


@pytest.fixture
def warp(capsys):
    """Exit status, stdout and stderr of `tofrender warp`."""
    return lambda *arguments: run(capsys, "warp", *arguments)


@pytest.mark.parametrize("points", ["independent", "grid", "stratified", "sobol"])
def test_figure_and_verdict(warp, tmp_path, points):
    out = tmp_path / "new" / "beckmann.png"
    status, text, err = warp("beckmann", "--alpha", "0.3", "--points", points, "--out", out)
    assert (status, err) == (0, "")
    assert text.startswith("beckmann (alpha = 0.3): passed\n  chi-square ")
    assert text.splitlines()[-1] == str(out)
    assert np.array(Image.open(out)).std() > 0


@pytest.mark.parametrize("name", [name for name, each in WARPS.items() if not each.parameter])
def test_every_warp(warp, tmp_path, name):
    status, text, _ = warp(name, "--count", "100", "--out", tmp_path / f"{name}.png")
    assert status == 0
    assert f"{name}: passed" in text


def test_image(warp, tmp_path):
    image = tmp_path / "image.png"
    Image.fromarray(np.array([[250, 200], [20, 90]], dtype=np.uint8)).save(image)
    status, text, _ = warp("hierarchical", "--image", image, "--out", tmp_path / "figure.svg")
    assert status == 0
    assert text.startswith("hierarchical: passed")


def test_broken_density_fails(warp, tmp_path, monkeypatch):
    monkeypatch.setattr(sampling, "square_to_tent_pdf", lambda p: 1.02 * square_to_tent_pdf(p))
    status, text, _ = warp("tent", "--out", tmp_path / "figure.png")
    assert status == 1
    assert text.startswith("tent: FAILED, the pdf integrates to 1.02")
    assert (tmp_path / "figure.png").exists()


def test_a_variant_that_cannot_render_in_time(warp, tmp_path):
    out = tmp_path / "figure.png"
    status, text, err = warp("tent", "--variant", "scalar_rgb", "--out", out)
    assert (status, text) == (1, "")
    assert err.startswith("error: --variant = 'scalar_rgb': cannot render in time")
    assert err.count("\n") == 1
    assert not out.exists()
