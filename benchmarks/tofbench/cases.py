"""Cases: scenes with known results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Case:
    """Scene with a known result.

    Attributes:
        name: Name of letters, digits and hyphens.
        title: Subject of the test, for the table.
        form: Formula and its source.
        scene: Description of the scene, see README.md.
        bins: Measured `quantity` and its parameters, see README.md.
        exact: Function that computes the expected numbers, for the mean of the film (numbers,) or
            for each pixel (height, width, numbers).
        needs: Abilities that are needed in addition to the quantity.
        whole: Whether the bins contain all light. Then the sum tests a steady renderer.
        readings: Weights of the numbers that are compared, (readings, numbers). If this is None,
            neighboring bins are grouped.
        steady_readings: Weights for the sums over time.
        samples: Samples per pixel of one run.
        rounding: Standard error of rounding relative to a reading. A tenth of it is relative to all
            light.
        standard_error: Function that computes the standard error of the expected numbers, for
            references.
    """

    name: str
    title: str
    form: str
    scene: dict
    bins: dict
    exact: Callable[[], np.ndarray]
    needs: tuple[str, ...] = ()
    whole: bool = True
    readings: np.ndarray | None = None
    steady_readings: np.ndarray | None = None
    samples: int = 8192
    rounding: float = 3e-4
    standard_error: Callable[[], np.ndarray] | None = None

    @cached_property
    def expected(self) -> np.ndarray:
        """Expected numbers."""
        return np.asarray(self.exact(), float)

    @cached_property
    def error(self) -> np.ndarray | None:
        """Standard error of the expected numbers; None for closed forms."""
        return None if self.standard_error is None else np.asarray(self.standard_error(), float)

    @property
    def pixels(self) -> tuple[int, int]:
        """Height and width of the result."""
        camera = self.scene["camera"]
        if "crop" in camera:
            return camera["crop"][3], camera["crop"][2]
        return camera["height"], camera["width"]

    @property
    def features(self) -> set[str]:
        """Abilities that the scene needs, without the quantity."""
        by_camera = self.scene["camera"].get("kind") == "perspective"
        return {*self.needs, *(["camera"] if by_camera and "half-space" not in self.needs else [])}

    def missing(self, abilities: frozenset[str]) -> set[str]:
        """Return the abilities that a renderer lacks for this case."""
        return ({self.bins["quantity"]} | self.features) - abilities

    def form_for(self, abilities: frozenset[str]) -> Case | None:
        """Return the case in a form that a renderer supports.

        This is the case itself, its sum over time, its delays, or None.
        """
        if not self.missing(abilities):
            return self
        if self.bins["quantity"] != "bins":
            return None

        # Compare the sum over time
        if "steady" in abilities and self.whole and self.features <= abilities:
            return replace(
                self,
                bins={"quantity": "steady"},
                exact=lambda: self.expected.sum(axis=-1, keepdims=True),
                standard_error=self.standard_error
                and (lambda: np.sqrt((self.error**2).sum(axis=-1, keepdims=True))),
                readings=self.steady_readings,
            )

        # Compare the delays
        if "delays" in abilities and "room" in self.scene and {*self.needs} <= abilities:
            return replace(
                self,
                bins=self.bins | {"quantity": "delays"},
                exact=lambda: (self.expected > 0).astype(float),
            )
        return None

    def request(self, runs: int, samples: float) -> dict:
        """Return the request to the process of an adapter, for JSON."""
        count = max(16, int(self.samples * samples))
        parts = {"scene": self.scene, "bins": self.bins, "runs": runs}
        return {"name": self.name, "samples": count} | parts
