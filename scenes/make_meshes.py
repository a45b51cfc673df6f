"""Meshes of the built-in scenes: `python -m scenes.make_meshes` writes their files anew.

The package reads the bust and the bunny from `tofrender/scenes/meshes.npz`, XML scenes read PLY
files from `scenes/meshes`. Only the bunny is transformed, so only it is kept in double precision.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tofrender.scenes import meshes

from .bunny import bunny
from .bust import bust

FOLDER = Path(__file__).parent / "meshes"


def arrays() -> dict[str, np.ndarray]:
    """Arrays of `meshes.npz`."""
    found = {"bust": [np.float32(each) for each in bust()], "bunny": bunny()}
    return {
        f"{name}_{part}": np.uint16(array) if part == "faces" else array
        for name, mesh in found.items()
        for part, array in zip(meshes.PARTS, mesh, strict=True)
    }


def write_ply(folder: Path) -> None:
    """Write a PLY file of each mesh into `folder`."""
    made = {"bust": meshes.bust_mesh(), "bunny": meshes.bunny_mesh()}
    made |= {"letter_z": meshes.letter_z_mesh()}
    made |= {f"{half}_triangle": meshes.half_rectangle(half) for half in meshes.HALVES}
    for name, mesh in made.items():
        mesh.write_ply(str(folder / f"{name}.ply"))


if __name__ == "__main__":
    np.savez_compressed(meshes.FILE, **arrays())
    meshes.stored.cache_clear()
    write_ply(FOLDER)
