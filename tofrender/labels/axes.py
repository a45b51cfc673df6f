"""Axes of Datasets: time bins, and the order of channels and Stokes components."""

from dataclasses import dataclass

import numpy as np

CHANNELS = ("R", "G", "B", "L")
"""Names of channels in their order. "L" is the only channel of a monochrome film."""

STOKES = ("S0", "S1", "S2", "S3")
"""Names of the components of the Stokes vector in their order."""

XYZ = ("x", "y", "z")
"""Axes of the world in their order."""

PARTS = ("I", "Q")
"""Parts of a phasor in their order."""

WEIGHTINGS = ("mis", "none")
"""Weights of the strategies of bidirectional path tracing, in their order."""


@dataclass(frozen=True)
class Bins:
    """Equally wide time bins without gaps.

    Bin k covers the path lengths from `start_opl + k bin_width_opl` to
    `start_opl + (k + 1) bin_width_opl`.

    Example:
        >>> bins = Bins(start_opl=3.0, bin_width_opl=0.5, count=4)
        >>> bins.stop_opl, bins.centers_opl.tolist()
        (5.0, [3.25, 3.75, 4.25, 4.75])
    """

    start_opl: float  # start of the first bin [m]
    bin_width_opl: float  # [m]
    count: int

    @property
    def stop_opl(self) -> float:
        """End of the last bin [m]."""
        return self.start_opl + self.count * self.bin_width_opl

    @property
    def edges_opl(self) -> np.ndarray:
        """Edges of the bins [m], float64 (count + 1)."""
        return self.start_opl + np.arange(self.count + 1) * self.bin_width_opl

    @property
    def centers_opl(self) -> np.ndarray:
        """Centers of the bins [m], float64 (count)."""
        return self.start_opl + (np.arange(self.count) + 0.5) * self.bin_width_opl
