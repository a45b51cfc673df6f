"""The page of the warp tester."""

from __future__ import annotations

import html
import io
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn
import param

from ...runtime import checks
from ...sampling.domains import find
from ...sampling.verdicts import Verdict
from ..ui import components
from ..ui.bundle import text_of
from ..ui.components import CONTROLS_WIDTH, Canvas, Page, control
from . import engine
from .engine import LIBRARY, MODULE, NO_PROOF, POINT_SETS, SUBJECT_ERRORS, Drawn, Engine
from .subjects import SUBJECTS, Parameter, Subject, density_of

COUNTS = [1 << k for k in range(17)]
SAMPLES = {"10 000": 10_000, "100 000": 100_000, "1 000 000": 1_000_000, "4 000 000": 4_000_000}

HEAD = """<h1>Warp tester</h1>
<p class="quiet">Points of the unit square, warped; and a χ² test of the warp
against its density.</p>"""
RULE = "<hr style='border: 0; border-top: 1px solid var(--tf-line)'>"

UNTESTED = components.box(
    "", "Not tested yet", "The test draws its own samples, whichever points are shown."
)
CHANGED = components.box("", "The file has changed", "Its points are redrawn; run the test again.")


class Plot(Canvas):
    """The canvas of points and grid; `plot.js` describes the parameters."""

    points = param.Bytes(default=b"")
    lines = param.Bytes(default=b"")
    domain = param.Dict(
        default={"dimensions": 2, "low": [0, 0], "high": [1, 1], "labels": ["", ""]}
    )
    view = param.String(default="2D")
    parts = param.List(default=["points", "grid"])
    _esm = text_of("warptest/plot.js")


