"""What a case is, and the list of all cases."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Case:
    """A scene with a known result.

    Attributes:
        name: Of letters, digits and hyphens.
        title: What it tests, for the table.
        form: The formula and its source.
        scene: See README.md.
        bins: What is measured: `quantity` and its parameters, see README.md.
        exact: Computes the expected numbers: of the film's mean (numbers,), or of each pixel
            (height, width, numbers).
        needs: Abilities besides the quantity.
        whole: Whether the bins hold all light, so that a steady renderer can be tested by its sum.
        readings: Weights of the numbers that are compared, (readings, numbers); None: groups.
        steady_readings: The same for the sums over time.
        samples: Samples per pixel of one run.
        rounding: Standard error of rounding, relative to a reading, and 0.1 of it to all light.
        standard_error: Computes the standard error of the expected numbers, for references.
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
        return np.asarray(self.exact(), float)

    @cached_property
    def error(self) -> np.ndarray | None:
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
        """Abilities that the scene needs."""
        by_camera = self.scene["camera"].get("kind") == "perspective"
        return {*self.needs, *(["camera"] if by_camera and "half-space" not in self.needs else [])}

    def missing(self, abilities: frozenset[str]) -> set[str]:
        """What a renderer would need besides."""
        return ({self.bins["quantity"]} | self.features) - abilities

    def form_for(self, abilities: frozenset[str]) -> Case | None:
        """The case as a renderer can do it: itself, its sum over time, its delays, or None."""
        if not self.missing(abilities):
            return self
        if self.bins["quantity"] != "bins":
            return None
        if "steady" in abilities and self.whole and self.features <= abilities:
            return replace(
                self,
                bins={"quantity": "steady"},
                exact=lambda: self.expected.sum(axis=-1, keepdims=True),
                standard_error=self.standard_error
                and (lambda: np.sqrt((self.error**2).sum(axis=-1, keepdims=True))),
                readings=self.steady_readings,
            )
        if "delays" in abilities and "room" in self.scene and {*self.needs} <= abilities:
            return replace(
                self,
                bins=self.bins | {"quantity": "delays"},
                exact=lambda: (self.expected > 0).astype(float),
            )
        return None

    def request(self, runs: int, samples: float) -> dict:
        """What an adapter's process gets, as JSON."""
        count = max(16, int(self.samples * samples))
        parts = {"scene": self.scene, "bins": self.bins, "runs": runs}
        return {"name": self.name, "samples": count} | parts
