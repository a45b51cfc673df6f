"""
A SPAD camera counts
====================

Photons that a camera of 64 x 64 SPADs detects in 1 to 3000 laser cycles. Colors are mean arrival
times: blue is early, red is late. The curves show one pixel on the floor.
"""

import base64
import io

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import HTML
from PIL import Image

import tofrender
from tofrender.sensors import Response, Spad, expected_photons

box = tofrender.render("cornell_box", spp=64, size=(64, 64), window="auto", bins=220)
rates = expected_photons(box, photons_per_cycle=0.2, background_per_cycle=0.002)
opl = rates["opl"].values
spad = Spad(jitter=Response(sigma_s=60e-12))

exposures = np.unique(np.geomspace(1, 3000, 48).astype(int))
counts = np.zeros(rates["rate"].shape, int)
frames = []
histograms = {}
for seed, cycles in enumerate(np.diff(exposures, prepend=0)):
    counts = counts + spad.histogram(rates, int(cycles), seed)["counts"].values
    photons = counts.sum(axis=-1)
    mean_opl = counts @ opl / np.maximum(photons, 1)
    color = plt.colormaps["turbo"]((mean_opl - 4.5) / 5)[..., :3]
    bright = np.sqrt(np.minimum(photons / max(1, np.percentile(photons, 97)), 1))
    pixels = np.rint(255 * color * bright[..., None]).astype(np.uint8)
    frames.append(Image.fromarray(pixels).resize((512, 512), Image.Resampling.NEAREST))
    histograms[int(exposures[seed])] = counts[60, 32]

figure, panels = plt.subplots(1, 3, figsize=(9, 2.8), layout="constrained")
for axes, cycles in zip(panels, (exposures[16], exposures[32], exposures[-1]), strict=True):
    axes.plot(opl, histograms[int(cycles)], ".", label="counts")
    axes.plot(opl, spad.expected(rates, int(cycles))["counts"][60, 32], label="expectation")
    axes.set(title=f"{cycles} cycles", xlabel="path length [m]", xlim=(5, 9))
panels[0].legend(frameon=False)

film = io.BytesIO()
frames[0].save(film, "WEBP", save_all=True, append_images=frames[1:], duration=90, loop=0)
film = base64.b64encode(film.getvalue()).decode()
HTML(f'<img src="data:image/webp;base64,{film}" alt="Photons gather in the Cornell box">')
