"""What the warp tester can show: warps, shapes and lights, whoever has written them.

Each is made of functions or classes that are looked up by name: in `tofrender.sampling`, or in a
student's file. The names and their contracts are those of the course's problems.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...runtime import checks
from ...sampling import domains, images

Lookup = Callable[[str], Any]
Functions = tuple[Callable[[Any], Any], Callable[[Any], Any]]

EXAMPLE_IMAGE = np.array([[4.0, 4.0], [1.0, 1.0]])
"""The 2 x 2 image of the course: 80 % of the light in the upper row."""

MAX_SIDE = 512
"""Most pixels along a side of an image; larger ones are averaged."""


@dataclass(frozen=True)
class Parameter:
    """A number that can be changed.

    Attributes:
        name: In files and options.
        label: In the window.
        default: Where it starts.
        low: Where the slider starts.
        high: Where the slider ends.
        step: Of the slider.
        allowed: Least and greatest value, if they are not the slider's.
    """

    name: str
    label: str
    default: float
    low: float
    high: float
    step: float
    allowed: tuple[float, float] | None = None

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest value."""
        return self.allowed or (self.low, self.high)


@dataclass(frozen=True)
class Subject:
    """A sampler with its density.

    Attributes:
        title: In the window.
        group: "Warps", "Shapes" or "Lights".
        domain: Where its points lie, a name in `tofrender.sampling.domains.DOMAINS`.
        density: What the density should be, in words of mathematics.
        names: Names that a file has to define, the sampler's first; none where nobody writes it.
        make: Called with a lookup of these names and the values of the parameters; returns
            `sample` and `pdf` as `chi_square_test` takes them.
        parameters: Numbers that can be changed.
        takes_image: Whether it is given an image, as `image`.
    """

    title: str
    group: str
    domain: str
    density: str
    names: tuple[str, ...]
    make: Callable[..., Functions]
    parameters: tuple[Parameter, ...] = ()
    takes_image: bool = False

    @property
    def dimensions(self) -> int:
        """Coordinates of a point: 2 in the plane, 3 on the sphere."""
        return domains.find(self.domain).dimensions

    def values(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """All parameters, with defaults for those that are not given.

        Raises:
            ValueError: One is unknown or out of range; one line.

        Example:
            >>> SUBJECTS["beckmann"].values({})
            {'alpha': 0.3}
        """
        known = {each.name: each for each in self.parameters}
        values: dict[str, Any] = {name: each.default for name, each in known.items()}
        if self.takes_image:
            values["image"] = EXAMPLE_IMAGE
        for name, value in given.items():
            if name not in values:
                takes = " and ".join(values) or "none"
                raise ValueError(
                    f"{name} = {checks.quote(value)}: must be left out; "
                    f"{self.title.lower()} has the parameters: {takes}"
                )
            if name == "image":
                values[name] = density_of(value)
            else:
                low, high = known[name].bounds
                values[name] = float(checks.number(name, value, low=low, high=high))
        return values


def density_of(image: Any) -> np.ndarray:
    """The luminance of an image on a grid of 2^M x 2^M pixels, at most `MAX_SIDE` a side.

    Args:
        image: What `HierarchicalWarp` takes: a path, a bitmap or an array.

    Raises:
        ValueError: It is no image; one line.

    Example:
        >>> density_of(np.ones((3, 600))).shape
        (512, 512)
    """
    from ...signals.colour import luminance

    weights = luminance(images.read_image(image))
    side = min(images.power_of_two(max(weights.shape)), MAX_SIDE)
    return weights if weights.shape == (side, side) else images.resized(weights, side)


def named(name: str, values: Mapping[str, Any]) -> str:
    """A subject with its numbers, for verdicts.

    Example:
        >>> named("beckmann", {"alpha": 0.3})
        'beckmann (alpha = 0.3)'
    """
    numbers = [f"{key} = {value:g}" for key, value in values.items() if key != "image"]
    return f"{name} ({', '.join(numbers)})" if numbers else name


# ------------------------------------------------------------------------------ how each is made


def _two_functions(get: Lookup, name: str, *values: float) -> Functions:
    sample, pdf = get(name), get(f"{name}_pdf")
    return lambda u: sample(u, *values), lambda p: pdf(p, *values)


def _warp(name: str, density: str, domain: str, title: str, *parameters: Parameter) -> Subject:
    return Subject(
        title=title,
        group="Warps",
        domain=domain,
        density=density,
        names=(name, f"{name}_pdf"),
        make=lambda get, **values: _two_functions(get, name, *values.values()),
        parameters=parameters,
    )


def _no_op(get: Lookup) -> Functions:
    import drjit as dr
    import mitsuba as mi

    def pdf(p: mi.Point2f) -> mi.Float:
        inside = (p.x >= 0) & (p.x <= 1) & (p.y >= 0) & (p.y <= 1)
        return dr.select(inside, mi.Float(1), 0)

    return lambda u: u, pdf


def _hierarchical(get: Lookup, image: Any) -> Functions:
    warp = get("HierarchicalWarp")(np.asarray(image))
    return warp.sample, warp.pdf


def _triangle(get: Lookup, apex: float) -> Functions:
    import mitsuba as mi

    corners = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [float(apex), 1.0, 0.0]
    sample, pdf = get("sample_triangle"), get("sample_triangle_pdf")

    def flat(u: mi.Point2f) -> mi.Point2f:
        p = sample(*corners, u)
        return mi.Point2f(p.x, p.y)

    return flat, lambda p: pdf(mi.Point3f(p.x, p.y, 0), *corners)


def _cap(get: Lookup, cos_theta_max: float) -> Functions:
    return _two_functions(get, "sample_sphere_cap", float(cos_theta_max))


def _light(build: Callable[[Lookup, float], Any]) -> Callable[..., Functions]:
    """Directions from the origin to a light above it."""

    def make(get: Lookup, distance: float) -> Functions:
        import drjit as dr
        import mitsuba as mi

        light = build(get, float(distance))

        def sample(u: mi.Point2f) -> tuple[Any, Any, Any]:
            record = light.sample(dr.opaque(mi.Point3f, 0, dr.width(u)), u)
            return record.d, dr.select(record.valid, mi.Float(1), 0), record.pdf

        return sample, lambda v: light.pdf(dr.opaque(mi.Point3f, 0, dr.width(v)), v)

    return make


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
    ball = get("Sphere")((-0.9, 0.0, distance), 0.4, emission=1.0)
    corners = [0.3, -0.6, distance], [1.5, -0.6, distance], [0.9, 0.6, distance]
    return get("SurfaceGroup")([ball, get("Triangle")(*corners, emission=1.0)])


def _lamp(title: str, density: str, build: Callable[[Lookup, float], Any], *names: str) -> Subject:
    distance = Parameter("distance", "Distance [m]", 1.0, 0.6, 5.0, 0.05)
    return Subject(title, "Lights", "sphere", density, names, _light(build), (distance,))


OVER_AREA = "p(ω) = r² / (A |cos θ|)"

SUBJECTS: dict[str, Subject] = {
    "tent": _warp("square_to_tent", "p(x, y) = (1 − |x|) (1 − |y|)", "plane", "Tent"),
    "uniform_disk": _warp("square_to_uniform_disk", "p(x, y) = 1/π", "disk", "Uniform disk"),
    "uniform_sphere": _warp(
        "square_to_uniform_sphere", "p(ω) = 1/(4π)", "sphere", "Uniform sphere"
    ),
    "uniform_hemisphere": _warp(
        "square_to_uniform_hemisphere", "p(ω) = 1/(2π)", "hemisphere", "Uniform hemisphere"
    ),
    "cosine_hemisphere": _warp(
        "square_to_cosine_hemisphere", "p(ω) = cos θ / π", "hemisphere", "Cosine hemisphere"
    ),
    "beckmann": _warp(
        "square_to_beckmann",
        "p(ω) = exp(−tan²θ / α²) / (π α² cos³θ)",
        "hemisphere",
        "Beckmann",
        Parameter("alpha", "Roughness α", 0.3, 0.01, 2.0, 0.01, (1e-6, 1e6)),
    ),
    "hierarchical": Subject(
        "Hierarchical (image)",
        "Warps",
        "image",
        "p(x, y) ∝ luminance of the image",
        ("HierarchicalWarp",),
        _hierarchical,
        takes_image=True,
    ),
    "no_op": Subject("No-op", "Warps", "square", "p(x, y) = 1", (), _no_op),
    "triangle": Subject(
        "Triangle",
        "Shapes",
        "square",
        "p(x, y) = 1 / area = 2",
        ("sample_triangle", "sample_triangle_pdf"),
        _triangle,
        (Parameter("apex", "Third corner, x", 0.3, 0.0, 1.0, 0.05),),
    ),
    "sphere_cap": Subject(
        "Spherical cap",
        "Shapes",
        "sphere",
        "p(ω) = 1 / (2π (1 − cos θmax))",
        ("sample_sphere_cap", "sample_sphere_cap_pdf"),
        _cap,
        (Parameter("cos_theta_max", "cos θmax", 0.5, -1.0, 0.99, 0.01),),
    ),
    "quad_light": _lamp("Rectangle light", OVER_AREA, _quad_light, "Quad"),
    "triangle_light": _lamp("Triangle light", OVER_AREA, _triangle_light, "Triangle"),
    "sphere_light": _lamp("Sphere light", "p(ω) = 1 / Ω of its cone", _sphere_light, "Sphere"),
    "two_lights": _lamp(
        "Two lights", "p(ω) = mean of both", _two_lights, "SurfaceGroup", "Sphere", "Triangle"
    ),
}
"""Everything that can be shown, by its name."""
