"""EXR file with several named layers."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..runtime import checks
from ..runtime.atomic import check_file, replacing


def save_exr_layers(
    path: str | os.PathLike,
    layers: Mapping[str, np.ndarray],
    attrs: Mapping[str, str | float | int] | None = None,
) -> Path:
    """Write pictures of one size as the layers of an EXR file.

    Args:
        path: File name; an existing file is replaced.
        layers: Pictures by name, shape (height, width, channels) with 1 or 3 channels. The name
            "" stands for the channels R, G, B or Y that every viewer shows.
        attrs: Attributes of the header.

    Raises:
        ValueError: There are no layers, or their sizes differ.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = save_exr_layers(folder + "/a.exr", {"I": np.zeros((2, 3, 3))})
        ...     file.name
        'a.exr'
    """
    import OpenEXR

    attrs = checks.mapping("attrs", attrs)
    arrays = {
        name: checks.real_array(f"layers[{name!r}]", values, np.float32)
        for name, values in checks.mapping("layers", layers).items()
    }
    for name, array in arrays.items():
        if array.ndim != 3 or array.shape[2] not in (1, 3) or 0 in array.shape:
            allowed = "must be (height, width, channels) with 1 or 3 channels"
            raise ValueError(f"layers[{name!r}] with shape {array.shape}: {allowed}")
    sizes = {array.shape[:2] for array in arrays.values()}
    if len(sizes) != 1:
        given = checks.quote(layers)
        raise ValueError(f"layers = {given}: have the sizes {sorted(sizes)}; must be one size")
    needed = sum(array.nbytes for array in arrays.values())
    target = check_file(path, overwrite=True, needed_bytes=needed)
    channels = {}
    for name, array in arrays.items():
        prefix = f"{name}." if name else ""
        for c, letter in enumerate("RGB" if array.shape[2] == 3 else "Y"):
            channels[prefix + letter] = np.ascontiguousarray(array[:, :, c])
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= {"format": "tofrender layers 1", **{k: str(value) for k, value in attrs.items()}}
    with replacing(target) as temporary:
        OpenEXR.File(header, channels).write(str(temporary))
    return target
