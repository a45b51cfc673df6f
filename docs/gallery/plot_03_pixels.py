"""
What a pixel sees
=================

The response of one pixel of the floor: first the lamp's direct light, then what walls and boxes
send. The band is the standard error of each bin, from the same render.
"""

import tofrender

dataset = tofrender.render(
    "cornell_box",
    spp=256,
    errors=True,
    window="auto",
    bins=220,
    size=(64, 64),
)
figure = tofrender.plot_pixel_transient(dataset.sel(opl=slice(5, 10)), x=32, y=60)
