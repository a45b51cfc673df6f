"""
Depth from phase
================

The depth camera of a phone: its lamp is a wave, and each pixel measures by how much the wave
lags. 50 MHz wraps after 3 m; with 20 MHz beside it, depth is one again. All frequencies come from
one trace.
"""

import tofrender

scene = tofrender.load_scene("cornell_box_flash", width=128, height=128)
frequencies = [20e6, 50e6]
I, Q, amplitude, phase, depth = tofrender.render_amcw_phasor(
    scene, scene.sensors()[0], frequencies, spp=64
)
figure = tofrender.phasor_panel(frequencies, I, Q, amplitude, phase, depth)
