"""`tofrender warp`: a figure and a verdict, status 1 for a wrong density, one line for the rest."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from tofrender import sampling
from tofrender.cli import app as cli
from tofrender.runtime.canvas import FIGURE_SUFFIXES
from tofrender.sampling.warps import WARPS, square_to_tent_pdf


@pytest.fixture
def run(capsys):
    """Exit status, stdout and stderr of `tofrender warp`."""

    def call(*arguments: object) -> tuple[int, str, str]:
        status = cli.main(["warp", *map(str, arguments)])
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return call


@pytest.mark.parametrize("points", ["independent", "grid", "stratified", "sobol"])
def test_figure_and_verdict(run, tmp_path, points):
    out = tmp_path / "new" / "beckmann.png"
    status, text, err = run("beckmann", "--alpha", "0.3", "--points", points, "--out", out)
    assert (status, err) == (0, "")
    assert text.startswith("beckmann (alpha = 0.3): passed\n  chi-square ")
    assert text.splitlines()[-1] == str(out)
    assert np.array(Image.open(out)).std() > 0


@pytest.mark.parametrize("name", [name for name, each in WARPS.items() if not each.parameter])
def test_every_warp(run, tmp_path, name):
    status, text, _ = run(name, "--count", "100", "--out", tmp_path / f"{name}.png")
    assert status == 0
    assert f"{name}: passed" in text


def test_image(run, tmp_path):
    image = tmp_path / "image.png"
    Image.fromarray(np.array([[250, 200], [20, 90]], dtype=np.uint8)).save(image)
    status, text, _ = run("hierarchical", "--image", image, "--out", tmp_path / "figure.svg")
    assert status == 0
    assert text.startswith("hierarchical: passed")


def test_broken_density_fails(run, tmp_path, monkeypatch):
    monkeypatch.setattr(sampling, "square_to_tent_pdf", lambda p: 1.02 * square_to_tent_pdf(p))
    status, text, _ = run("tent", "--out", tmp_path / "figure.png")
    assert status == 1
    assert text.startswith("tent: FAILED, the pdf integrates to 1.02")
    assert (tmp_path / "figure.png").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bekmann"], "NAME = 'bekmann': did you mean 'beckmann'? Must be one of tent, uniform_"),
        (["beckmann"], "--alpha: must be given, beckmann needs it"),
        (["beckmann", "--alpha", "0"], "--alpha = 0: must be a finite number from 1e-06 to 1e+06"),
        (["beckmann", "--alpha", "x"], "--alpha = x: must be a number from 0"),
        (["tent", "--alpha", "1"], "--alpha = 1: must be left out, tent has none"),
        (["tent", "--image", "a.exr"], "--image = a.exr: must be left out, tent has none"),
        (["hierarchical"], "--image: must be given, hierarchical needs it"),
        (
            ["hierarchical", "--image", "nope.exr"],
            "--image = 'nope.exr': must be a file that exists",
        ),
        (["tent", "--points", "gird"], "--points = 'gird': did you mean 'grid'?"),
        (["tent", "--count", "0"], "--count = 0: must be an integer from 1 to 16777216"),
        (["tent", "--seed", "-1"], "--seed = -1: must be an integer from 0 to 4294967295"),
        (["tent", "--variant", "scalar_rgb"], "--variant = 'scalar_rgb': cannot render in time"),
    ],
)
def test_bad_input(run, tmp_path, arguments, message):
    out = tmp_path / "figure.png"
    status, text, err = run(*arguments, "--out", out)
    assert status != 0
    assert text == ""
    assert err.startswith(f"error: {message}")
    assert err.count("\n") == 1
    assert not out.exists()


def test_bad_out(run, tmp_path):
    status, _, err = run("tent", "--out", tmp_path / "figure.exr")
    assert status == 2
    assert "must be a file name that ends in .png or .pdf or .svg" in err
    (tmp_path / "folder.png").mkdir()
    status, _, err = run("tent", "--out", tmp_path / "folder.png")
    assert status == 2
    assert "is a folder" in err
    assert FIGURE_SUFFIXES == (".png", ".pdf", ".svg")
