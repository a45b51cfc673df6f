"""What the gallery's examples show: figures made outside of pyplot, and players."""

from __future__ import annotations

from typing import Any


def scrape(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save each new figure among the variables of an example, and of what it ends with."""
    from matplotlib.animation import Animation
    from matplotlib.figure import Figure
    from sphinx_gallery.scrapers import figure_rst

    paths, variables = [], block_vars["example_globals"]
    for value in list(variables.values()):
        if isinstance(value, Animation) and not hasattr(value, "is_in_gallery"):
            value.is_in_gallery = True
            _brightest(
                variables["dataset"].sel(opl=slice(4.5, None)),
                next(block_vars["image_path_iterator"]),
            )
        if not isinstance(value, Figure) or hasattr(value, "number"):
            continue  # Pyplot's are numbered, and saved by another scraper
        if not hasattr(value, "is_in_gallery"):
            value.is_in_gallery = True  # pyright: ignore[reportAttributeAccessIssue]
            path = next(block_vars["image_path_iterator"])
            value.savefig(path, dpi=100, bbox_inches="tight")
            paths.append(path)
    return figure_rst(paths, gallery_conf["src_dir"])


def strict(gallery_conf: dict[str, Any], name: str) -> None:
    """Let an example that warns fail."""
    import warnings

    warnings.simplefilter("error", UserWarning)


def _brightest(dataset: Any, path: str) -> None:
    """Save the brightest frame of a film: what the gallery's first page shows of it."""
    from PIL import Image

    from tofrender.vis import auto_exposure, tonemap

    transient = dataset["transient"]
    frame = transient.isel(opl=int(transient.sum(("y", "x", "channel")).values.argmax())).values
    image = Image.fromarray(tonemap(frame, exposure=auto_exposure(transient.values)))
    image.resize((400, 400 * image.height // image.width)).save(path)
