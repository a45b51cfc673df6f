"""The window of the warp tester."""

from __future__ import annotations

import html
import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import panel as pn
import param

from ...sampling.verdicts import Verdict
from .. import looks
from ..redrawing import Redrawing
from . import engine
from .engine import LIBRARY, MODULE, NO_PROOF, POINT_SETS, TROUBLE, Drawn, Engine
from .subjects import SUBJECTS, Parameter

COUNTS = [1 << k for k in range(17)]
SAMPLES = {"10 000": 10_000, "100 000": 100_000, "1 000 000": 1_000_000, "4 000 000": 4_000_000}
SIDE = 264
"""Width of the controls [px]."""

HEAD = """<h1>Warp tester</h1>
<p class="quiet">Points of the unit square, warped; and a χ² test of the warp
against its density.</p>"""

WAITING = looks.box("", "Not tested yet", "The test takes points of its own, whichever are drawn.")
CHANGED = looks.box("", "The file has changed", "Its points are drawn anew; run the test again.")


class Plot(pn.custom.JSComponent):
    """The canvas of points and grid; `plot.js` says what each parameter is."""

    ready = param.Integer(default=0)
    points = param.Bytes(default=b"")
    lines = param.Bytes(default=b"")
    dimensions = param.Integer(default=2)
    view = param.String(default="2D")
    parts = param.List(default=["points", "grid"])
    low = param.List(default=[0.0, 0.0])
    high = param.List(default=[1.0, 1.0])
    labels = param.List(default=["x", "y"])
    down = param.Boolean(default=False)
    upper = param.Boolean(default=False)
    alt = param.String(default="")

    _esm = Path(__file__).with_name("plot.js").read_text(encoding="utf-8")


