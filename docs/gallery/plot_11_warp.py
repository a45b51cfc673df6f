"""
Do samples follow their density?
================================

Points of the square, bent into Beckmann's distribution of microfacet normals, and the chi-square
test that compares how many fall into each cell with how many should.
"""

import numpy as np

from tofrender.sampling import point_set, warp_case
from tofrender.vis import warp_figure

case = warp_case("beckmann", alpha=0.3)
points = np.array(case.sample(point_set("stratified", 1024, seed=0)))
figure = warp_figure(points, case.test(samples=100_000))
