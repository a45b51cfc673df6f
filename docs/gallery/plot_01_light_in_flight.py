"""
Light in flight
===============

A pulse leaves the lamp in the ceiling. Its front runs over boxes and walls; what was reflected before
follows. The player opens on the brightest bin.
"""

import tofrender

dataset = tofrender.render(
    "cornell_box",
    spp=64,
    window=(4.5, 9.5),
    temporal_bins=100,
    settings={"width": 128, "height": 128, "pulse_width_opl": 0.05},
)
tofrender.visualize_transient(dataset)
