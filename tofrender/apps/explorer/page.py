"""The explorer as a single page that needs neither server nor network."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...runtime import checks
from ...runtime.atomic import check_file, check_writable, replacing
from .contents import Contents, contents_of
from .module import javascript, style

if TYPE_CHECKING:
    import xarray as xr

OPEN = """
async function inflated(text) {
  const packed = Uint8Array.from(atob(text), (each) => each.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const read = (id) => document.getElementById(id).textContent;
const page = document.getElementById("explorer");
try {
  mount(page, { header: JSON.parse(read("header")), bytes: await inflated(read("data")) });
  document.getElementById("waiting").remove();
} catch (error) {
  document.getElementById("waiting").textContent = `This page cannot be shown: ${error.message}`;
  throw error;
}
"""

STYLE = """
html { color-scheme: light dark; }
body { margin: 0; background: #fff; font-family: system-ui, sans-serif; }
#waiting { padding: 16px; }
@media (prefers-color-scheme: dark) { body { background: #14171a; color: #e8eaed; } }
"""

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="tofrender">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main id="explorer"><p id="waiting">Unpacking; this needs JavaScript.</p></main>
<script type="application/json" id="header">{header}</script>
<script type="application/octet-stream" id="data">{data}</script>
<script type="module">{script}</script>
</body>
</html>
"""


def report(
    data: xr.Dataset,
    path: str | os.PathLike,
    *,
    orders: Mapping[str, xr.Dataset] | None = None,
    distance_m: Any = None,
    title: str | None = None,
    megabytes: float = 10,
    overwrite: bool = False,
) -> Path:
    """Write the explorer of a transient as one HTML file.

    The file opens from disk in any browser of 2023 or later; it needs no server and no network,
    and forbids itself to use one. It appears whole or not at all. Values are kept as one byte on a
    logarithmic scale; blocks of pixels are averaged, and bins summed, until the file is as small
    as asked for. The page says how right values are and what was reduced.

    Args:
        data: What `render`, `capture`, `strategy_pyramid` or `reconstruct` returns.
        path: A file name that ends in .html.
        orders: As for `explore`.
        distance_m: As for `explore`.
        title: Above everything; by default the scene.
        megabytes: What the file may take [1e6 bytes], 0.1 to 1000.
        overwrite: Replace a file that is there.

    Returns:
        `path`.

    Raises:
        ValueError: `data` is none of these, or another argument does not fit; one line.
        FileExistsError: The file exists.
        PermissionError: The place is not writable.
        OSError: The disk is full; nothing half-written remains.
        MemoryError: The codes do not fit into memory.

    Example:
        >>> import tempfile, tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=20)
        >>> dataset = tofrender.render(scene, spp=16, window="auto")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     report(dataset, folder + "/box.html").name
        'box.html'
    """
    target = check_file(path, ".html", ".htm", overwrite=overwrite)
    most = 1e6 * checks.number("megabytes", megabytes, low=0.1, high=1000)
    given: dict[str, Any] = {"orders": orders, "distance_m": distance_m, "title": title}
    share = 0.96  # What is estimated of the size may be a little too small
    while True:
        room = int(share * 3 / 4 * most)
        contents = contents_of(data, **given, most_bytes=room, packed=True)
        text = page_of(contents).encode()
        if len(text) <= most:
            break
        share *= 0.9 * most / len(text)
    check_writable(path, len(text))
    with replacing(path, needed_bytes=len(text)) as temporary:
        temporary.write_bytes(text)
    return target


def page_of(contents: Contents) -> str:
    """The page as text. What comes from the data is in it as text or JSON, never as markup."""
    script, sheet = javascript() + OPEN, style() + STYLE
    policy = (
        "default-src 'none'; base-uri 'none'; form-action 'none'; "
        f"script-src '{_digest(script)}'; style-src '{_digest(sheet)}'"
    )
    return PAGE.format(
        policy=policy,
        title=html.escape(contents.header["title"]),
        style=sheet,
        header=_json(contents.header),
        data=base64.b64encode(zlib.compress(contents.data, 6)).decode(),
        script=script,
    )


def _digest(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _json(value: Any) -> str:
    """JSON in which no markup can begin."""
    text = json.dumps(value, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
