"""Problem a2.time_gated: the scene at one instant, and at many."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from gaussian_pulse import GaussianPulse


class TimeGatedTransientPath(mi.SamplingIntegrator):
    """Path tracer for one instant. Start from `PathTracer` in `path_tracer.py`.

    Every contribution of a path, by a connection or by an emitter that a ray hits, is weighted by
    p(target_time - opl), where p is the light's pulse and opl the path's length. The value is a
    radiance per meter; the sum over gates times their spacing is the steady-state image.

    Lengths are sums of distances between the points of a path, from the emitter to the sensor.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 8 | longest path in segments: 1 shows emitters only, 2 adds direct light |
    | `rr_depth` | 5 | surface vertices from which on Russian roulette may end a path |
    | `pulse_width_opl` | 0.03 | standard deviation of the pulse [m] |

    Attributes:
        pulse: A `GaussianPulse`. It may be set to any object with the same methods and `support`,
            which need not be symmetric.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_depth = props.get("max_depth", 8)
        self.rr_depth = props.get("rr_depth", 5)
        self.pulse: Any = GaussianPulse(props.get("pulse_width_opl", 0.03))

    def sample(self, scene, sampler, ray, target_time, medium=None, active=True, origin=None):
        """Estimate the radiance per meter along rays at one instant.

        Args:
            scene: The scene.
            sampler: Random numbers.
            ray: Camera rays.
            target_time: Path length of the gate [m].
            medium: Ignored.
            active: Lanes to trace.
            origin: Points where lengths start; by default the origins of the rays. (Camera rays
                start at the near plane, not at the camera, so `render_at_time` has to pass it.)

        Returns:
            Spectrum [1/m], mask of the lanes that hit a surface, and an empty list.
        """
        raise NotImplementedError("a2.time_gated: TimeGatedTransientPath.sample")


def render_at_time(
    scene: mi.Scene,
    integrator: TimeGatedTransientPath,
    sensor: mi.Sensor,
    target_time: float,
    spp: int = 64,
    seed: int = 0,
) -> np.ndarray:
    """Render the scene at one instant.

    `tofrender.paths.camera.sample_camera(sensor, film, sampler, pixel)` makes a random ray through
    each of the given pixels (indices, row by row), and returns the point where its length starts.

    Args:
        scene: The scene.
        integrator: The integrator, with its pulse.
        sensor: The camera; its film defines the number of pixels. The filter is a box.
        target_time: Path length of the gate [m].
        spp: Samples per pixel.
        seed: Seed of the random numbers; a different seed gives different paths.

    Returns:
        Radiance per meter, float32 array of shape (height, width, 3).
    """
    raise NotImplementedError("a2.time_gated: render_at_time")


def render_transient(
    scene: mi.Scene,
    integrator: TimeGatedTransientPath,
    sensor: mi.Sensor,
    film_config: Mapping[str, Any],
    spp: int = 64,
    seed: int = 0,
) -> np.ndarray:
    """Render many instants: gates at the centers of time bins.

    All gates use the same paths, which need to be traced only once. Each gate weights a
    contribution by its own time.

    Args:
        scene: The scene.
        integrator: The integrator, with its pulse.
        sensor: The camera; its film defines the number of pixels.
        film_config: `temporal_bins`, the number T of gates; `start_opl` [m], start of the first
            bin; `bin_width_opl` [m], their spacing. Gate k is at
            start_opl + (k + 1/2) bin_width_opl.
        spp: Samples per pixel.
        seed: Seed of the random numbers.

    Returns:
        Radiance per meter, float32 array of shape (height, width, T, 3).
    """
    raise NotImplementedError("a2.time_gated: render_transient")
