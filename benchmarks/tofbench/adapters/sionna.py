"""Sionna RT: delays of specular paths between two antennas."""

from __future__ import annotations

from functools import cache

import numpy as np

INSTALL = "pip install sionna-rt"
ABILITIES = frozenset({"delays", "mirror"})
LIGHT_M_S = 299_792_458.0


def version() -> str:
    from importlib.metadata import PackageNotFoundError, version as number

    try:
        return f"sionna-rt {number('sionna-rt')}"
    except PackageNotFoundError as error:
        raise ImportError("sionna-rt is not installed") from error


def _wall(name: str, shape: dict) -> str:
    u = np.array(shape["u"], float)
    v = np.array(shape["v"], float)
    normal = np.cross(u, v)
    matrix = np.eye(4)
    matrix[:3] = np.stack([u, v, normal / np.linalg.norm(normal), shape["center"]], axis=1)
    values = " ".join(map(str, matrix.ravel()))
    place = f'<transform name="to_world"><matrix value="{values}"/></transform>'
    return f'<shape type="rectangle" id="{name}">{place}<ref id="metal" name="bsdf"/></shape>'


@cache
def _load(walls: str, source: tuple, receiver: tuple):
    import sionna.rt as rt

    metal = '<string name="type" value="metal"/><float name="thickness" value="0.01"/>'
    metal = f'<bsdf type="itu-radio-material" id="metal">{metal}</bsdf>'
    scene = rt.load_scene_from_string(f'<scene version="2.1.0">{metal}{walls}</scene>')
    antenna = {"num_rows": 1, "num_cols": 1, "pattern": "iso", "polarization": "V"}
    scene.tx_array = scene.rx_array = rt.PlanarArray(**antenna)
    scene.add(rt.Transmitter("source", list(source)))
    scene.add(rt.Receiver("receiver", list(receiver)))
    return scene


def render(scene: dict, bins: dict, samples: int, seed: int) -> np.ndarray:
    """Return 1 in bins with the delay of a path, otherwise 0. The floor is omitted."""
    import sionna.rt as rt

    # Load the walls
    shapes = scene["shapes"].items()
    walls = "".join(_wall(k, w) for k, w in shapes if w["material"]["kind"] == "mirror")
    room = scene["room"]
    loaded = _load(walls, tuple(room["source"]), tuple(room["receiver"]))

    # Find the paths
    kinds = {"los": True, "specular_reflection": True, "diffuse_reflection": False}
    paths = rt.PathSolver()(loaded, max_depth=1, refraction=False, seed=seed + 1, **kinds)
    lengths = np.array(paths.tau).ravel()[np.array(paths.valid).ravel()] * LIGHT_M_S
    edges = bins["start"] + bins["width"] * np.arange(bins["count"] + 1)
    return (np.histogram(lengths + room["extra_opl"], edges)[0] > 0).astype(float)[None, None]
