"""
Light in flight
===============

A pulse leaves the ceiling lamp of the Cornell box. The wavefront of direct light moves over boxes
and walls, and indirect light follows. Play it, or click pixels to compare their responses.
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
tofrender.explore(dataset.sel(opl=slice(4.5, 9.5)), title="The Cornell box")
