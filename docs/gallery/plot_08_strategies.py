"""
Who finds the light
===================

A path of light with so many vertices from the lamp and so many from the camera: each way of
making it finds other light. Weighted, they add up to the picture.
"""

import tofrender

scene = tofrender.caustic(width=32, height=32, temporal_bins=20, bin_width_opl=0.2)
pyramid = tofrender.strategy_pyramid(scene, max_depth=4, spp=64)
figure = tofrender.pyramid_figure(pyramid)
