"""`tofrender phasor` and `tofrender gate` follow the paths of the scene's own integrator."""

import re
from pathlib import Path

import mitsuba as mi
import numpy as np
import OpenEXR
import pytest
from helpers.commands import refused, run

import tofrender

XML = Path(__file__).parents[2] / "scenes" / "cornell_box.xml"
OURS = {"type": "transient_path", "max_depth": 3, "rr_depth": 1, "pulse_width_opl": 1.5}
OURS |= {"hide_emitters": True, "camera_unwarp": True}
MITSUBAS = {"type": "path", "max_depth": 3, "hide_emitters": True}
PIXELS, SPP = (8, 6), 16
SETTINGS = ["--size", "8x6", "--spp", SPP]


def room(folder: Path, integrator: dict) -> Path:
    """The Cornell box with another integrator."""
    kinds = {bool: "boolean", int: "integer", float: "float"}
    properties = "".join(
        f'<{kinds[type(value)]} name="{name}" value="{str(value).lower()}"/>'
        for name, value in integrator.items()
        if name != "type"
    )
    text = f'<integrator type="{integrator["type"]}">{properties}</integrator>'
    path = folder / "room.xml"
    path.write_text(
        re.sub(r"<integrator .*?</integrator>", text, XML.read_text(encoding="utf-8"), flags=re.S),
        encoding="utf-8",
    )
    return path


def by_command(capsys, command: str, path: Path, *options: object) -> np.ndarray:
    """The image that a command writes: I of its phasors, or the gate."""
    out = path.parent / command
    told = run(capsys, command, path, "--out", out, *SETTINGS, *options)
    assert told[0] == 0, told[2]
    file, channel = ("gate.exr", "RGB") if command == "gate" else ("phasor_20MHz.exr", "I")
    return OpenEXR.File(str(out / file)).channels()[channel].pixels


def by_call(command: str, path: Path, parameters: dict) -> np.ndarray:
    """The same by the Python call, with these parameters of the integrator."""
    scene = mi.load_file(str(path), width=str(PIXELS[0]), height=str(PIXELS[1]))
    sensor = scene.sensors()[0]
    if command == "gate":
        integrator = mi.load_dict({**parameters, "type": "time_gated_transient_path"})
        return tofrender.render_at_time(scene, integrator, sensor, 3.0, SPP)
    integrator = mi.load_dict({**parameters, "type": "amcw_transient_path"})
    return tofrender.render_amcw_phasor(scene, sensor, 20e6, SPP, integrator=integrator)[0]


OPTIONS = {"gate": ["--at", 3], "phasor": ["--freq", "20e6"]}


@pytest.mark.essential
@pytest.mark.parametrize(
    ("command", "integrator"), [("phasor", OURS), ("gate", MITSUBAS), ("gate", OURS)]
)
def test_the_scenes_integrator_says_which_paths(capsys, tmp_path, command, integrator):
    path = room(tmp_path, integrator)
    pulse = {"pulse_width_opl": 2.0} if integrator is MITSUBAS else {}
    options = OPTIONS[command] + (["--pulse-width", 2] if pulse else [])
    seen = by_command(capsys, command, path, *options)
    np.testing.assert_allclose(seen, by_call(command, path, integrator | pulse), rtol=1e-4)
    for name in integrator.keys() - {"type", "rr_depth"}:
        others = {k: v for k, v in integrator.items() if k != name}
        assert not np.allclose(seen, by_call(command, path, others | pulse), rtol=1e-3), name
    deeper = by_command(capsys, command, path, *options, "--max-depth", 5)
    wanted = by_call(command, path, integrator | pulse | {"max_depth": 5})
    np.testing.assert_allclose(deeper, wanted, rtol=1e-4)
    assert not np.allclose(seen, deeper, rtol=1e-3)


@pytest.mark.parametrize(
    ("command", "source"),
    [("phasor", {"type": "depth"}), ("gate", {"type": "direct"}), ("gate", "bust_ao")],
)
def test_an_integrator_that_cannot_do_it_is_refused(capsys, tmp_path, command, source):
    scene = source if isinstance(source, str) else room(tmp_path, source)
    told = run(capsys, command, scene, "--out", tmp_path / "out", *SETTINGS, *OPTIONS[command])
    assert told[0] == 2
    assert "error: integrator = " in told[2]
    assert "transient_path" in told[2]
    assert not (tmp_path / "out").exists()


def test_a_gate_refuses_connections_through_panes(capsys, tmp_path):
    path = room(tmp_path, {"type": "volpath"})
    pane = '<shape type="rectangle"><bsdf type="thindielectric"/></shape></scene>'
    path.write_text(path.read_text(encoding="utf-8").replace("</scene>", pane))
    told = run(capsys, "gate", path, "--out", tmp_path / "out", *SETTINGS, *OPTIONS["gate"])
    assert told[0] == 2
    assert "error: integrator = TransientVolpath does not support gates" in told[2]


@pytest.mark.parametrize("frequency", ["20", "999.5"])
def test_a_small_frequency_needs_a_unit(capsys, tmp_path, frequency):
    out = ("--size", "2x2", "--spp", "1", "--out", tmp_path / "out")
    said = refused(capsys, "phasor", "cornell_box", "--freq", frequency, *out)
    assert f"--freq = {frequency} needs a unit. Write {frequency}MHz" in said
    assert not (tmp_path / "out").exists()
