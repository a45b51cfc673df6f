"""The commands `tofrender phasor` and `tofrender gate`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..io.contents import GATE, PHASORS
from ..runtime import checks
from ..runtime.progress import EVERY_S, deferred_stop
from . import checkpoints, options as opt
from .answers import Json, answer

if TYPE_CHECKING:
    import numpy as np

LAYERS = ("I", "Q", "amplitude", "phase", "depth")
GATE_WIDTH = 0.03  # Standard deviation of a gate where the scene's light has no pulse [m]


def phasor(
    source: Annotated[
        str,
        opt.argument(
            "RENDER_DIR|SCENE", "What `tofrender render` has written, or a scene as for it."
        ),
    ],
    out: opt.Out,
    freq: Annotated[list[float], opt.frequency("Modulation frequency, repeatable")],
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
    """Phasor images: I, Q, amplitude, phase and depth at each frequency.

    From a scene, phasors are rendered, all frequencies in one trace, by the scene's integrator with
    its limits and its pulse. From a render, they are converted from its bins, which lack light
    outside the window. The command writes one EXR file per frequency, with layers I, Q, amplitude,
    phase [rad] and depth [m], and a panel.
    """
    opt.check_out(out)
    for frequency in freq:
        checks.require("--freq", frequency, freq.count(frequency) == 1, "given once")
    if os.path.isdir(source):
        opt.check_apart(out, Path(source))
        given = {"--spp": spp, "--size": size, "--max-depth": max_depth, "--variant": variant}
        given |= {"--resume": resume or None, "--seed": seed or None}
        given["--checkpoint"] = None if checkpoint == EVERY_S else checkpoint
        for option, value in given.items():
            if value is not None:
                raise ValueError(f"{option} = {value}: must be left out, {source} is rendered")
        from tofrender.analysis import transient_to_phasor

        rendered = opt.load_render(Path(source), "RENDER_DIR")
        opt.check_disk_space(out, len(LAYERS) * len(freq) * rendered["steady"].size)
        parts = transient_to_phasor(rendered, freq)
        first = int(rendered["x"][0]), int(rendered["y"][0])
        with checkpoints.exclusively(out), deferred_stop() as stop:
            facts = _write_phasors(out, freq, parts, source, figure, dpi, first)
    else:
        loaded, sensor, samples = load(source, spp, size, max_depth, variant)
        from tofrender.integrators.amcw import render_amcw_phasor

        opt.check_disk_space(out, len(LAYERS) * len(freq) * values(sensor))
        more: Any = {"frequencies_hz": freq, "spp": samples, "seed": seed}
        recipe = checkpoints.recipe_of(loaded, sensor, **more, figure=figure, dpi=dpi)
        if resume and checkpoints.answer_if_finished("phasor", out, PHASORS, recipe, as_json):
            return
        with checkpoints.checkpointed(out, checkpoint, resume) as file:
            checkpoints.require_begun(resume, file and file.path, out)
            parts = render_amcw_phasor(loaded, sensor, freq, samples, seed, checkpoint=file)
            with deferred_stop() as stop:
                first = first_pixel(sensor)
                facts = _write_phasors(out, freq, parts, source, figure, dpi, first, recipe)
    answer("phasor", as_json, facts, [f"{out}: {', '.join(facts['files'])}"])
    checkpoints.end_if_stopped(stop)


def gate(
    scene: opt.Scene,
    out: opt.Out,
    at: Annotated[float, opt.real(0, "Path length of the gate, metres.")],
    pulse_width: Annotated[
        float | None, opt.positive("metres", "Gaussian gate's deviation, metres; else the scene's.")
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
    """Render SCENE at one instant, given as a path length.

    Paths are those of the scene's integrator, and so is the gate: its pulse, of 0.03 m if it has
    none. The command writes gate.exr, the radiance per metre of path at that instant, and
    picture.png, labelled with time and brightness.
    """
    opt.check_out(out)
    loaded, sensor, samples = load(scene, spp, size, max_depth, variant)
    from tofrender import io, vis
    from tofrender.integrators.time_gated import render_at_time

    opt.check_disk_space(out, values(sensor))
    integrator = _gated(loaded, pulse_width)
    width: float = integrator.pulse.width_opl
    more: Any = {"opl": at, "pulse_width_opl": width, "spp": samples, "seed": seed}
    recipe = checkpoints.recipe_of(loaded, sensor, **more, figure=figure, dpi=dpi)
    if resume and checkpoints.answer_if_finished("gate", out, GATE, recipe, as_json):
        return
    with checkpoints.checkpointed(out, checkpoint, resume) as file:
        checkpoints.require_begun(resume, file and file.path, out)
        image = render_at_time(loaded, integrator, sensor, at, samples, seed, checkpoint=file)
        if not image.any():
            raise ValueError(f"--at = {at:g}: no light arrives then; `tofrender render` shows when")
        files = [GATE, f"picture.{figure}"]
        rows, columns = image.shape[:2]
        facts = {"out": str(out), "files": files, "width": columns, "height": rows, "scene": scene}
        facts |= {"at": at, "pulse_width": width, "spp": samples, "seed": seed}
        attrs = {"opl": at, "pulse_width_opl": width, "units": "W m^-3 sr^-1", "spp": samples}
        attrs |= checkpoints.run_attribute(recipe, facts)
        with deferred_stop() as stop, io.output_folder(out, overwrite=True) as folder:
            first = first_pixel(sensor)
            io.save_exr_layers(folder / files[0], {"": image}, attrs, first_pixel=first)
            drawn = vis.gate_figure(image, at, width)
            io.save_figure(drawn, folder / files[1], **opt.dots(dpi))
    answer("gate", as_json, facts, [f"{out}: {', '.join(files)}"])
    checkpoints.end_if_stopped(stop)


def load(
    source: str, spp: int | None, size: opt.Size | None, max_depth: int | None, variant: str | None
) -> tuple[Any, Any, int]:
    """Load a scene with a transient integrator, its sensor, and samples per pixel."""
    opt.activate(variant)
    from tofrender.scenes.loading import find_scene, load_scene, require_light, require_sensor
    from tofrender.scenes.transient_integrators import transient_integrator_for

    found = find_scene(source)
    settings: dict[str, Any] = {"max_depth": max_depth}
    if size is not None:
        settings |= size._asdict()
    loaded = load_scene(found, **settings)
    require_sensor(loaded)
    if getattr(loaded.integrator(), "traits", None) is None:  # One in a wrapper does not tell
        kind = transient_integrator_for(loaded.integrator())
        loaded = load_scene(found, integrator=kind, **settings)
    own: Any = loaded.integrator()
    if own.needs_lights:
        require_light(loaded)
    sensor = loaded.sensors()[0]
    return loaded, sensor, spp or sensor.sampler().sample_count()


def _gated(scene: Any, pulse_width: float | None) -> Any:
    """Make a gated integrator with the settings of a scene's, or set the pulse of a gated one."""
    from tofrender.paths.surfaces import lets_straight_through
    from tofrender.scenes.loading import load_plugin
    from tofrender.signals.pulses import GaussianPulse

    own = scene.integrator()
    kind = type(own).__name__
    if not own.needs_lights:
        raise ValueError(f"integrator = {kind}: has no gates; must be one like transient_path")
    if own.goes_straight and lets_straight_through(scene):
        raise ValueError(
            f"integrator = {kind}: has no gates in scenes with panes, masks or polarisers; must be "
            "transient_path, whose connections they block, or use `tofrender render`"
        )
    width = pulse_width or (GATE_WIDTH if own.pulse is None else own.pulse.width_opl)
    if not hasattr(own, "gate"):
        traits = own.traits | {"type": "time_gated_transient_path"}
        own = load_plugin("integrator", traits | {"pulse_width_opl": width})
    own.pulse = GaussianPulse(width)
    return own


