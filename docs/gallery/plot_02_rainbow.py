"""
When light arrives, in one picture
==================================

Hue is the time of each pixel's light, so that a front is a band of one colour. One colour comes
back after ``period_ns``.
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
