"""The page that shows the explorer, with what only a live application can do."""

from __future__ import annotations

import html
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import panel as pn
import param

from .. import looks
from ..explorer.contents import Contents, contents_of
from ..explorer.module import javascript, style
from .looking import Live, Saved

MOST_BYTES = 24_000_000
"""Codes that go to the browser at once [bytes]; larger cubes are reduced, parts of them are not."""

LIVE_BYTES = 8_000_000
EVERY_MS = 400

SHOW = """
const KEPT = ["view", "bin", "speed", "exposure", "gamma", "colours", "smooth", "pixels", "active",
  "channel", "log", "gate", "frequency", "phasor", "laser", "unwarped", "playing"];

export function render({ model }) {
  const element = document.createElement("div");
  element.style.width = "100%";
  let shown = null;
  let shape = "";
  const show = () => {
    const all = new Uint8Array(model.contents);
    if (!all.length) return;
    const length = new DataView(all.buffer, all.byteOffset).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(all.subarray(4, 4 + length)));
    const data = { header, bytes: all.slice(4 + length) };
    const now = JSON.stringify([header.kind, header.axis, header.grid]);
    if (shown === null) {
      shown = mount(element, data);
    } else {
      const before = shown.state();
      shown.setData(data);
      if (now === shape) shown.set(Object.fromEntries(KEPT.map((name) => [name, before[name]])));
    }
    shape = now;
    element.dataset.version = model.version;
  };
  model.on("contents", show);
  model.ready += 1;
  model.on("remove", () => shown && shown.destroy());
  show();
  return element;
}
"""


class Explorer(pn.custom.JSComponent):
    """The explorer; `contents` is a length, a header of that length, and the bytes behind it."""

    contents = param.Bytes(default=b"")
    ready = param.Integer(default=0)
    version = param.Integer(default=0)
    _esm = javascript() + SHOW
    _stylesheets: Any = (style(),)


def packed(contents: Contents) -> bytes:
    """Contents as the page takes them.

    Example:
        >>> packed(Contents({"kind": "x"}, b"12"))[4:]
        b'{"kind": "x"}12'
    """
    header = json.dumps(contents.header, allow_nan=False).encode()
    return len(header).to_bytes(4, "little") + header + contents.data


