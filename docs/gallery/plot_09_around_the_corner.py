"""
Around the corner
=================

A laser scans a wall; a letter that neither laser nor sensor sees sends some light back to it.
From when that light comes, the letter is found.
"""

import tofrender

figure = tofrender.plan_figure(tofrender.load_scene("nlos_z", optimize=False))

# %%
# A confocal capture: each point of the wall is lit while it is looked at. Then the light-cone
# transform.

capture = tofrender.capture(tofrender.nlos_z(width=32, height=32, temporal_bins=500), spp=256)
found = tofrender.reconstruct(capture, "lct")
picture = tofrender.reconstruction_figure(found)
