"""A small folder like that of the data set LCSPC, with counts of a sensor that is known."""

import json
import struct
from pathlib import Path

import numpy as np

from tofrender.apps.twin.experiment import predicted
from tofrender.apps.twin.recordings import FILES, ChipRecording, _parts
from tofrender.fitting.calibration import Calibration
from tofrender.io.stl import read_stl
from tofrender.sensors import MultiZone

POSES = 8
CLOTH = 1.6
LATER = 1.5  # Counts of the pyramid session over those of the first
TABLE_M = -0.16

CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
SIDES = [(0, 1, 2), (0, 2, 3), (4, 6, 5), (4, 7, 6)]
SIDES += [(k, (k + 1) % 4 + 4, (k + 1) % 4) for k in range(4)]
SIDES += [(k, k + 4, (k + 1) % 4 + 4) for k in range(4)]


def box(low, high, top: float = 1.0) -> np.ndarray:
    """Triangles of a box whose upper face is smaller by a factor."""
    low, high = np.array(low), np.array(high)
    base = low[:2] + CORNERS * (high - low)[:2]
    middle = base.mean(axis=0)
    upper = middle + top * (base - middle)
    vertices = [[*each, low[2]] for each in base] + [[*each, high[2]] for each in upper]
    return np.array(vertices)[np.array(SIDES)]


def stl(triangles: np.ndarray) -> bytes:
    content = bytes(80) + struct.pack("<I", len(triangles))
    for each in triangles:
        content += struct.pack("<12fH", 0, 0, 0, *each.ravel(), 0)
    return content


def poses(offset: float) -> np.ndarray:
    """Poses around the object, which look at it from different heights."""
    made = []
    for k in range(POSES):
        turn = 2 * np.pi * k / POSES + offset
        height = 0.12 + 0.03 * (k % 4)
        place = np.array([0.17 * np.cos(turn), 0.17 * np.sin(turn), height])
        z = np.array([0.02, 0.01 * k, -0.05]) - place
        z /= np.linalg.norm(z)
        x = np.cross([np.cos(k), np.sin(k), 0.4], z)
        x /= np.linalg.norm(x)
        pose = np.eye(4)
        pose[:3] = np.stack([x, np.cross(z, x), z, place], axis=1)
        made.append(pose)
    return np.array(made)


def write_recordings(folder: Path) -> Path:
    """Write four recordings of a block and of a pyramid on a table."""
    slab = box((-1, -1, TABLE_M - 0.2), (1, 1, TABLE_M))
    meshes = {
        "tall_block/tall_block.stl": box((-0.03, -0.02, TABLE_M), (0.03, 0.04, 0.05)),
        "pyramid/pyramid2.stl": box((-0.08, -0.07, TABLE_M), (0.07, 0.08, 0.06), top=0.05),
    }
    for name, mesh in meshes.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(stl(np.concatenate([slab, mesh])))
    known = Calibration.__new__(Calibration)
    object.__setattr__(known, "sensor", MultiZone.preset("tmf8820"))
    object.__setattr__(known, "albedos", {"object": 1.0, "cloth": CLOTH})
    random = np.random.default_rng(2)
    for number, (name, (histograms, mesh)) in enumerate(FILES.items()):
        vertices, faces = read_stl(folder / mesh)
        there = poses(0.3 * number)
        recording = ChipRecording(name, np.zeros(0), there, vertices, _parts(vertices, faces))
        counts = predicted(known, recording.render(spp=4))
        counts = random.poisson(counts * (LATER if "pyramid" in name else 1.0))
        records = [
            {"hists": c.tolist(), "pose": p.tolist(), "reference_hist": c[0].tolist()}
            for c, p in zip(counts, there, strict=True)
        ]
        (folder / histograms).write_text(json.dumps(records))
    return folder
