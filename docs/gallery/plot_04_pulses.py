"""
A pulse blurs time
==================

Lamps do not flash for an instant. A pulse spreads each arrival by its exact energy in every bin,
which adds no noise: the light of one pixel of the box, with pulses of three lengths.
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
