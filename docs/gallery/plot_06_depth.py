"""
Depth from phase
================

The depth camera of a phone modulates its lamp, and measures the phase delay of the light at each
pixel. Depth wraps after 3 m at 50 MHz; together with 20 MHz it is unambiguous. All frequencies are
computed from the same paths.
"""

import tofrender

scene = tofrender.load_scene("cornell_box_flash", width=128, height=128)
frequencies = [20e6, 50e6]
I, Q, amplitude, phase, depth = tofrender.render_amcw_phasor(
    scene, scene.sensors()[0], frequencies, spp=64
)
figure = tofrender.phasor_panel(frequencies, I, Q, amplitude, phase, depth)
