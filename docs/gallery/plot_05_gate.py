"""
A time gate
===========

Three images of a camera with a time gate that is open for a tenth of a nanosecond. The integrator
samples only light of the gate's path lengths, so it needs fewer samples than a film with all bins.
"""

import matplotlib.pyplot as plt
import numpy as np

import tofrender

scene = tofrender.load_scene("cornell_box", width=128, height=128)
gate = {"type": "time_gated_transient_path", "pulse_width_opl": 0.03, "max_depth": 4}
integrator = tofrender.load_scene("cornell_box", integrator=gate).integrator()

figure, panels = plt.subplots(1, 3, figsize=(9, 3.3), layout="constrained")
for axes, opl in zip(panels, (5.4, 5.9, 6.6), strict=True):
    frame = np.array(tofrender.render_at_time(scene, integrator, scene.sensors()[0], opl, spp=64))
    axes.imshow(tofrender.tonemap(frame))
    axes.set_title(f"{opl} m, {tofrender.opl_to_ns(opl):.1f} ns")
    axes.axis("off")
