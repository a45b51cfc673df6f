"""Load a scene whose contributions are to have rates of change."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any, TypedDict

import mitsuba as mi

from ..integrators.amcw import in_time
from ..integrators.base import TransientIntegrator
from ..rendering.renderer import open_scene
from ..rendering.settings import RenderSettings
from ..runtime import backend, checks
from ..runtime.checkpoints import Checkpoint

FOLLOW = ("TransientPath", "TransientVolpath", "TransientLightTracer", "TransientBDPT")
"""Classes of integrators whose contributions have rates of change."""


class MovingSettings(TypedDict, total=False):
    """Arguments of `render` that renders of moving scenes take, too."""

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
    """Load a scene; returns it, its sensor, an integrator without pulse, and samples per pixel."""
    backend.require_unpolarised()
    scene, own = open_scene(settings)
    tracer: Any = in_time(own)
    checks.one_of("integrator", type(tracer).__name__, FOLLOW)
    checks.require(
        "pulse", tracer.pulse, tracer.pulse is None, "left out: each path has one length"
    )
    sensor = scene.sensors()[settings.sensor]
    spp = sensor.sampler().sample_count() if settings.spp is None else settings.spp
    return scene, sensor, tracer, spp


def separated(
    scene: object, settings: Mapping[str, Any], **more: Any
) -> tuple[RenderSettings, Checkpoint | None, bool]:
    """Check settings; returns those of the render, its checkpoint, and whether to show a bar."""
    unknown = [name for name in settings if name not in NAMES]
    if unknown:
        raise TypeError(f"{unknown[0]}: is no argument; must be one of {checks.join_names(NAMES)}")
    own = dict(settings)
    checkpoint = Checkpoint.of(own.pop("checkpoint", None))
    progress = checks.boolean("progress", own.pop("progress", True))
    return RenderSettings(scene, **own, **more), checkpoint, progress
