"""Save the figures of the gallery for light and dark pages, and show explorers."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import explorers
import running


def scrape(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save each new figure of an example twice: for light pages and for dark pages."""
    from matplotlib import pyplot
    from matplotlib.figure import Figure

    text = ""
    paths = block_vars["image_path_iterator"]
    words = Path(block_vars["src_file"]).read_text("utf-8").splitlines()[1]  # The title
    figures = [pyplot.figure(number) for number in pyplot.get_fignums()]
    figures += [f for f in block_vars["example_globals"].values() if isinstance(f, Figure)]
    for figure in dict.fromkeys(figures):
        if hasattr(figure, "is_in_gallery"):
            continue
        figure.is_in_gallery = True  # pyright: ignore[reportAttributeAccessIssue]
        path = Path(next(paths))
        for theme, file in (("light", path), ("dark", path.with_stem(f"{path.stem}_dark"))):
            ink(figure, theme)
            figure.savefig(file, dpi=100, bbox_inches="tight", facecolor="none")
            address = file.relative_to(gallery_conf["src_dir"])
            text += f"\n.. image:: /{address}\n   :alt: {words}\n"
            text += f"   :class: sphx-glr-single-img only-{theme}\n"
    pyplot.close("all")
    while explorers.SHOWN:
        _brightest(explorers.SHOWN.pop(), next(paths))
    return text


def ink(figure: Any, theme: str) -> None:
    """Remove a figure's white background. For dark pages, turn black and gray elements light."""
    from matplotlib.collections import Collection
    from matplotlib.colors import to_rgba, to_rgba_array
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.text import Text

    from tofrender.runtime.canvas import PALETTES

    light = PALETTES["light"]
    dark = PALETTES["dark"]
    pairs = {to_rgba(light.good): dark.good, to_rgba(light.bad): dark.bad}

    def turned(color: Any) -> Any:
        red, green, blue, alpha = to_rgba(color)
        if theme == "dark" and (red, green, blue, alpha) in pairs:
            return pairs[red, green, blue, alpha]
        gray = max(red, green, blue) - min(red, green, blue) < 0.05 and red < 0.6
        return (0.93 - 0.5 * red,) * 3 + (alpha,) if gray and theme == "dark" else color

    def turn_all(artist: Any, *names: str) -> None:
        for name in names:
            colors = to_rgba_array(getattr(artist, f"get_{name}")())
            getattr(artist, f"set_{name}")([turned(color) for color in colors])

    for artist in figure.findobj():
        if isinstance(artist, (Text, Line2D)):
            artist.set_color(turned(artist.get_color()))
        elif isinstance(artist, Collection):
            if artist.get_array() is None:
                turn_all(artist, "facecolor", "edgecolor")
        elif isinstance(artist, Patch):
            if to_rgba(artist.get_facecolor())[:3] == (1, 1, 1):
                artist.set_facecolor("none")
            artist.set_edgecolor(turned(artist.get_edgecolor()))
    for axes in figure.axes:
        axes.tick_params(color=turned("#1a1a1a"), labelcolor=turned("#1a1a1a"))


def prepare(gallery_conf: dict[str, Any], name: str | None, when: str) -> None:
    """Prepare an example before it runs, and record its imports after it has run.

    Warnings become errors, and `tofrender.explore` writes HTML pages.
    """
    if when == "after":
        running.record(str(name))
        return
    warnings.simplefilter("error", UserWarning)
    explorers.use_pages(Path(gallery_conf["src_dir"]) / "_static/made")


def _brightest(dataset: Any, path: str) -> None:
    """Save the brightest frame of a film as the thumbnail for the gallery's first page."""
    from PIL import Image

    from tofrender.vis import auto_exposure, tonemap

    transient = dataset["transient"].sel(opl=slice(4.5, None))
    frame = transient.isel(opl=int(transient.sum(("y", "x", "channel")).values.argmax())).values
    image = Image.fromarray(tonemap(frame, exposure=auto_exposure(transient.values)))
    ground = Image.new("RGB", (400, 280))
    ground.paste(image.resize((280 * image.width // image.height, 280)), (60, 0))
    ground.save(path)
