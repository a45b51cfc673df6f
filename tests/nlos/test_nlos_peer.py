"""Captures agree with mitransient's, where mitransient is correct: same scene, bins and scale."""

import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from helpers.parts import gray
from helpers.support import agree, film, over_seeds
from oracles.nlos import Rectangle, Setup, estimates, load_nlos, relay_wall

SEEDS = range(12)
DEVICE = (-0.5, 0.0, 0.25)
LIT = (0.1, -0.2, 0.0)
SPP = 8192


def peers_scene(mode: str) -> dict:
    """Return a facing plate with laser and hidden-geometry sampling, without known errors."""
    plate = Rectangle((0.2, 0.1, 0.9), (-0.3, 0, 0), (0, 0.25, 0))
    to_world = mi.ScalarTransform4f().look_at(list(DEVICE), list(LIT), [0, 1, 0])
    laser = {"type": "projector", "irradiance": gray(100.0), "fov": 0.2}
    window = film(2, 2, bins=40, start=1.7, bin_width=0.05)
    integrator = {"type": "transient_nlos_path", "account_first_and_last_bounces": False}
    integrator |= {"nlos_laser_sampling": True, "nlos_hidden_geometry_sampling": True}
    integrator |= {"capture_type": {"single": 1, "confocal": 2}[mode], "temporal_filter": "box"}
    wall = relay_wall(Setup(sensor=DEVICE), window)
    parts = {"relay_wall": wall, "laser": laser | {"to_world": to_world}, "hidden": plate.shape()}
    return {"type": "scene", "integrator": integrator} | parts


def render_as_peer(mode: str, path: str) -> None:
    """Render in a separate process, in which mitransient owns the names of the plugins."""
    from mitransient.nlos import focus_emitter_at_relay_wall_3dpoint

    scene = mi.load_dict(peers_scene(mode), parallel=False, optimize=False)
    wall = next(shape for shape in scene.shapes() if shape.is_sensor())
    focus_emitter_at_relay_wall_3dpoint(mi.Point3f(LIT), wall, scene.emitters()[0])
    np.save(path, over_seeds(estimates(scene, SPP, "transient"), SEEDS))


PROGRAM = """
import sys, warnings
warnings.simplefilter("ignore")
sys.path[:0] = [sys.argv[1], sys.argv[1] + "/.."]
import test_nlos_peer as test
import mitransient
test.render_as_peer(*sys.argv[2:])
"""


@pytest.mark.statistical
@pytest.mark.parametrize("mode", ["single", "confocal"])
def test_same_capture(mode, tmp_path):
    path, here = tmp_path / "peer.npy", Path(__file__).parent
    command = [sys.executable, "-c", PROGRAM, str(here), mode, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=here.parents[1])
    assert done.returncode == 0, done.stderr
    theirs = with_sum(np.load(path))
    ours = with_sum(over_seeds(estimates(load_nlos(peers_scene(mode)), SPP, "transient"), SEEDS))
    assert theirs.shape == ours.shape == (12, 41)
    assert agree(ours, theirs, rounding=1e-3)
    assert not agree(1.03 * ours, theirs, rounding=1e-3)
    assert not agree(np.roll(ours, 1, axis=1), theirs, rounding=1e-3)


def with_sum(bins: np.ndarray) -> np.ndarray:
    """Return bins of all points after the bins of their sum."""
    together = bins.sum(axis=(1, 2))
    return np.column_stack([together.sum(axis=1), together])
