"""The page that shows the explorer, with what only a live application can do."""

from __future__ import annotations

import html
from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import panel as pn
import param

from ..explorer.contents import Contents, contents_of
from ..explorer.module import javascript, style
from ..ui import components
from ..ui.bundle import text_of
from ..ui.components import Canvas, Page, control
from .sources import LiveRender, SavedDataset

MAX_BYTES = {SavedDataset: 24_000_000, LiveRender: 8_000_000}
"""Codes that go to the browser at once [bytes]; larger cubes are reduced, parts of them are not."""

REFRESH_MS = 400


class Explorer(Canvas):
    """The explorer; `data` has to be set before `header`."""

    header = param.Dict(default={})
    data = param.Bytes(default=b"")
    _esm = javascript() + text_of("view/view.js")
    _stylesheets: Any = (style(),)


class Window(Page):
    """The page of one reader of a source that all readers share; a render is saved as `out`."""

    def __init__(self, source: SavedDataset | LiveRender, executor: Executor, out: Path) -> None:
        super().__init__(executor)
        self.source, self.out = source, out
        self._shown_version, self._updates, self._was_saved = -1, 0, False
        self.explorer = Explorer(sizing_mode="stretch_width", min_height=200)
        self.message = components.text(sizing_mode="stretch_width", margin=(4, 6))
        self.stop = control("Button", "Stop", width=110)
        self.save = control("Button", f"Save as {out.name}", width=220)
        labels = {"y": "Rows", "x": "Columns", "opl": "Bins"}
        self.sliders = {k: control("IntRangeSlider", v, width=240) for k, v in labels.items()}
        closer = control("Button", "Look closer", color="primary", width=120)
        self.region = pn.Row(*self.sliders.values(), closer, visible=False)
        self.stop.on_click(self._stop_or_go_on)
        self.save.on_click(self._save)
        closer.on_click(self._show_region)
        self.explorer.param.watch(self._show_all, "ready")

    def layout(self) -> Any:
        """Buttons and messages above the explorer."""
        redraw: Any = self.redraw
        pn.state.add_periodic_callback(redraw, period=REFRESH_MS)
        buttons = []
        if isinstance(self.source, LiveRender):
            buttons = [self.stop, self.save]
            self._show_progress(self.source)
        wrap = {"flex-wrap": "wrap", "align-items": "center"}
        self.region.styles = wrap
        bar = pn.Row(*buttons, self.message, sizing_mode="stretch_width", styles=wrap)
        return pn.Column(bar, self.region, self.explorer, sizing_mode="stretch_width")

    async def _show_all(self, _: Any) -> None:
        self._shown_version = -1
        await self.redraw()

    async def draw(self) -> None:
        """Show the source's state, and its data if they are new."""
        source = self.source
        if not self.explorer.ready:  # Bokeh fails if a button is disabled before it is on the page
            return
        if isinstance(source, LiveRender):
            self._show_progress(source)
        else:
            await self.run(source.refresh)
        version = source.version
        if version != self._shown_version:
            if source.error is not None:
                self._show_error(f"{source.name} cannot be shown", source.error)
            elif source.data is not None:
                await self._show(source.data)
            self._shown_version = version

    def _show_progress(self, live: LiveRender) -> None:
        is_done = live.spp >= live.max_spp
        self.stop.label = "Stop" if live.is_running else "Go on"
        self.stop.disabled = not live.is_running and (is_done or live.error is not None)
        self.save.disabled = live.data is None
        if live.error is None and not self._was_saved:
            state = "rendering" if live.is_running else "done" if is_done else "stopped"
            line = f"{live.name}: {live.spp} of {live.max_spp} samples per pixel, {state}"
            self.message.object = f'<p class="quiet" role="status">{html.escape(line)}</p>'

    def _show_error(self, title: str, error: BaseException) -> None:
        self.message.object = components.error_box(title, error)

    async def _show(self, data: Any, **region: slice) -> None:
        name, max_bytes = self.source.name, MAX_BYTES[type(self.source)]
        title = str(data.attrs.get("scene") or name)

        def work() -> Contents:
            part = data.isel(region) if region else data
            return contents_of(part, title=title, most_bytes=max_bytes)

        try:
            contents = await self.run(work)
        except (ValueError, OSError, MemoryError) as error:
            self._show_error(f"{name} cannot be shown", error)
            return
        if isinstance(self.source, SavedDataset):
            self.message.object = ""
            if not region:
                self._offer_region(data, contents)
        self._updates += 1
        self.explorer.data = contents.data
        self.explorer.header = contents.header | {"update": self._updates}

    def _offer_region(self, data: Any, contents: Contents) -> None:
        """Offer to show a part at full resolution if the whole was reduced."""
        header = contents.header
        if header["kind"] != "transient" or not set(self.sliders) <= set(data.sizes):
            return
        if header["grid"]["step"] == 1 and header["axis"]["count"] == data.sizes["opl"]:
            return
        for axis, slider in self.sliders.items():
            size = data.sizes[axis]
            slider.param.update(start=0, end=size, value=(0, size), step=1)
        self.region.visible = True

    async def _show_region(self, _: Any) -> None:
        if self.source.data is not None:
            ends = {axis: slider.value for axis, slider in self.sliders.items()}
            region = {axis: slice(low, max(high, low + 1)) for axis, (low, high) in ends.items()}
            await self._show(self.source.data, **region)

    def _stop_or_go_on(self, _: Any) -> None:
        assert isinstance(self.source, LiveRender)
        self._was_saved = False
        if self.source.is_running:
            self.source.stop()
        else:
            self.source.start()

    async def _save(self, _: Any) -> None:
        live = self.source
        assert isinstance(live, LiveRender)
        try:
            path = await self.run(lambda: live.save(self.out, overwrite=self._was_saved))
        except (ValueError, OSError, MemoryError) as error:
            self._show_error("Nothing was saved", error)
            return
        finally:
            self._was_saved = True
        line = f"Saved {path} with {live.spp} samples per pixel"
        self.message.object = components.box("good", line)


def application(source: SavedDataset | LiveRender, out: Path) -> Any:
    """A function that makes a reader's page, for `serving.serve`."""
    executor = ThreadPoolExecutor(1)

    def page() -> Window:
        if isinstance(source, LiveRender) and not source.has_started:
            source.start()
        return Window(source, executor, out)

    return components.application(page)
