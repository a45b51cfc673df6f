"""Problem a2.amcw_path: images of a correlation sensor, and phasors."""

# ruff: noqa: F401 (imported for what you will write)

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from amcw_pulse import AMCWPulse


class AMCWTransientPath(mi.SamplingIntegrator):
    """Path tracer for amplitude-modulated light. Start from `PathTracer` in `path_tracer.py`.

    Every contribution of a path is weighted by m(opl), the modulation at its length: the value is
    the integral of L(opl) m(opl) over all lengths, which can be negative.

    | parameter | default | meaning |
    |---|---|---|
    | `max_depth` | 8 | longest path in segments: 1 shows emitters only, 2 adds direct light |
    | `rr_depth` | 5 | surface vertices from which on Russian roulette may end a path |
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.max_depth = props.get("max_depth", 8)
        self.rr_depth = props.get("rr_depth", 5)
        self.modulation: Any = None

    def set_modulation(self, modulation: Any) -> None:
        """Set the modulation: an `AMCWPulse`, or any object with a method `eval(opl)`."""
        self.modulation = modulation

    def sample(self, scene, sampler, ray, medium=None, active=True, origin=None):
        """Estimate the correlation value along rays.

        Args:
            scene: The scene.
            sampler: Random numbers.
            ray: Camera rays.
            medium: Ignored.
            active: Lanes to trace.
            origin: Points where lengths start; by default the origins of the rays.

        Returns:
            Spectrum, mask of the lanes that hit a surface, and an empty list.
        """
        raise NotImplementedError("a2.amcw_path: AMCWTransientPath.sample")


def render_single_amcw(
    scene: mi.Scene, integrator: AMCWTransientPath, sensor: mi.Sensor, spp: int = 64, seed: int = 0
) -> np.ndarray:
    """Render one correlation image.

    Args:
        scene: The scene.
        integrator: The integrator, with its modulation set.
        sensor: The camera; its film defines the number of pixels. The filter is a box.
        spp: Samples per pixel.
        seed: Seed of the random numbers; the same seed gives the same paths.

    Returns:
        Float32 array of shape (height, width, 3).
    """
    raise NotImplementedError("a2.amcw_path: render_single_amcw")


def render_amcw_phasor(
    scene: mi.Scene, sensor: mi.Sensor, frequency_hz: float, spp: int = 64, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Render the phasor P = Σ L exp(+i 2π f opl/c) of every pixel, I and Q from the same paths.

    Args:
        scene: The scene.
        sensor: The camera; its film defines the number of pixels.
        frequency_hz: Modulation frequency f [Hz].
        spp: Samples per pixel.
        seed: Seed of the random numbers.

    Returns:
        I = Re P, Q = Im P, amplitude |P|, phase in (-π, π] [rad], and depth, half the path length
        that follows from the phase, in [0, c/2f) [m]. Five arrays of shape (height, width, 3).
    """
    raise NotImplementedError("a2.amcw_path: render_amcw_phasor")
