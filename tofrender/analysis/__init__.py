"""What is computed from rendered light: phasors and depth, sensor models, statistics."""

from __future__ import annotations

from ..phasors import phasor_parts
from .correlation import MultipathError, four_bucket, from_four_bucket, multipath_error, true_depth
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
