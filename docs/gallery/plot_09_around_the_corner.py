"""
Around the corner (NLOS)
========================

A laser scans a relay wall. A letter that neither laser nor sensor sees reflects some light back to
the wall. The letter is reconstructed from the arrival times of this light.
"""

import tofrender

figure = tofrender.plan_figure(tofrender.load_scene("nlos_z", optimize=False))

# %%
# In a confocal capture, laser and sensor point at the same point of the wall. The light-cone
# transform reconstructs it.

capture = tofrender.capture(tofrender.nlos_z(width=32, height=32, temporal_bins=500), spp=256)
found = tofrender.reconstruct(capture, "lct")
picture = tofrender.reconstruction_figure(found)
