"""Velocities in scene descriptions, and motions that are refused in one line."""

import mitsuba as mi
import numpy as np
import pytest
from helpers.moving import share_at
from helpers.parts import diffuse, gray, plane, point_light, unit
from helpers.scenes import refusal
from helpers.support import camera, film, scene

import tofrender
from tofrender import Motion

EYE, LAMP = np.array([0.4, -0.3, 3.0]), np.array([1.0, 0.3, 2.0])
VIEW = camera(EYE, (0, 0, 0), film(2, 2), fov=30)


def described(**parts) -> dict:
    base = {"floor": plane(bsdf=diffuse(0.5)), "lamp": point_light(LAMP, 3.0)}
    return scene(base | parts, VIEW | {"id": "eye"}, max_depth=2)


XML = """<scene version="3.0.0">
  <integrator type="transient_path"><integer name="max_depth" value="2"/></integrator>
  <sensor type="perspective" id="eye">
    <float name="fov" value="0.006"/>
    <transform name="to_world"><lookat origin="0.4,-0.3,3" target="0,0,0" up="0,1,0"/></transform>
    <vector name="velocity" x="0.5" y="-1" z="0.25"/>
    <film type="transient_hdr_film">
      <integer name="width" value="1"/><integer name="height" value="1"/>
      <integer name="temporal_bins" value="1"/><float name="bin_width_opl" value="1000"/>
      <rfilter type="box"/>
    </film>
  </sensor>
  <emitter type="point" id="lamp">
    <point name="position" x="1" y="0.3" z="2"/>
    <rgb name="intensity" value="3"/>
    <vector name="angular_velocity" x="0" y="0" z="2"/>
    <point name="rotation_center" x="0" y="0.5" z="1"/>
  </emitter>
  <shape type="rectangle" id="floor">
    <transform name="to_world"><scale value="5"/></transform>
    <vector name="velocity" x="0" y="0" z="1.5"/>
  </shape>
</scene>"""


def test_velocities_in_a_file(tmp_path):
    (tmp_path / "a.xml").write_text(XML)
    found = tofrender.motions_of(tofrender.load_scene(tmp_path / "a.xml"))
    assert found == {
        "eye": Motion((0.5, -1, 0.25)),
        "lamp": Motion((0, 0, 0), (0, 0, 2), (0, 0.5, 1)),
        "floor": Motion((0, 0, 1.5)),
    }
    v, w, u = (0, 0, 1.5), np.cross((0, 0, 2), LAMP - (0, 0.5, 1)), np.array([0.5, -1, 0.25])
    rate = (v - u) @ unit(-EYE) + (w - v) @ unit(LAMP)
    assert share_at(str(tmp_path / "a.xml"), rate) == pytest.approx(1, abs=1e-4)


def test_velocities_in_a_dict_and_by_name():
    moving = {"velocity": [0.0, 1.0, 2.0], "angular_velocity": [1.0, 0.0, 0.0]}
    by_dict = tofrender.load_scene(described(floor=plane(bsdf=diffuse(0.5), **moving)))
    by_name = tofrender.moving(
        tofrender.load_scene(described(), optimize=False),
        {"floor": Motion((0, 1, 2), (1, 0, 0)), "lamp": Motion()},
    )
    assert tofrender.motions_of(by_dict) == tofrender.motions_of(by_name)
    assert list(tofrender.motions_of(by_name)) == ["floor"]
    tofrender.moving(by_name, {"lamp": Motion((1, 0, 0))})
    assert list(tofrender.motions_of(by_name)) == ["lamp"]  # Replaces all earlier ones


def test_shapes_are_merged_unless_something_moves():
    gray_wall = diffuse(0.5)
    parts = {name: {"type": "cube", "bsdf": gray_wall} for name in "abc"}
    resting = tofrender.load_scene(described(**parts))
    moving = tofrender.load_scene(described(**parts | {"b": parts["b"] | {"velocity": [0, 0, 1]}}))
    standing = tofrender.load_scene(
        described(**parts | {"b": parts["b"] | {"velocity": [0, 0, 0]}})
    )
    assert len(standing.shapes()) == len(resting.shapes()) < len(moving.shapes()) == 4


@pytest.mark.parametrize(
    ("motion", "said"),
    [
        ({"velocity": (0, 0, np.nan)}, "velocity = "),
        ({"velocity": (0, np.inf, 0)}, "velocity = "),
        ({"velocity": (0, 0, 1.1e6)}, "velocity = "),
        ({"velocity": (9e5, 9e5, 0)}, "velocity = "),
        ({"velocity": (1, 2)}, "velocity = "),
        ({"velocity": 3.0}, "velocity = "),
        ({"angular_velocity": (0, 0, "fast")}, "angular_velocity = "),
        ({"angular_velocity": (0, 0, 1e7)}, "angular_velocity = "),
        ({"rotation_center": (0, 0, np.inf)}, "rotation_center = "),
    ],
)
def test_motions_that_are_none(motion, said):
    """They are refused by name, and in scene descriptions with the part's name."""
    with pytest.raises(ValueError, match=rf"\A{said}.*must .+\Z"):
        Motion(**motion)


