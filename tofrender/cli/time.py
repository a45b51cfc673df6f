"""The commands `tofrender phasor` and `tofrender gate`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..io.command_files import GATE, PHASORS
from ..runtime import checks
from ..runtime.progress import EVERY_S, deferred_stop
from . import checkpoints, options as opt
from .answers import Json, answer

if TYPE_CHECKING:
    import numpy as np

LAYERS = ("I", "Q", "amplitude", "phase", "depth")
GATE_WIDTH = 0.03
"""Standard deviation of a gate if the scene's integrator has no pulse [m]."""


@opt.with_groups
def phasor(
    source: Annotated[
        str,
        opt.argument("DIR|SCENE", "Folder of `tofrender render`, or a scene to render."),
    ],
    out: opt.Out,
    freq: Annotated[
        list[float],
        opt.frequency("Modulation frequency; repeat the option for more frequencies"),
    ],
    *,
    picture: opt.Picture,
    drawing: opt.Drawing,
    stopping: checkpoints.Stopping,
    as_json: Json = False,
) -> None:
    """Make phasor images of an AMCW camera.

    The command writes one EXR file per frequency with the layers I, Q, amplitude, phase [rad] and
    depth [m], and a figure of all of them.

    A scene is rendered once for all frequencies, by its own integrator with its pulse. The time
    bins of an existing render are converted. They do not contain the light outside the window.

    Examples:
        tofrender phasor cornell_box --freq 20MHz --out phasors
        tofrender phasor box --freq 20MHz --freq 50MHz --out phasors
    """
    opt.check_out(out)
    for frequency in freq:
        checks.require("--freq", frequency, freq.count(frequency) == 1, "given once")
    if os.path.isdir(source):
        opt.check_apart(out, Path(source))
        of_scenes = {
            "--spp": picture.spp,
            "--size": picture.size,
            "--max-depth": picture.max_depth,
            "--variant": picture.variant,
            "--resume": stopping.resume or None,
            "--seed": picture.seed or None,
            "--checkpoint": None if stopping.checkpoint == EVERY_S else stopping.checkpoint,
        }
        for option, value in of_scenes.items():
            if value is not None:
                raise ValueError(
                    f"{option} = {value} requires a scene, but {source} is rendered already. "
                    "Remove the option"
                )
        from tofrender.analysis import transient_to_phasor

        rendered = opt.load_render(Path(source), "DIR|SCENE")
        opt.check_disk_space(out, len(LAYERS) * len(freq) * rendered["steady"].size)
        parts = transient_to_phasor(rendered, freq)
        first = int(rendered["x"][0]), int(rendered["y"][0])
        with checkpoints.exclusively(out), deferred_stop() as stop:
            facts = _write_phasors(out, freq, parts, source, drawing, first)
    else:
        loaded, sensor, samples = load(source, picture)
        from tofrender.integrators.amcw import render_amcw_phasor

        opt.check_disk_space(out, len(LAYERS) * len(freq) * values(sensor))
        more: Any = {"frequencies_hz": freq, "spp": samples, "seed": picture.seed}
        recipe = checkpoints.recipe_of(loaded, sensor, **more, **vars(drawing))
        if stopping.resume and checkpoints.answer_if_finished(
            "phasor", out, PHASORS, recipe, as_json
        ):
            return
        with checkpoints.checkpointed(out, stopping.checkpoint, stopping.resume) as file:
            checkpoints.require_begun(stopping.resume, file and file.path, out)
            parts = render_amcw_phasor(loaded, sensor, freq, samples, picture.seed, checkpoint=file)
            with deferred_stop() as stop:
                first = first_pixel(sensor)
                facts = _write_phasors(out, freq, parts, source, drawing, first, recipe)
    answer("phasor", as_json, facts, [f"{out}: {', '.join(facts['files'])}"])
    checkpoints.end_if_stopped(stop)


@opt.with_groups
def gate(
    scene: opt.Scene,
    out: opt.Out,
    at: Annotated[float, opt.real(0, "Optical path length of the gate [m]")],
    *,
    pulse_width: Annotated[
        float | None,
        opt.positive(
            "meters",
            "Standard deviation of the gate, a Gaussian pulse [m]",
            show_default=f"the scene's pulse, otherwise {GATE_WIDTH}",
        ),
    ] = None,
    picture: opt.Picture,
    drawing: opt.Drawing,
    stopping: checkpoints.Stopping,
    as_json: Json = False,
) -> None:
    """Render one instant, given as a path length.

    The command writes gate.exr, the radiance per meter of path at the instant, and picture.png with
    the time and the brightness. The scene's integrator traces the paths.

    Examples:
        tofrender gate cornell_box --at 8 --out gate
        tofrender gate scene.xml --at 3.5 --pulse-width 0.05 --spp 256 --out gate
    """
    opt.check_out(out)
    loaded, sensor, samples = load(scene, picture)
    from tofrender import io, vis
    from tofrender.integrators.time_gated import render_at_time

    opt.check_disk_space(out, values(sensor))
    integrator = _gated(loaded, pulse_width)
    width: float = integrator.pulse.width_opl
    recipe = checkpoints.recipe_of(
        loaded,
        sensor,
        opl=at,
        pulse_width_opl=width,
        spp=samples,
        seed=picture.seed,
        **vars(drawing),
    )
    if stopping.resume and checkpoints.answer_if_finished("gate", out, GATE, recipe, as_json):
        return
    with checkpoints.checkpointed(out, stopping.checkpoint, stopping.resume) as file:
        checkpoints.require_begun(stopping.resume, file and file.path, out)
        image = render_at_time(
            loaded, integrator, sensor, at, samples, picture.seed, checkpoint=file
        )
        if not image.any():
            raise ValueError(
                f"--at = {at:g}: no light arrives at this path length. Use `tofrender render` to "
                "find when light arrives"
            )
        files = [GATE, f"picture.{drawing.figure}"]
        rows, columns = image.shape[:2]
        facts = {
            "out": str(out),
            "files": files,
            "width": columns,
            "height": rows,
            "scene": scene,
            "at": at,
            "pulse_width": width,
            "spp": samples,
            "seed": picture.seed,
        }
        attrs = {"opl": at, "pulse_width_opl": width, "units": "W m^-3 sr^-1", "spp": samples}
        attrs |= checkpoints.run_attribute(recipe, facts)
        with deferred_stop() as stop, io.output_folder(out, overwrite=True) as folder:
            first = first_pixel(sensor)
            io.save_exr_layers(folder / files[0], {"": image}, attrs, first_pixel=first)
            drawn = vis.gate_figure(image, at, width)
            io.save_figure(drawn, folder / files[1], **opt.dots(drawing.dpi))
    answer("gate", as_json, facts, [f"{out}: {', '.join(files)}"])
    checkpoints.end_if_stopped(stop)


