"""Results of pilots, kept for later renders of the same scene.

A pilot traces photons with fixed random numbers before a render. Frames of a still scene, batches
of samples, tiles, and repeated renders need the same pilot. Its result is stored under a key that
contains a hash of the current content of the scene and the sensor. The scene object itself is not
suitable as a key, because its parameters may change in place. The expected value of a picture would
not depend on the result of an older pilot, but its noise would depend on earlier renders.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeVar

import mitsuba as mi

from ..runtime.backend import tracing_lock
from ..scenes.fingerprint import content_digest

R = TypeVar("R")

# Number of results that are kept. A result may need a few MB
MOST_RESULTS = 8

# Results by key. The result that was used last comes last
_results: dict[tuple, Any] = {}


class Pilots:
    """Pilots of a scene and a sensor in their current state.

    Args:
        scene: The scene.
        sensor: The sensor.
    """

    def __init__(self, scene: mi.Scene, sensor: mi.Sensor) -> None:
        self.scene = scene
        self.sensor = sensor

    @cached_property
    def content(self) -> str:
        """Hash of the current content of the scene and the sensor, computed at the first use."""
        return content_digest(self.scene, self.sensor)

    @tracing_lock()
    def result(self, trace: Callable[[], R], *settings: Any) -> R:
        """Return the stored result of a pilot, or trace the pilot and store its result.

        Args:
            trace: Function that traces the pilot. It must return NumPy arrays instead of arrays of
                Dr.Jit, which would stay in memory until Python ends.
            settings: Name of the pilot, and all values except the scene and the sensor that its
                result depends on.
        """
        # Trace the pilot if its result is not stored
        key = (mi.variant(), self.content, *settings)
        result = _results.pop(key) if key in _results else trace()

        # Store the result as the last one, and drop the oldest results
        _results[key] = result
        while len(_results) > MOST_RESULTS:
            del _results[next(iter(_results))]
        return result