class Window(Page):
    """The page of one reader, beginning with a subject and its given parameters."""

    def __init__(self, shared: Engine, subject: str, given: dict[str, Any]) -> None:
        super().__init__(shared.executor)
        self.engine, self.given = shared, dict(given)
        self.verdict: Verdict | None = None
        self.drawn: Drawn | None = None
        self._setting_controls = False
        self._make_controls(subject)
        wide = {"sizing_mode": "stretch_width"}
        self.plot = Plot(height=355, view=self.view, parts=self.show, **wide)
        self.about = components.text(margin=(0, 6), **wide)
        self.error = components.text(visible=False, margin=(0, 6, 8, 6), **wide)
        self.message = components.text(UNTESTED, margin=(0, 6), **wide)
        self.panels = components.text(margin=(4, 6), **wide)
        self._watch_controls()

    def _make_controls(self, subject: str) -> None:
        make = partial(control, margin=(3, 6))
        names, module = {"This package": LIBRARY}, self.engine.module
        if module is not None:
            names = {f"Yours: {module.path.name}": MODULE} | names
        self.source = make("Select", "Whose", options=names, value=next(iter(names.values())))
        self.subject = make("Select", "Distribution")
        self._list_subjects(subject)
        self.number = make("FloatInput", "", value=0.5)
        self.slider = make("FloatSlider", "", start=0, end=1, value=0.5, show_value=False)
        self.image = make("FileInput", "", accept=".exr,.png,.jpg")
        self.example = make("Button", "2 × 2 example")
        self.kind = make("Select", "Point set", options=[*POINT_SETS])
        self.count = make("DiscreteSlider", "Points", options=COUNTS, value=1024)
        self.seed = make("IntInput", "Seed", value=0, start=0, end=checks.MAX_SEED)
        parts = ["points", "grid"]
        self.show = make("CheckButtonGroup", "Show", options=parts, value=parts)
        self.view = make("RadioButtonGroup", "View", options=["3D", "2D"])
        self.samples = make("Select", "Samples of the test", options=SAMPLES, value=1_000_000)
        self.test = make("Button", "Run the χ² test", color="primary")
        self.format = make("Select", "Figure", options=["png", "pdf", "svg"], width=84)
        self.save = control(
            *("FileDownload", "Save the figure"),
            callback=self._figure,
            filename=pn.bind("warp.{}".format, self.format),
            disabled=True,
            width=CONTROLS_WIDTH - 96,
            margin=(25, 6, 3, 6),
        )

    def _watch_controls(self) -> None:
        for each in (self.kind, self.count, self.seed, self.number):
            each.param.watch(self.redraw, "value")
        self.slider.param.watch(self._slide, "value")
        self.source.param.watch(self._choose_source, "value")
        self.subject.param.watch(self._choose_subject, "value")
        self.image.param.watch(self._read_image, "value")
        self.example.on_click(self._use_example)
        self.view.param.watch(self._describe, "value")
        self.samples.param.watch(self._discard_verdict, "value")
        self.test.on_click(self._test)
        self.plot.param.watch(self.redraw, "ready")

    def _list_subjects(self, wanted: str) -> None:
        """List the subjects of the source; of the library also those that it withholds."""
        library = self.source.value == LIBRARY
        names = list(SUBJECTS) if library else self.engine.sources[MODULE].names()
        groups: dict[str, dict[str, str]] = {}
        for name in names:
            groups.setdefault(SUBJECTS[name].group, {})[SUBJECTS[name].title] = name
        self.subject.groups = groups
        self.subject.value = wanted if wanted in names else names[0]

    @property
    def chosen(self) -> Subject:
        """The chosen subject."""
        return SUBJECTS[self.subject.value]

    @property
    def parameter(self) -> Parameter | None:
        """The number that the subject takes."""
        return next(iter(self.chosen.parameters), None)

    def _show_parameters(self) -> None:
        """Set the controls for the subject."""
        parameter = self.parameter
        self.number.visible = self.slider.visible = parameter is not None
        self.image.visible = self.example.visible = self.chosen.takes_image
        self.view.visible = self.chosen.dimensions == 3
        if parameter is None:
            return
        low, high = parameter.bounds or (parameter.low, parameter.high)
        value = float(self.given.get(parameter.name, parameter.default))
        near = min(max(value, parameter.low), parameter.high)
        self._setting_controls = True
        self.number.param.update(label=parameter.label, start=None, end=None)
        self.number.param.update(start=low, end=high, step=parameter.step, value=value)
        self.slider.param.update(
            start=parameter.low, end=parameter.high, step=parameter.step, value=near
        )
        self._setting_controls = False

    def values(self) -> dict[str, Any]:
        """Parameters as the controls have them."""
        parameter = self.parameter
        if parameter is not None:
            value = self.number.value
            return {parameter.name: parameter.default if value is None else value}
        image = self.chosen.takes_image and "image" in self.given
        return {"image": self.given["image"]} if image else {}

    async def _choose_source(self, _: Any) -> None:
        self._list_subjects(self.subject.value)
        await self._choose_subject()

    async def _choose_subject(self, *_: Any) -> None:
        self._show_parameters()
        await self.redraw()

    def _slide(self, event: Any) -> None:
        if not self._setting_controls:
            self.number.value = event.new

    async def _use_example(self, _: Any) -> None:
        self.given.pop("image", None)
        await self.redraw()

    async def _read_image(self, event: Any) -> None:
        if not event.new:
            return
        name = str(self.image.filename)
        try:
            self.given["image"] = await self.run(_density_of_file, event.new, name)
        except SUBJECT_ERRORS as error:
            self._show_error(f"{name} cannot be used", error)
            return
        await self.redraw()

    async def check_files(self) -> None:
        """Redraw if the student has saved a file."""
        module = self.engine.module
        if module is not None and await self.run(module.refresh):
            self._list_subjects(self.subject.value)
            await self.redraw()
            self.message.object = CHANGED

    async def redraw(self, *events: Any) -> None:
        """Draw points of the current choice, which is not tested yet."""
        if not self._setting_controls:
            self._discard_verdict()
            await super().redraw(*events)

    async def draw(self) -> None:
        """Warp points and grid, and hand them to the canvas."""
        source, name, values = self.source.value, self.subject.value, self.values()
        points, subject = (self.kind.value, self.count.value, self.seed.value or 0), self.chosen

        def work() -> Drawn:
            return engine.draw(self.engine.sources[source].case(name, values), *points)

        try:
            self.drawn = shown = await self.run(work)
            self.error.visible = False
        except SUBJECT_ERRORS as error:
            module = self.engine.module if source == MODULE else None
            whose = (module and module.file_of(name)) or "this package"
            self._show_error(f"{subject.title}: {whose} gives no points", error)
            self.drawn, shown = None, Drawn(*[np.zeros((subject.dimensions, 0), np.float32)] * 2)
        domain = find(subject.domain)
        alt = f"{shown.points.shape[1]} points of {subject.title} and the grid of the unit square"
        names = ("dimensions", "low", "high", "labels", "down", "upper_only")
        self.plot.param.update(
            points=np.ascontiguousarray(shown.points).tobytes(),
            lines=np.ascontiguousarray(shown.lines).tobytes(),
            domain={name: getattr(domain, name) for name in names} | {"alt": alt},
        )
        self._describe()

    def _describe(self, *_: Any) -> None:
        is_3d = self.chosen.dimensions == 3 and self.view.value == "3D"
        density = html.escape(self.chosen.density) + " · drag to turn" * is_3d
        title = html.escape(self.chosen.title)
        self.about.object = f'<h2>{title}</h2><p class="quiet">{density}</p>'

    def _show_error(self, title: str, error: BaseException) -> None:
        self.error.param.update(object=components.error_box(title, error), visible=True)

    def _discard_verdict(self, *_: Any) -> None:
        """Remove the verdict when the tested choice changes."""
        self.verdict = None
        self.save.disabled = True
        self.panels.object = ""
        self.message.object = UNTESTED

    def _choice(self) -> tuple[str, str, dict[str, Any], int, int]:
        return (
            *(self.source.value, self.subject.value, self.values()),
            *(self.samples.value, self.seed.value or 0),
        )

    async def _test(self, _: Any) -> None:
        choice = source, name, values, samples, seed = self._choice()
        self._discard_verdict()
        self.message.object = components.box("", "Testing …")
        self.test.disabled = True

        def work() -> tuple[Verdict, str]:
            case = self.engine.sources[source].case(name, values)
            verdict = case.test(samples=samples, seed=seed)
            return verdict, engine.panels(verdict)

        try:
            verdict, panels = await self.run(work)
        except SUBJECT_ERRORS as error:
            title = f"{SUBJECTS[name].title}: the test could not be run"
            self.message.object = components.error_box(title, error)
            return
        finally:
            self.test.disabled = False
        if repr(self._choice()) != repr(choice):
            self._discard_verdict()
            return
        self.verdict = verdict
        self.message.object = verdict_box(verdict, samples)
        self.panels.object = panels
        self.save.disabled = self.drawn is None

    def _figure(self) -> io.BytesIO:
        assert self.drawn is not None
        assert self.verdict is not None
        title = f"{self.drawn.points.shape[1]} {self.kind.value} points"
        return io.BytesIO(engine.save(self.drawn, self.verdict, title, self.format.value))

    def layout(self) -> Any:
        """Controls on the left; plot, verdict and densities on the right."""
        self._show_parameters()
        has_module = self.engine.module is not None
        if has_module:
            check: Any = self.check_files
            pn.state.add_periodic_callback(check, period=1000)
        controls = pn.Column(
            components.text(HEAD, width=CONTROLS_WIDTH, margin=(8, 6, 6, 6)),
            *[self.source] * has_module,
            *(self.subject, self.number, self.slider, self.image, self.example),
            *(self.kind, self.count, self.seed, self.view, self.show),
            components.text(RULE, width=CONTROLS_WIDTH),
            *(self.samples, self.test),
            pn.Row(self.format, self.save, width=CONTROLS_WIDTH + 12, margin=0),
            width=CONTROLS_WIDTH + 12,
            margin=(0, 12, 0, 8),
        )
        half: dict[str, Any] = {"sizing_mode": "stretch_width"}
        half["styles"] = {"flex": "1 1 330px", "min-width": "300px"}
        note = components.text(f'<p class="quiet">{html.escape(NO_PROOF)}</p>', margin=(8, 10))
        left = pn.Column(self.about, self.plot, **half)
        right = pn.Column(self.error, self.message, note, **half)
        wide = {"sizing_mode": "stretch_width", "min_width": 330}
        top = pn.Row(left, right, styles={"flex-wrap": "wrap"}, **wide)
        main = pn.Column(top, self.panels, margin=(10, 10, 0, 0), **wide)
        return pn.Row(controls, main, sizing_mode="stretch_width")


