"""What the gallery's examples show: figures made outside of pyplot, and players."""

from __future__ import annotations

from typing import Any


def scrape(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Save each new figure among the variables of an example, and of what it ends with."""
    from matplotlib.figure import Figure
    from sphinx_gallery.scrapers import figure_rst

    paths = []
    for value in list(block_vars["example_globals"].values()):
        if isinstance(value, Figure) and not getattr(value, "is_in_gallery", False):
            value.is_in_gallery = True  # pyright: ignore[reportAttributeAccessIssue]
            path = next(block_vars["image_path_iterator"])
            value.savefig(path, dpi=100, bbox_inches="tight")
            paths.append(path)
    return figure_rst(paths, gallery_conf["src_dir"])
