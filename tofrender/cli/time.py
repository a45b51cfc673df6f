"""The commands `tofrender phasor` and `tofrender gate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import check_out, load_render, number, settings_of

if TYPE_CHECKING:
    import numpy as np

Text = str | None
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write, made whole.")]
Spp = Annotated[Text, typer.Option("--spp", metavar="N", help="Samples per pixel.")]
Size = Annotated[Text, typer.Option("--size", metavar="WxH", help="Picture's size, pixels.")]
Seed = Annotated[str, typer.Option("--seed", metavar="N", help="Random seed.")]
Variant = Annotated[Text, typer.Option("--variant", metavar="NAME", help="Mitsuba variant.")]


def phasor(
    source: Annotated[
        str,
        typer.Argument(
            metavar="RENDER_DIR|SCENE",
            help="What `tofrender render` has written, or a scene as for it.",
        ),
    ],
    out: Out,
    freq: Annotated[
        list[str], typer.Option("--freq", metavar="HZ", help="Modulation frequency; repeatable.")
    ],
    spp: Spp = None,
    size: Size = None,
    seed: Seed = "0",
    variant: Variant = None,
) -> None:
    """Phasor images: I, Q, amplitude, phase and depth at each frequency.

    From a scene, phasors are rendered, all frequencies in one trace. From a render, they are
    converted from its bins, which can hold less light. DIR gets an EXR file a frequency, with
    layers I, Q, amplitude, phase [rad] and depth [m], and a panel.
    """
    from tofrender.runtime import backend, checks

    frequencies = [
        checks.metres("--freq", number(text), positive=True, unit="hertz") for text in freq
    ]
    if not frequencies:
        raise ValueError("--freq: must be given at least once, e.g. --freq 20e6")
    given = settings_of(size=size, spp=spp)
    seed_number = checks.integer("--seed", number(seed), 0, checks.MAX_SEED)
    check_out(out)
    if Path(source).is_dir():
        for option, text in (("--spp", spp), ("--size", size), ("--variant", variant)):
            if text is not None:
                raise ValueError(f"{option} = {text}: must be left out, {source} is rendered")
        from tofrender.analysis import transient_to_phasor

        parts = transient_to_phasor(load_render(Path(source), "RENDER_DIR"), frequencies)
    else:
        backend.activate(variant)
        backend.require_vectorised()
        from tofrender.integrators.amcw import render_amcw_phasor

        loaded, sensor, samples = _load(source, given)
        parts = render_amcw_phasor(loaded, sensor, frequencies, samples, seed_number)
    _write_phasors(out, frequencies, parts, source)


def gate(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="A scene as for `render`.")],
    out: Out,
    at: Annotated[str, typer.Option("--at", metavar="M", help="Path length of the gate, metres.")],
    pulse_width: Annotated[
        str, typer.Option("--pulse-width", metavar="M", help="Gaussian gate's deviation, metres.")
    ] = "0.03",
    spp: Spp = None,
    size: Size = None,
    seed: Seed = "0",
    variant: Variant = None,
) -> None:
    """Render SCENE at one instant, given as a path length.

    DIR gets gate.exr, the radiance per metre of path at that instant, and picture.png.
    """
    from tofrender.runtime import backend, checks, plugins

    target = checks.metres("--at", number(at))
    if target < 0:
        raise ValueError(f"--at = {at}: must be 0 m or more, light starts there")
    width = checks.metres("--pulse-width", number(pulse_width), positive=True)
    given = settings_of(size=size, spp=spp)
    seed_number = checks.integer("--seed", number(seed), 0, checks.MAX_SEED)
    check_out(out)
    backend.activate(variant)
    backend.require_vectorised()

    import mitsuba as mi
    from PIL import Image

    from tofrender import io, vis
    from tofrender.integrators.time_gated import render_at_time

    plugin = {
        "type": plugins.own_name("time_gated_transient_path"),
        "pulse_width_opl": width,
    }
    loaded, sensor, samples = _load(scene, given)
    image = render_at_time(loaded, mi.load_dict(plugin), sensor, target, samples, seed_number)
    if not image.any():
        raise ValueError(f"--at = {at}: no light arrives then; `tofrender render` shows when")
    attrs = {"opl": target, "pulse_width_opl": width, "units": "W m^-3 sr^-1", "spp": samples}
    with io.output_folder(out, overwrite=True) as folder:
        io.save_exr_layers(folder / "gate.exr", {"": image}, attrs)
        Image.fromarray(vis.tonemap(image)).save(folder / "picture.png")
    typer.echo(f"{out}: gate.exr, picture.png")


def _load(source: str, given: dict[str, Any]) -> tuple[Any, Any, int]:
    """A scene, its sensor and the number of samples per pixel."""
    from tofrender.scenes.loading import find_scene, load_scene, require_light, require_sensor

    samples = given.pop("spp", None)
    loaded = load_scene(find_scene(source), **given)
    require_sensor(loaded)
    require_light(loaded)
    sensor = loaded.sensors()[0]
    return loaded, sensor, samples or sensor.sampler().sample_count()


def _write_phasors(
    out: Path, frequencies: list[float], parts: tuple[np.ndarray, ...], source: str
) -> None:
    """EXR files and the panel."""
    from tofrender import io, vis

    names = ("I", "Q", "amplitude", "phase", "depth")
    with io.output_folder(out, overwrite=True) as folder:
        files = []
        for k, frequency in enumerate(frequencies):
            layers = {name: part[k] for name, part in zip(names, parts, strict=True)}
            files.append(f"phasor_{frequency:.0f}Hz.exr")
            io.save_exr_layers(folder / files[-1], layers, {"frequency_hz": frequency})
        figure = vis.phasor_panel(frequencies, *parts, title=f"{source}")
        figure.savefig(folder / "panel.png")
    typer.echo(f"{out}: {', '.join(files)}, panel.png")
