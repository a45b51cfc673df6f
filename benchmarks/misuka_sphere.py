"""Derivatives of misuka, a renderer of sound, in a sphere with a closed form.

misuka supports area lights only, and its receiver records sound from all sides. Therefore it cannot
render the scenes of the table. Here a small lamp is in the center of a diffuse sphere, and the
receiver is off the center.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable

LAMP_RADIUS = 0.01  # Radius of the lamp [m]
OFFSET = 0.3  # Distance of the receiver from the center [m]
INTENSITY = 2.0
LONGEST_PATH = 4  # Number of segments
RADIUS = 1.2  # Radius of the sphere [m]
ALBEDO = 0.8
BINS = 137
BIN_WIDTH = 0.1  # [m]
FREQUENCIES = ("250, 500", "1, 2")
"""Bands [Hz]: usual bands, and bands with correct derivatives only."""


def light(radius: float, albedo: float) -> tuple[float, float]:
    """Return the light at the receiver (mean over directions), and light times path length.

    A lamp of intensity I is in the center of a sphere of radius R. After k reflections, the
    radiance of the wall is I rho^k / (pi R^2). The first segment has the length R. Chords between
    reflections have the mean length 4/3 R. The last segment is the mean distance from the wall to
    the receiver.
    """
    # Mean distance from the wall to the receiver
    leg = (radius**2 - OFFSET**2) / (2 * OFFSET)
    leg = (radius + leg * math.log((radius + OFFSET) / (radius - OFFSET))) / 2

    # Sum over reflections
    bounces = range(1, LONGEST_PATH)
    bright = [INTENSITY * albedo**k / (math.pi * radius**2) for k in bounces]
    lengths = [radius + (k - 1) * 4 / 3 * radius + leg for k in bounces]
    return sum(bright), sum(b * opl for b, opl in zip(bright, lengths, strict=True))


def closed_form(by: str) -> dict[str, float]:
    """Differentiate both results of `light` by the radius or the albedo."""
    step = 1e-5
    moved = [
        light(RADIUS + sign * step * (by == "radius"), ALBEDO + sign * step * (by == "albedo"))
        for sign in (1, -1)
    ]
    change = ((up - down) / (2 * step) for up, down in zip(*moved, strict=True))
    return dict(zip(("sum", "moment"), change, strict=True))


def main() -> None:
    """Print the derivatives of all seeds, for each parameter and measure, as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--spp", type=int, default=1 << 14)
    options = parser.parse_args()
    found: list[dict[str, object]] = []
    for frequencies in FREQUENCIES:
        measure = _misuka(frequencies, options.spp)
        for name in ("radius", "albedo"):
            for what in ("sum", "moment"):
                values = [measure(name, what, seed) for seed in range(1, options.seeds + 1)]
                found.append({"by": name, "of": what, "frequencies": frequencies, "values": values})
    print(json.dumps(found))


def _misuka(frequencies: str, spp: int) -> Callable[[str, str, int], float]:
    """Return a function of parameter, measure and seed that differentiates in reverse mode."""
    import drjit as dr
    import misuka
    import numpy as np

    misuka.set_variant("llvm_ad_acoustic")
    misuka.set_log_level(misuka.LogLevel.Error)

    # Describe the scene
    place = misuka.ScalarTransform4f()
    film = {"type": "tape", "frequencies": frequencies, "time_bins": BINS}
    film["rfilter"] = {"type": "gaussian", "stddev": 1.0}
    integrator = {"type": "acoustic_prb_threepoint", "track_time_derivatives": True}
    integrator |= {"max_time": BINS * BIN_WIDTH, "speed_of_sound": 1.0, "max_energy_loss": -1.0}
    integrator |= {"max_depth": LONGEST_PATH, "hide_emitters": True}
    radiance = INTENSITY / (math.pi * LAMP_RADIUS**2)
    scene = misuka.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": {
                **{"type": "microphone", "film": film},
                "to_world": place.translate([OFFSET, 0, 0]),
            },
            "wall": {
                **{"type": "sphere", "to_world": place.scale(RADIUS), "flip_normals": True},
                "bsdf": {"type": "diffuse", "reflectance": _uniform(ALBEDO)},
            },
            "lamp": {
                **{"type": "sphere", "to_world": place.scale(LAMP_RADIUS)},
                "emitter": {"type": "area", "radiance": _uniform(radiance)},
            },
        }
    )
    lengths = (np.arange(BINS) + 0.5) * BIN_WIDTH

    # The filter of misuka over bins is not normalized
    per_unit = math.sqrt(2 * math.pi) - 8 * math.exp(-8)

    def measure(name: str, what: str, seed: int) -> float:
        # Attach the gradient
        parameters = misuka.traverse(scene)
        theta = misuka.Float(RADIUS if name == "radius" else ALBEDO)
        dr.enable_grad(theta)
        if name == "radius":
            parameters["wall.to_world"] = misuka.Transform4f().scale(theta)
        else:
            parameters["wall.bsdf.reflectance.value"] = theta
        parameters.update()

        # Differentiate the sum or the moment in time
        image = misuka.render(scene, parameters, spp=spp, seed=seed)
        weights = np.zeros((BINS, math.prod(image.shape) // BINS), np.float32)
        weights[:, 0] = 1 if what == "sum" else lengths
        dr.backward(dr.sum(image * misuka.TensorXf(weights.reshape(image.shape)), axis=None))
        return float(dr.grad(theta)[0]) / per_unit

    return measure


def _uniform(value: float) -> dict[str, object]:
    """Describe a spectrum that is the same at all frequencies."""
    return {"type": "uniform", "value": value}


if __name__ == "__main__":
    main()
