"""Load scenes for renders with rates of change of path lengths."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any, TypedDict

import mitsuba as mi

from ..integrators.amcw import with_phasors
from ..integrators.base import TransientIntegrator
from ..rendering.renderer import open_scene
from ..rendering.settings import RenderSettings
from ..runtime import checks, variants
from ..runtime.checkpoints import Checkpoint
from ..runtime.parameters import require_names

SUPPORTED = ("TransientPath", "TransientVolpath", "TransientLightTracer", "TransientBDPT")
"""Classes of integrators that compute rates of change of path lengths."""


class MovingSettings(TypedDict, total=False):
    """Arguments of `render` that renders of moving scenes support too."""

    spp: int | None
    seed: int
    size: tuple[int, int] | None
    max_depth: int | None
    integrator: str | Mapping[str, object] | mi.Integrator | None
    sensor: int
    define: Mapping[str, object] | None
    checkpoint: Checkpoint | str | PathLike[str] | None
    progress: bool


NAMES = tuple(MovingSettings.__annotations__)


def open_moving(settings: RenderSettings) -> tuple[mi.Scene, mi.Sensor, TransientIntegrator, int]:
    """Load a scene for a render with rates of change.

    Returns:
        The scene, its sensor, an integrator without pulse, and the number of samples per pixel.

    Raises:
        ValueError: If the integrator is not supported or has a pulse.
    """
    # The scene, and its integrator or the transient integrator with the same paths
    variants.require_unpolarized()
    scene, integrator = open_scene(settings)
    tracer: Any = with_phasors(integrator)
    checks.one_of("integrator", type(tracer).__name__, SUPPORTED)
    checks.require(
        "pulse", tracer.pulse, tracer.pulse is None, "omitted, because pulses are not supported"
    )

    # The sensor, with the sample count of the scene by default
    sensor = scene.sensors()[settings.sensor]
    spp = sensor.sampler().sample_count() if settings.spp is None else settings.spp
    return scene, sensor, tracer, spp


def split_settings(
    function: str,
    scene: mi.Scene | Mapping[str, object] | str | PathLike[str],
    settings: Mapping[str, Any],
    **time_axis: Any,
) -> tuple[RenderSettings, Checkpoint | None, bool]:
    """Check the settings of a user, and split them.

    Args:
        function: Name of the function that the user called.
        scene: The scene.
        settings: Settings of `MovingSettings`.
        **time_axis: Settings of `RenderSettings` for the time axis.

    Returns:
        The settings of the render, the checkpoint, and whether a progress bar is shown.
    """
    require_names(function, settings, NAMES)
    remaining = dict(settings)
    checkpoint = Checkpoint.of(remaining.pop("checkpoint", None))
    progress = checks.boolean("progress", remaining.pop("progress", True))
    return RenderSettings(scene, **remaining, **time_axis), checkpoint, progress
