"""
Light through glass
===================

A glass sphere focuses the light of a small lamp on the floor. Paths from the camera hardly find
that lamp; paths from both ends do. Light in glass is late: it goes slower there.
"""

import tofrender

dataset = tofrender.render(
    "caustic",
    integrator={"type": "transient_bdpt", "max_depth": 6},
    spp=128,
    window="auto",
    bins=300,
    size=(96, 96),
)
tofrender.visualize_transient(dataset.sel(opl=slice(5.2, 7.6)))