class Window:
    """What one reader sees.

    Args:
        given: The engine, which all readers share.
        subject: What is shown first.
        values: Its parameters, where they are not the defaults.
    """

    def __init__(self, given: Engine, subject: str, values: dict[str, Any]) -> None:
        self.engine = given
        self.given = dict(values)
        self.verdict: Verdict | None = None
        self.drawn: Drawn | None = None
        self._quiet, self._drawing = False, Redrawing(self._draw)
        self._make_controls(subject)
        self.plot = Plot(sizing_mode="stretch_width", height=355)
        self.about = looks.text(sizing_mode="stretch_width", margin=(0, 6))
        self.trouble = looks.text(sizing_mode="stretch_width", visible=False, margin=(0, 6, 8, 6))
        self.said = looks.text(WAITING, sizing_mode="stretch_width", margin=(0, 6))
        self.panels = looks.text(sizing_mode="stretch_width", margin=(4, 6))

    # ------------------------------------------------------------------------------ controls

    def _make_controls(self, subject: str) -> None:
        style = {"stylesheets": [looks.controls_style()], "width": SIDE, "margin": (3, 6)}
        sources = {"This package": LIBRARY}
        if self.engine.module is not None:
            sources = {f"Yours: {self.engine.module.path.name}": MODULE} | sources
        whose = MODULE if self.engine.module is not None else LIBRARY
        self.source = pn.widgets.Select(label="Whose", options=sources, value=whose, **style)
        self.subject = pn.widgets.Select(label="Distribution", **style)
        self._offer(subject)
        self.number = pn.widgets.FloatInput(label="", value=0.5, **style)
        self.slider = pn.widgets.FloatSlider(
            start=0, end=1, value=0.5, show_value=False, label="", **style
        )
        self.image = pn.widgets.FileInput(accept=".exr,.png,.jpg", **style)
        self.example = pn.widgets.Button(label="2 × 2 example", **style)
        self.kind = pn.widgets.Select(label="Point set", options=[*POINT_SETS], **style)
        self.count = pn.widgets.DiscreteSlider(label="Points", options=COUNTS, value=1024, **style)
        self.seed = pn.widgets.IntInput(label="Seed", value=0, start=0, end=(1 << 32) - 1, **style)
        self.show = pn.widgets.CheckButtonGroup(
            label="Show", options=["points", "grid"], value=["points", "grid"], **style
        )
        self.view = pn.widgets.RadioButtonGroup(label="View", options=["3D", "2D"], **style)
        self.samples = pn.widgets.Select(
            label="Samples of the test", options=SAMPLES, value=1_000_000, **style
        )
        self.test = pn.widgets.Button(label="Run the χ² test", color="primary", **style)
        self.format = pn.widgets.Select(
            label="Figure", options=["png", "pdf", "svg"], **(style | {"width": 84})
        )
        self.save = pn.widgets.FileDownload(
            callback=self._figure,
            filename="warp.png",
            label="Save the figure",
            disabled=True,
            **(style | {"width": SIDE - 96, "margin": (25, 6, 3, 6)}),
        )
        for each in (self.kind, self.count, self.seed, self.number):
            each.param.watch(self._redraw, "value")
        self.slider.param.watch(self._slide, "value")
        self.source.param.watch(self._choose_source, "value")
        self.subject.param.watch(self._choose, "value")
        self.image.param.watch(self._read_image, "value")
        self.example.on_click(self._use_example)
        self.show.param.watch(self._view, "value")
        self.view.param.watch(self._view, "value")
        self.samples.param.watch(self._forget, "value")
        self.test.on_click(self._test)
        self.format.param.watch(self._name_figure, "value")

    def _offer(self, wanted: str) -> None:
        """List what the source has; in the library nothing is hidden, so that one reads why not."""
        names = self.engine.names(self.source.value)
        if self.source.value == LIBRARY:
            names = list(SUBJECTS)
        groups: dict[str, dict[str, str]] = {}
        for name in names:
            groups.setdefault(SUBJECTS[name].group, {})[SUBJECTS[name].title] = name
        self.subject.groups = groups
        self.subject.value = wanted if wanted in names else names[0]

    @property
    def parameter(self) -> Parameter | None:
        """The number that the subject takes."""
        parameters = SUBJECTS[self.subject.value].parameters
        return parameters[0] if parameters else None

    def _show_parameters(self) -> None:
        """Set the controls for the subject."""
        subject, parameter = SUBJECTS[self.subject.value], self.parameter
        self.number.visible = self.slider.visible = parameter is not None
        self.image.visible = self.example.visible = subject.takes_image
        self.view.visible = subject.dimensions == 3
        if parameter is not None:
            low, high = parameter.bounds
            value = float(self.given.get(parameter.name, parameter.default))
            self._quiet = True
            self.number.param.update(label=parameter.label, start=None, end=None)
            self.number.param.update(start=low, end=high, step=parameter.step, value=value)
            near = min(max(value, parameter.low), parameter.high)
            self.slider.param.update(
                start=parameter.low, end=parameter.high, step=parameter.step, value=near
            )
            self._quiet = False

    def values(self) -> dict[str, Any]:
        """The parameters as the controls have them."""
        parameter = self.parameter
        if parameter is not None:
            value = self.number.value
            return {parameter.name: parameter.default if value is None else value}
        if SUBJECTS[self.subject.value].takes_image and "image" in self.given:
            return {"image": self.given["image"]}
        return {}

    # -------------------------------------------------------------------------------- events

    async def _choose_source(self, _: Any) -> None:
        before = self.subject.value
        self._offer(before)
        if self.subject.value == before:
            await self._choose(None)

    async def _choose(self, _: Any) -> None:
        self._show_parameters()
        await self._redraw(None)

    def _slide(self, event: Any) -> None:
        if not self._quiet:
            self.number.value = event.new

    async def _use_example(self, _: Any) -> None:
        self.given.pop("image", None)
        await self._redraw(None)

    async def _read_image(self, event: Any) -> None:
        """A picture that the reader has chosen."""
        if not event.new:
            return
        name = str(self.image.filename)
        try:
            self.given["image"] = await self.engine.call(_image_of, event.new, name)
        except TROUBLE as error:
            self._say_trouble(f"{name} cannot be used", error)
            return
        await self._redraw(None)

    async def _redraw(self, _: Any) -> None:
        """Draw points of what is chosen now."""
        if not self._quiet:
            self._forget(None)
            await self._drawing()

    async def _draw(self) -> None:
        source, name, values = self.source.value, self.subject.value, self.values()
        kind, count, seed = self.kind.value, self.count.value, self.seed.value or 0
        subject = SUBJECTS[name]

        def work() -> Drawn:
            return engine.draw(self.engine.case(source, name, values), kind, count, seed)

        try:
            self.drawn = await self.engine.call(work)
        except TROUBLE as error:
            self.drawn = None
            self._say_trouble(self._failed(), error)
            empty = np.zeros((subject.dimensions, 0), np.float32)
            self._send(Drawn(empty, empty))
            return
        self.trouble.visible = False
        self._send(self.drawn)

    def _failed(self) -> str:
        """The head of what is said of a failure."""
        module = self.engine.module if self.source.value == MODULE else None
        file = "" if module is None else module.file_of(self.subject.value)
        return f"{SUBJECTS[self.subject.value].title}: {file or 'this package'} gives no points"

    def _send(self, drawn: Drawn) -> None:
        """Hand points to the canvas."""
        from ...sampling.domains import find

        subject = SUBJECTS[self.subject.value]
        domain = find(subject.domain)
        what = f"{drawn.points.shape[1]} points of {subject.title} and the grid of the unit square"
        self.plot.param.update(
            points=np.ascontiguousarray(drawn.points).tobytes(),
            lines=np.ascontiguousarray(drawn.lines).tobytes(),
            dimensions=subject.dimensions,
            view=self.view.value,
            parts=list(self.show.value),
            low=list(domain.low),
            high=list(domain.high),
            labels=list(domain.labels),
            down=domain.down,
            upper=domain.upper_only,
            alt=what,
        )
        turn = " · drag to turn" if subject.dimensions == 3 and self.view.value == "3D" else ""
        density = html.escape(subject.density)
        title = html.escape(subject.title)
        self.about.object = f'<h2>{title}</h2><p class="quiet">{density}{turn}</p>'

    def _view(self, _: Any) -> None:
        self.plot.param.update(view=self.view.value, parts=list(self.show.value))

    def _say_trouble(self, title: str, error: BaseException) -> None:
        self.trouble.object = looks.trouble(title, error)
        self.trouble.visible = True

    # -------------------------------------------------------------------------------- the test

    def _forget(self, _: Any) -> None:
        """A verdict belongs to what was tested, so it goes when that changes."""
        self.verdict = None
        self.save.disabled = True
        self.panels.object = ""
        self.said.object = WAITING

    async def _test(self, _: Any) -> None:
        source, name, values = self.source.value, self.subject.value, self.values()
        samples, seed = self.samples.value, self.seed.value or 0
        self._forget(None)
        self.said.object = looks.box("", "Testing …")
        self.test.disabled = True

        def work() -> tuple[Verdict, str]:
            case = self.engine.case(source, name, values)
            verdict = case.test(samples=samples, seed=seed)
            return verdict, engine.panels(verdict)

        try:
            verdict, drawn = await self.engine.call(work)
        except TROUBLE as error:
            title = SUBJECTS[name].title
            self.said.object = looks.trouble(f"{title}: the test could not be run", error)
            return
        finally:
            self.test.disabled = False
        now = (self.source.value, self.subject.value, self.samples.value, self.seed.value or 0)
        if now != (source, name, samples, seed) or repr(self.values()) != repr(values):
            self._forget(None)
            return
        self.verdict = verdict
        self.said.object = described(verdict, samples)
        self.panels.object = drawn
        self.save.disabled = self.drawn is None

    def _figure(self) -> io.BytesIO:
        """The file that "Save the figure" hands out."""
        assert self.drawn is not None
        assert self.verdict is not None
        title = f"{self.drawn.points.shape[1]} {self.kind.value} points"
        return io.BytesIO(engine.save(self.drawn, self.verdict, title, self.format.value))

    def _name_figure(self, _: Any) -> None:
        self.save.filename = f"warp.{self.format.value}"

    async def look_again(self) -> None:
        """Draw anew when the student has saved a file."""
        if await self.engine.call(self.engine.has_changed):
            self._offer(self.subject.value)
            await self._redraw(None)
            self.said.object = CHANGED

    # ------------------------------------------------------------------------------ the layout

    def layout(self) -> Any:
        """All of it."""
        self._show_parameters()
        self.plot.param.watch(self._redraw, "ready")
        if self.engine.module is not None:
            watch: Any = self.look_again
            pn.state.add_periodic_callback(watch, period=1000)
        mark = looks.text
        figure = pn.Row(self.format, self.save, width=SIDE + 12, margin=0)
        controls = pn.Column(
            looks.text(HEAD, width=SIDE, margin=(8, 6, 6, 6)),
            *([self.source] if self.engine.module is not None else []),
            self.subject,
            self.number,
            self.slider,
            self.image,
            self.example,
            self.kind,
            self.count,
            self.seed,
            self.view,
            self.show,
            mark("<hr style='border: 0; border-top: 1px solid var(--tf-line)'>", width=SIDE),
            self.samples,
            self.test,
            figure,
            width=SIDE + 12,
            margin=(0, 12, 0, 8),
        )
        half = {
            "sizing_mode": "stretch_width",
            "styles": {"flex": "1 1 330px", "min-width": "300px"},
        }
        left = pn.Column(self.about, self.plot, **half)
        right = pn.Column(
            self.trouble,
            self.said,
            looks.text(f'<p class="quiet">{html.escape(NO_PROOF)}</p>', margin=(8, 10)),
            **half,
        )
        wide = {"sizing_mode": "stretch_width", "min_width": 330}
        top = pn.Row(left, right, styles={"flex-wrap": "wrap"}, **wide)
        main = pn.Column(top, self.panels, margin=(10, 10, 0, 0), **wide)
        return pn.Row(controls, main, sizing_mode="stretch_width")


