"""Recordings of the data set LCSPC: histograms of a TMF8820, poses, and the mesh of the object.

C. Sifferman, Y. Wang, M. Gupta and M. Gleicher have published them at
https://github.com/uwgraphics/LCSPCData, under the MIT license. Nothing is downloaded here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ...io.histogram_files import load_histograms
from ...io.stl import read_stl
from ...motion.sensor_poses import render_poses
from ...runtime import checks
from ...scenes.meshes import mesh_with

FILES = {
    "tall_block": ("tall_block/tall_block.json", "tall_block/tall_block.stl"),
    "tall_block_random": ("tall_block/tall_block_random.json", "tall_block/tall_block.stl"),
    "pyramid": ("pyramid/pyramid.json", "pyramid/pyramid2.stl"),
    "pyramid_random": ("pyramid/pyramid_random.json", "pyramid/pyramid2.stl"),
}
"""Histograms and mesh of each recording, in the folder of the data or its folder `real`."""

PARTS = ("object", "cloth")
"""Parts of the scene. The object stands on a table with a cloth."""

FIELD_OF_VIEW_DEG = 44.0
WINDOW_OPL = (0.0, 2.1)
BINS = 300  # A quarter of the sensor's bin each
SAME_HEIGHT_M = 1e-4


@dataclass(frozen=True, eq=False)
class ChipRecording:
    """Histograms of one object from many poses.

    Args:
        name: Name of the recording.
        counts: Photon counts, (poses, zones, bins).
        poses: Poses of the sensor, (poses, 4, 4).
        vertices: Vertices of the mesh of object and table [m], (n, 3).
        faces: Corners of the faces of each part, by name.
    """

    name: str
    counts: np.ndarray
    poses: np.ndarray
    vertices: np.ndarray
    faces: dict[str, np.ndarray]

    def render(
        self,
        shown: ChipRecording | None = None,
        *,
        size: int = 12,
        spp: int = 4,
        seed: int = 0,
        step: Callable[[], Any] = lambda: None,
    ) -> dict[str, xr.Dataset]:
        """Render each part alone, with the albedo 1 and with the other part black.

        `shown` is a recording with a mesh to render instead, from the poses of this recording.
        `step` is called after each part.
        """
        source = self if shown is None else shown
        found = {}
        for lit in PARTS:
            scene = source.scene({part: float(part == lit) for part in PARTS}, size)
            found[lit] = render_poses(
                scene, self.poses, attached=["laser"], spp=spp, seed=seed, progress=False
            )
            step()
        return found

    def scene(self, albedos: dict[str, float], size: int) -> dict[str, Any]:
        """Return the scene with albedos of the parts, lit by a laser at the sensor."""
        film = {
            "type": "transient_hdr_film",
            "width": size,
            "height": size,
            "temporal_bins": BINS,
            "start_opl": WINDOW_OPL[0],
            "bin_width_opl": (WINDOW_OPL[1] - WINDOW_OPL[0]) / BINS,
            "rfilter": {"type": "box"},
        }
        camera = {"type": "perspective", "fov": FIELD_OF_VIEW_DEG, "near_clip": 1e-3, "film": film}
        meshes = {}
        for part in PARTS:
            color = {"type": "rgb", "value": albedos[part]}
            bsdf = {"type": "twosided", "material": {"type": "diffuse", "reflectance": color}}
            meshes[part] = mesh_with(part, self.vertices, self.faces[part], bsdf=bsdf)
        # Paths end at the first surface, since interreflection does not improve the agreement
        return meshes | {
            "type": "scene",
            "integrator": {"type": "transient_path", "max_depth": 2},
            "camera": camera,
            "laser": {"type": "point", "position": [0.0, 0.0, 0.0], "intensity": 1.0},
        }


def load_recording(folder: Path, name: str) -> ChipRecording:
    """Read a recording from the folder of the data."""
    folder = checks.path("path", folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"path = {folder}: is not a folder; must be a copy of LCSPCData")
    root = folder / "real" if (folder / "real").is_dir() else folder
    histograms, mesh = (root / file for file in FILES[name])
    data = load_histograms(histograms)
    if "to_world" not in data:
        raise ValueError(f"path = {histograms}: contains no poses; must have a pose in each record")
    vertices, faces = read_stl(mesh)
    return ChipRecording(
        name=name,
        counts=np.asarray(data["counts"].values, np.float64),
        poses=data["to_world"].values,
        vertices=vertices,
        faces=_parts(vertices, faces),
    )


def _parts(vertices: np.ndarray, faces: np.ndarray) -> dict[str, np.ndarray]:
    """Separate the slab of the table, up to the height of its rim, from the object on it."""
    at_rim = vertices[:, 0] <= vertices[:, 0].min() + SAME_HEIGHT_M
    top = vertices[at_rim, 2].max() + SAME_HEIGHT_M
    is_table = (vertices[faces][:, :, 2] <= top).all(axis=1)
    if is_table.all():
        raise ValueError(
            "the mesh has no points above its widest part. It must contain a table and an object"
        )
    return {"object": faces[~is_table], "cloth": faces[is_table]}


def training_poses(count: int) -> np.ndarray:
    """Return which of the poses are fitted, a quarter of them.

    Poses lie on rings of elevation, the number modulo 8. This choice has poses of all rings.
    """
    number = np.arange(count)
    return (number % 8 + number // 8) % 4 == 0
