"""
A caustic in flight
===================

A glass sphere focuses the light of a small lamp on the floor. Paths from the camera rarely hit the
lamp; bidirectional paths find its light. The caustic arrives late, since light is slower in glass.
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
tofrender.explore(dataset.sel(opl=slice(5.2, 7.6)), title="A caustic in flight")
