"""The page that compares two pictures, or two films with a common clock."""

from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import asdict
from typing import Any

import numpy as np

from ...runtime import backend
from ...runtime.editions import LeftOut
from ...signals.color import LUMINANCE
from ..ui import bundle
from ..ui.page import App, failure
from .course_pictures import SCENES, render_technique, techniques
from .pairs import Pair, alike, numbers

DIFFERENCES = "RdBu_r"  # Matplotlib's colors of negative and positive differences


class Comparison(App):
    """The page of one reader. It starts with a scene of the course, or with a pair of files."""

    _esm = bundle.javascript(
        "ui/parts",
        "ui/app",
        "explorer/recording",
        "explorer/words",
        "explorer/paint",
        "explorer/plot",
        "explorer/frame",
        "compare/zoom",
        "compare/comparison",
    )
    _stylesheets: Any = (bundle.style("compare/comparison"),)

    def __init__(self, executor: Executor, scene: str | None, pair: Pair | None) -> None:
        from matplotlib import colormaps

        colors = np.rint(255 * colormaps[DIFFERENCES](np.arange(256) / 255)[:, :3])
        state: dict[str, Any] = {"colors": colors.astype(np.uint8).tobytes(), "white": 1.0}
        chosen: dict[str, Any] = {}
        if pair is None:
            scene = scene or SCENES[0]
            a, *others = techniques(scene)
            chosen |= {"scene": scene, "a": a, "b": "mis" if "mis" in others else "reference"}
            chosen["spp"] = 16
            state["scenes"] = {name: [*techniques(name).items()] for name in SCENES}
        elif pair.clock is not None:
            state["white"], step = pair.look()
            state |= {"clock": asdict(pair.clock), "quantity": pair.quantity}
            chosen["step"] = step
        super().__init__(executor, chosen, **state)
        self.pair = pair

    async def draw(self) -> None:
        """Send both chosen pictures, and their difference in numbers."""
        chosen = self.chosen
        step = chosen.get("step")
        pixel = chosen.get("pixel")

        def work() -> tuple[list[str], list[np.ndarray], list[np.ndarray], list[Any]]:
            if self.pair is not None:
                frames = self.pair.frames(step)
                x, y = pixel or (frames[0].shape[1] // 2, frames[0].shape[0] // 2)
                curves = self.pair.responses(x, y)
                return [p.name for p in self.pair.pictures], frames, curves, _rows(frames)
            scene = chosen["scene"]
            spp = chosen["spp"]
            pictures = [render_technique(scene, chosen[side], spp) for side in "ab"]
            reference = render_technique(scene, "reference", 1)
            frames = alike([each.pixels for each in pictures])
            return [p.name for p in pictures], frames, [], _rows(frames, reference.pixels)

        # Compute the pictures in the thread
        if self.pair is None:
            self.tell(message={"title": "Rendering …"})
        try:
            names, frames, curves, rows = await self.run(work)
        except (ValueError, RuntimeError, OSError, LeftOut) as error:
            self.tell(message=failure("There is no picture", error))
            return

        # Send them as bytes
        height, width, channels = frames[0].shape
        planes = [np.ascontiguousarray(f.transpose(2, 0, 1), np.float32).tobytes() for f in frames]
        weights = LUMINANCE.tolist() if channels == 3 else [1.0]
        size = {"height": height, "width": width, "weights": weights, "step": step}
        curves = [np.float32(curve).tobytes() for curve in curves]
        data = {"pictures": planes, "curves": curves, "names": names, **size}
        self.send(self.param.update, data=data)
        self.tell(message=None, rows=rows)


def _rows(frames: list[np.ndarray], reference: np.ndarray | None = None) -> list[list[str]]:
    """Return differences in words and numbers, with the reference of pictures of the course."""
    rms, largest, *means = numbers(*frames)
    rows = [
        ["RMS of B − A", f"{rms:.4g}, {percent(rms, means[0])} of A's mean"],
        ["largest |B − A|", f"{largest:.4g}"],
        ["mean of A, of B", ", ".join(f"{mean:.4g}" for mean in means)],
    ]
    for name, frame in zip("AB", frames, strict=True) if reference is not None else ():
        rms, _, mean, _ = numbers(*alike([np.asarray(reference), frame]))
        rows.append([f"{name}, RMS from the reference", percent(rms, mean)])
    return rows


def percent(part: float, whole: float) -> str:
    """Format a part in percent."""
    return f"{100 * part / whole:.3g} %" if whole else "–"


def application(scene: str | None = None, pair: Pair | None = None) -> Any:
    """Return a function that makes the page of a reader, for `serving.serve`."""
    variant = backend.activate(None)
    executor = ThreadPoolExecutor(1, initializer=backend.activate, initargs=(variant,))
    return lambda: Comparison(executor, scene, pair)
