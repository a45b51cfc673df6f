"""
Strategies of bidirectional path tracing
========================================

Each picture shows one strategy (s, t): s vertices are sampled from the lamp, t from the camera.
With MIS weights, the pictures sum to the render.
"""

import tofrender

scene = tofrender.caustic(width=32, height=32, temporal_bins=20, bin_width_opl=0.2)
pyramid = tofrender.strategy_pyramid(scene, max_depth=4, spp=64)
figure = tofrender.pyramid_figure(pyramid)
