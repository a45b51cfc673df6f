"""
The response of a pixel
=======================

The response of a pixel on the floor: first the direct light of the lamp, then indirect light from
walls and boxes. The band is the standard error of each bin, from the same render.
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
