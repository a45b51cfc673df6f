"""The commands `tofrender doppler` and `tofrender fmcw`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from ..io.command_files import DOPPLER, DOPPLER_LAYERS, ESTIMATES, RANGE_RATE, SPECTRA
from ..motion.choices import MAX_CYCLES, MAX_LOOKS, WAVEFORMS, WINDOWS
from ..runtime import checks
from ..runtime.progress import deferred_stop
from . import checkpoints, options as opt
from .answers import Json, answer
from .time import first_pixel, load, values

if TYPE_CHECKING:
    from ..films.rate_bins import Axis

MAX_VALUES = (1 << 29) - 1
"""Largest number of values of an array in a NetCDF 3 file."""

FEWER_BINS = "a narrower --window or --rates, a lower --bandwidth or a shorter --chirp"
"""Options that reduce the number of bins."""


def _window(name: str, value: Any) -> str | tuple[float, float]:
    """Check a window: auto, or its start and stop [m]."""
    found = opt.span(name, value)
    checks.require(name, value, found != opt.SCENE_TIME, "auto or start,stop in meters of path")
    return found


def _rates(name: str, value: Any) -> tuple[float, float]:
    """Check the start and stop of rates [m/s]."""
    ends = [opt.number(end) for end in str(value).split(",")]
    allowed = "start,stop in meters per second, like -6,6"
    checks.require(name, value, not any(isinstance(end, str) for end in ends), allowed)
    return checks.interval(name, ends, allowed)


@dataclass(frozen=True)
class Modulation:
    """Options of the modulation of a Doppler ToF camera."""

    freq: Annotated[float, opt.frequency("Modulation frequency")] = 30e6
    exposure: Annotated[float, opt.positive("seconds", "Exposure time [s]")] = 1.5e-3
    cycles: Annotated[
        int,
        opt.integer(
            1,
            MAX_CYCLES,
            "Modulation cycles of the sensor in one exposure, minus the cycles of the light",
        ),
    ] = 1
    waveform: Annotated[
        str, opt.choice(WAVEFORMS, "Correlation of the modulation of light and sensor")
    ] = "sine"


@opt.with_groups
def doppler(
    scene: opt.Scene,
    out: opt.Out,
    *,
    modulation: Modulation,
    picture: opt.Picture,
    drawing: opt.Drawing,
    stopping: checkpoints.Stopping,
    as_json: Json = False,
) -> None:
    """Simulate a Doppler ToF camera in a moving scene.

    The command writes I and Q of the homodyne and the heterodyne measurement to doppler.nc and
    doppler.exr. With --waveform sine, both files also contain the rate of change of the path length
    [m/s], and the figure velocity.png shows the velocity.

    Examples:
        tofrender doppler corridor --out doppler
        tofrender doppler scene.xml --freq 50MHz --exposure 1e-3 --out doppler
    """
    waveform = modulation.waveform
    if waveform != "sine" and drawing != opt.Drawing():
        raise ValueError(
            f"--figure and --dpi require --waveform sine, because {waveform} does not give a "
            "velocity to draw. Remove the two options, or use --waveform sine"
        )
    opt.check_out(out)
    loaded, sensor, samples = load(scene, picture)
    from tofrender import io, vis
    from tofrender.io.netcdf import save_measurement
    from tofrender.motion.doppler_camera import doppler as measure, doppler_rate

    opt.check_disk_space(out, 2 * 6 * values(sensor))
    attrs: dict[str, Any] = {
        "frequency_hz": modulation.freq,
        "exposure_s": modulation.exposure,
        "cycles": modulation.cycles,
    }
    recipe = checkpoints.recipe_of(
        loaded,
        sensor,
        **attrs,
        waveform=waveform,
        spp=samples,
        seed=picture.seed,
        **vars(drawing),
    )
    if stopping.resume and checkpoints.answer_if_finished("doppler", out, DOPPLER, recipe, as_json):
        return
    with checkpoints.checkpointed(out, stopping.checkpoint, stopping.resume) as file:
        checkpoints.require_begun(stopping.resume, checkpoints.unfinished_work(out), out)
        note_rest(loaded)
        measured = measure(
            loaded, **attrs, waveform=waveform, spp=samples, seed=picture.seed, checkpoint=file
        )
        measured.attrs |= {"scene": scene, "quantity": "heterodyne"}
        layers = {
            f"{name}.{part}": measured[name].sel(part=part).values
            for name in ("homodyne", "heterodyne")
            for part in "IQ"
        }
        files = [DOPPLER, DOPPLER_LAYERS]
        if waveform == "sine":
            files.append(f"velocity.{drawing.figure}")
        facts = {
            "out": str(out),
            "files": files,
            "width": measured.sizes["x"],
            "height": measured.sizes["y"],
            "scene": scene,
            "frequency_hz": modulation.freq,
            "exposure": modulation.exposure,
            "cycles": modulation.cycles,
            "waveform": waveform,
            "spp": samples,
            "seed": picture.seed,
        }
        measured.attrs |= checkpoints.run_attribute(recipe, facts)
        with deferred_stop() as stop, io.output_folder(out, overwrite=True) as folder:
            if waveform == "sine":
                measured["rate"] = doppler_rate(measured)
                layers["rate"] = measured["rate"].values[..., None]
                drawn = vis.velocity_map(measured["rate"], **limit_of(loaded), title=scene)
                io.save_figure(drawn, folder / files[-1], **opt.dots(drawing.dpi))
            save_measurement(measured, folder / files[0])
            first = first_pixel(sensor)
            io.save_exr_layers(folder / files[1], layers, attrs, first_pixel=first)
    answer("doppler", as_json, facts, [f"{out}: {', '.join(files)}"])
    checkpoints.end_if_stopped(stop)


@dataclass(frozen=True)
class Chirps:
    """Options of the chirps of an FMCW lidar, and of their spectra."""

    bandwidth: Annotated[float, opt.positive("hertz", "Bandwidth of a chirp [Hz]")] = 1e9
    chirp: Annotated[float, opt.positive("seconds", "Duration of a chirp [s]")] = 1e-5
    wavelength: Annotated[float, opt.positive("meters", "Wavelength of the laser [m]")] = 1.55e-6
    window_function: Annotated[str, opt.choice(WINDOWS, "Window function of the spectra")] = "hann"
    looks: Annotated[
        int,
        opt.integer(
            0, MAX_LOOKS, "Number of measurements with speckle to average, 0 for the expectation"
        ),
    ] = 0
    photons: Annotated[
        float | None,
        opt.positive("photons", "Mean number of photons in a chirp", show_default="no shot noise"),
    ] = None


@dataclass(frozen=True)
class Axes:
    """Options of the bins of path lengths and rates."""

    window: Annotated[
        Any,
        opt.checked(
            _window,
            "Start and stop of the path lengths [m].",
            metavar="auto|START,STOP",
            show_default=opt.FROM_SCENE,
        ),
    ] = None
    bins: Annotated[int | None, opt.setting("bins", default="two per resolution of the lidar")] = (
        None
    )
    rates: Annotated[
        Any,
        opt.checked(
            _rates,
            "Start and stop of the rates of change of the path length [m/s].",
            metavar="START,STOP",
            show_default="from the fastest part of the scene",
        ),
    ] = None
    rate_bins: Annotated[
        int | None,
        opt.integer(
            2,
            checks.MAX_BINS,
            "Number of bins of the rates",
            show_default="two per resolution of the lidar",
        ),
    ] = None


@opt.with_groups
def fmcw(
    scene: opt.Scene,
    out: opt.Out,
    *,
    chirps: Chirps,
    axes: Axes,
    picture: opt.Picture,
    drawing: opt.Drawing,
    stopping: checkpoints.Stopping,
    as_json: Json = False,
) -> None:
    """Simulate an FMCW lidar in a moving scene.

    The command renders the light over path length and its rate of change. It writes three NetCDF
    files: range_rate.nc is this light, spectra.nc contains the spectra of the beats of up and down
    chirps, and estimates.nc the path length and the rate of each pixel. The figure
    range_velocity.png shows the light of all pixels, and velocity.png the estimated velocities.

    Examples:
        tofrender fmcw fan --out fan
        tofrender fmcw scene.xml --bandwidth 2e9 --chirp 2e-5 --size 32x24 --out beats
    """
    opt.check_out(out)
    loaded, sensor, samples = load(scene, picture)
    from tofrender import io, vis
    from tofrender.io.netcdf import save_measurement
    from tofrender.motion.fmcw import Fmcw
    from tofrender.motion.range_rate_film import default_rates, range_rate

    waves: Any = {
        "bandwidth_hz": chirps.bandwidth,
        "chirp_s": chirps.chirp,
        "wavelength_m": chirps.wavelength,
    }
    spectrum: Any = {"looks": chirps.looks, "photons": chirps.photons}
    lidar = Fmcw(**waves, window=chirps.window_function, **spectrum)
    opl = _axis(_span(loaded, axes.window), axes.bins, lidar.resolution[0])
    rate = _axis(axes.rates or default_rates(loaded), axes.rate_bins, lidar.resolution[1])
    of_pixel = opl.count * rate.count, lidar.samples(opl, rate)
    if picture.size is None and values(sensor) * max(of_pixel) > MAX_VALUES // 4:
        size = _largest_size(sensor, max(of_pixel), MAX_VALUES // 4)
        opt.note(
            f"note: rendering {size} pixels, so that the film has half a gigabyte; --size allows "
            f"up to {_largest_size(sensor, max(of_pixel), MAX_VALUES)}, and more with {FEWER_BINS}"
        )
        loaded, sensor, samples = load(scene, replace(picture, size=size))
    sizes = tuple(values(sensor) * each for each in of_pixel)
    if max(sizes) > MAX_VALUES:
        wanted = opt.Size(*(int(n) for n in sensor.film().crop_size()))
        raise ValueError(
            f"--size = {wanted}: the files would contain {max(sizes):,} values, because each pixel "
            f"has {opl.count} x {rate.count} bins. At most {MAX_VALUES:,} are possible. Use --size "
            f"{_largest_size(sensor, max(of_pixel), MAX_VALUES)} or less, or {FEWER_BINS}"
        )
    opt.check_disk_space(out, *sizes)
    film_axes: Any = {
        "bins": opl.count,
        "window": (opl.start, opl.start + opl.count * opl.width),
        "rate_bins": rate.count,
        "rates": (rate.start, rate.start + rate.count * rate.width),
    }
    recipe = checkpoints.recipe_of(
        loaded,
        sensor,
        **waves,
        **film_axes,
        window_function=chirps.window_function,
        **spectrum,
        spp=samples,
        seed=picture.seed,
        **vars(drawing),
    )
    if stopping.resume and checkpoints.answer_if_finished("fmcw", out, RANGE_RATE, recipe, as_json):
        return
    with checkpoints.checkpointed(out, stopping.checkpoint, stopping.resume) as file:
        checkpoints.require_begun(stopping.resume, file and file.path, out)
        film = range_rate(loaded, **film_axes, spp=samples, seed=picture.seed, checkpoint=file)
        note_rest(loaded)
        film.attrs["scene"] = scene
        spectra = lidar.spectra(film, picture.seed)
        estimates = lidar.estimates(spectra)
        drawn = {
            f"range_velocity.{drawing.figure}": vis.range_velocity_map(film, lidar=lidar),
            f"velocity.{drawing.figure}": vis.velocity_map(
                estimates["rate"], **limit_of(loaded), title=scene
            ),
        }
        saved = {RANGE_RATE: film, SPECTRA: spectra, ESTIMATES: estimates}
        files = [*saved, *drawn]
        outside = film.attrs["energy_outside_window"]
        facts = {
            "out": str(out),
            "files": files,
            "width": film.sizes["x"],
            "height": film.sizes["y"],
            "scene": scene,
            "resolution": lidar.resolution[0],
            "rate_resolution": lidar.resolution[1],
            "bins": opl.count,
            "rate_bins": rate.count,
            "spp": samples,
            "seed": picture.seed,
            "energy_outside_window": outside,
        }
        film.attrs |= checkpoints.run_attribute(recipe, facts)
        with deferred_stop() as stop, io.output_folder(out, overwrite=True) as folder:
            for name, dataset in saved.items():
                save_measurement(dataset.drop_vars("time", errors="ignore"), folder / name)
            for name, each in drawn.items():
                io.save_figure(each, folder / name, **opt.dots(drawing.dpi))
    about = f"resolution {lidar.resolution[0]:.4g} m and {lidar.resolution[1]:.4g} m/s of path"
    lines = [f"{out}: {', '.join(files)}", f"{about}, {outside:.1%} of the energy outside the bins"]
    answer("fmcw", as_json, facts, lines)
    checkpoints.end_if_stopped(stop)


def _largest_size(sensor: Any, of_pixel: int, most: int) -> opt.Size:
    """Return the largest size with the sensor's ratio of sides and at most `most` values.

    Args:
        sensor: The scene's sensor.
        of_pixel: Number of values of a pixel and channel.
        most: Largest number of values in three channels.
    """
    shrink = min(1.0, math.sqrt(most / values(sensor) / of_pixel))
    width, height = (max(int(int(n) * shrink), 1) for n in sensor.film().crop_size())
    return opt.Size(width, height)


def _span(scene: Any, window: Any) -> tuple[float, float]:
    """Return the start and stop of the path lengths [m].

    The window is given, or belongs to the film. For a film without bins it is automatic.
    """
    if window not in (None, "auto"):
        return window
    from tofrender.rendering.renderer import make_job, with_default_window
    from tofrender.rendering.settings import RenderSettings
    from tofrender.rendering.time_window import BINS

    settings = RenderSettings(scene, window=window, bins=BINS if window else None)
    film = make_job(with_default_window(settings)).film
    return film.start_opl, film.end_opl()


def _axis(span: tuple[float, float], bins: int | None, resolution: float) -> Axis:
    """Return the bins of a span. By default their number is odd, with two bins per resolution."""
    from tofrender.films.rate_bins import Axis

    start, stop = span
    count = bins
    if count is None:
        count = math.ceil(2 * (stop - start) / resolution * (1 - 1e-9)) + 1
        count += 1 - count % 2
    checks.integer("bins", count, 2, checks.MAX_BINS)
    return Axis(count, start, (stop - start) / count)


def note_rest(scene: Any) -> None:
    """Print a note if no part of a scene moves."""
    from tofrender.motion.range_rate_film import fastest

    if not fastest(scene):
        opt.note(
            "note: no part of this scene moves, so that all velocities are 0; the built-in scenes "
            "fan, corridor and moving_mirror move"
        )


def limit_of(scene: Any) -> dict[str, float]:
    """Return the limit of a velocity map: the speed of the fastest part, if a part moves."""
    from tofrender.motion.range_rate_film import fastest

    speed = fastest(scene)
    return {"limit_m_s": speed} if speed else {}
