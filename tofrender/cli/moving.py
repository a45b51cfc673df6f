"""The commands `tofrender doppler` and `tofrender fmcw`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

from ..io.contents import DOPPLER, DOPPLER_LAYERS, ESTIMATES, RANGE_RATE, SPECTRA
from ..motion.choices import MAX_CYCLES, MAX_LOOKS, WAVEFORMS, WINDOWS
from ..runtime import checks
from ..runtime.progress import EVERY_S, deferred_stop
from . import checkpoints, options as opt
from .answers import Json, answer
from .time import first_pixel, load, values

if TYPE_CHECKING:
    from ..films.rates import Axis

MOST = (1 << 29) - 1  # Values of an array in a NetCDF 3 file
FEWER_BINS = "a narrower --window or --rates, a lower --bandwidth or a shorter --chirp"


def _window(name: str, value: Any) -> str | tuple[float, float]:
    """Check a window: auto, or where it starts and stops."""
    found = opt.span(name, value)
    checks.require(name, value, found != opt.SCENE_TIME, "auto or start,stop in metres of path")
    return found


def _rates(name: str, value: Any) -> tuple[float, float]:
    """Check where rates start and stop."""
    ends = [opt.number(end) for end in str(value).split(",")]
    allowed = "start,stop in metres per second, like -6,6"
    checks.require(name, value, not any(isinstance(end, str) for end in ends), allowed)
    return checks.interval(name, ends, allowed)


def doppler(
    scene: opt.Scene,
    out: opt.Out,
    freq: Annotated[float, opt.frequency("Modulation frequency")] = 30e6,
    exposure: Annotated[float, opt.positive("seconds", "Exposure, seconds.")] = 1.5e-3,
    cycles: Annotated[
        int, opt.integer(1, MAX_CYCLES, "Cycles by which light and sensor differ in it.")
    ] = 1,
    waveform: Annotated[str, opt.choice(WAVEFORMS, "Correlation of light and sensor.")] = "sine",
    spp: opt.Spp = None,
    size: opt.Pixels = None,
    max_depth: opt.MaxDepth = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    figure: opt.Figure = "png",
    dpi: opt.Dpi = None,
    checkpoint: checkpoints.Seconds = EVERY_S,
    resume: checkpoints.Resume = False,
    as_json: Json = False,
) -> None:
    """Render what a Doppler time-of-flight camera measures of SCENE, whose parts move.

    The command writes I and Q of the homodyne and the heterodyne measurement to doppler.nc and
    doppler.exr. A sine tells the rate of change of path lengths [m/s] as well, which is in both
    files and, as a velocity, in the figure velocity.png; other waveforms have neither.
    """
    if waveform != "sine" and (figure != "png" or dpi is not None):
        raise ValueError(
            f"--waveform = {waveform}: has no figure; must be sine with --figure, --dpi"
        )
    opt.check_out(out)
    loaded, sensor, samples = load(scene, spp, size, max_depth, variant)
    from tofrender import io, vis
    from tofrender.io.netcdf import save_measurement
    from tofrender.motion.doppler_camera import doppler as measure, doppler_rate

    opt.check_disk_space(out, 2 * 6 * values(sensor))
    modulation: dict[str, Any] = {"frequency_hz": freq, "exposure_s": exposure, "cycles": cycles}
    pictures: Any = {"figure": figure, "dpi": dpi}
    recipe = checkpoints.recipe_of(
        loaded, sensor, **modulation, waveform=waveform, spp=samples, seed=seed, **pictures
    )
    if resume and checkpoints.answer_if_finished("doppler", out, DOPPLER, recipe, as_json):
        return
    with checkpoints.checkpointed(out, checkpoint, resume) as file:
        checkpoints.require_begun(resume, checkpoints.unfinished_work(out), out)
        keep: Any = {"spp": samples, "seed": seed, "checkpoint": file}
        measured = measure(loaded, **modulation, waveform=waveform, **keep)
        measured.attrs |= {"scene": scene, "quantity": "heterodyne"}
        layers = {
            f"{name}.{part}": measured[name].sel(part=part).values
            for name in ("homodyne", "heterodyne")
            for part in "IQ"
        }
        files = [DOPPLER, DOPPLER_LAYERS] + [f"velocity.{figure}"] * (waveform == "sine")
        width, height = measured.sizes["x"], measured.sizes["y"]
        facts = {"out": str(out), "files": files, "width": width, "height": height, "scene": scene}
        facts |= {"frequency_hz": freq, "exposure": exposure, "cycles": cycles}
        facts |= {"waveform": waveform, "spp": samples, "seed": seed}
        measured.attrs |= checkpoints.run_attribute(recipe, facts)
        with deferred_stop() as stop, io.output_folder(out, overwrite=True) as folder:
            if waveform == "sine":
                measured["rate"] = doppler_rate(measured)
                layers["rate"] = measured["rate"].values[..., None]
                drawn = vis.velocity_map(measured["rate"], **limit_of(loaded), title=scene)
                io.save_figure(drawn, folder / files[-1], **opt.dots(dpi))
            save_measurement(measured, folder / files[0])
            first = first_pixel(sensor)
            io.save_exr_layers(folder / files[1], layers, modulation, first_pixel=first)
    answer("doppler", as_json, facts, [f"{out}: {', '.join(files)}"])
    checkpoints.end_if_stopped(stop)


def fmcw(
    scene: opt.Scene,
    out: opt.Out,
    bandwidth: Annotated[float, opt.positive("hertz", "Bandwidth of a chirp, hertz.")] = 1e9,
    chirp: Annotated[float, opt.positive("seconds", "Duration of a chirp, seconds.")] = 1e-5,
    wavelength: Annotated[float, opt.positive("metres", "Wavelength, metres.")] = 1.55e-6,
    window_function: Annotated[str, opt.choice(WINDOWS, "Window of the spectra.")] = "hann",
    looks: Annotated[
        int, opt.integer(0, MAX_LOOKS, "Looks with speckle to average; 0: the expectation.")
    ] = 0,
    photons: Annotated[
        float | None,
        opt.positive("photons", "Mean photons of a chirp, for shot noise; else there is none."),
    ] = None,
    window: Annotated[
        Any,
        opt.checked(_window, "Path lengths, metres; else the scene's.", metavar="auto|START,STOP"),
    ] = None,
    bins: Annotated[
        int | None, opt.setting("bins", more="; else two in the lidar's resolution")
    ] = None,
    rates: Annotated[
        Any,
        opt.checked(
            _rates, "Rates of path lengths, m/s; else by the fastest part.", metavar="START,STOP"
        ),
    ] = None,
    rate_bins: Annotated[
        int | None,
        opt.integer(2, checks.MAX_BINS, "Bins of rates; else two in the lidar's resolution."),
    ] = None,
    spp: opt.Spp = None,
    size: opt.Pixels = None,
    max_depth: opt.MaxDepth = None,
    seed: opt.Seed = 0,
    variant: opt.Variant = None,
    figure: opt.Figure = "png",
    dpi: opt.Dpi = None,
    checkpoint: checkpoints.Seconds = EVERY_S,
    resume: checkpoints.Resume = False,
    as_json: Json = False,
) -> None:
    """Render SCENE, whose parts move, by path length and its rate of change; simulate FMCW lidar.

    The command writes NetCDF files: range_rate.nc, the light over both, spectra.nc, the beats of up
    and down chirps, and estimates.nc, the path length and rate of each pixel. Figures are
    range_velocity.png, of all pixels, and velocity.png.
    """
    opt.check_out(out)
    loaded, sensor, samples = load(scene, spp, size, max_depth, variant)
    from tofrender import io, vis
    from tofrender.io.netcdf import save_measurement
    from tofrender.motion.fmcw import Fmcw
    from tofrender.motion.range_rate_film import default_rates, range_rate

    chirps: Any = {"bandwidth_hz": bandwidth, "chirp_s": chirp, "wavelength_m": wavelength}
    lidar = Fmcw(**chirps, window=window_function, looks=looks, photons=photons)
    opl = _axis(_span(loaded, window), bins, lidar.resolution[0])
    rate = _axis(rates or default_rates(loaded), rate_bins, lidar.resolution[1])
    of_pixel = opl.count * rate.count, lidar.samples(opl, rate)
    if size is None and values(sensor) * max(of_pixel) > MOST // 4:
        size = _largest_size(sensor, max(of_pixel), MOST // 4)
        opt.note(
            f"note: {size} pixels, for a film of half a gigabyte; --size allows up to "
            f"{_largest_size(sensor, max(of_pixel), MOST)}, and {FEWER_BINS} allow more"
        )
        loaded, sensor, samples = load(scene, spp, size, max_depth, variant)
    sizes = tuple(values(sensor) * each for each in of_pixel)
    if max(sizes) > MOST:
        wanted = opt.Size(*(int(n) for n in sensor.film().crop_size()))
        raise ValueError(
            f"--size = {wanted}: {opl.count} x {rate.count} bins in each pixel make files with "
            f"{max(sizes):,} values, at most {MOST:,} are possible. Use --size "
            f"{_largest_size(sensor, max(of_pixel), MOST)} or less, or {FEWER_BINS}"
        )
    opt.check_disk_space(out, *sizes)
    axes: Any = {
        **{"bins": opl.count, "window": (opl.start, opl.start + opl.count * opl.width)},
        **{"rate_bins": rate.count},
        "rates": (rate.start, rate.start + rate.count * rate.width),
    }
    more: Any = {"window_function": window_function, "looks": looks, "photons": photons}
    more |= {"spp": samples, "seed": seed, "figure": figure, "dpi": dpi}
    recipe = checkpoints.recipe_of(loaded, sensor, **chirps, **axes, **more)
    if resume and checkpoints.answer_if_finished("fmcw", out, RANGE_RATE, recipe, as_json):
        return
    with checkpoints.checkpointed(out, checkpoint, resume) as file:
        checkpoints.require_begun(resume, file and file.path, out)
        film = range_rate(loaded, **axes, spp=samples, seed=seed, checkpoint=file)
        film.attrs["scene"] = scene
        spectra = lidar.spectra(film, seed)
        estimates = lidar.estimates(spectra)
        drawn = {
            f"range_velocity.{figure}": vis.range_velocity_map(film, lidar=lidar),
            f"velocity.{figure}": vis.velocity_map(
                estimates["rate"], **limit_of(loaded), title=scene
            ),
        }
        saved = {RANGE_RATE: film, SPECTRA: spectra, ESTIMATES: estimates}
        files = [*saved, *drawn]
        width, height = film.sizes["x"], film.sizes["y"]
        outside = film.attrs["energy_outside_window"]
        facts = {"out": str(out), "files": files, "width": width, "height": height, "scene": scene}
        facts |= {"resolution": lidar.resolution[0], "rate_resolution": lidar.resolution[1]}
        facts |= {"bins": opl.count, "rate_bins": rate.count, "spp": samples, "seed": seed}
        facts |= {"energy_outside_window": outside}
        film.attrs |= checkpoints.run_attribute(recipe, facts)
        with deferred_stop() as stop, io.output_folder(out, overwrite=True) as folder:
            for name, dataset in saved.items():
                save_measurement(dataset.drop_vars("time", errors="ignore"), folder / name)
            for name, each in drawn.items():
                io.save_figure(each, folder / name, **opt.dots(dpi))
    about = f"resolution {lidar.resolution[0]:.4g} m and {lidar.resolution[1]:.4g} m/s of path"
    lines = [f"{out}: {', '.join(files)}", f"{about}, {outside:.1%} of the energy outside the bins"]
    answer("fmcw", as_json, facts, lines)
    checkpoints.end_if_stopped(stop)


def _largest_size(sensor: Any, of_pixel: int, most: int) -> opt.Size:
    """Return the largest size like the sensor's with at most `most` values in three channels.

    `of_pixel` is the number of values of a pixel and channel.
    """
    shrink = min(1.0, math.sqrt(most / values(sensor) / of_pixel))
    width, height = (max(int(int(n) * shrink), 1) for n in sensor.film().crop_size())
    return opt.Size(width, height)


def _span(scene: Any, window: Any) -> tuple[float, float]:
    """Start and stop of path lengths: given, the film's own, or found where it has none."""
    if window not in (None, "auto"):
        return window
    from tofrender.rendering.renderer import make_job, with_default_window
    from tofrender.rendering.settings import RenderSettings
    from tofrender.rendering.window import BINS

    settings = RenderSettings(scene, window=window, bins=BINS if window else None)
    film = make_job(with_default_window(settings)).film
    return film.start_opl, film.end_opl()


def _axis(span: tuple[float, float], bins: int | None, resolution: float) -> Axis:
    """Bins of a span; unless their number is given, an odd one, with two in the resolution."""
    from tofrender.films.rates import Axis

    start, stop = span
    count = bins or math.ceil(2 * (stop - start) / resolution * (1 - 1e-9)) + 1 | 1
    return Axis(checks.integer("bins", count, 2, checks.MAX_BINS), start, (stop - start) / count)


def limit_of(scene: Any) -> dict[str, float]:
    """Limit of a velocity map: the speed of the scene's fastest part, if one moves."""
    from tofrender.motion.range_rate_film import fastest

    speed = fastest(scene)
    return {"limit_m_s": speed} if speed else {}
