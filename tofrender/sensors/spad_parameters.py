"""Parameters of SPAD arrays, and their checks."""

from dataclasses import dataclass
from typing import Any

from ..runtime import checks
from .response import distribution

MODES = ("first_photon", "multi_hit", "free_running")


@dataclass(frozen=True, kw_only=True)
class SpadParameters:
    """Parameters of a SPAD array, see `Spad`."""

    mode: str = "first_photon"
    dead_time_s: float = 0.0
    paralysable: bool = False
    afterpulse_probability: float = 0.0
    afterpulse_time_s: float = 0.0
    crosstalk_probability: float = 0.0
    jitter: Any = None
    tdc_bits: int | None = None
    tdc_lsb_s: float | None = None
    tdc_dnl: float = 0.0
    macro_pixel: tuple[int, int] = (1, 1)
    coincidence: int = 1
    coincidence_window_s: float = 0.0
    hot_fraction: float = 0.0
    hot_rate_hz: float = 0.0
    device_seed: int = 0

    def __post_init__(self) -> None:
        # Check the numbers
        seconds = {"unit": "seconds", "low": 0, "high": 1}
        part = {"low": 0, "high": 0.9}
        limits: dict[str, Any] = {
            "dead_time_s": seconds,
            "afterpulse_time_s": seconds,
            "tdc_dnl": part,
            "coincidence_window_s": seconds,
            "afterpulse_probability": part,
            "crosstalk_probability": part,
            "hot_fraction": part,
            "hot_rate_hz": {"low": 0},
        }
        for name, limit in limits.items():
            checks.number(name, getattr(self, name), **limit)

        # Check the other parameters
        checks.one_of("mode", self.mode, MODES)
        checks.boolean("paralysable", self.paralysable)
        checks.integer("device_seed", self.device_seed, 0, checks.MAX_SEED)
        if self.jitter is not None:
            distribution("jitter", self.jitter)
        if self.tdc_bits is not None:
            checks.integer("tdc_bits", self.tdc_bits, 1, 20)
        if self.tdc_lsb_s is not None:
            checks.number("tdc_lsb_s", self.tdc_lsb_s, unit="seconds", positive=True)

        # Check the macro pixels
        sizes = checks.items("macro_pixel", self.macro_pixel, 2, "(rows, columns)")
        tall, wide = (checks.integer("macro_pixel", n, 1, 64) for n in sizes)
        object.__setattr__(self, "macro_pixel", (tall, wide))
        checks.integer("coincidence", self.coincidence, 1, tall * wide)
        self._refuse_parameters_without_effect()

    def _refuse_parameters_without_effect(self) -> None:
        """Raise a ValueError if a parameter has no effect in this mode or with other parameters."""
        if self.mode == "first_photon":
            for name in ("dead_time_s", "afterpulse_probability"):
                if getattr(self, name):
                    raise ValueError(
                        f'{name} has no effect in mode "first_photon". Remove it or choose mode '
                        '"multi_hit" or "free_running"'
                    )
        needed = {
            "paralysable": "dead_time_s",
            "afterpulse_time_s": "afterpulse_probability",
            "hot_rate_hz": "hot_fraction",
        }
        for name, other in needed.items():
            if getattr(self, name) and not getattr(self, other):
                raise ValueError(f"{name} has no effect with {other} = 0. Remove it or set {other}")
        if self.coincidence_window_s and self.coincidence == 1:
            raise ValueError(
                "coincidence_window_s has no effect with coincidence = 1. Remove it or set "
                "coincidence to 2 or more"
            )
