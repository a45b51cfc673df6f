"""
Photons and the Cramér-Rao bound
================================

How well do estimators find a depth from few photons? The points are errors of 400 simulated
histograms each, the dashed line is the least error that an unbiased estimator can have. Below some
tens of counts, returns are missed, and the bound says nothing.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import norm

import tofrender
from tofrender.sensors import depth_bound, estimate_depth

width, background, sigma = 0.02, 0.1, 0.06  # Of bins [m], counts per bin, of the pulse [m]
response = tofrender.GaussianPulse(sigma)
signals = np.array([3, 10, 30, 100, 300, 1000])
rng = np.random.default_rng(1)
position = (100 + rng.random(400)) * width
edges = np.arange(201) * width - position[:, None]
masses = np.diff(norm.cdf(edges / sigma))
counts = rng.poisson(signals[:, None, None] * masses + background)

figure, axes = plt.subplots(layout="constrained")
for method in ("matched", "log_matched", "centroid", "ml"):
    depth = estimate_depth(counts, response, method, bin_width_opl=width)["depth"].values
    error = np.sqrt(np.mean((depth - position / 2) ** 2, axis=1))
    axes.loglog(signals, error, "o-", label=method)
bound = depth_bound(signals, background, response, width)
axes.loglog(signals, bound, "--", color="tab:gray", label="Cramér-Rao bound")
axes.set(xlabel="signal [counts]", ylabel="RMS error of depth [m]")
axes.legend()
