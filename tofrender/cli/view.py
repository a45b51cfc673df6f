"""The commands `tofrender view` and `tofrender compare`."""

from contextlib import closing, nullcontext
from pathlib import Path
from typing import Annotated

from ..runtime import checks
from . import options as opt
from .report import load_result
from .warp import Browser, Host, Port

MAX_SPP = 1024


def view(
    source: Annotated[
        str,
        opt.argument(
            "DIR|FILE|SCENE",
            "What a command has written; or a built-in name or XML file, with --live.",
        ),
    ],
    live: Annotated[bool, opt.switch("--live", "Render SCENE progressively.")] = False,
    spp: opt.Spp = None,
    size: opt.Pixels = None,
    max_depth: opt.MaxDepth = None,
    seed: opt.Seed = 0,
    out: Annotated[Path | None, opt.named("FILE", "With --live: npz file to save to.")] = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    browser: Browser = True,
    variant: opt.Variant = None,
) -> None:
    """View light in time in the browser: a saved file, or a progressive render.

    A cube that is too large for the browser is read in parts and averaged; parts of it can be
    looked at in full. With --live, SCENE is rendered to ever more samples; it can be stopped,
    can go on, and be saved.
    """
    from tofrender.apps.ui.serving import prepare, serve

    if not live and (spp or size or max_depth is not None or out is not None):
        raise ValueError("--live: must be given with --spp, --size, --max-depth or --out")
    name = Path(source).stem if live else ""
    target = out or Path(f"{name}.npz")
    if live:
        opt.check_file_out(target, ".npz", overwrite=out is None)
    elif not Path(checks.path("DIR|FILE|SCENE", source)).exists():
        from tofrender.scenes import BUILT_IN

        hint = "add --live to render it" if source in BUILT_IN else "must exist, or be a scene"
        raise ValueError(f"DIR|FILE|SCENE = {checks.quote(source)}: {hint}")
    prepare(host, port)
    opt.activate(variant, polarised=not live)

    from tofrender.apps.view.sources import LiveRender, SavedDataset
    from tofrender.apps.view.window import application

    if live:
        from tofrender.scenes.loading import load_scene

        width, height = size or (None, None)
        load_scene(source, width=width, height=height)
        options = {"scene": source, "spp": spp or MAX_SPP, "seed": seed, "window": "auto"}
        options |= {"size": tuple(size) if size else None, "max_depth": max_depth}
        shown = LiveRender(name, options | {"pulse_width": "auto"})
    else:
        shown = SavedDataset(Path(source), load_result)
    with closing(shown) if isinstance(shown, LiveRender) else nullcontext():
        make = application(shown, target)
        serve(make, "Light in time", host=host, port=port, browser=browser, tell=opt.say)


def compare(
    one: Annotated[
        str, opt.argument("SCENE|DIR|FILE", "A scene of the course, a picture, or a film.")
    ] = "veach",
    two: Annotated[str | None, opt.argument("[DIR|FILE]", "Another one of the same size.")] = None,
    host: Host = "127.0.0.1",
    port: Port = None,
    browser: Browser = True,
    variant: opt.Variant = None,
) -> None:
    """Compare two pictures, or two films with one clock.

    They are shown on both sides of a divider or in turns, with their values, their difference and
    the responses of pixels. Pictures are exr, png or jpg; films are what `render` writes. A scene
    of the course is rendered by the techniques that are chosen in the page.
    """
    from tofrender.apps.ui.serving import prepare, serve

    prepare(host, port)
    opt.activate(variant)

    from tofrender.apps.compare.pairs import Pair, load
    from tofrender.apps.compare.pictures import SCENES
    from tofrender.apps.compare.window import application

    if two is None:
        make = application(scene=checks.one_of("SCENE|DIR|FILE", one, SCENES))
    else:
        make = application(pair=Pair(*(load(each, load_result) for each in (one, two))))
    serve(make, "Comparison", host=host, port=port, browser=browser, tell=opt.say)
