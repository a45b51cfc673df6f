"""The page that compares pictures, or films with a common clock, two at a time."""

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
from .picture_set import PictureSet, alike, difference, relative_errors

DIFFERENCES = "RdBu_r"  # Matplotlib's colors of negative and positive differences


class Comparison(App):
    """The page of one browser session. It shows a scene of the course, or pictures from files."""

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

    def __init__(self, executor: Executor, scene: str | None, files: PictureSet | None) -> None:
        from matplotlib import colormaps

        colors = np.rint(255 * colormaps[DIFFERENCES](np.arange(256) / 255)[:, :3])
        state: dict[str, Any] = {"colors": colors.astype(np.uint8).tobytes(), "white": 1.0}
        chosen: dict[str, Any] = {}
        if files is None:
            scene = scene or SCENES[0]
            a, *others = techniques(scene)
            chosen |= {"scene": scene, "a": a, "b": "mis" if "mis" in others else "reference"}
            chosen["spp"] = 16
            state["scenes"] = {name: [*techniques(name).items()] for name in SCENES}
        else:
            chosen |= {"a": 0, "b": 1}
            if len(files.pictures) > 2:
                state["files"] = [[k, each.name] for k, each in enumerate(files.pictures)]
            if files.clock is not None:
                state["white"], step = files.look()
                state |= {"clock": asdict(files.clock), "quantity": files.quantity}
                chosen["step"] = step
        super().__init__(executor, chosen, **state)
        self.files = files

    async def draw(self) -> None:
        """Send both chosen pictures, and their difference in numbers."""
        chosen = self.chosen
        step = chosen.get("step")
        pixel = chosen.get("pixel")

        def work() -> tuple[list[str], list[np.ndarray], list[np.ndarray], list[Any]]:
            if self.files is not None:
                sides = [int(chosen[side]) for side in "ab"]
                names = [each.name for each in self.files.pictures]
                all_frames = self.files.frames(step)
                x, y = pixel or (all_frames[0].shape[1] // 2, all_frames[0].shape[0] // 2)
                all_curves = self.files.responses(x, y)
                frames = [all_frames[k] for k in sides]
                rows = _rows(frames) + _errors(names, all_frames, sides[0])
                curves = [all_curves[k] for k in sides] if all_curves else []
                return [names[k] for k in sides], frames, curves, rows
            scene = chosen["scene"]
            spp = chosen["spp"]
            pictures = [render_technique(scene, chosen[side], spp) for side in "ab"]
            reference = render_technique(scene, "reference", 1)
            names = [each.name for each in pictures]
            frames = alike([each.pixels for each in pictures])
            return names, frames, [], _rows(frames, reference.pixels)

        # Compute the pictures in the thread
        if self.files is None:
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
    rms, largest, *means = difference(*frames)
    rows = [
        ["RMS of B − A", f"{rms:.4g}, {percent(rms, means[0])} of A's mean"],
        ["largest |B − A|", f"{largest:.4g}"],
        ["mean of A, of B", ", ".join(f"{mean:.4g}" for mean in means)],
    ]
    for name, frame in zip("AB", frames, strict=True) if reference is not None else ():
        true, seen = alike([np.asarray(reference), frame])
        rms, _, mean, _ = difference(true, seen)
        rows.append([f"{name}, RMS from the reference", percent(rms, mean)])
        rows.append([f"{name} against the reference", _relative(true, seen)])
    return rows


def _errors(names: list[str], frames: list[np.ndarray], a: int) -> list[list[str]]:
    """Return the relative errors of all pictures except A, against A."""
    pictures = zip(names, frames, strict=True)
    others = [each for k, each in enumerate(pictures) if k != a]
    return [[f"{name} against A", _relative(frames[a], frame)] for name, frame in others]


def _relative(reference: np.ndarray, picture: np.ndarray) -> str:
    """Return both relative errors of a picture in words."""
    rel_mse, smape = relative_errors(reference, picture)
    return f"relMSE {rel_mse:.3g}, SMAPE {smape:.3g}"


def percent(part: float, whole: float) -> str:
    """Format a part in percent."""
    return f"{100 * part / whole:.3g} %" if whole else "–"


def application(scene: str | None = None, files: PictureSet | None = None) -> Any:
    """Return a function that makes the page of a reader, for `serving.serve`."""
    variant = backend.activate(None)
    executor = ThreadPoolExecutor(1, initializer=backend.activate, initargs=(variant,))
    return lambda: Comparison(executor, scene, files)
