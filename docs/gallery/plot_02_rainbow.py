"""
Arrival times in one picture
============================

The hue of a pixel shows when its light arrives, so that a wavefront appears as a band of one
color. Hues repeat every ``period_ns``.
"""

import tofrender

dataset = tofrender.render(
    "cornell_box_flash",
    spp=128,
    window="auto",
    bins=200,
    size=(128, 128),
)
figure = tofrender.light_in_flight(dataset, style="rainbow", period_ns=3.0)
