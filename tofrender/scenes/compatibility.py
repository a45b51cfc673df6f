"""Translate plugin names of mitransient and its course fork in scene files to this package's."""

import warnings
from typing import Any

from ..runtime import checks
from ..runtime.plugins import limit_depth

TIME_SAMPLINGS = ("stratified", "random")


def translate_names(state: Any) -> None:
    """Replace names in a parsed scene by this package's equivalents.

    - `timegated_transient_path` with a `confocal_projector` becomes `transient_path` with the same
      projector. Its gates fill the bins of a film, so the result is the same.
    - `transient_prbvolpath` becomes `transient_volpath`.
    - The parameter `nlos_confocal` of a `transient_nlos_path` becomes `capture_type`.

    Raises:
        ValueError: If a node has no equivalent.
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
    """Replace `timegated_transient_path` by `transient_path`."""
    if "confocal_projector" not in props:
        raise ValueError(
            "integrator = 'timegated_transient_path': only supported with a confocal_projector. "
            "Use transient_path for a film with bins, or time_gated_transient_path for one gate"
        )
    if "time_sampling" in props:
        sampling = checks.one_of("time_sampling", props["time_sampling"], TIME_SAMPLINGS)
        del props["time_sampling"]
        text = (
            f"time_sampling = {sampling!r}: ignored, because every path contributes to all bins. "
            "Remove it"
        )
        warnings.warn(text, stacklevel=5)
    limit_depth(props)
    props.set_plugin_name("transient_path")


def _set_capture_type(props: Any) -> None:
    """Replace the parameter `nlos_confocal` by `capture_type`."""
    confocal = checks.boolean("nlos_confocal", props["nlos_confocal"])
    del props["nlos_confocal"]
    if "capture_type" in props:
        raise ValueError(
            f"nlos_confocal = {confocal}: capture_type is given too. Remove nlos_confocal"
        )
    props["capture_type"] = "confocal" if confocal else "single"
    if confocal:
        warnings.warn(
            "nlos_confocal = True: replaced by capture_type = 'confocal'. The light is scaled by "
            "the emitter's irradiance at each lit point (or laser_power), not by 1",
            stacklevel=5,
        )
