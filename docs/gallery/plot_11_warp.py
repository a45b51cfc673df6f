"""
Testing a warp
==============

Points of the unit square, warped to Beckmann's distribution of microfacet normals, and a
chi-square test that compares the number of points in each cell with the expected number.
"""

import numpy as np

from tofrender.sampling import point_set, warp_case
from tofrender.vis import warp_figure

case = warp_case("beckmann", alpha=0.3)
points = np.array(case.sample(point_set("stratified", 1024, seed=0)))
figure = warp_figure(points, case.test(samples=100_000))
