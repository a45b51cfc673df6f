"""`render`: from a scene to a labelled Dataset, with everything checked before work starts."""

from __future__ import annotations

import os
from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any

import mitsuba as mi

from ..runtime import backend, checks
from ..runtime.checkpoints import Checkpoint
from ..runtime.withheld import Withheld
from ..scenes.checking import check_scene
from ..scenes.loading import load_plugin, load_scene, require_light, require_sensor
from ..scenes.packing import packed
from ..scenes.settings import INTEGRATORS
from .job import Job, carry_out, collect, decide
from .store import check_film
from .streaming import stream
from .window import is_auto, start_and_width, windowed_film
from .workers import require_client

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

ARGUMENTS = ("source", "integrator", "sampler")
"""What `load_scene` takes and `render` is told in another way."""


def render(
    scene: mi.Scene | Mapping[str, Any] | str | PathLike[str],
    *,
    spp: int | None = None,
    seed: int = 0,
    integrator: Any = None,
    sensor: int = 0,
    sampler: str | mi.Sampler | None = None,
    window: str | tuple[float, float] | None = None,
    temporal_bins: int | None = None,
    resume: xr.Dataset | None = None,
    settings: Mapping[str, Any] | None = None,
    errors: bool = False,
    checkpoint: Checkpoint | str | PathLike[str] | None = None,
    out: str | PathLike[str] | None = None,
    client: Client | None = None,
    progress: bool = True,
) -> xr.Dataset:
    """Render a scene in time.

    Args:
        scene: A built-in name, the path of a Mitsuba XML file, a dict as for `mi.load_dict`, or a
            loaded scene.
        spp: Samples per pixel, 1 to 2^24; by default the scene's. Powers of two suit the default
            sampler best; Mitsuba's samplers round to what they can do.
        seed: Seed of all random numbers. Two renders with the same seed agree to float rounding.
        integrator: A plugin name, a dict or an integrator; by default the scene's. By name or dict
            it takes the place of the scene's while that is loaded, and what it does not say of
            `max_depth`, `rr_depth` and `hide_emitters` stays as it is there.
        sensor: Number of the sensor.
        sampler: `padded_sobol` by default, whatever the scene says: on the Cornell box, its steady
            picture has about half the variance of Mitsuba's default. A name picks another; an
            object is cloned, and its own `sample_count` counts if `spp` is not given.
        window: (start, stop) of the time bins, in metres of path; "auto" finds what holds 99.9 %
            of the light; by default the film's.
        temporal_bins: Number of bins; by default the film's.
        resume: A Dataset of the same render with fewer samples, stopped or complete, to go on
            from: only the samples that are missing are taken. `padded_sobol` goes on in the same
            point set.
        settings: What to change of the scene while it is loaded, keyword arguments of `load_scene`
            by name, for example {"width": 64, "max_depth": 4}.
        errors: Whether to measure what is noise: the samples are taken in 16 parts (8 or 4 where
            `spp` is no multiple of 16), each with points of its own, whose scatter tells.
        checkpoint: A `Checkpoint`, or the name of its file: the film so far is kept there every
            30 s and when the render is stopped. A call with equal arguments, `spp` apart, goes on
            from it to the same result.
        out: Name of a folder that ends in .zarr. The film streams to it, tile by tile, and may be
            larger than memory. The same call goes on with the tiles of a render that was stopped.
        client: A `distributed.Client`, whose workers render tiles or, for light that lands
            anywhere, shares of the samples. The scene must be a name, a file or a dict.
        progress: Whether to show a bar for work that takes more than two seconds.

    Returns:
        A Dataset with `transient (y, x, opl, channel)`, the radiance that arrives in each bin, and
        `steady (y, x, channel)`, that of all time [W m^-2 sr^-1]. Coordinates are pixels and bin
        centres [m]; attributes say how it was made, among them `energy_outside_window`, the
        fraction of the steady energy that no bin holds. With `errors`, `transient_error` and
        `steady_error` are standard errors: the truth is within one of them in 2 of 3 bins that many
        paths reach, and less often where few do. Ctrl-C, SIGTERM and SIGHUP return what is
        finished, with `complete` = 0 and `spp` as far as it got; a second one ends it at once.

    Raises:
        ValueError: An argument or the scene is wrong, or no light can reach the window.
        MemoryError: The bins do not fit; the message says what would.
        BackendError: The active variant cannot render in time.
        KeyboardInterrupt: A render with `out` or a client was stopped; one line.

    Warns:
        UserWarning: More than 1 % of the energy is outside the window, or the render was stopped.

    Example:
        >>> dataset = render("cornell_box", spp=1, window=(3.5, 15.0))
        >>> dict(dataset.sizes)
        {'y': 256, 'x': 256, 'opl': 300, 'channel': 3}
    """
    checks.boolean("progress", progress)
    if client is not None:
        require_client(client)
    if out is not None:
        check_film(out)
    if out is not None and checkpoint is not None:
        raise ValueError("checkpoint: must be left out with `out`, which keeps all tiles")
    if resume is not None and (out is not None or client is not None):
        raise ValueError("resume: must be left out with `out` and with a client; see `merge`")
    if client is not None:
        packed("scene", scene)  # Refuses what cannot be sent
    job = make_job(
        scene,
        spp=spp,
        seed=checks.integer("seed", seed, 0, checks.MAX_SEED),
        integrator=integrator,
        sensor=sensor,
        sampler=sampler,
        settings=settings,
        window=window,
        temporal_bins=temporal_bins,
        errors=checks.boolean("errors", errors),
    )
    if out is not None:
        return stream(job, out, client=client, progress=progress)
    if client is not None:
        return collect(job, client, checkpoint, progress)
    return carry_out(job, resume, checkpoint, progress)


