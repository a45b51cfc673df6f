"""The commands `tofrender view` and `tofrender compare`."""

from contextlib import closing, nullcontext
from pathlib import Path
from typing import Annotated

from ..runtime import checks
from . import options as opt
from .report import load_result
from .warp import Page

MAX_SPP = 1024


@opt.with_groups
def view(
    source: Annotated[
        str,
        opt.argument(
            "DIR|FILE|SCENE",
            "Folder or file of another command, or with --live a built-in scene or an XML file.",
        ),
    ],
    live: Annotated[
        bool, opt.switch("--live", "Render a scene progressively, instead of opening a file.")
    ] = False,
    spp: opt.Spp = None,
    size: opt.Pixels = None,
    max_depth: opt.MaxDepth = None,
    seed: opt.Seed = 0,
    out: Annotated[
        Path | None, opt.named("FILE", "With --live, npz file that the button Save writes.")
    ] = None,
    *,
    page: Page,
) -> None:
    """View light in time in the browser.

    The source is a saved result, or with --live a scene that is rendered progressively. The render
    can be paused, continued and saved. If a film is too large for the browser, it is averaged, and
    parts of it can be shown in full resolution.

    Examples:
        tofrender view box
        tofrender view cornell_box --live --size 128x128
    """
    from tofrender.apps.ui.serving import prepare, serve

    if not live and (spp or size or max_depth is not None or out is not None):
        raise ValueError("--spp, --size, --max-depth and --out require --live")
    name = Path(source).stem if live else ""
    target = out or Path(f"{name}.npz")
    if live:
        opt.check_file_out(target, ".npz", overwrite=out is None)
    elif not Path(checks.path("DIR|FILE|SCENE", source)).exists():
        from tofrender.scenes import BUILT_IN

        name = checks.quote(source)
        if source in BUILT_IN:
            raise ValueError(f"DIR|FILE|SCENE = {name} is a scene. Add --live to render it")
        raise ValueError(f"DIR|FILE|SCENE = {name} does not exist, and is not a built-in scene")
    prepare(page.host, page.port)
    opt.activate(page.variant, polarized=not live)

    from tofrender.apps.view.film_sources import LiveRender, SavedDataset
    from tofrender.apps.view.viewer import application

    if live:
        from tofrender.scenes.loading import load_scene

        width, height = size or (None, None)
        load_scene(source, width=width, height=height)
        options = {
            "scene": source,
            "spp": spp or MAX_SPP,
            "seed": seed,
            "size": tuple(size) if size else None,
            "max_depth": max_depth,
            "window": "auto",
            "pulse_width": "auto",
        }
        shown = LiveRender(name, options)
    else:
        shown = SavedDataset(Path(source), load_result)
    with closing(shown) if isinstance(shown, LiveRender) else nullcontext():
        make = application(shown, target)
        serve(make, "Light in time", **page.address, tell=opt.say)


@opt.with_groups
def compare(
    one: Annotated[
        str, opt.argument("SCENE|DIR|FILE", "Scene of the course, picture, or film.")
    ] = "veach",
    others: Annotated[
        list[str] | None,
        opt.argument("[DIR|FILE]...", "Further pictures or films of the same size."),
    ] = None,
    *,
    page: Page,
) -> None:
    """Compare pictures or films in the browser.

    The page shows two pictures A and B on both sides of a divider or alternately, with their
    values, their difference and the responses of pixels. With more pictures, lists on the page
    choose A and B, and the page prints the errors of all pictures against A. All films run with one
    clock. Pictures are .exr, .png or .jpg files, and films are folders or files of `tofrender
    render`. For a scene of the course, you choose the techniques on the page.

    Examples:
        tofrender compare veach
        tofrender compare box_1024 box_64 box_denoised
    """
    from tofrender.apps.ui.serving import prepare, serve

    prepare(page.host, page.port)
    opt.activate(page.variant)

    from tofrender.apps.compare.comparison import application
    from tofrender.apps.compare.course_pictures import SCENES
    from tofrender.apps.compare.picture_set import PictureSet, load

    if others:
        files = PictureSet(*(load(each, load_result) for each in (one, *others)))
        make = application(files=files)
    else:
        make = application(scene=checks.one_of("SCENE|DIR|FILE", one, SCENES))
    serve(make, "Comparison", **page.address, tell=opt.say)
