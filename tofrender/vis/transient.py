"""What the pictures are drawn from: a transient image, its time axis and its first pixel."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..rendering.dataset import DIMS, QUANTITIES, first_pixel, time_axis
from ..runtime import checks
from ..signals.colour import luminance
from ..signals.units import opl_to_ns


@dataclass
class Transient:
    """A transient image with its time axis and the index of its first pixel."""

    values: np.ndarray
    """(height, width, bins, channels), 1 or 3 channels."""
    start_opl: float
    bin_width_opl: float
    x0: int = 0
    y0: int = 0
    quantity: str = "radiance per bin"

    def __post_init__(self) -> None:
        """Refuse what no picture can be drawn of."""
        self.values = _cube("values", self.values)
        self.start_opl = checks.metres("start_opl", self.start_opl)
        self.bin_width_opl = checks.metres("bin_width_opl", self.bin_width_opl, positive=True)
        for name in ("x0", "y0"):
            checks.integer(name, getattr(self, name), -checks.MAX_SIZE, checks.MAX_SIZE)
        checks.instance("quantity", self.quantity, str, "text")

    @classmethod
    def of(
        cls,
        data: Any,
        start_opl: float | None = None,
        bin_width_opl: float | None = None,
        quantity: str | None = None,
    ):
        """Take a Dataset of `render`, or an array with its time axis, and check it."""
        extra: dict[str, Any] = {}
        if quantity is not None:
            extra["quantity"] = checks.one_of("quantity", quantity, QUANTITIES)
        if hasattr(data, "data_vars"):
            _require_labels(data)
            start, width = time_axis(data)
            start_opl = start if start_opl is None else start_opl
            bin_width_opl = width if bin_width_opl is None else bin_width_opl
            x0, y0 = first_pixel(data)
            units = re.sub(r"\^(-?\d+)", r"$^{\1}$", data.attrs["units"])
            named = f"{data.attrs['quantity']} [{units}]"
            extra = {"quantity": named} | extra | {"x0": x0, "y0": y0}
            data = data["transient"].values
        start = checks.metres("start_opl", start_opl)
        width = checks.metres("bin_width_opl", bin_width_opl, positive=True)
        return cls(_cube("data", data), start, width, **extra)

    @property
    def opl(self) -> np.ndarray:
        """Bin centres [m]."""
        return self.start_opl + (np.arange(self.values.shape[2]) + 0.5) * self.bin_width_opl

    def label(self, index: int) -> str:
        """Time and path length at the centre of bin `index`, with digits that tell bins apart."""
        opl = float(self.opl[index])
        width = self.bin_width_opl
        in_ns, in_m = (max(2, 1 - math.floor(math.log10(w))) for w in (opl_to_ns(width), width))
        return f"t = {opl_to_ns(opl):.{in_ns}f} ns   OPL = {opl:.{in_m}f} m"

    def pixel(self, x: Any, y: Any) -> np.ndarray:
        """Response (bins, channels) of pixel (x, y)."""
        height, width = self.values.shape[:2]
        column = checks.integer("x", x, self.x0, self.x0 + width - 1) - self.x0
        row = checks.integer("y", y, self.y0, self.y0 + height - 1) - self.y0
        return self.values[row, column]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top edge in pixels, for `imshow`."""
        height, width = self.values.shape[:2]
        return (self.x0 - 0.5, self.x0 + width - 0.5, self.y0 + height - 0.5, self.y0 - 0.5)

    def light(self) -> np.ndarray:
        """Luminance (height, width, bins) where it is finite and above 0, and 0 elsewhere."""
        light = luminance(self.values)
        return np.where(np.isfinite(light) & (light > 0), light, np.float32(0))

    def peak_ns(self, light: np.ndarray) -> np.ndarray:
        """Centre of the brightest bin [ns], (height, width); NaN where there is no light."""
        peak = opl_to_ns(self.opl)[light.argmax(axis=2)]
        return np.where(light.max(axis=2) > 0, peak, np.nan)


def _cube(name: str, data: Any) -> np.ndarray:
    """Real numbers as (height, width, bins, channels)."""
    values = checks.real_array(name, data)
    values = values[..., None] if values.ndim == 3 else values
    if values.ndim != 4 or values.shape[3] not in (1, 3) or 0 in values.shape:
        raise ValueError(
            f"{name} with shape {np.shape(data)}: must be (height, width, bins) or "
            "(height, width, bins, channels) with 1 or 3 channels last"
        )
    return values


def _require_labels(data: Any) -> None:
    """Refuse a Dataset without what `render` writes into it."""
    found = {str(name): variable.dims for name, variable in data.data_vars.items()}
    axes = DIMS["transient"]
    if found.get("transient") != axes or not set(axes) <= set(data.coords):
        raise ValueError(f"data = Dataset with {found}: must hold transient {axes}")
    for name in ("quantity", "units"):
        if not isinstance(data.attrs.get(name), str):
            raise ValueError(f"data: attribute {name} = {data.attrs.get(name)!r}: must be text")