def load(source: str, picture: opt.Picture) -> tuple[Any, Any, int]:
    """Load a scene and replace its integrator by a transient integrator if necessary.

    Returns:
        The scene, its first sensor, and the number of samples per pixel.
    """
    opt.activate(picture.variant)
    from tofrender.scenes.loading import find_scene, load_scene, require_light, require_sensor
    from tofrender.scenes.transient_integrators import transient_integrator_for

    found = find_scene(source)
    settings: dict[str, Any] = {"max_depth": picture.max_depth}
    if picture.size is not None:
        settings |= picture.size._asdict()
    loaded = load_scene(found, **settings)
    require_sensor(loaded)
    if getattr(loaded.integrator(), "traits", None) is None:
        # An integrator of Mitsuba, or one that is wrapped by another
        kind = transient_integrator_for(loaded.integrator())
        loaded = load_scene(found, integrator=kind, **settings)
    own: Any = loaded.integrator()
    if own.needs_lights:
        require_light(loaded)
    sensor = loaded.sensors()[0]
    return loaded, sensor, picture.spp or sensor.sampler().sample_count()


def _gated(scene: Any, pulse_width: float | None) -> Any:
    """Return a gated integrator with the settings of the scene's integrator and the given pulse."""
    from tofrender.paths.surfaces import lets_straight_through
    from tofrender.scenes.loading import load_plugin
    from tofrender.signals.pulses import GaussianPulse

    own = scene.integrator()
    kind = type(own).__name__
    if not own.needs_lights:
        raise ValueError(f"integrator = {kind} does not support gates. Use transient_path")
    if own.goes_straight and lets_straight_through(scene):
        raise ValueError(
            f"integrator = {kind} does not support gates in scenes with panes, masks or "
            "polarizers. Use transient_path, which treats them as opaque for connections, or use "
            "`tofrender render`"
        )
    width = pulse_width or (GATE_WIDTH if own.pulse is None else own.pulse.width_opl)
    if not own.has_gates:
        traits = own.traits | {"type": "time_gated_transient_path"}
        own = load_plugin("integrator", traits | {"pulse_width_opl": width})
    own.pulse = GaussianPulse(width)
    return own


def values(sensor: Any) -> int:
    """Return the number of values, width x height x 3, in a color image of the sensor."""
    width, height = sensor.film().crop_size()
    return 3 * int(width) * int(height)


def first_pixel(sensor: Any) -> tuple[int, int]:
    """Return the column and the row of the first pixel of the sensor's image."""
    column, row = sensor.film().crop_offset()
    return int(column), int(row)


def _label(frequency_hz: float) -> str:
    """Return a frequency as text with a unit, for example 20MHz."""
    for unit, size in (("GHz", 1e9), ("MHz", 1e6), ("kHz", 1e3)):
        if frequency_hz >= size:
            return f"{frequency_hz / size:.15g}{unit}"
    return f"{frequency_hz:.15g}Hz"


def _write_phasors(
    out: Path,
    frequencies: list[float],
    parts: tuple[np.ndarray, ...],
    source: str,
    drawing: opt.Drawing,
    first: tuple[int, int],
    recipe: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write an EXR file for each frequency and the figure of all frequencies.

    Args:
        out: Folder to write.
        frequencies: Modulation frequencies [Hz].
        parts: Arrays of the layers `LAYERS`, each with the frequencies along its first axis.
        source: Scene or folder, as the user has given it.
        drawing: File type and resolution of the figure.
        first: Column and row of the first pixel, for a crop window.
        recipe: Everything that the result depends on. It is stored in the attributes of the files,
            so that `--resume` recognizes a finished run. None without such a check.

    Returns:
        The facts that the command prints with `--json`: files, size, source and frequencies.
    """
    from tofrender import io, vis

    files = [f"phasor_{_label(frequency)}.exr" for frequency in frequencies]
    files.append(f"panel.{drawing.figure}")
    height, width = parts[0].shape[1:3]
    facts = {
        "out": str(out),
        "files": files,
        "width": width,
        "height": height,
        "source": source,
        "frequencies_hz": frequencies,
    }
    run = {} if recipe is None else checkpoints.run_attribute(recipe, facts)

    with io.output_folder(out, overwrite=True) as folder:
        for k, frequency in enumerate(frequencies):
            layers = {name: part[k] for name, part in zip(LAYERS, parts, strict=True)}
            attrs = {"frequency_hz": frequency, **run}
            io.save_exr_layers(folder / files[k], layers, attrs, first_pixel=first)
        panel = vis.phasor_panel(frequencies, *parts, title=source)
        io.save_figure(panel, folder / files[-1], **opt.dots(drawing.dpi))
    return facts
