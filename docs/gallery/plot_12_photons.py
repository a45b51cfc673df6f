"""
Photons and the Cramér-Rao bound
================================

How well do estimators find a depth from few photons? The points are errors of 400 simulated
histograms each, the dashed lines are the least errors that unbiased estimators can have. Below some
tens of counts, returns are missed, and the bound says nothing. On the right are the errors of an
echo's intensity and width, over their true values. An echo ends where the response does, so its
width is slightly biased, and can vary less than the bound.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import norm

import tofrender
from tofrender.sensors import depth_bound, echo_bounds, echoes, estimate_depth

width, background, sigma = 0.02, 0.1, 0.06  # Of bins [m], counts per bin, of the pulse [m]
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
