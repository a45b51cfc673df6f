"""a3.all_strategies: shares of light that was reflected several times."""

import formulas
import pytest
from test_all_strategies import sphere

from tofrender.course.judge import expect

pytestmark = pytest.mark.a3_all_strategies


@pytest.mark.parametrize("mis", ["balance", "power"])
def test_shares_of_indirect_light(submission, mis):
    """Two reflections in a sphere, strategy by strategy."""
    options = {"origin": (0, 0, 0), "target": (0, 0, 1), "size": (4, 4), "fov": 100.0}
    view = formulas.View(**options)
    shares = formulas.sphere_shares(view, 2, {"balance": 1, "power": 2}[mis])
    whole = formulas.sphere_bounce(2, 1.0, 0.8, 1.0)
    for (s, t), share in zip(((1, 3), (2, 2), (3, 1)), shares, strict=True):
        steady, _ = sphere(submission, options, 3, strategy=f"{s},{t}", mis=mis)
        what = f"film's mean, strategy ({s}, {t}), mis {mis!r}"
        hint = "every vertex has a density from each end, also the two at the connection"
        expect.estimate(steady, share * whole, what, rounding=4e-3, hint=hint)
