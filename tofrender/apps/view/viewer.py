"""The page that shows the explorer, with the controls of a live application."""

from concurrent.futures import Executor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from ..explorer.module import javascript, style
from ..explorer.page_contents import PageContents, contents_of
from ..ui import bundle
from ..ui.page import App, failure
from .film_sources import LiveRender, SavedDataset

MAX_BYTES = {SavedDataset: 24_000_000, LiveRender: 8_000_000}
"""Codes that are sent to the browser at once [bytes]. Larger cubes are reduced."""

AXES = ("y", "x", "opl")


class Viewer(App):
    """The page of one reader. All readers share the source. A render is saved as `out`."""

    _esm = javascript() + bundle.javascript("ui/app", "view/viewer")
    _stylesheets: Any = (style(),)
    PERIOD_MS = 400

    def __init__(self, source: SavedDataset | LiveRender, executor: Executor, out: Path) -> None:
        super().__init__(executor)
        self.source = source
        self.out = out
        self._shown_version = -1
        self._was_saved = False

    async def draw(self) -> None:
        """Show the state of the source, and its data if they are new."""
        # Has the source changed?
        source = self.source
        if isinstance(source, LiveRender):
            self._tell_progress(source)
        else:
            await self.run(source.refresh)
        if source.version == self._shown_version:
            return
        self._shown_version = source.version
        if source.error is not None:
            self.tell(message=failure(f"{source.name} cannot be shown", source.error))
        elif source.data is not None:
            await self._show(source.data)

    def _tell_progress(self, live: LiveRender) -> None:
        is_done = live.spp >= live.max_spp
        state = "rendering" if live.is_running else "done" if is_done else "stopped"
        progress = {
            "status": f"{live.name}: {live.spp} of {live.max_spp} samples per pixel, {state}",
            "running": live.is_running,
            "canStop": live.is_running or not (is_done or live.error),
            "out": self.out.name,
            "canSave": live.data is not None,
        }
        self.tell(live=progress)

    async def _show(self, data: Any, **region: slice) -> None:
        name = self.source.name
        max_bytes = MAX_BYTES[type(self.source)]
        title = str(data.attrs.get("scene") or name)

        def work() -> PageContents:
            part = data.isel(region) if region else data
            return contents_of(part, title=title, most_bytes=max_bytes)

        # Prepare the contents in the thread
        is_first = not self.data
        if is_first:
            self.tell(message={"title": "Preparing the page …"})
        try:
            contents = await self.run(work)
        except (ValueError, OSError, MemoryError) as error:
            self.tell(message=failure(f"{name} cannot be shown", error))
            return

        # Send them to the page
        if is_first or isinstance(self.source, SavedDataset):
            self.tell(message=None)
        if isinstance(self.source, SavedDataset) and not region:
            self._offer_region(data, contents.header)
        data = {"header": contents.header, "bytes": contents.data}
        self.send(self.param.update, data=data)

    def _offer_region(self, data: Any, header: dict[str, Any]) -> None:
        """Offer to show a part at full resolution if the whole was reduced."""
        if header["kind"] != "transient" or not set(AXES) <= set(data.sizes):
            return
        if header["grid"]["step"] > 1 or header["axis"]["count"] < data.sizes["opl"]:
            self.tell(region={axis: data.sizes[axis] for axis in AXES})

    async def do_look_closer(self, ends: dict[str, list[int]]) -> None:
        """Show a part of the data in full."""
        if self.source.data is not None:
            region = {axis: slice(low, max(high, low + 1)) for axis, (low, high) in ends.items()}
            await self._show(self.source.data, **region)

    async def do_trace(self, pixel: list[int], range: list[float]) -> None:
        """Send the paths of a pixel of a render."""
        assert isinstance(self.source, LiveRender)
        self.send(self._send_msg, {"paths": await self.run(self.source.trace, pixel, range)})

    async def do_stop_or_go_on(self) -> None:
        """Stop a render, or continue it."""
        assert isinstance(self.source, LiveRender)
        self._was_saved = False
        self.tell(message=None)
        if self.source.is_running:
            self.source.stop()
        else:
            self.source.start()

    async def do_save(self) -> None:
        """Save a render. The second time replaces the first file."""
        live = self.source
        assert isinstance(live, LiveRender)
        try:
            path = await self.run(lambda: live.save(self.out, overwrite=self._was_saved))
        except (ValueError, OSError, MemoryError) as error:
            self.tell(message=failure("Nothing was saved", error))
            return
        finally:
            self._was_saved = True
        title = f"Saved {path} with {live.spp} samples per pixel"
        self.tell(message={"kind": "good", "title": title})


def application(source: SavedDataset | LiveRender, out: Path) -> Any:
    """Return a function that makes the page of a reader, for `serving.serve`."""
    executor = ThreadPoolExecutor(1)

    def page() -> Viewer:
        if isinstance(source, LiveRender) and not source.has_started:
            source.start()
        return Viewer(source, executor, out)

    return page
