"""
Light in flight
===============

A pulse leaves the lamp in the ceiling. Its front runs over boxes and walls; what was reflected
before follows. The player opens on the brightest bin.
"""

import tofrender

dataset = tofrender.render(
    "cornell_box",
    spp=64,
    window="auto",
    bins=220,
    size=(128, 128),
    pulse_width=0.05,
)
tofrender.visualize_transient(dataset.sel(opl=slice(4.5, 9.5)))
