"""Pictures of any size, in color, of the plane under the lamp."""

from __future__ import annotations

import formulas
import numpy as np

from tofrender.course.judge import expect


def drawn_view(random):
    """A camera over the plane with a crop, colors of plane and lamp, and means over pixels.

    The last result is a function. It returns the pixel means of a function of (light, length),
    of shape (height, width, 3).
    """
    width, height = (int(n) for n in random.permutation([2, 3, 4, 5])[:2])
    left, above, right, below = (int(n) for n in random.integers(0, 3, 4))
    whole = (left + width + right, above + height + below + 1)
    fov = float(random.uniform(40, 65))
    over = formulas.OVER
    colors = random.uniform(0.3, 1.0, (2, 3))

    def value(weight):
        means = formulas.over_pixels(
            lambda x, y: weight(*formulas.lamp(x, y, over["origin"])),
            over["origin"],
            fov,
            *whole,
        )[..., above : above + height, left : left + width]
        return means[..., None] * colors.prod(axis=0)

    near = float(random.uniform(0.2, 0.6))
    crop = (left, above, width, height)
    view = {"fov": fov, "size": whole, "crop": crop, "near_clip": near}
    return over | view, colors, value


def expect_pictures(came, wanted, what, most, is_single=True, hint=""):
    """Right on average, no noisier than so many samples are, and the same again."""
    own = hint
    hint = "(height, width, ..., channels): rows are y; each channel for itself"
    expect.shape(came["values"][0], wanted.shape, what, hint=hint)
    if is_single:
        text = f"{what}: expected ndarray of float32, came {came['kind']}"
        expect.true(came["kind"] == "ndarray of float32", text)
    scale = wanted.max()
    first, second = came["values"][:2]
    text = f"{what}, the same seed again"
    expect.close(came["again"], first, text, rtol=1e-3, atol=1e-4 * scale, hint="use the seed")
    text = f"{what}, another seed: other random numbers; came the same"
    expect.true(np.abs(first - second).max() > 1e-6 * scale, text, hint="use the seed")
    lit = wanted > 0.02 * wanted.max()
    dark = came["values"][:, ~lit]
    if dark.size:
        more = {"rtol": 0, "atol": 0.02 * scale, "hint": own}
        expect.close(dark.mean(0), wanted[~lit], f"{what}, dark", **more)
    hint = own or hint
    expect.estimate(came["values"][:, lit], wanted[lit], what, rounding=5e-3, hint=hint)
    hint = "do all of the spp samples of a pixel count?"
    expect.noise(came["values"] / scale, most, f"{what}, over its maximum", hint=hint)
    if "few" in came:
        few, many = (came[name].std(axis=0).mean() for name in ("few", "values"))
        text = f"standard deviation of {what}: an 8th of that with a 64th of the samples; came 1 /"
        expect.true(many < few / 4, f"{text} {few / many:.1f}", hint=hint)
