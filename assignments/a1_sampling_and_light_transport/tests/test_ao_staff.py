"""a1.ao: drawn lids over drawn plates."""

import drawn_staff as drawn
import numpy as np
import pytest
import small_scenes as scenes

from tofrender.course.judge import expect

pytestmark = pytest.mark.a1_ao

UP = np.array([0, 0, 1.0])
APART = 30.0


def ask(submission, scene, x, d, spp=1024, seeds=16, shift=0):
    """All that is answered for points x that are seen along d from close by."""
    return submission.ask(
        "answer",
        integrator="AmbientOcclusion",
        name="ao",
        parameters={},
        scene=scene,
        o=x - 0.01 * d,
        d=d,
        seeds=seeds,
        spp=spp,
        seed=submission.seed + shift,
    )


def test_drawn_lids(submission):
    """Lids of any material over both sides of tilted plates, under a sky."""
    random = submission.random
    materials = [scenes.BLACK, {"type": "dielectric"}, {"type": "null"}, scenes.BLACK]
    parts = {"sky": {"type": "constant", "radiance": scenes.rgb(4.0)}}
    x = APART * np.array([[1.0, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]])
    n = drawn.directions(random, 4)
    height = random.uniform(1, 2.5, 4)
    radius = random.uniform(0.5, 2, 4)
    for k in range(4):
        turned = n[k] if random.random() < 0.5 else -n[k]
        emitter = {"emitter": scenes.lamp(2.0)} if k == 3 else {}
        parts[f"plate{k}"] = scenes.disk(x[k], turned, 0.1, scenes.diffuse(0.2 * k))
        lid = x[k] + height[k] * n[k]
        parts[f"lid{k}"] = scenes.disk(lid, turned, radius[k], materials[k], **emitter)
    normal = drawn.near(random, UP, random.uniform(0.4, 0.9))
    at = np.zeros(3)
    parts["tilted"] = drawn.tilted_normals(at, UP, normal, 0.1, scenes.BLACK)
    parts["ground"] = scenes.disk(at - 0.003 * UP, UP, 5.0, scenes.BLACK)
    points = np.concatenate([x, x, at[None], [[0, 0, 90.0]]])
    d = np.concatenate([-n, n, -UP[None], UP[None]])
    came = ask(submission, scenes.scene(**parts), points, d)
    open_part = height**2 / (height**2 + radius**2)
    wanted = np.concatenate([open_part, np.ones(4), [(1 + normal[2]) / 2]])
    hint = "any surface hides the sky, on the side of the shading normal that the camera sees"
    what = "openness of plates under lids, of their backs, and with tilted shading normals"
    gray = came["radiance"][:, :9]
    same = "L is the same in each channel"
    expect.close(gray, gray[..., :1] * np.ones(3), "openness in all channels", hint=same)
    expect.estimate(gray.mean(axis=2), wanted, what, rounding=5e-3, hint=hint)
    expect.close(came["radiance"][:, 9], 0.0, "value where there is no surface, but a sky")
    expect.close(came["met"][:9], 1.0, "lanes that met a surface")
    in_the_open = np.max(came["deviation"][4:8])
    text = f"standard deviation in the open must be 0, each estimate is 1; it is {in_the_open:.3g}"
    expect.true(in_the_open < 0.1, text, hint="draw with the density cos / pi: f/p is V")
    most = np.max(came["deviation"])
    text = f"standard deviation of one direction's estimate must be below 1.2; it is {most:.3g}"
    expect.true(most < 1.2, text, hint="draw with the density cos / pi: each estimate is 0 or 1")


def test_far_lid(submission):
    """A lid far away, by one direction in each call; random numbers come from the sampler."""
    random = submission.random
    n = drawn.directions(random, 1)
    far = float(10 ** random.uniform(2.5, 4))
    parts = {
        "plate": scenes.disk([0, 0, 0], n[0], 0.5, scenes.BLACK),
        "lid": scenes.disk(far * n[0], -n[0], far, scenes.BLACK),
    }
    scene = scenes.scene(**parts)
    zero = np.zeros((1, 3))
    beside = np.cross(n, drawn.directions(random, 1))
    nothing = ask(submission, scene, 2 * beside / np.linalg.norm(beside), -n)
    expect.close(nothing["radiance"], 0.0, "value where there is no surface")
    hint = "the second of what sample returns says which lanes met a surface: si.is_valid()"
    expect.close(nothing["met"], 0.0, "lanes that met a surface", hint=hint)
    expect.true(nothing["empty"], "the third of what sample returns must be []")
    came = ask(submission, scene, zero, -n)
    hint = "the shadow ray has no end"
    expect.estimate(
        came["radiance"], 0.5, f"openness with a lid in {far:.0f} m", rounding=3e-3, hint=hint
    )
    least = np.min(came["deviation"])
    text = (
        f"half open, one direction scatters by about 1/2; a call's result scatters by {least:.3g}"
    )
    expect.true(least > 0.4, text, hint="each call estimates the integral with one direction")
    again = ask(submission, scene, zero, -n)["radiance"]
    other = ask(submission, scene, zero, -n, shift=1)["radiance"]
    expect.close(
        again, came["radiance"], "the same with the same seed", atol=2e-3, hint="sampler.next_2d"
    )
    different = np.abs(other - again).max() > 0
    expect.true(different, "other seeds must give other estimates", hint="sampler.next_2d")