def test_motions_that_are_none_in_a_scene():
    fast = described(floor=plane(velocity=[0.0, 0.0, 2e6]))
    with pytest.raises(ValueError, match=r"\Afloor: velocity = .*2000000.* must be .+\Z"):
        tofrender.load_scene(fast)
    with pytest.raises(ValueError, match=r"\A.*velocity.*\Z"):
        tofrender.load_scene(described(floor=plane(velocity=3.0)))
    with pytest.raises(ValueError, match=r"\A.*velocity.*\Z"):
        tofrender.load_scene(described(floor=plane(bsdf=diffuse(0.5) | {"velocity": [0, 0, 1]})))
    alone = described(floor=plane(rotation_center=[0.0, 0.0, 1.0]))
    with pytest.raises(ValueError, match=r"\A.*rotation_center.*\Z"):
        tofrender.load_scene(alone)


def test_motions_of_parts_that_cannot():
    medium = {"type": "heterogeneous", "sigma_t": {"type": "gridvolume", "grid": None}}
    medium["sigma_t"]["grid"] = mi.VolumeGrid(np.full((2, 2, 2), 0.5, np.float32))
    parts = {
        "sky": {"type": "constant"},
        "sun": {"type": "directional", "direction": [0, 0, -1], "irradiance": gray(1.0)},
        "panel": plane(size=0.1, emitter={"type": "area", "id": "shine"}),
        "smoke": {"type": "cube", "bsdf": {"type": "null"}, "interior": medium},
    }
    step = Motion((0, 0, 1))
    for name, said in {
        "wand": "an id of the scene, one of",
        "floo": "an id of the scene, one of",
        "sky": "infinity",
        "shine": "the id of its shape",
        "smoke": "medium on a grid",
    }.items():
        more = {name: parts[name]} if name in parts else {"panel": parts["panel"]}
        loaded = tofrender.load_scene(described(**more), optimize=False)
        line = refusal(tofrender.moving, loaded, {name: step})
        assert line.startswith(f"motions = '{name}': "), line
        assert said in line, line
        assert tofrender.motions_of(loaded) == {}
    loaded = tofrender.load_scene(described(sun=parts["sun"]), optimize=False)
    assert "infinity" in refusal(tofrender.moving, loaded, {"sun": step})
    sun = described(sun=parts["sun"] | {"velocity": [0, 0, 1]})
    assert "infinity" in refusal(tofrender.load_scene, sun)
    far = {"floor": Motion(angular_velocity=(0, 0, 1e3), rotation_center=(1e4, 0, 0))}
    assert "1e+06 m/s" in refusal(tofrender.moving, loaded, far)
    line = refusal(tofrender.moving, loaded, {"floor": (0, 0, 1)})
    assert line.startswith("motions['floor'] = ")
    assert line.endswith("a Motion")


def test_a_medium_of_two_shapes_that_move_differently():
    medium = {"type": "homogeneous", "id": "air", "sigma_t": 0.1, "albedo": 0.5}
    box = {"type": "cube", "bsdf": {"type": "null"}, "interior": medium}
    other = box | {"interior": {"type": "ref", "id": "air"}, "velocity": [0.0, 0.0, 1.0]}
    loaded = tofrender.load_scene(described(one=box, two=other), optimize=False)
    line = refusal(tofrender.range_rate, loaded, integrator="transient_volpath", progress=False)
    assert "'two'" in line
    assert "medium" in line


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"exposure_s": 0}, "exposure_s = 0"),
        ({"exposure_s": -1e-3}, "exposure_s = -0.001"),
        ({"exposure_s": float("nan")}, "exposure_s = nan"),
        ({"cycles": 0}, "cycles = 0"),
        ({"cycles": 1.5}, "cycles = 1.5"),
        ({"waveform": "square"}, "waveform = 'square'"),
        ({"frequency_hz": 0}, "frequency_hz = 0"),
        ({"integrator": "path_tracer_mis"}, "integrator = "),
    ],
)
def test_doppler_options_that_are_wrong(options, said):
    line = refusal(tofrender.doppler, described(), progress=False, **options)
    assert line.startswith(said), line
    assert "must " in line, line


def test_integrators_with_a_pulse_are_refused():
    pulsed = described() | {"integrator": {"type": "transient_path", "pulse_width_opl": 0.1}}
    for call in (tofrender.doppler, tofrender.range_rate):
        assert "pulse" in refusal(call, pulsed, progress=False)


def test_rates_of_other_measurements_are_refused():
    triangle = tofrender.doppler(described(), waveform="triangle", spp=1, progress=False)
    assert refusal(tofrender.doppler_rate, triangle).startswith("waveform = 'triangle'")
    line = refusal(tofrender.doppler_rate, triangle.drop_attrs())
    assert line.startswith("measured: the attribute waveform is missing"), line
    line = refusal(tofrender.range_rate, described(), rates=(1.0, 1.0), progress=False)
    assert line.startswith("rates = (1.0, 1.0):"), line
    line = refusal(tofrender.range_rate, described(), window="auto", progress=False)
    assert line.startswith("window = 'auto':")
