"""y-tal: reconstruction from captures."""

from __future__ import annotations

import numpy as np

INSTALL = "pip install 'numpy<2' y-tal==0.20.0, in an environment of its own"
ABILITIES = frozenset({"locate"})


def version() -> str:
    from importlib.metadata import PackageNotFoundError, version as number

    try:
        return f"y-tal {number('y-tal')}"
    except PackageNotFoundError as error:
        raise ImportError("y-tal is not installed") from error


def render(scene: dict, bins: dict, samples: int, seed: int) -> np.ndarray:
    """Return the center of the brightest voxel of `tal.reconstruct.bp`."""
    import tal
    from tal.enums import GridFormat, HFormat, VolumeFormat

    # Transpose to axes x, y
    count = bins["count"]
    grid = np.array(scene["grid"])
    opl = np.array(scene["opl"]).T
    light = np.array(scene["light"]).T

    # Make a capture
    data = tal.io.capture_data.NLOSCaptureData()
    data.H = np.zeros((count, *opl.shape), np.float32)  # Time first
    k = ((opl - bins["start"]) / bins["width"]).astype(int)
    x, y = np.indices(k.shape)
    data.H[k, x, y] = light
    data.H_format = HFormat.T_Sx_Sy
    points = np.stack([grid[x], grid[y], 0 * opl], axis=-1).astype(np.float32)
    data.sensor_grid_xyz = data.laser_grid_xyz = points
    normals = np.broadcast_to((0.0, 0.0, 1.0), points.shape)
    data.sensor_grid_normals = data.laser_grid_normals = normals
    data.sensor_grid_format = data.laser_grid_format = GridFormat.X_Y_3
    data.sensor_xyz = data.laser_xyz = np.zeros(3)
    data.delta_t = bins["width"]
    data.t_start = bins["start"]
    data.t_accounts_first_and_last_bounces = False

    # Reconstruct
    axes = [np.linspace(low, high, int(n)) for low, high, n in scene["volume"]]
    volume = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    found = tal.reconstruct.bp.solve(
        data, volume_xyz=volume, volume_format=VolumeFormat.X_Y_Z_3, progress=False
    )
    return volume.reshape(-1, 3)[np.argmax(np.abs(found))][None, None]