class Window:
    """What one reader sees.

    Args:
        looked_at: A file, or a render under way; all readers share it.
        thread: Where contents are made.
        out: Where a render is saved.
    """

    def __init__(self, looked_at: Saved | Live, thread: ThreadPoolExecutor, out: Path) -> None:
        self.looked_at, self.out = looked_at, out
        self._thread = thread
        self._shown, self._busy, self._saved = -1, False, False
        options: dict[str, Any] = {"stylesheets": [looks.controls_style()], "margin": (4, 6)}
        self.explorer = Explorer(sizing_mode="stretch_width", min_height=200)
        self.said = looks.text(sizing_mode="stretch_width", margin=(4, 6))
        self.stop = pn.widgets.Button(label="Stop", width=110, **options)
        self.save = pn.widgets.Button(label=f"Save as {out.name}", width=220, **options)
        self.rows = pn.widgets.IntRangeSlider(label="Rows", width=240, **options)
        self.columns = pn.widgets.IntRangeSlider(label="Columns", width=240, **options)
        self.bins = pn.widgets.IntRangeSlider(label="Bins", width=240, **options)
        self.closer = pn.widgets.Button(label="Look closer", color="primary", width=120, **options)
        self.region = pn.Row(self.rows, self.columns, self.bins, self.closer, visible=False)
        self.stop.on_click(self._stop)
        self.save.on_click(self._save)
        self.closer.on_click(self._closer)

    def layout(self) -> Any:
        """All of it."""
        self.explorer.param.watch(self._begin, "ready")
        look: Any = self._look
        pn.state.add_periodic_callback(look, period=EVERY_MS)
        buttons = [self.stop, self.save] if self.looked_at.is_live else []
        wrap = {"flex-wrap": "wrap", "align-items": "center"}
        self.region.styles = wrap
        bar = pn.Row(*buttons, self.said, sizing_mode="stretch_width", styles=wrap)
        return pn.Column(bar, self.region, self.explorer, sizing_mode="stretch_width")

    async def _begin(self, _: Any) -> None:
        """The browser has drawn the page: what is sent from now on arrives."""
        self._shown = -1
        await self._look()

    async def _look(self) -> None:
        """Show what is new."""
        it = self.looked_at
        if isinstance(it, Live):
            self._tell(it)
        if self._busy or not self.explorer.ready:
            return
        self._busy = True
        try:
            await self._on_thread(it.look)
            if it.version != self._shown:
                version = it.version
                if it.error is not None:
                    self.said.object = looks.trouble(f"{it.name} cannot be shown", it.error)
                elif it.data is not None:
                    await self._show(it.data)
                self._shown = version
        finally:
            self._busy = False

    def _tell(self, it: Live) -> None:
        """How far the render is."""
        self.stop.label = "Stop" if it.is_running else "Go on"
        self.stop.disabled = not it.is_running and (it.done >= it.most or it.error is not None)
        self.save.disabled = it.data is None
        if it.error is None and not self._saved:
            state = "rendering" if it.is_running else "done" if it.done >= it.most else "stopped"
            words = f"{it.name}: {it.done} of {it.most} samples per pixel, {state}"
            self.said.object = f'<p class="quiet" role="status">{html.escape(words)}</p>'

    async def _show(self, data: Any, **region: slice) -> None:
        most = LIVE_BYTES if self.looked_at.is_live else MOST_BYTES
        name = self.looked_at.name
        title = str(data.attrs.get("scene") or name)

        def work() -> Contents:
            part = data.isel(region) if region else data
            return contents_of(part, title=title, most_bytes=most)

        try:
            contents = await self._on_thread(work)
        except (ValueError, OSError, MemoryError) as error:
            self.said.object = looks.trouble(f"{name} cannot be shown", error)
            return
        if not self.looked_at.is_live:
            self.said.object = ""
            if not region:
                self._offer_region(data, contents)
        self.explorer.param.update(version=self.explorer.version + 1, contents=packed(contents))

    def _offer_region(self, data: Any, contents: Contents) -> None:
        """Parts can be looked at in full where all of it had to be reduced."""
        if contents.header["kind"] != "transient" or not {"y", "x", "opl"} <= set(data.sizes):
            return
        bins = data.sizes["opl"]
        if contents.header["grid"]["step"] == 1 and contents.header["axis"]["count"] == bins:
            return
        for slider, axis in ((self.rows, "y"), (self.columns, "x"), (self.bins, "opl")):
            size = data.sizes[axis]
            slider.param.update(start=0, end=size, value=(0, size), step=1)
        self.region.visible = True

    async def _closer(self, _: Any) -> None:
        data = self.looked_at.data
        if data is None:
            return
        sliders = {"y": self.rows, "x": self.columns, "opl": self.bins}
        region = {}
        for axis, slider in sliders.items():
            low, high = slider.value
            region[axis] = slice(low, max(high, low + 1))
        await self._show(data, **region)

    def _stop(self, _: Any) -> None:
        it = self.looked_at
        if isinstance(it, Live):
            self._saved = False
            if it.is_running:
                it.stop()
            else:
                it.go_on()

    async def _save(self, _: Any) -> None:
        it = self.looked_at
        assert isinstance(it, Live)
        try:
            path = await self._on_thread(lambda: it.save(self.out, overwrite=self._saved))
        except (ValueError, OSError, MemoryError) as error:
            self.said.object = looks.trouble("Nothing was saved", error)
            return
        finally:
            self._saved = True
        words = f"Saved {path} with {it.done} samples per pixel"
        self.said.object = looks.box("good", words)

    async def _on_thread(self, function: Any) -> Any:
        import asyncio

        return await asyncio.get_running_loop().run_in_executor(self._thread, function)


def application(looked_at: Saved | Live, out: Path) -> Any:
    """A function that makes what one reader sees."""
    thread = ThreadPoolExecutor(1)

    def make() -> Any:
        if looks.page_style() not in pn.config.raw_css:
            pn.config.raw_css = [*pn.config.raw_css, looks.page_style()]
        looked_at.begin()
        return Window(looked_at, thread, out).layout()

    return make
