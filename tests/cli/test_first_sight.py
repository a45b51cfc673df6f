"""What the command shows of a scene of which nobody says when to look at it."""

import subprocess
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

import tofrender
from tofrender.cli import main
from tofrender.io import load_npz
from tofrender.rendering.time_window import PULSES
from tofrender.scenes.loading import is_steady

ROOT = Path(__file__).parents[2]
SMALL = ["--size", "16x16", "--spp", "16", "--format", "npz"]
STEADY = '<scene version="3.0.0"><integrator type="path"/>{}</scene>'
BODY = """
<sensor type="perspective"><transform name="to_world">
  <lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
  <film type="{film}"><integer name="width" value="8"/><integer name="height" value="8"/>
  {bins}</film>
</sensor>
<shape type="sphere"/>
<emitter type="point"><point name="position" x="3" y="3" z="4"/></emitter>
"""
BINS = """<integer name="temporal_bins" value="50"/><float name="start_opl" value="6"/>
<float name="bin_width_opl" value="0.1"/>"""


def rendered(tmp_path, capfd, scene, *options):
    out = tmp_path / "out"
    assert main(["render", str(scene), "--out", str(out), "--no-video", *SMALL, *options]) == 0
    return load_npz(out / "transient.npz"), capfd.readouterr().err


def start_of(dataset):
    return float(dataset.opl[0] - (dataset.opl[1] - dataset.opl[0]) / 2)


def test_a_built_in_scene_gets_a_window_and_a_pulse_as_python_has_them(tmp_path, capfd):
    dataset, said = rendered(tmp_path, capfd, "cornell_box")
    same = tofrender.render(
        "cornell_box", size=(16, 16), spp=16, window="auto", pulse_width="auto", progress=False
    )
    np.testing.assert_array_equal(dataset.opl, same.opl)
    np.testing.assert_allclose(dataset.transient, same.transient, rtol=1e-4, atol=1e-7)
    assert dataset.attrs["pulse"] == same.attrs["pulse"]
    span = float(dataset.opl[-1] - dataset.opl[0])
    width = float(dataset.attrs["pulse"].split("=")[1].rstrip(")"))
    assert width == pytest.approx(span / PULSES, rel=0.15)  # Of the window without the pulse
    assert dataset.attrs["energy_outside_window"] < 0.01
    line = next(line for line in said.splitlines() if line.startswith("note: chose bins from "))
    assert f"bins from {start_of(dataset):.4g} to" in line
    assert f"a pulse of {width:g} m automatically" in line


@pytest.mark.parametrize(
    ("options", "start"),
    [
        ("--window scene", 3.5),
        ("--window 3,20 --bins 10", 3.0),
        ("--window 3,20 --pulse-width auto", 3.0),  # Bins from 3 to 20 m were not found
    ],
)
def test_whoever_speaks_of_time_gets_what_they_say(tmp_path, capfd, options, start):
    dataset, said = rendered(tmp_path, capfd, "cornell_box", *options.split())
    assert "automatically" not in said
    assert (dataset.attrs["pulse"] == "none") == ("auto" not in options)
    assert start_of(dataset) == pytest.approx(start)
    assert "--bins" not in options or dataset.sizes["opl"] == 10


@pytest.mark.parametrize(("pulse", "width"), [("scene", "none"), ("0.25", "0.25")])
def test_a_pulse_does_not_switch_the_automatic_window_off(tmp_path, capfd, pulse, width):
    dataset, said = rendered(tmp_path, capfd, "cornell_box", "--pulse-width", pulse)
    assert "note: chose bins from" in said
    assert start_of(dataset) != pytest.approx(3.5)
    assert dataset.attrs["energy_outside_window"] < 0.01
    assert width in dataset.attrs["pulse"]


def test_a_file_with_bins_of_its_own_keeps_them(tmp_path, capfd):
    file = tmp_path / "ball.xml"
    text = STEADY.format(BODY.format(film="transient_hdr_film", bins=BINS))
    file.write_text(text.replace('type="path"', 'type="transient_path"'))
    dataset, said = rendered(tmp_path, capfd, file)
    assert (start_of(dataset), dataset.sizes["opl"]) == (pytest.approx(6.0), 50)
    assert dataset.attrs["pulse"] == "none"
    assert "automatically" not in said


def test_a_loaded_scene_has_its_pulse():
    scene = tofrender.load_scene("cornell_box", width=4, height=4)
    with pytest.raises(ValueError, match="pulse_width = 'auto': must be left out with a loaded"):
        tofrender.render(scene, spp=1, pulse_width="auto")


def test_a_pulse_of_the_integrator_stays():
    own = tofrender.cornell_box(width=8, height=8)
    own["integrator"] = {"type": "transient_path", "pulse_width_opl": 0.5}
    dataset = tofrender.render(own, spp=4, window="auto", pulse_width="auto", progress=False)
    assert dataset.attrs["pulse"] == "GaussianPulse(width_opl=0.5)"


def test_the_first_frame_is_not_black(tmp_path):
    out = tmp_path / "box"
    assert main(["render", "cornell_box", "--size", "48x48", "--spp", "64", "--out", str(out)]) == 0
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-i", str(out / "video.mp4")]
    first = tmp_path / "first.bmp"
    subprocess.run([*command, "-frames:v", "1", str(first)], check=True)
    picture = np.asarray(Image.open(first))
    assert (picture[: int(0.9 * len(picture))].max(axis=2) > 128).mean() > 0.001


def test_the_box_as_a_file_has_bins():
    assert not is_steady(ROOT / "scenes" / "cornell_box.xml", {})


@pytest.mark.parametrize("kind", ["file", "dict", "name", "loaded"])
def test_a_steady_scene_has_the_same_bins_from_python(tmp_path, capfd, kind):
    """What the command finds, `render` finds; a scene that is loaded keeps its pulse."""
    size = {"width": 16, "height": 16}
    path = tmp_path / "scene.xml"
    path.write_text(STEADY.format(BODY.format(film="hdrfilm", bins="")), encoding="utf-8")
    described = tofrender.scenes.small_box(**size, integrator="path_tracer_mis")
    scene, command, size = {
        "file": (path, path, (16, 16)),
        "dict": (described, "small_box", None),
        "name": ("small_box", "small_box", (16, 16)),
        "loaded": (tofrender.load_scene(described), "small_box", None),
    }[kind]
    bare = ["--pulse-width", "scene"] * (kind == "loaded")
    dataset, said = rendered(tmp_path, capfd, command, *bare)
    same = tofrender.render(scene, size=size, spp=16, progress=False)
    assert same.sizes["opl"] == 300
    assert dataset.attrs["energy_outside_window"] < 0.01
    assert kind == "loaded" or dataset.attrs["pulse"].startswith("GaussianPulse")
    np.testing.assert_allclose(dataset.opl, same.opl, rtol=1e-6)
    assert dataset.attrs["pulse"] == same.attrs["pulse"]
    assert ("and a pulse of" in said) == (kind != "loaded")


def test_a_steady_scene_has_no_window_of_its_own(tmp_path, capfd):
    out = ["--out", str(tmp_path / "out"), "--window", "scene"]
    assert main(["render", "small_box", *out]) == 2
    assert "--window = scene: must be auto or START,STOP" in capfd.readouterr().err
