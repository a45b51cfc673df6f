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
from ..runtime import checks
from ..runtime.atomic import part_path
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
    scene, own = open_scene(settings)
    tracer: Any = in_time(own)
    checks.one_of("integrator", type(tracer).__name__, FOLLOW)
    checks.require(
        "pulse", tracer.pulse, tracer.pulse is None, "left out: each path has one length"
    )
    sensor = scene.sensors()[settings.sensor]
    spp = sensor.sampler().sample_count() if settings.spp is None else settings.spp
    return scene, sensor, tracer, spp


class Keeping:
    """Seed, checkpoint and progress bar of a render, as `render_all` takes them."""

    def __init__(self, seed: int, checkpoint: Any, progress: bool) -> None:
        self.seed, self.progress = seed, checks.boolean("progress", progress)
        self.checkpoint = Checkpoint.of(checkpoint)

    def of_part(self, number: int | None = None) -> tuple[int, Checkpoint | None, bool]:
        """Return them; one of several renders has its number in the checkpoint's name."""
        own = self.checkpoint
        if own is not None and number is not None:
            path = part_path(own.path, number)
            own = Checkpoint(path, own.seconds, own.tell, own.again, own.resume)
        return self.seed, own, self.progress


def separated(
    scene: object, settings: Mapping[str, Any], **more: Any
) -> tuple[RenderSettings, Keeping]:
    """Check settings, and return those of the render and those of its progress."""
    unknown = [name for name in settings if name not in NAMES]
    if unknown:
        raise TypeError(f"{unknown[0]}: is no argument; must be one of {checks.join_names(NAMES)}")
    own = {
        name: value for name, value in settings.items() if name not in ("checkpoint", "progress")
    }
    wanted = RenderSettings(scene, **own, **more)
    progress = settings.get("progress", True)
    return wanted, Keeping(wanted.seed, settings.get("checkpoint"), progress)
