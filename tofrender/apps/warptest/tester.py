"""The page of the warp tester."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...runtime import checks
from ...sampling.chi_square import Case
from ...sampling.domains import find
from ...sampling.verdicts import Verdict
from ..ui import bundle
from ..ui.page import App, failure
from . import engine
from .engine import LIBRARY, MODULE, NO_PROOF, POINT_SETS, SUBJECT_ERRORS, Drawn, Engine
from .subjects import SUBJECTS, density_of

SAMPLES = (10_000, 100_000, 1_000_000, 4_000_000)

UNTESTED = "Not tested yet", "The test draws its own samples, whichever points are shown."
CHANGED = "The file has changed", "Its points are redrawn; run the test again."
TESTING = "Testing …", ""


class Tester(App):
    """The page of the warp tester for one user.

    Args:
        shared: Engine that all users share.
        subject: Name of the warp, shape or light that the page shows first.
        given: Values of its parameters, and the image if the warp needs an image.
    """

    _esm = bundle.javascript(
        "ui/parts",
        "ui/app",
        "explorer/recording",
        "explorer/words",
        "explorer/plot",
        "warptest/points",
        "warptest/tester",
    )
    _stylesheets: Any = (bundle.style("warptest/tester"),)
    PERIOD_MS = 1000

    def __init__(self, shared: Engine, subject: str, given: Mapping[str, Any]) -> None:
        self.engine = shared
        self.image = given.get("image")
        self.verdict: Verdict | None = None
        self.drawn: Drawn | None = None
        (source, _, names), *_ = sources = self._sources()
        chosen = {
            **{"source": source, "subject": subject if subject in names else names[0]},
            **{"kind": "independent", "count": 1024, "seed": 0, "samples": 1_000_000},
            "values": {name: value for name, value in given.items() if name != "image"},
        }
        lists = {"kinds": [*POINT_SETS], "samples": SAMPLES, "maxSeed": checks.MAX_SEED}
        about = {"subjects": _described(), "sources": sources, "note": NO_PROOF}
        super().__init__(shared.executor, chosen, **lists, **about)

    def _sources(self) -> list[tuple[str, str, list[str]]]:
        """Return name, label and subjects of each source.

        The library lists all subjects, also if it withholds some of them.
        """
        module = self.engine.module
        library = (LIBRARY, "This package", [*SUBJECTS])
        if module is None:
            return [library]
        return [(MODULE, f"Yours: {module.path.name}", module.names()), library]

    def _case(self, chosen: dict[str, Any]) -> Case:
        subject = SUBJECTS[chosen["subject"]]
        values = chosen["values"]
        given = {p.name: values[p.name] for p in subject.parameters if p.name in values}
        if subject.takes_image and self.image is not None:
            given["image"] = self.image
        return self.engine.sources[chosen["source"]].case(chosen["subject"], given)

    def _say(self, title: str, text: str) -> None:
        """Show a text instead of a verdict."""
        self.verdict = None
        self.tell(verdict={"title": title, "text": text}, panels="")

    async def refresh(self) -> None:
        """Redraw if the user has saved a file."""
        module = self.engine.module
        if module is not None and await self.run(module.refresh):
            self.tell(sources=self._sources())
            await self.do_redraw()
            self._say(*CHANGED)

    async def do_redraw(self, *_: Any) -> None:
        """Draw points of the current choice, without a test."""
        self._say(*UNTESTED)
        await super().do_redraw()

    async def draw(self) -> None:
        """Warp points and grid, and send them to the page."""
        chosen = self.chosen
        subject = SUBJECTS[chosen["subject"]]

        def work() -> Drawn:
            return engine.draw(self._case(chosen), chosen["kind"], chosen["count"], chosen["seed"])

        try:
            self.drawn = shown = await self.run(work)
            self.tell(error=None)
        except SUBJECT_ERRORS as error:
            module = self.engine.module if chosen["source"] == MODULE else None
            whose = (module and module.file_of(chosen["subject"])) or "this package"
            self.tell(error=failure(f"{subject.title}: {whose} gives no points", error))
            self.drawn = None
            nothing = np.zeros((subject.dimensions, 0), np.float32)
            shown = Drawn(points=nothing, lines=nothing)

        # Send them with their domain
        domain = find(subject.domain)
        names = ("dimensions", "low", "high", "labels", "down", "upper_only")
        alt = f"{shown.points.shape[1]} points of {subject.title} and the grid of the unit square"
        data = {
            "points": np.ascontiguousarray(shown.points).tobytes(),
            "lines": np.ascontiguousarray(shown.lines).tobytes(),
            **{name: getattr(domain, name) for name in names},
            **{"alt": alt, "subject": chosen["subject"]},
        }
        self.send(self.param.update, data=data)

    async def do_image(self, name: str, content: bytes) -> None:
        """Use an image of the reader."""
        try:
            self.image = await self.run(_density_of_file, content, name)
        except SUBJECT_ERRORS as error:
            self.tell(error=failure(f"{name} cannot be used", error))
            return
        await self.do_redraw()

    async def do_example(self) -> None:
        """Use the image of the course."""
        self.image = None
        await self.do_redraw()

    async def do_test(self) -> None:
        """Test the choice, and show the verdict unless the choice has changed meanwhile."""
        chosen = self.chosen
        image = self.image

        def work() -> tuple[Verdict, str]:
            verdict = self._case(chosen).test(samples=chosen["samples"], seed=chosen["seed"])
            return verdict, engine.panels(verdict)

        # Run the test in the thread
        self._say(*TESTING)
        self.tell(testing=True)
        try:
            verdict, panels = await self.run(work)
        except SUBJECT_ERRORS as error:
            title = f"{SUBJECTS[chosen['subject']].title}: the test could not be run"
            if self.chosen == chosen and self.image is image:
                self.tell(verdict=failure(title, error))
            return
        finally:
            self.tell(testing=False)

        # Is it still the reader's choice?
        if self.chosen == chosen and self.image is image:
            self.verdict = verdict
            self.tell(verdict=_told(verdict, chosen["samples"]), panels=panels)

    async def do_save(self, format: str) -> None:
        """Send the figure of points and verdict."""
        if self.drawn is not None and self.verdict is not None:
            title = f"{self.drawn.points.shape[1]} {self.chosen['kind']} points"
            content = await self.run(engine.save, self.drawn, self.verdict, title, format)
            self.send(self._send_msg, {"name": f"warp.{format}", "content": content})


def _described() -> dict[str, dict[str, Any]]:
    """Describe each subject for the page."""
    return {
        name: {
            "title": subject.title,
            "group": subject.group,
            "density": subject.density,
            "dimensions": subject.dimensions,
            "takesImage": subject.takes_image,
            "parameter": [vars(each) for each in subject.parameters][:1],
        }
        for name, subject in SUBJECTS.items()
    }


def _told(verdict: Verdict, samples: int) -> dict[str, Any]:
    """Return the message of a verdict in words and numbers."""
    worst = max(verdict.moments, key=lambda moment: abs(moment.z))
    rows = {
        "p-value": f"{verdict.p_value:.3g} (must be {verdict.alpha:.2g} or more)",
        "χ²": f"{verdict.chi2:.1f} with {verdict.degrees_of_freedom} degrees of freedom",
        "∫ pdf": f"{verdict.pdf_integral:.5f} ± {verdict.pdf_integral_error:.5f}",
        "samples": f"{samples}, valid {verdict.valid:.5f}",
        "worst moment": f"{worst.name}: {worst.z:+.1f} standard errors",
    }
    kind, word = ("good", "passed") if verdict.passed else ("bad", "FAILED")
    title = f"{verdict.name}: {word}"
    return {"kind": kind, "title": title, "text": verdict.reason, "rows": [*rows.items()]}


def _density_of_file(content: bytes, name: str) -> np.ndarray:
    """Return the density of an uploaded image."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"image{Path(name).suffix.lower()}"
        path.write_bytes(content)
        try:
            return density_of(path)
        except (ValueError, FileNotFoundError) as error:
            raise ValueError(str(error).replace(str(path), name)) from None
