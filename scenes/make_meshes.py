"""Write the files of the built-in scenes' meshes: `python -m scenes.make_meshes`.

The package reads the bust and the bunny from `tofrender/scenes/meshes.npz`. XML scenes read PLY
files from `scenes/meshes`. The bunny is stored in double precision because scenes transform it; the
bust is stored in single precision.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tofrender.scenes import meshes

from .bunny import bunny
from .bust import bust

FOLDER = Path(__file__).parent / "meshes"


def arrays() -> dict[str, np.ndarray]:
    """Compute the arrays of `meshes.npz`, by name."""
    computed = {"bust": [np.float32(each) for each in bust()], "bunny": bunny()}
    return {
        f"{name}_{part}": np.uint16(array) if part == "faces" else array
        for name, mesh in computed.items()
        for part, array in zip(meshes.PARTS, mesh, strict=True)
    }


def write_ply(folder: Path) -> None:
    """Write a PLY file of each mesh to `folder`."""
    by_name = {
        "bust": meshes.bust_mesh(),
        "bunny": meshes.bunny_mesh(),
        "letter_z": meshes.letter_z_mesh(),
    }
    by_name |= {f"{half}_triangle": meshes.half_rectangle(half) for half in meshes.HALVES}
    for name, mesh in by_name.items():
        mesh.write_ply(str(folder / f"{name}.ply"))


if __name__ == "__main__":
    np.savez_compressed(meshes.FILE, **arrays())
    meshes.stored.cache_clear()
    write_ply(FOLDER)
