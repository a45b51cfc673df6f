"""Subjects of the warp tester: warps, shapes and lights, by this package or by a user.

Their functions or classes are found by name in `tofrender.sampling` or in a user's file. Names
and contracts are defined by the problems of the course.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ...runtime import checks
from ...sampling import domains, images
from ...signals.color import luminance

Lookup = Callable[[str], Any]
Functions = tuple[Callable[[Any], Any], Callable[[Any], Any]]

# The 2 x 2 image of the course: 80 % of the light in the upper row
EXAMPLE_IMAGE = np.array([[4.0, 4.0], [1.0, 1.0]])
MAX_SIDE = 512  # Largest side of an image [pixels]. Larger images are averaged


@dataclass(frozen=True)
class Parameter:
    """A number that can be changed, with the range and step of its slider."""

    name: str
    label: str
    default: float
    low: float
    high: float
    step: float
    bounds: tuple[float, float] | None = None  # Range of the number, by default of the slider


@dataclass(frozen=True)
class Subject:
    """What the tester draws and tests: a warp, shape or light with a sampler and its density."""

    title: str
    group: str  # "Warps", "Shapes" or "Lights"
    domain: str  # Domain of its points, a name in `tofrender.sampling.domains.DOMAINS`
    density: str  # Formula
    names: tuple[str, ...]  # Names that a file must define. The sampler is first
    make: Callable[..., Functions]  # Called with a lookup of these names, and the parameters
    parameters: tuple[Parameter, ...] = ()
    takes_image: bool = False  # Whether it has the parameter `image`

    @property
    def dimensions(self) -> int:
        """Coordinates of a point: 2 in the plane, 3 on the sphere."""
        return domains.find(self.domain).dimensions

    def values(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of all parameters. Missing values are defaults."""
        known = {each.name: each for each in self.parameters}
        values: dict[str, Any] = {name: each.default for name, each in known.items()}
        if self.takes_image:
            values["image"] = EXAMPLE_IMAGE
        for name, value in given.items():
            if name not in values:
                has = f"{self.title.lower()} has the parameters: {' and '.join(values) or 'none'}"
                raise ValueError(f"{name} = {checks.quote(value)}: must be left out; {has}")
            if name == "image":
                values[name] = density_of(value)
            else:
                low, high = known[name].bounds or (known[name].low, known[name].high)
                values[name] = float(checks.number(name, value, low=low, high=high))
        return values


def density_of(image: Any) -> np.ndarray:
    """Return the luminance of an image (path, bitmap, array) on 2^M x 2^M pixels, M <= 9."""
    weights = luminance(images.read_image(image))
    side = min(images.power_of_two(max(weights.shape)), MAX_SIDE)
    return weights if weights.shape == (side, side) else images.resized(weights, side)


def labeled(name: str, values: Mapping[str, Any]) -> str:
    """Return a subject's name with its parameters, for example "beckmann (alpha = 0.3)"."""
    numbers = [f"{key} = {value:g}" for key, value in values.items() if key != "image"]
    return f"{name} ({', '.join(numbers)})" if numbers else name


def _two_functions(get: Lookup, name: str, *values: float) -> Functions:
    sample = get(name)
    pdf = get(f"{name}_pdf")
    return lambda u: sample(u, *values), lambda p: pdf(p, *values)


def _no_op(get: Lookup) -> Functions:
    def pdf(p: mi.Point2f) -> mi.Float:
        inside = (p.x >= 0) & (p.x <= 1) & (p.y >= 0) & (p.y <= 1)
        return dr.select(inside, mi.Float(1), 0)

    return lambda u: u, pdf


def _hierarchical(get: Lookup, image: Any) -> Functions:
    warp = get("HierarchicalWarp")(np.asarray(image))
    return warp.sample, warp.pdf


def _triangle(get: Lookup, apex: float) -> Functions:
    corners = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [float(apex), 1.0, 0.0]
    sample = get("sample_triangle")
    pdf = get("sample_triangle_pdf")

    def in_plane(u: mi.Point2f) -> mi.Point2f:
        p = sample(*corners, u)
        return mi.Point2f(p.x, p.y)

    return in_plane, lambda p: pdf(mi.Point3f(p.x, p.y, 0), *corners)


def _quad_light(get: Lookup, distance: float) -> Any:
    quad = get("Quad")
    edges = [-1.0, -0.5, distance], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]
    return getattr(quad, "from_edges", quad)(*edges, emission=1.0)


def _triangle_light(get: Lookup, distance: float) -> Any:
    corners = [-1.0, -0.7, distance], [1.0, -0.7, distance], [0.0, 1.0, distance]
    return get("Triangle")(*corners, emission=1.0)


