"""A beam of any width, with an edge in its way."""

import formulas
import numpy as np
import pytest
from cases_staff import Case, compare
from hidden_staff import Patch, facing, legs
from scenes_staff import blocked, diffuse, placed, square

pytestmark = pytest.mark.a2_area_spot


def test_any_beam(submission):
    """Only what the beam reaches sends light on, and only to what it sees."""
    random = submission.random
    sigma = float(random.uniform(0.6, 0.7))
    power = float(random.uniform(1, 4))
    wall = random.uniform(0.4, 0.9, 3)
    p = np.array([*random.uniform(-0.1, 0.1, 2), 0.0])
    eye = p + random.uniform([-0.08, -0.05, 0.3], [-0.02, 0.05, 0.4])
    center = p + random.uniform([0.15, -0.1, 0.3], [0.2, 0.1, 0.35])
    hidden = Patch(center, (0.15, 0.1), random.uniform(0.3, 0.9, 3), cells=14, **facing(center, p))
    # A low edge on the wall: points before it do not see the patch, and some behind it no beam
    middle = p + np.array([random.uniform(0.1, 0.12), 0, 0.05])
    edge = (middle, (0, 1, 0), (0, 0, 1), (1.0, 0.05))
    case = Case(
        {
            "relay_wall": square((0, 0, 0), 5.0, diffuse(wall)),
            "hidden": hidden.part,
            "edge": {"type": "rectangle", "to_world": placed(*edge), "bsdf": diffuse(0.0)},
        }
    )
    spots = [(q, s) for q, s in formulas.spots(eye, p, sigma, 100) if s > 1e-8]
    g, r = legs(p, hidden)
    g = g * ~blocked(p, hidden.points, *edge)
    d = np.linalg.norm(eye - p)
    light = 0.0
    moment = 0.0
    for q, share in spots:
        if blocked(eye, q, *edge):
            continue
        g_q, r_q = legs(q, hidden)
        seen = share * g * g_q * ~blocked(q, hidden.points, *edge)
        light += seen.sum()
        moment += (seen * (d + r + r_q + np.linalg.norm(eye - q))).sum()
    tint = power * wall**2 * hidden.albedo * hidden.area / np.pi**3
    case.add(eye, p, [(light * tint, moment / light)])
    came = case.ask(
        submission,
        "ConfocalTransientIntegrator",
        lanes=32768,
        max_depth=3,
        power=power,
        spot_sigma=sigma,
        use_nlos_only=True,
    )
    hint = (
        "x and y of standard deviation tan(spot_sigma); the spot is where that ray ends; does the "
        "vertex see it (scene.ray_test)? Device to spot, spot to patch, patch to p, p to device"
    )
    compare(came, case, hint, most=0.1, rounding=1.5e-2)
