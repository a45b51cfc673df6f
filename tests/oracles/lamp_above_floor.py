"""A lamp above a floor in closed form, as an integrator whose time bins have derivatives."""

from typing import Any

import drjit as dr
import mitsuba as mi

RHO = 0.5
WIDTH_OPL = 0.1  # Standard deviation of the lamp's pulse [m]

POSITION = "lamp.position"
INTENSITY = "lamp.intensity.value"


class LampAboveFloor(mi.SamplingIntegrator):
    """Points on the plane z = 0 between -1 and 1, one a pixel, seen from where they are.

    Each gets the radiance rho I cos / (pi r²) at the path length r, spread by a Gaussian pulse.
    `noise` is the standard deviation of a factor of all bins that the seed decides.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.noise = props.get("noise", 0.0)
        self.renders = 0

    def light(self, params: Any, film: Any, seed: int) -> tuple[Any, Any]:
        height, width, bins, channels = film.shape
        index = dr.arange(mi.UInt32, height * width)
        x = (mi.Float(index % width) + 0.5) / width * 2 - 1
        y = (mi.Float(index // width) + 0.5) / height * 2 - 1
        to_lamp = mi.Point3f(params[POSITION]) - mi.Point3f(x, y, 0)
        r = dr.norm(to_lamp)
        power = dr.mean(mi.unpolarized_spectrum(params[INTENSITY]))
        radiance = RHO / dr.pi * power * to_lamp.z / r**3
        shape = (height, width, 1, 1)
        k = dr.arange(mi.Float, bins + 1)
        edges = mi.TensorXf(film.start_opl + k * film.bin_width_opl, shape=(1, 1, bins + 1, 1))
        length, each = mi.TensorXf(r, shape=shape), mi.TensorXf(radiance, shape=shape)
        cdf = 0.5 * (1 + dr.erf((edges - length) / (WIDTH_OPL * dr.sqrt(2.0))))
        film_bins = each * (cdf[:, :, 1:, :] - cdf[:, :, :-1, :])
        if self.noise:
            rng = mi.PCG32(bins * height * width, dr.opaque(mi.UInt64, seed))
            spread = rng.next_float_normal(mi.Float)
            film_bins *= 1 + self.noise * mi.TensorXf(spread, shape=(height, width, bins, 1))
        film_bins *= mi.TensorXf(dr.ones(mi.Float, channels), shape=(1, 1, 1, channels))
        return dr.sum(film_bins, axis=2), film_bins

    def render(self, scene, sensor=0, seed=0, spp=0, develop=True, evaluate=True):
        self.renders += 1
        return self.light(mi.traverse(scene), sensor.film(), seed)

    def render_backward(self, scene, params, grad_in, sensor=0, seed=0, spp=0):
        with dr.resume_grad():
            known = dict(mi.traverse(scene)) | dict(params)
            out = self.light(known, sensor.film(), seed)
            for each, gradient in zip(out, grad_in, strict=True):
                dr.set_grad(each, gradient)
            dr.enqueue(dr.ADMode.Backward, *out)
            dr.traverse(dr.ADMode.Backward)

    def traverse(self, callback):
        pass

    def to_string(self):
        return "LampAboveFloor[]"


def scene(
    position=(0.2, -0.1, 1.5), intensity: float = 2.0, size: int = 4, **integrator: Any
) -> mi.Scene:
    mi.register_integrator("lamp_above_floor", LampAboveFloor)
    film = {"width": size, "height": size, "rfilter": {"type": "box"}}
    bins = {"temporal_bins": 60, "start_opl": 0.5, "bin_width_opl": 0.05}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "lamp_above_floor", **integrator},
            "lamp": {"type": "point", "position": list(position), "intensity": intensity},
            "sensor": {"type": "perspective", "film": film | bins | {"type": "transient_hdr_film"}},
        }
    )
