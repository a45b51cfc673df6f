"""Reference formulas for fog and polarizers, and a random walk of photons in NumPy."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def absorb(
    transient_data: ArrayLike, mu_a: float, start_opl: float, bin_width_opl: float
) -> NDArray[Any]:
    """Apply absorption exp(-mu_a s) [1/m] to radiance per bin (height, width, bins, channels).

    Light is assumed to be spread evenly over the path lengths s [m] of its bin.

    Example:
        >>> absorb(np.ones((1, 1, 2, 1)), 1.0, 0.0, 1.0).ravel().round(4)
        array([0.6321, 0.2325])
    """
    light = np.asarray(transient_data)
    edges = start_opl + bin_width_opl * np.arange(light.shape[2] + 1)
    transmittance = np.exp(-mu_a * edges)
    depth = mu_a * bin_width_opl
    mean = -np.diff(transmittance) / depth if depth > 1e-6 else transmittance[:-1]
    return light * mean[:, None]


def sample_turn(xi: ArrayLike, g: float) -> NDArray[Any]:
    """Sample the cosine of the scattering angle by Henyey and Greenstein's phase function (1941).

    The density of the cosine is (1 - g²) / (2 (1 + g² - 2 g cos)^1.5), and its mean is g. The
    uniform random numbers `xi` are in [0, 1].

    Example:
        >>> sample_turn([0.0, 0.5, 1.0], 0.5)
        array([-1.    ,  0.6875,  1.    ])
    """
    xi = np.asarray(xi, np.float64)
    if abs(g) < 1e-6:
        return 2 * xi - 1
    ratio = (1 - g * g) / (1 - g + 2 * g * xi)
    return np.clip((1 + g * g - ratio * ratio) / (2 * g), -1, 1)


def wander(
    random: np.random.Generator, mu_s: float, g: float, opl: float, count: int
) -> NDArray[Any]:
    """Simulate positions (count, 3) [m] of photons in endless fog after a path length `opl` [m].

    All photons start at the origin along +z. They scatter mu_s times per meter on average, by the
    angles of `sample_turn`.

    Example:
        >>> wander(np.random.default_rng(0), 0.0, 0.5, 3.0, 2)
        array([[0., 0., 3.],
               [0., 0., 3.]])
    """
    # Start at the origin
    p = np.zeros((count, 3))
    d = np.zeros((count, 3))
    d[:, 2] = 1
    remaining = np.full(count, float(opl))
    flies = remaining > 0
    while flies.any():
        # Sample a free-flight distance, limited to the remaining path length
        n = int(flies.sum())
        step = random.exponential(1 / mu_s, n) if mu_s > 0 else np.full(n, np.inf)
        step = np.minimum(step, remaining[flies])
        p[flies] += step[:, None] * d[flies]
        remaining[flies] -= step

        # Scatter
        d[flies] = _scattered(d[flies], sample_turn(random.random(n), g), random.random(n))
        flies = remaining > 0
    return p


def _scattered(d: NDArray[Any], cosine: NDArray[Any], xi: NDArray[Any]) -> NDArray[Any]:
    """Rotate directions by angles with a given cosine, at uniform azimuths.

    Frames are constructed as by Duff et al. (2017).
    """
    # Construct a frame around each direction
    sign = np.copysign(1.0, d[:, 2])
    a = -1 / (sign + d[:, 2])
    b = d[:, 0] * d[:, 1] * a
    s = np.stack([1 + sign * d[:, 0] ** 2 * a, sign * b, -sign * d[:, 0]], axis=1)
    t = np.stack([b, sign + d[:, 1] ** 2 * a, -d[:, 1]], axis=1)

    # Rotate in this frame
    sine = np.sqrt(1 - cosine**2)
    angle = 2 * np.pi * xi
    local = np.stack([sine * np.cos(angle), sine * np.sin(angle), cosine], axis=1)
    scattered = np.einsum("na,nax->nx", local, np.stack([s, t, d], axis=1))
    return scattered / np.linalg.norm(scattered, axis=1, keepdims=True)


def through_polarizer(stokes: ArrayLike, angle: float) -> NDArray[Any]:
    """Return Stokes vectors (in the last axis) after an ideal linear polarizer at an angle [rad].

    The angle 0 transmits S1 > 0, and pi/4 transmits S2 > 0.

    Example:
        >>> through_polarizer([1.0, 0.6, 0.0, 0.0], 0.0).tolist()
        [0.8, 0.8, 0.0, 0.0]
    """
    s0, s1, s2, _ = np.moveaxis(np.asarray(stokes, np.float64), -1, 0)
    cosine = np.cos(2 * angle)
    sine = np.sin(2 * angle)
    passed = 0.5 * (s0 + s1 * cosine + s2 * sine)
    return np.stack([passed, passed * cosine, passed * sine, 0 * passed], axis=-1)
