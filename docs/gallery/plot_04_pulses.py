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
        bins=250,
        window=(4.5, 9.5),
        pulse_width=sigma or None,
    )
    response = dataset["transient"].isel(x=16, y=30).sum("channel")
    time_ns = tofrender.opl_to_ns(dataset["opl"].values)
    axes.plot(time_ns, response, label=f"{100 * sigma:g} cm")
axes.set(xlabel="time [ns]", ylabel="radiance per bin")
axes.legend(title="pulse", frameon=False)
