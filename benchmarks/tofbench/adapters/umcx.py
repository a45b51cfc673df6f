"""umcx, a Monte Carlo program for turbid media. Users build it from source."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

INSTALL = "build umcx from source (make -C src omp) and name the program in UMCX"
ABILITIES = frozenset({"bins", "half-space"})
MM = 5.0  # Voxels of 1 mm per meter of the scene
SIDE = 100  # Voxels along an edge
LIGHT_M_S = 299_792_458.0
SIZES = {"i": "<i1", "U": "<u1", "I": "<i2", "u": "<u2", "l": "<i4", "m": "<u4"}


def _program() -> str:
    found = shutil.which(os.environ.get("UMCX", "umcx"))
    if found is None:
        raise ImportError("umcx is not installed: UMCX does not name a program")
    return found


def version() -> str:
    text = subprocess.run([_program(), "--help"], capture_output=True, text=True).stdout
    return "umcx" + "".join(re.findall(r"Copyright \(c\) ([\d-]+)", text)[:1]).rjust(10)


def _photons(data: bytes) -> np.ndarray:
    """Read photons (photons, columns) from the array `[$d#[#i 2 rows columns` of BJData."""
    at = data.index(b"PhotonRawData[$d#[") + len(b"PhotonRawData[$d#[")
    shape = []
    at += 3  # Skip "#i" and the number of axes
    for _ in range(2):
        kind = np.dtype(SIZES[chr(data[at])])
        shape.append(int(np.frombuffer(data, kind, 1, at + 1)[0]))
        at += 1 + kind.itemsize
    return np.frombuffer(data, "<f4", shape[0] * shape[1], at).reshape(shape)


def render(scene: dict, bins: dict, samples: int, seed: int) -> np.ndarray:
    """Return the path lengths of photons of a pencil beam that leave the medium again.

    By reciprocity, this is the radiance in the direction of the beam under uniform light.
    """
    # Describe the medium and the beam
    fog = scene["media"]["fog"]
    end_s = MM / 1e3 * (bins["start"] + bins["count"] * bins["width"]) / LIGHT_M_S
    medium = {"mua": fog["absorption"] / MM, "mus": fog["scattering"] / MM, "g": 0.0, "n": 1.0}
    middle = [SIDE / 2, SIDE / 2, 0]
    settings = {
        "Session": {
            **{"ID": "run", "Photons": samples, "RNGSeed": seed + 1, "MaxDetPhoton": samples},
            **{"DoMismatch": False, "DoSaveVolume": True, "SaveDetFlag": 5},
        },
        "Forward": {"T0": 0, "T1": end_s, "Dt": end_s},
        "Domain": {
            **{"Dim": [SIDE] * 3, "LengthUnit": 1, "OriginType": 1},
            "Media": [{"mua": 0, "mus": 0, "g": 1, "n": 1}, medium],
        },
        "Optode": {
            "Source": {"Type": "pencil", "Pos": middle, "Dir": [0, 0, 1]},
            "Detector": [{"Pos": middle, "R": 0.6 * SIDE}],
        },
        "Shapes": [{"Grid": {"Tag": 1, "Size": [SIDE] * 3}}],
    }

    # Run the program
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "run.json").write_text(json.dumps(settings))
        command = [_program(), "-f", "run.json"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        photons = _photons((Path(folder) / "run_detp.jdb").read_bytes())

    # Sum the photons in bins
    path_m = photons[:, 1] / MM
    edges = bins["start"] + bins["width"] * np.arange(bins["count"] + 1)
    weights = np.exp(-fog["absorption"] * path_m) / samples
    return np.histogram(path_m, edges, weights=weights)[0][None, None]