def verdict_box(verdict: Verdict, samples: int) -> str:
    """HTML of a verdict in words and numbers."""
    title = f"{verdict.name}: " + ("passed" if verdict.passed else "FAILED")
    worst = max(verdict.moments, key=lambda moment: abs(moment.z))
    rows = {
        "p-value": f"{verdict.p_value:.3g} (must be {verdict.alpha:.2g} or more)",
        "χ²": f"{verdict.chi2:.1f} with {verdict.degrees_of_freedom} degrees of freedom",
        "∫ pdf": f"{verdict.pdf_integral:.5f} ± {verdict.pdf_integral_error:.5f}",
        "samples": f"{samples}, valid {verdict.valid:.5f}",
        "worst moment": f"{worst.name}: {worst.z:+.1f} standard errors",
    }
    reason = f"<p>{html.escape(verdict.reason)}</p>" if verdict.reason else ""
    kind = "good" if verdict.passed else "bad"
    return components.box(kind, title, reason + components.table(rows))


def _density_of_file(content: bytes, name: str) -> np.ndarray:
    """Density of an uploaded image."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"image{Path(name).suffix.lower()}"
        path.write_bytes(content)
        try:
            return density_of(path)
        except (ValueError, FileNotFoundError) as error:
            raise ValueError(str(error).replace(str(path), name)) from None
