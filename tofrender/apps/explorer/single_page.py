"""The explorer as a single HTML page that needs neither server nor network."""

import base64
import hashlib
import html
import json
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Annotated, Any

import xarray as xr

from ...labels import CAPTURE, EXPLORED, PATHS, TRANSIENT
from ...runtime import checks
from ...runtime.atomic import check_file, check_writable, replacing
from ..ui.bundle import text_of
from .module import javascript, style
from .page_contents import PageContents, contents_of


def report(
    data: Annotated[xr.Dataset, EXPLORED],
    path: str | os.PathLike,
    *,
    capture: Annotated[xr.Dataset, CAPTURE] | None = None,
    orders: Mapping[str, Annotated[xr.Dataset, TRANSIENT]] | None = None,
    distance_m: Any = None,
    title: str | None = None,
    paths: Sequence[Annotated[xr.Dataset, PATHS]] | None = None,
    megabytes: float = 10,
    overwrite: bool = False,
) -> Path:
    """Write the explorer of a transient as one HTML file, and return its path.

    The file opens from disk in any browser of 2024 or later. The page works without a server and
    without a network, and its security policy forbids both. An incomplete file never appears at
    `path`. Values are stored as one byte on a logarithmic scale. Blocks of pixels are averaged, and
    bins are summed, until the file is small enough. The page states the precision of values, and
    the sizes of joined blocks and bins. See also `explore`.

    Args:
        data: As for `explore`.
        path: A file name that ends in .html.
        capture: As for `explore`.
        orders: As for `explore`.
        distance_m: As for `explore`.
        title: Title. By default the name of the scene.
        paths: As for `explore`.
        megabytes: Largest size of the file [1e6 bytes], 0.1 to 1000.
        overwrite: Replace an existing file.

    Raises:
        ValueError: `data` is another Dataset, or another argument does not fit.
        FileExistsError: The file exists.
        PermissionError: The folder is not writable.
        OSError: The disk is full. An unfinished file is removed.
        MemoryError: The codes do not fit into memory.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=20)
        >>> dataset = tofrender.render(scene, spp=16, window="auto")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     report(dataset, folder + "/box.html").name
        'box.html'
    """
    # Check the arguments
    target = check_file(path, ".html", ".htm", overwrite=overwrite)
    limit = 1e6 * checks.number("megabytes", megabytes, low=0.1, high=1000)
    options: dict[str, Any] = {"orders": orders, "distance_m": distance_m}
    options |= {"capture": capture, "title": title, "paths": paths}

    # Reduce the data until the page is small enough. The estimated size may be a little too small
    margin = 0.96
    while True:
        most = int(margin * 3 / 4 * limit)
        text = page_of(contents_of(data, **options, most_bytes=most, packed=True)).encode()
        if len(text) <= limit:
            break
        margin *= 0.9 * limit / len(text)
    check_writable(path, len(text))
    with replacing(path, needed_bytes=len(text)) as temporary:
        temporary.write_bytes(text)
    return target


def page_of(contents: PageContents) -> str:
    """Return the page as text. The page contains data as text or JSON, never as markup."""
    # Allow only the page's own script and style
    script = javascript() + text_of("explorer/page.js")
    sheet = style() + text_of("explorer/page.css")
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; "
        f"script-src '{_digest(script)}'; style-src '{_digest(sheet)}'"
    )
    header = json.dumps(contents.header, allow_nan=False)

    # Escape characters that could begin markup
    for mark in "<>&":
        header = header.replace(mark, f"\\u{ord(mark):04x}")
    return Template(text_of("explorer/page.html")).substitute(
        policy=policy,
        title=html.escape(contents.header["title"]),
        style=sheet,
        header=header,
        data=base64.b64encode(zlib.compress(contents.data, 6)).decode(),
        script=script,
    )


def _digest(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