def _sphere_light(get: Lookup, distance: float) -> Any:
    return get("Sphere")((0.0, 0.0, distance), 0.5, emission=1.0)


def _two_lights(get: Lookup, distance: float) -> Any:
    sphere = get("Sphere")((-0.9, 0.0, distance), 0.4, emission=1.0)
    corners = [0.3, -0.6, distance], [1.5, -0.6, distance], [0.9, 0.6, distance]
    return get("SurfaceGroup")([sphere, get("Triangle")(*corners, emission=1.0)])


def _warp(title: str, domain: str, density: str, name: str, *parameters: Parameter) -> Subject:
    def make(get: Lookup, **values: float) -> Functions:
        return _two_functions(get, name, *values.values())

    return Subject(title, "Warps", domain, density, (name, f"{name}_pdf"), make, parameters)


def _light(title: str, density: str, build: Callable[[Lookup, float], Any], *names: str) -> Subject:
    """Return the subject of directions from the origin to a light above the origin."""

    def make(get: Lookup, distance: float) -> Functions:
        light = build(get, float(distance))

        def sample(u: mi.Point2f) -> tuple[Any, Any, Any]:
            record = light.sample(dr.opaque(mi.Point3f, 0, dr.width(u)), u)
            return record.d, dr.select(record.valid, mi.Float(1), 0), record.pdf

        return sample, lambda v: light.pdf(dr.opaque(mi.Point3f, 0, dr.width(v)), v)

    distance = Parameter("distance", "Distance [m]", 1.0, 0.6, 5.0, 0.05)
    return Subject(title, "Lights", "sphere", density, names, make, (distance,))


_OVER_AREA = "p(ω) = r² / (A |cos θ|)"
_BECKMANN = "p(ω) = exp(−tan²θ / α²) / (π α² cos³θ)"
_ALPHA = Parameter("alpha", "Roughness α", 0.3, 0.01, 2.0, 0.01, (1e-6, 1e6))

SUBJECTS: dict[str, Subject] = {
    "tent": _warp("Tent", "plane", "p(x, y) = (1 − |x|) (1 − |y|)", "square_to_tent"),
    "uniform_disk": _warp("Uniform disk", "disk", "p(x, y) = 1/π", "square_to_uniform_disk"),
    "uniform_sphere": _warp(
        "Uniform sphere", "sphere", "p(ω) = 1/(4π)", "square_to_uniform_sphere"
    ),
    "uniform_hemisphere": _warp(
        "Uniform hemisphere", "hemisphere", "p(ω) = 1/(2π)", "square_to_uniform_hemisphere"
    ),
    "cosine_hemisphere": _warp(
        "Cosine hemisphere", "hemisphere", "p(ω) = cos θ / π", "square_to_cosine_hemisphere"
    ),
    "beckmann": _warp("Beckmann", "hemisphere", _BECKMANN, "square_to_beckmann", _ALPHA),
    "hierarchical": Subject(
        title="Hierarchical (image)",
        group="Warps",
        domain="image",
        density="p(x, y) ∝ luminance of the image",
        names=("HierarchicalWarp",),
        make=_hierarchical,
        takes_image=True,
    ),
    "no_op": Subject("No-op", "Warps", "square", "p(x, y) = 1", (), _no_op),
    "triangle": Subject(
        title="Triangle",
        group="Shapes",
        domain="square",
        density="p(x, y) = 1 / area = 2",
        names=("sample_triangle", "sample_triangle_pdf"),
        make=_triangle,
        parameters=(Parameter("apex", "Third corner, x", 0.3, 0.0, 1.0, 0.05),),
    ),
    "sphere_cap": Subject(
        title="Spherical cap",
        group="Shapes",
        domain="sphere",
        density="p(ω) = 1 / (2π (1 − cos θmax))",
        names=("sample_sphere_cap", "sample_sphere_cap_pdf"),
        make=lambda get, cos_theta_max: _two_functions(get, "sample_sphere_cap", cos_theta_max),
        parameters=(Parameter("cos_theta_max", "cos θmax", 0.5, -1.0, 0.99, 0.01),),
    ),
    "quad_light": _light("Rectangle light", _OVER_AREA, _quad_light, "Quad"),
    "triangle_light": _light("Triangle light", _OVER_AREA, _triangle_light, "Triangle"),
    "sphere_light": _light("Sphere light", "p(ω) = 1 / Ω of its cone", _sphere_light, "Sphere"),
    "two_lights": _light(
        "Two lights", "p(ω) = mean of both", _two_lights, "SurfaceGroup", "Sphere", "Triangle"
    ),
}
"""All subjects by name."""
