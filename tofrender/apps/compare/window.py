"""The page of two pictures."""

from __future__ import annotations

import asyncio
import html
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn
import param

from ...runtime import backend
from ...runtime.withheld import Withheld
from .. import looks
from ..redrawing import Redrawing
from .pictures import SCENES, Picture, difference, rendered, same_size, techniques

SAMPLES = [1, 2, 4, 8, 16, 32, 64, 128, 256]
SIDE = 264
"""Width of the controls [px]."""


class Divider(pn.custom.JSComponent):
    """The two pictures; `divider.js` says what each parameter is."""

    ready = param.Integer(default=0)
    left = param.Bytes(default=b"")
    right = param.Bytes(default=b"")
    size = param.List(default=[0, 0])
    names = param.List(default=["", ""])
    exposure = param.Number(default=0.0)
    _esm = Path(__file__).with_name("divider.js").read_text(encoding="utf-8")


class Window:
    """What one reader sees.

    Args:
        thread: Where pictures are rendered.
        scene: What is shown first, or None for files.
        files: Two pictures, if none is rendered.
    """

    def __init__(
        self, thread: ThreadPoolExecutor, scene: str | None, files: tuple[Picture, Picture] | None
    ) -> None:
        self._thread, self.files = thread, files
        self._redraw = Redrawing(self._show)
        style: dict[str, Any] = {"stylesheets": [looks.controls_style()], "width": SIDE}
        style |= {"margin": (4, 6)}
        self.scene = pn.widgets.Select(
            label="Scene", options=list(SCENES), value=scene or SCENES[0], **style
        )
        self.one = pn.widgets.Select(label="Left", **style)
        self.two = pn.widgets.Select(label="Right", **style)
        self.count = pn.widgets.DiscreteSlider(
            label="Samples per pixel", options=SAMPLES, value=16, **style
        )
        self.exposure = pn.widgets.FloatSlider(
            label="Exposure [stops]", start=-6, end=6, step=0.25, value=0, **style
        )
        self.divider = Divider(sizing_mode="stretch_width")
        self.said = looks.text(width=SIDE, margin=(8, 6))
        self._offer()
        self.scene.param.watch(self._choose, "value")
        for each in (self.one, self.two, self.count):
            each.param.watch(self._change, "value")
        self.exposure.param.watch(self._expose, "value")

    def layout(self) -> Any:
        """All of it."""
        self.divider.param.watch(self._change, "ready")
        head = "<h1>Two pictures</h1><p class='quiet'>Drag the divider, or use its slider.</p>"
        chosen = [self.scene, self.one, self.two, self.count] if self.files is None else []
        head = looks.text(head, width=SIDE, margin=(8, 6))
        controls = pn.Column(head, *chosen, self.exposure, self.said, margin=(0, 12, 0, 8))
        wide = {"sizing_mode": "stretch_width", "min_width": 330}
        main = pn.Column(self.divider, margin=(16, 16, 0, 0), styles={"flex": "1 1 330px"}, **wide)
        return pn.Row(controls, main, sizing_mode="stretch_width", styles={"flex-wrap": "wrap"})

    def _offer(self) -> None:
        ways = {what: name for name, what in techniques(self.scene.value).items()}
        first = "mats" if "mats" in ways.values() else "own"
        second = "mis" if "mis" in ways.values() else "reference"
        self.one.param.update(options=ways, value=first)
        self.two.param.update(options=ways, value=second)

    def _expose(self, _: Any) -> None:
        self.divider.exposure = self.exposure.value

    async def _choose(self, _: Any) -> None:
        self._offer()
        await self._redraw()

    async def _change(self, _: Any) -> None:
        await self._redraw()

    async def _show(self) -> None:
        """Show what is chosen."""
        self.said.object = looks.box("", "Rendering …")
        scene, spp = self.scene.value, self.count.value
        try:
            if self.files is not None:
                one, two = self.files
                same_size(one, two)
                lines = [(two.name, difference(two, one))]
                against = one.name
            else:
                one = await self._call(rendered, scene, self.one.value, spp)
                two = await self._call(rendered, scene, self.two.value, spp)
                reference = await self._call(rendered, scene, "reference", 1)
                lines = [(each.name, difference(each, reference)) for each in (one, two)]
                against = "the reference"
        except (ValueError, RuntimeError, Withheld) as error:
            self.said.object = looks.trouble("There is no picture", error)
            return
        self._send(one, two)
        rows = "".join(
            f"<dt>{html.escape(name)}</dt><dd>{100 * apart:.3g} %</dd>" for name, apart in lines
        )
        head = f"Root mean square difference from {against}"
        self.said.object = looks.box("", head, f"<dl>{rows}</dl>")

    def _send(self, one: Picture, two: Picture) -> None:
        height, width = one.pixels.shape[:2]
        self.divider.param.update(
            size=[width, height],
            left=np.ascontiguousarray(one.pixels).tobytes(),
            right=np.ascontiguousarray(two.pixels).tobytes(),
            names=[one.name, two.name],
        )

    async def _call(self, function: Any, *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._thread, function, *arguments)


def application(scene: str | None = None, files: tuple[Picture, Picture] | None = None) -> Any:
    """A function that makes what one reader sees."""
    variant = backend.activate(None)
    thread = ThreadPoolExecutor(1, initializer=backend.activate, initargs=(variant,))

    def make() -> Any:
        if looks.page_style() not in pn.config.raw_css:
            pn.config.raw_css = [*pn.config.raw_css, looks.page_style()]
        return Window(thread, scene, files).layout()

    return make
