"""Pyramid of pictures, with one picture for each strategy of bidirectional path tracing."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING

import mitsuba as mi
import numpy as np
import xarray as xr

from ..films.recording import recording, warn_not_finite
from ..integrators.passes import steps
from ..runtime import checks, memory, variants
from ..runtime.progress import ProgressBar
from ..scenes.loading import load_plugin
from .dataset import DIMS, coordinates
from .job import film_of_light, sampler_for
from .labels import labeled
from .renderer import open_scene
from .settings import RenderSettings
from .time_window import check_window, windowed_film

if TYPE_CHECKING:
    from ..films.transient import TransientHDRFilm
    from ..integrators.base import TransientIntegrator

# Plugin of the integrator
KIND = "transient_bdpt"

# Default of the longest path in segments
DEFAULT_DEPTH = 4

# Parameters that are copied from the scene's integrator
OWN = ("rr_depth", "hide_emitters")

# Parameters that the pyramid sets, so that the argument `parameters` must not contain them
VARIED = ("type", "strategy", "mis", "camera_connections", "max_depth")


def strategy_pyramid(
    scene: mi.Scene | Mapping[str, object] | str | PathLike[str],
    *,
    max_depth: int = DEFAULT_DEPTH,
    mis: str = "power",
    parameters: Mapping[str, object] | None = None,
    spp: int | None = None,
    seed: int = 0,
    size: tuple[int, int] | None = None,
    sensor: int = 0,
    window: str | tuple[float, float] | None = None,
    bins: int | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Render each strategy (s, t) of `transient_bdpt` alone, weighted and unweighted.

    Strategy (s, t) samples paths with s vertices from a light and t vertices from the lens. These
    paths have s + t - 1 segments. An unweighted picture is the estimate of a single strategy for
    all light of this length. The strategies of one length agree where they can sample the light,
    and differ in noise. Weighted by MIS, the pictures of all strategies add up to the picture of
    `transient_bdpt`. See also `pyramid_figure`.

    Args:
        scene: As for `render`.
        max_depth: Longest path in segments, 2 to 64: n segments make n (n + 3) / 2 strategies.
        mis: Weights, "power" or "balance".
        parameters: Further parameters of `transient_bdpt`, by name; `rr_depth` and `hide_emitters`
            are by default the scene's.
        spp: Samples per pixel of each picture, 1 to 2^24; by default the scene's.
        seed: Seed of all random numbers.
        size: Width and height [pixels]; by default the film's.
        sensor: Index of the sensor.
        window: As for `render`; "auto" uses the light of all strategies together.
        bins: Number of bins; by default the film's.
        progress: Whether to show a progress bar for work of more than two seconds.

    Returns:
        A Dataset with `transient (weighting, strategy, y, x, opl, channel)` and `steady
        (weighting, strategy, y, x, channel)` [W m^-2 sr^-1]. `weighting` is "mis" or "none",
        `strategy` is "s,t", with s and t as coordinates too. The attributes describe the window,
        the samples and the arguments, with the names that `render` uses.

    Raises:
        ValueError: An argument or the scene is wrong.
        MemoryError: The pictures do not fit.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=8, height=8, temporal_bins=50, bin_width_opl=0.3)
        >>> pyramid = strategy_pyramid(scene, max_depth=2, spp=4)
        >>> [str(name) for name in pyramid.strategy.values]
        ['0,2', '1,1', '0,3', '1,2', '2,1']
    """
    # Check the arguments
    variants.require_vectorized()
    variants.require_unpolarized()
    kind = {"type": KIND, "max_depth": max_depth}
    settings = RenderSettings(
        scene=scene,
        spp=spp,
        seed=seed,
        size=size,
        bins=bins,
        window=window,
        integrator=kind,
        sensor=sensor,
    )
    checks.one_of("mis", mis, ("power", "balance"))
    checks.boolean("progress", progress)
    shared = checks.mapping("parameters", parameters)
    for name in VARIED:
        if name in shared:
            raise ValueError(f"parameters with {name!r}: must be others, a pyramid gives this one")
    shared |= kind

    # Are the parameters of the integrator valid?
    load_plugin("integrator", shared | {"mis": mis})

    # Load the scene, and complete the parameters with the scene's values
    scene, _ = open_scene(settings)
    own = scene.integrator()
    values = {name: getattr(own, name, None) for name in OWN}
    shared = {name: value for name, value in values.items() if value is not None} | shared
    tracer = load_plugin("integrator", shared | {"mis": mis})

    # Find the window, the sampler and the strategies
    camera = scene.sensors()[sensor]
    plan = tracer.plan(scene, camera)
    film, profile, arrivals = film_of_light(plan, tracer, camera, settings)
    check_window(film, arrivals, profile)
    points = sampler_for(camera, None, spp)
    strategies = [
        (s, segments + 1 - s) for segments in range(1, max_depth + 1) for s in range(segments + 1)
    ]

    # Do all pictures fit into memory?
    copies = 2 * len(strategies) + 2
    memory.require_film(*film.shape, copies=copies, device_copies=2, host_copies=copies)

    # Render each strategy, weighted and unweighted
    steady = []
    transient = []
    total = 2 * len(strategies)
    with ProgressBar("Rendering", total, unit="picture", enabled=progress) as bar:
        for weighting, (s, t) in itertools.product((mis, "none"), strategies):
            alone = shared | {"mis": weighting, "strategy": f"{s},{t}"}
            tracer = load_plugin("integrator", alone)
            picture = _picture(tracer, scene, camera, film, points, seed)
            steady.append(picture[0])
            transient.append(picture[1])
            bar.update(1)

    # Make the Dataset
    variables = {}
    for name, pictures in (("transient", transient), ("steady", steady)):
        stacked = np.stack(pictures).reshape(2, len(strategies), *pictures[0].shape)
        variables[name] = ("weighting", "strategy", *DIMS[name]), stacked
    strategy = {
        "weighting": ["mis", "none"],
        "strategy": [f"{s},{t}" for s, t in strategies],
        "s": ("strategy", [s for s, _ in strategies]),
        "t": ("strategy", [t for _, t in strategies]),
    }
    attrs = {
        "scene": settings.scene_label,
        "quantity": "radiance per bin",
        "units": "W m^-2 sr^-1",
        "start_opl": film.start_opl,
        "bin_width_opl": film.bin_width_opl,
        "max_depth": max_depth,
        "mis": mis,
        "spp": points.sample_count(),
        "seed": seed,
    }
    return labeled(xr.Dataset(variables, coordinates(film) | strategy, attrs))


def _picture(
    tracer: TransientIntegrator,
    scene: mi.Scene,
    camera: mi.Sensor,
    film: TransientHDRFilm,
    points: mi.Sampler,
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Render a strategy on a new film like `film`. Return the steady and the transient picture."""
    window = film.start_opl, film.end_opl()
    own = windowed_film(film, window, film.shape[2])
    record = recording(own, tracer.exposure())
    for _ in steps(tracer.plan(scene, camera), record, camera, points.clone(), seed):
        pass
    warn_not_finite(record.accumulation.not_finite)
    return own.take()
