"""What is computed from rendered light: phasors and depth, sensor models, statistics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy import names_of

if TYPE_CHECKING:
    from ..phasors import phasor_parts
    from .correlation import (
        MultipathError,
        four_bucket,
        from_four_bucket,
        multipath_error,
        true_depth,
    )
    from .phasors import sum_channels, transient_to_phasor, unambiguous_range, unwrap

__all__ = [
    "MultipathError",
    "four_bucket",
    "from_four_bucket",
    "multipath_error",
    "phasor_parts",
    "sum_channels",
    "transient_to_phasor",
    "true_depth",
    "unambiguous_range",
    "unwrap",
]

__getattr__, __dir__ = names_of(
    __name__,
    {
        ".phasors": ("phasor_parts",),
        "correlation": (
            "MultipathError",
            "four_bucket",
            "from_four_bucket",
            "multipath_error",
            "true_depth",
        ),
        "phasors": ("sum_channels", "transient_to_phasor", "unambiguous_range", "unwrap"),
        "statistics": (),
    },
)
