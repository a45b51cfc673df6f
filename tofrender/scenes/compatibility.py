"""Translate names in scene files of mitransient and its course fork into those of this package."""

import warnings
from typing import Any

from ..runtime import checks
from ..runtime.plugins import limit_depth

TIME_SAMPLINGS = ("stratified", "random")


def translate_names(state: Any) -> None:
    """Replace names by this package's where they mean the same, and refuse others.

    `timegated_transient_path`, whose gates fill the bins of a film, becomes the `transient_path`
    around the same `confocal_projector`; `transient_prbvolpath` becomes `transient_volpath`;
    `nlos_confocal` of a `transient_nlos_path` its `capture_type`.
    """
    for node in state.nodes:
        name = node.props.plugin_name()
        if name == "timegated_transient_path":
            _gate_all_bins(node.props)
        elif name == "transient_prbvolpath":
            limit_depth(node.props)
            node.props.set_plugin_name("transient_volpath")
        elif name == "transient_nlos_path" and "nlos_confocal" in node.props:
            _set_capture_type(node.props)


def _gate_all_bins(props: Any) -> None:
    if "confocal_projector" not in props:
        raise ValueError(
            "integrator = 'timegated_transient_path': has no confocal_projector; must have one, or "
            "be transient_path, or time_gated_transient_path for a single gate"
        )
    if "time_sampling" in props:
        given = checks.one_of("time_sampling", props["time_sampling"], TIME_SAMPLINGS)
        del props["time_sampling"]
        text = f"time_sampling = {given!r}: has no effect; every path counts in all bins"
        warnings.warn(text, stacklevel=5)
    limit_depth(props)
    props.set_plugin_name("transient_path")


def _set_capture_type(props: Any) -> None:
    confocal = checks.boolean("nlos_confocal", props["nlos_confocal"])
    del props["nlos_confocal"]
    if "capture_type" in props:
        raise ValueError(f"nlos_confocal = {confocal}: must be left out; capture_type is given")
    props["capture_type"] = "confocal" if confocal else "single"
    if confocal:
        warnings.warn(
            "nlos_confocal = True: is capture_type = 'confocal'; the light is scaled by the "
            "emitter's irradiance at each lit point (or laser_power), not by 1",
            stacklevel=5,
        )