def described(verdict: Verdict, samples: int) -> str:
    """A verdict in words and numbers."""
    title = f"{verdict.name}: " + ("passed" if verdict.passed else "FAILED")
    worst = max(verdict.moments, key=lambda moment: abs(moment.z))
    rows = {
        "p-value": f"{verdict.p_value:.3g} (must be {verdict.alpha:.2g} or more)",
        "χ²": f"{verdict.chi2:.1f} with {verdict.degrees_of_freedom} degrees of freedom",
        "∫ pdf": f"{verdict.pdf_integral:.5f} ± {verdict.pdf_integral_error:.5f}",
        "samples": f"{samples}, valid {verdict.valid:.5f}",
        "worst moment": f"{worst.name}: {worst.z:+.1f} standard errors",
    }
    items = "".join(f"<dt>{key}</dt><dd>{html.escape(value)}</dd>" for key, value in rows.items())
    reason = f"<p>{html.escape(verdict.reason)}</p>" if verdict.reason else ""
    return looks.box("good" if verdict.passed else "bad", title, f"{reason}<dl>{items}</dl>")


def _image_of(content: bytes, name: str) -> np.ndarray:
    """The density of a file that came over the wire."""
    from .subjects import density_of

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"image{Path(name).suffix.lower()}"
        path.write_bytes(content)
        try:
            return density_of(path)
        except (ValueError, FileNotFoundError) as error:
            said = str(error).replace(str(path), name)
            raise ValueError(said) from None
