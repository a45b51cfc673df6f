"""
Photons and the Cramér-Rao bound
================================

How well do estimators find a depth from few photons? Each point is the error of 400 simulated
histograms. The dashed lines are the smallest possible errors of unbiased estimators. With fewer
than some tens of counts, the estimators miss returns, and the bound is not meaningful. The right
plot shows the errors of an echo's intensity and width, relative to the true values. The width is
slightly biased, because an echo ends where the response ends. Therefore its error can be smaller
than the bound.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import norm

import tofrender
from tofrender.sensors import depth_bound, echo_bounds, echoes, estimate_depth

width = 0.02  # Width of bins [m]
background = 0.1  # Counts per bin
sigma = 0.06  # Standard deviation of the pulse [m]
response = tofrender.GaussianPulse(sigma)
signals = np.array([3, 10, 30, 100, 300, 1000])
rng = np.random.default_rng(1)
position = (100 + rng.random(400)) * width
edges = np.arange(201) * width - position[:, None]
masses = np.diff(norm.cdf(edges / sigma))
counts = rng.poisson(signals[:, None, None] * masses + background)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
for method in ("matched", "log_matched", "centroid", "ml"):
    found = estimate_depth(counts, response, method, start_opl=0.0, bin_width_opl=width)
    depth = found["depth"].values
    error = np.sqrt(np.mean((depth - position / 2) ** 2, axis=1))
    left.loglog(signals, error, "o-", label=method)
bound = depth_bound(signals, background, response, width)
left.loglog(signals, bound, "--", color="tab:gray", label="Cramér-Rao bound")
left.set(xlabel="signal [counts]", ylabel="RMS error of depth [m]")
left.legend()

bright = signals[2:]
bounds = echo_bounds(bright, background, response, width)
found = [echoes(each[None], response, start_opl=0.0, bin_width_opl=width) for each in counts[2:]]
for name, truth in (("intensity", bright), ("width", np.full(len(bright), sigma))):
    errors = [np.sqrt(np.mean((e[name] - t) ** 2)) for e, t in zip(found, truth, strict=True)]
    (line,) = right.loglog(bright, np.array(errors) / truth, "o-", label=name)
    right.loglog(bright, bounds[name] / truth, "--", color=line.get_color(), label="bound")
right.set(xlabel="signal [counts]", ylabel="relative RMS error of an echo")
right.legend()
