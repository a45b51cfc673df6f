"""
A fan and its velocities
========================

A spinning fan, exposed for 3 ms in each frame, and the radial velocities of what
pixels see: red comes nearer, blue goes away.
"""

import base64
import io

import matplotlib.pyplot as plt
import mitsuba as mi
import numpy as np
from IPython.display import HTML
from PIL import Image

import tofrender

SIZE = 160
still = tofrender.scenes.fan(width=SIZE, height=SIZE, max_depth=2)
spin = tofrender.Motion(angular_velocity=(0, 0, 40), rotation_center=(0, 0, 0))
times = np.linspace(0, 2 * np.pi / 5 / 40, 12, endpoint=False)  # until the next blade is there
axes_of_rates = {"spp": 64, "bins": 1, "window": (3, 12), "rate_bins": 81, "rates": (-40, 40)}
more = {"spp": 64, "bins": 1, "start_opl": 3.0, "bin_width": 9.0}
film = tofrender.render_frames(still, times, exposure_s=3e-3, poses=16, **more)
frames = []
for time, picture in zip(times, film["steady"].values, strict=True):
    turned = mi.ScalarTransform4f(spin.matrix(time))
    blades = {
        name: part | {"to_world": turned @ part["to_world"]}
        for name, part in still.items()
        if name.startswith("blade")
    }
    light = tofrender.range_rate(still | blades, **axes_of_rates)["radiance"]
    light = light.sum(("opl", "channel"))
    velocity = ((light * light["rate"] / 2).sum("rate") / light.sum("rate")).values
    colors = plt.colormaps["RdBu"](velocity / 30 + 0.5)[..., :3]
    both = np.concatenate([tofrender.tonemap(picture, exposure=3.0) / 255, colors], axis=1)
    frames.append(Image.fromarray(np.rint(255 * np.nan_to_num(both)).astype(np.uint8)))

figure, axes = plt.subplots(figsize=(5, 4), layout="constrained")
shown = axes.imshow(velocity, cmap="RdBu", vmin=-15, vmax=15)
figure.colorbar(shown, label="radial velocity [m/s]")
axes.axis("off")

film = io.BytesIO()
frames[0].save(film, "WEBP", save_all=True, append_images=frames[1:], duration=60, loop=0)
film = base64.b64encode(film.getvalue()).decode()
HTML(f'<img src="data:image/webp;base64,{film}" alt="A fan spins, and its radial velocities">')
