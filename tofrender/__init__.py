"""tofrender: light in flight on Mitsuba 3 and Dr.Jit.

Importing the package makes a Mitsuba variant active if none is: `cuda_ad_rgb` where CUDA works,
else `llvm_ad_rgb`. A variant that is set stays, and switching later works.

    import tofrender
    dataset = tofrender.render("cornell_box", spp=64)
    tofrender.save_exr_stack(dataset, "out")
"""

from __future__ import annotations

import importlib
import sys
from pathlib import PurePath
from typing import Any

from . import backend, withheld

__version__ = "0.1.0"

_HOMES = {
    "units": ("SPEED_OF_LIGHT", "ns_to_opl", "opl_to_ns"),
    "pulses": ("BoxPulse", "GaussianPulse", "SampledPulse"),
    "modulations": ("AMCWPulse", "HamiltonianCode", "MSequence", "SquareWave"),
    "lights": (
        "ConnectionsOnly",
        "EmitterHits",
        "GatedLights",
        "OneSampleLights",
        "OpenSky",
        "PointSource",
        "SceneLights",
    ),
    "loading": ("load_scene",),
    "rendering": ("render",),
    "integrators.amcw": ("render_amcw_phasor", "render_single_amcw"),
    "integrators.time_gated": ("render_at_time", "render_transient"),
    "scenes": (
        "bust_ao",
        "bust_simple",
        "cornell_box",
        "cornell_box_flash",
        "cornell_box_glass",
        "cornell_box_mirror",
        "cornell_box_steady_state",
        "nlos_bunny",
        "nlos_patch",
        "nlos_plane",
        "nlos_z",
        "ourbox_confocal",
        "rectangle_light_quad",
        "rectangle_light_triangles",
        "small_box",
        "sphere_light_large",
        "sphere_light_medium",
        "sphere_light_small",
        "veach",
        "wall_box_behind",
        "wall_box_hi_nlos",
        "wall_box_sphere_nlos",
        "wall_box_spheres_nlos",
    ),
    "io": (
        "load_capture",
        "load_exr_stack",
        "load_npz",
        "save_capture",
        "save_exr_stack",
        "save_npz",
        "save_png_frames",
        "save_video",
    ),
    "vis": (
        "light_in_flight",
        "phasor_panel",
        "plan_figure",
        "plot_pixel_transient",
        "reconstruction_figure",
        "summary_figure",
        "tonemap",
        "unwarp_camera",
        "visualize_transient",
    ),
    "relay_wall": ("find_relay_wall", "is_on_relay_wall"),
    "nlos": (
        "capture",
        "depth_error",
        "depth_map",
        "focus_laser",
        "hidden_depth",
        "make_capture",
        "max_projection",
        "reconstruct",
    ),
    "analysis": (
        "four_bucket",
        "from_four_bucket",
        "multipath_error",
        "phasor_parts",
        "sum_channels",
        "transient_to_phasor",
        "true_depth",
        "unambiguous_range",
        "unwrap",
    ),
}
_MODULE_OF = {name: module for module, names in _HOMES.items() for name in names}

_SUBMODULES = {
    *(name for name in _HOMES if "." not in name),
    "analysis",
    "doctor",
    "films",
    "phasors",
    "integrators",
    "sampling",
    "walk",
}

__all__ = sorted({*_MODULE_OF, *backend.PLUGINS, *_SUBMODULES, "__version__", "backend"})  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import what is asked for when it is asked for; plugin classes follow the active variant."""
    if name in backend.PLUGINS:
        return backend.plugin(name)
    if name in _SUBMODULES:
        return importlib.import_module(f".{name}", __name__)
    if name in _MODULE_OF:
        try:
            value = getattr(importlib.import_module(f".{_MODULE_OF[name]}", __name__), name)
        except withheld.Withheld as reason:
            raise withheld.of_name(__name__, name, reason) from None
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names, loaded or not."""
    return sorted({*globals(), *__all__})


def _is_command() -> bool:
    """Whether Python runs for the `tofrender` command, or for one of our modules by -m."""
    program = sys.argv[0] if sys.argv else ""
    if program != "-m":
        return PurePath(program).stem == "tofrender"
    options = sys.orig_argv
    return "-m" in options and options[options.index("-m") + 1].split(".")[0] == "tofrender"


# The command answers --help without Mitsuba, and activates a variant when it needs one.
if not _is_command():
    backend.activate()