def make_job(
    scene: Any,
    *,
    spp: int | None = None,
    seed: int = 0,
    integrator: Any = None,
    sensor: int = 0,
    sampler: Any = None,
    settings: Mapping[str, Any] | None = None,
    window: Any = None,
    temporal_bins: int | None = None,
    bins: tuple[int, float, float] | None = None,
    errors: bool = False,
) -> Job:
    """Decide what is rendered.

    The arguments are those of `render`; `bins`, if they were decided elsewhere, are their number,
    start and width [m].
    """
    arguments = {
        "scene": scene,
        "spp": spp,
        "seed": seed,
        "integrator": integrator,
        "sensor": sensor,
        "sampler": sampler,
        "settings": settings,
        "errors": errors,
    }
    if bins is not None:
        window, temporal_bins = (bins[1], bins[1] + bins[0] * bins[2]), bins[0]
    loaded, number, apart = opened(scene, sensor, integrator, window, temporal_bins, settings)
    tracer = _integrator(loaded, apart)
    if tracer.needs_lights:
        require_light(loaded)
    return decide(
        tracer.plan(loaded, loaded.sensors()[number]),
        tracer,
        loaded,
        name=scene_name(scene),
        sensor=number,
        spp=spp,
        seed=seed,
        sampler=sampler,
        window=window,
        temporal_bins=temporal_bins,
        bins=bins,
        errors=errors,
        origin=(make_job, arguments),
    )


# ------------------------------------------------------------------------ before rendering


def scene_name(scene: Any) -> str:
    """What a Dataset calls a scene: its name or path, else "scene"."""
    return os.fspath(scene) if isinstance(scene, str | PathLike) else "scene"


def opened(
    scene: Any,
    sensor: Any,
    integrator: Any,
    window: Any,
    temporal_bins: int | None,
    settings: Mapping[str, Any] | None = None,
) -> tuple[mi.Scene, int, Any]:
    """Load and check a scene: gives it, the sensor's number, and the integrator if it is apart.

    The arguments are those of `render`.
    """
    backend.require_vectorised()
    settings = checks.mapping("settings", settings)
    for name in ARGUMENTS:
        if name in settings:
            raise ValueError(f"settings with {name!r}: must be others, this is an argument")
    if not isinstance(scene, mi.Scene):
        more = _settings(integrator, window, temporal_bins)
        scene = load_scene(scene, **(settings | more))
        if isinstance(integrator, str | Mapping):
            integrator = None  # It is the scene's now
    elif settings:
        raise ValueError("settings: must be left out with a loaded scene, which cannot be changed")
    require_sensor(scene)
    sensors = scene.sensors()
    sensor = checks.integer("sensor", sensor, 0, len(sensors) - 1)
    check_scene(scene, sensors[sensor])
    windowed_film(sensors[sensor].film(), window, temporal_bins)  # Refuses a wrong window first
    return scene, sensor, integrator


def _integrator(scene: mi.Scene, integrator: Any) -> Any:
    """The integrator to use."""
    if isinstance(integrator, str):
        integrator = {"type": checks.one_of("integrator", integrator, INTEGRATORS)}
    if isinstance(integrator, Mapping):
        integrator = load_plugin("integrator", integrator)
    found = scene.integrator() if integrator is None else integrator
    withheld = getattr(found, "withheld", None)
    if withheld is not None:
        raise Withheld(f"integrator = {withheld}")
    if not getattr(found, "fills_bins", False):
        cls = type(found)
        foreign = cls.__module__.partition(".")[0] not in ("mitsuba", "builtins", "tofrender")
        if foreign:
            kind = f"{cls.__module__}.{cls.__name__}"
        elif cls.__module__ == "mitsuba":
            kind = found.class_name()
        else:
            kind = repr(found) if isinstance(found, int | str | None) else cls.__name__
        raise ValueError(
            f"integrator = {kind}: cannot render in time; must be one of {', '.join(INTEGRATORS)}"
            + (", as this package has it: give the scene as a dict or file" if foreign else "")
        )
    return found


def _settings(integrator: Any, window: Any, temporal_bins: int | None) -> Any:
    """What makes a steady scene transient while it loads, where enough is given.

    An integrator takes the place of the scene's, which need not even load; for an object that is
    at hand any other keeps the place.
    """
    by_name = integrator is None or isinstance(integrator, str | Mapping)
    given = {"integrator": integrator if by_name else INTEGRATORS[0]}
    if window is None or temporal_bins is None:
        return given
    bins = checks.integer("temporal_bins", temporal_bins, 1, checks.MAX_BINS)
    start, width = (0.0, 1.0) if is_auto(window) else start_and_width(window, bins)
    return given | {"temporal_bins": bins, "start_opl": start, "bin_width_opl": width}
