"""One EXR file of several named pictures."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..runtime import checks
from ..runtime.atomic import replacing


def save_exr_layers(
    path: str | os.PathLike,
    layers: Mapping[str, np.ndarray],
    attrs: Mapping[str, str | float | int] | None = None,
) -> Path:
    """Write pictures of one size as the layers of an EXR file.

    Args:
        path: The file, replaced whole if it exists.
        layers: Pictures by name, shape (height, width, channels) with 1 or 3 channels. The name
            "" has the plain channels R, G, B or Y that every viewer shows.
        attrs: Attributes of the header.

    Returns:
        `path`.

    Raises:
        ValueError: There are no layers, their sizes differ, or no path; one line.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = save_exr_layers(folder + "/a.exr", {"I": np.zeros((2, 3, 3))})
        ...     file.name
        'a.exr'
    """
    import OpenEXR

    target = checks.path("path", path)
    sizes = {np.shape(values)[:2] for values in layers.values()}
    if len(sizes) != 1:
        raise ValueError(f"layers: have the sizes {sorted(sizes)}; must be one size")
    channels = {}
    for name, values in layers.items():
        array = np.asarray(values, dtype=np.float32)
        for c, letter in enumerate("RGB" if array.shape[2] == 3 else "Y"):
            channel = f"{name}.{letter}" if name else letter
            channels[channel] = np.ascontiguousarray(array[:, :, c])
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "format": "tofrender layers 1",
        **{name: str(value) for name, value in (attrs or {}).items()},
    }
    with replacing(target) as temporary:
        OpenEXR.File(header, channels).write(str(temporary))
    return target