def values(sensor: Any) -> int:
    """Number of values of the sensor's picture, in three channels at most."""
    width, height = sensor.film().crop_size()
    return 3 * int(width) * int(height)


def first_pixel(sensor: Any) -> tuple[int, int]:
    """Column and row of the first pixel of the sensor's picture."""
    column, row = sensor.film().crop_offset()
    return int(column), int(row)


def _write_phasors(
    out: Path,
    frequencies: list[float],
    parts: tuple[np.ndarray, ...],
    source: str,
    figure: str,
    dpi: int | None,
    first: tuple[int, int],
    recipe: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write EXR files and the panel, and return the facts of the run.

    With a `recipe`, the files have what `--resume` needs to find the run finished.
    """
    from tofrender import io, vis

    files = [f"phasor_{frequency:.15g}Hz.exr" for frequency in frequencies]
    files.append(f"panel.{figure}")
    height, width = parts[0].shape[1:3]
    facts = {"out": str(out), "files": files, "width": width, "height": height}
    facts |= {"source": source, "frequencies_hz": frequencies}
    run = {} if recipe is None else checkpoints.run_attribute(recipe, facts)

    with io.output_folder(out, overwrite=True) as folder:
        for k, frequency in enumerate(frequencies):
            layers = {name: part[k] for name, part in zip(LAYERS, parts, strict=True)}
            attrs = {"frequency_hz": frequency, **run}
            io.save_exr_layers(folder / files[k], layers, attrs, first_pixel=first)
        panel = vis.phasor_panel(frequencies, *parts, title=source)
        io.save_figure(panel, folder / files[-1], **opt.dots(dpi))
    return facts
