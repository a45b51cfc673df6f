"""Files: EXR stacks, NumPy archives, PNG frames and videos, each written whole or not at all."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy import names_of

if TYPE_CHECKING:
    from .atomic import replacing
    from .exr import load_exr_stack, save_exr_stack
    from .hdf5 import load_capture, save_capture
    from .layers import save_exr_layers
    from .npz import load_npz, save_npz
    from .output import check_output, output_folder
    from .pictures import save_png_frames, save_video

__all__ = [
    "check_output",
    "load_capture",
    "load_exr_stack",
    "load_npz",
    "output_folder",
    "replacing",
    "save_capture",
    "save_exr_layers",
    "save_exr_stack",
    "save_npz",
    "save_png_frames",
    "save_video",
]

__getattr__, __dir__ = names_of(
    __name__,
    {
        "atomic": ("replacing",),
        "exr": ("load_exr_stack", "save_exr_stack"),
        "hdf5": ("load_capture", "save_capture"),
        "layers": ("save_exr_layers",),
        "npz": ("load_npz", "save_npz"),
        "output": ("check_output", "output_folder"),
        "pictures": ("save_png_frames", "save_video"),
    },
)
