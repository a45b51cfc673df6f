"""
Pulses of finite length
=======================

Real lamps emit pulses of finite length. Each bin gets the exact energy of the pulse in it, which
adds no noise. The figure shows one pixel of the Cornell box with pulses of three lengths.
"""

import matplotlib.pyplot as plt

import tofrender

figure, axes = plt.subplots(figsize=(7, 3.8), layout="constrained")
for sigma in (0.0, 0.05, 0.2):
    dataset = tofrender.render(
        "cornell_box",
        spp=256,
        size=(32, 32),
        bins=500,
        window=(3.5, 15.0),
        pulse_width=sigma or None,
    )
    response = dataset["transient"].isel(x=16, y=30).sum("channel").sel(opl=slice(4.5, 9.5))
    axes.plot(response["time"], response, label=f"{100 * sigma:g} cm")
axes.set(xlabel="time [ns]", ylabel="radiance per bin")
axes.legend(title="pulse", frameon=False)
