"""The page that compares two pictures."""

from __future__ import annotations

from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any

import panel as pn
import param

from ...runtime import backend
from ...runtime.withheld import Withheld
from ..ui import components
from ..ui.bundle import text_of
from ..ui.components import CONTROLS_WIDTH, Canvas, Page, control
from .pictures import SCENES, Picture, difference, render_technique, same_size, techniques

SAMPLES = [1, 2, 4, 8, 16, 32, 64, 128, 256]
HEAD = "<h1>Two pictures</h1><p class='quiet'>Drag the divider, or use its slider.</p>"


class Divider(Canvas):
    """Two pictures with a divider; `divider.js` describes the parameters."""

    left = param.Bytes(default=b"")
    right = param.Bytes(default=b"")
    size = param.List(default=[0, 0])
    names = param.List(default=["", ""])
    exposure = param.Number(default=0.0)
    _esm = text_of("compare/divider.js")


class Window(Page):
    """The page of one reader, beginning with a scene, or with two pictures of the same size."""

    def __init__(
        self, executor: Executor, scene: str | None, files: tuple[Picture, Picture] | None
    ) -> None:
        super().__init__(executor)
        self.files = files
        self.scene = control("Select", "Scene", options=list(SCENES), value=scene or SCENES[0])
        self.sides = [control("Select", label) for label in ("Left", "Right")]
        self.spp = control("DiscreteSlider", "Samples per pixel", options=SAMPLES, value=16)
        stops = {"start": -6, "end": 6, "step": 0.25, "value": 0}
        self.exposure = control("FloatSlider", "Exposure [stops]", **stops)
        self.divider = Divider(sizing_mode="stretch_width", exposure=self.exposure)
        self.message = components.text(width=CONTROLS_WIDTH, margin=(8, 6))
        self._list_techniques()
        self.scene.param.watch(self._list_techniques, "value")
        for each in (self.scene, *self.sides, self.spp):
            each.param.watch(self.redraw, "value")
        self.divider.param.watch(self.redraw, "ready")

    def layout(self) -> Any:
        """Controls on the left, pictures on the right."""
        head = components.text(HEAD, width=CONTROLS_WIDTH, margin=(8, 6))
        choices = [self.scene, *self.sides, self.spp] if self.files is None else []
        controls = pn.Column(head, *choices, self.exposure, self.message, margin=(0, 12, 0, 8))
        wide = {"sizing_mode": "stretch_width", "min_width": 330}
        main = pn.Column(self.divider, margin=(16, 16, 0, 0), styles={"flex": "1 1 330px"}, **wide)
        return pn.Row(controls, main, sizing_mode="stretch_width", styles={"flex-wrap": "wrap"})

    def _list_techniques(self, *_: Any) -> None:
        options = {label: name for name, label in techniques(self.scene.value).items()}
        defaults = ("mats", "mis") if "mis" in options.values() else ("own", "reference")
        for side, value in zip(self.sides, defaults, strict=True):
            side.param.update(options=options, value=value)

    async def draw(self) -> None:
        """Render and show the chosen pictures, and their differences from the reference."""
        self.message.object = components.box("", "Rendering …")
        scene, spp = self.scene.value, self.spp.value
        try:
            if self.files is not None:
                pictures = list(self.files)
                same_size(*pictures)
                differences = {pictures[1].name: difference(pictures[1], pictures[0])}
                reference = pictures[0].name
            else:
                chosen = [side.value for side in self.sides]
                pictures = [await self.run(render_technique, scene, c, spp) for c in chosen]
                against = await self.run(render_technique, scene, "reference", 1)
                differences = {each.name: difference(each, against) for each in pictures}
                reference = "the reference"
        except (ValueError, RuntimeError, Withheld) as error:
            self.message.object = components.error_box("There is no picture", error)
            return
        height, width = pictures[0].pixels.shape[:2]
        self.divider.param.update(
            size=[width, height],
            left=pictures[0].pixels.tobytes(),
            right=pictures[1].pixels.tobytes(),
            names=[each.name for each in pictures],
        )
        rows = {name: f"{100 * value:.3g} %" for name, value in differences.items()}
        title = f"Root mean square difference from {reference}"
        self.message.object = components.box("", title, components.table(rows))


def application(scene: str | None = None, files: tuple[Picture, Picture] | None = None) -> Any:
    """A function that makes a reader's page, for `serving.serve`."""
    variant = backend.activate(None)
    executor = ThreadPoolExecutor(1, initializer=backend.activate, initargs=(variant,))
    return components.application(lambda: Window(executor, scene, files))
