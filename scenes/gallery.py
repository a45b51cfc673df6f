"""Make the pictures of the built-in scenes: `python -m scenes.gallery [NAME ...]`.

All pictures together need a few minutes. Scenes with hidden objects are drawn as plans. All other
pictures are rendered with a fixed seed, so the same versions of all packages make the same files,
up to floating-point rounding.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

import tofrender
from tofrender.runtime import checks
from tofrender.scenes import BUILT_IN

FOLDER = Path(__file__).parent / "pictures"
PANEL_WIDTH = 256  # Width of a rendered panel [pixels]
POLARIZED = "llvm_ad_mono_polarized"
"""Variant for pictures of polarized light."""


@dataclass(frozen=True)
class Panel:
    """One rendered picture of a scene.

    Attributes:
        scene: Name of a built-in scene.
        label: Text in the picture, "" for a picture without text.
        options: Arguments of the scene's builder.
        spp: Samples per pixel.
        exposure: Factor of the radiance; a radiance of 1 / exposure is white.
        gated: Whether the picture shows only light that arrives in the film's bins.
        shown: Quantity of polarized light, the `shown` of `tofrender.polarization_picture`,
            rendered in a polarized variant; "" for the picture in color.
        cut: Fraction of the height that is removed at the top and at the bottom.
    """

    scene: str
    label: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    spp: int = 256
    exposure: float = 1.0
    gated: bool = False
    shown: str = ""
    cut: float = 0.0


ONE_BIN = {"temporal_bins": 1}  # For panels that show the steady picture
GATED = ONE_BIN | {"start_opl": 29.9, "bin_width_opl": 0.4}  # Light of the sign in fog
FIRST = ONE_BIN | {"start_opl": 3.0, "bin_width_opl": 3.2}  # Light that the window reflects
BOTH_ENDS = ONE_BIN | {"integrator": "transient_bdpt"}


def _by(strategy: str) -> Panel:
    """Return Veach's plates, rendered with a sampling strategy."""
    return Panel("veach", strategy, {"integrator": f"path_tracer_{strategy}"}, 16, 1.2)


def _foggy(
    scene: str,
    label: str,
    spp: int,
    exposure: float,
    options: Mapping[str, Any] = ONE_BIN,
    gated: bool = False,
) -> Panel:
    """Return a scene with fog, smoke or milk, cut to a wide format."""
    return Panel(scene, label, options, spp, exposure, gated, cut=1 / 16)


def _polarized(
    scene: str,
    label: str,
    shown: str,
    options: Mapping[str, Any] = ONE_BIN,
    spp: int = 16,
    exposure: float = 1.0,
    gated: bool = False,
) -> Panel:
    """Return a quantity of polarized light in a scene."""
    return Panel(scene, label, options, spp, exposure, gated, shown)


PICTURES: dict[str, tuple[Panel, ...]] = {
    "cornell_box": (
        Panel("cornell_box", "ceiling light", ONE_BIN),
        Panel("cornell_box_flash", "flash", ONE_BIN, exposure=4.0),
        Panel("cornell_box_glass", "glass", ONE_BIN, 1024),
        Panel("cornell_box_mirror", "mirror", ONE_BIN, 4096),
    ),
    "bust_simple": (Panel("bust_simple", spp=64),),
    "bust_ao": (Panel("bust_ao"),),
    "veach": (_by("mats"), _by("nee"), _by("mis")),
    "sphere_lights": tuple(
        Panel(f"sphere_light_{size}", size) for size in ("small", "medium", "large")
    ),
    "rectangle_lights": (
        Panel("rectangle_light_quad", "quad"),
        Panel("rectangle_light_triangles", "triangles"),
    ),
    "small_box": (
        Panel("small_box", "direct", {"max_bounces": 1}, 256, 1.2),
        Panel("small_box", "8 bounces", {}, 512, 1.2),
        Panel("small_box", "mirror_glass", {"spheres": "mirror_glass"}, 1024, 1.2),
    ),
    "caustics": (
        Panel("caustic", "caustic", BOTH_ENDS, 64, 0.8),
        Panel("mirror_and_glass", "mirror and glass", BOTH_ENDS, 64, 0.7),
        Panel("lamp_in_fixture", "fixture", BOTH_ENDS, 64, 0.7),
        Panel("light_through_hole", "hole", BOTH_ENDS, 64),
    ),
    "fog": (
        _foggy("cornell_box_fog", "fog", 768, 1.6),
        _foggy("lamp_in_milk", "milk", 1536, 0.7),
        _foggy("smoke_corridor", "smoke", 512, 0.9),
        _foggy("headlight_in_fog", "headlight", 1024, 0.5),
        _foggy("headlight_in_fog", "gate at 30 m", 1536, 25.0, GATED, gated=True),
    ),
    "polarized": (
        _polarized("brewster_window", "window", "intensity", spp=1024),
        _polarized("brewster_window", "degree", "degree", spp=1024),
        _polarized("brewster_window", "first light", "intensity", FIRST, 1024, gated=True),
        _polarized("strained_mirror_corridor", "mirrors", "intensity", exposure=1.8),
        _polarized("strained_mirror_corridor", "angle", "angle", ONE_BIN | {"angle": 20.0}),
        _polarized("strained_mirror_corridor", "circular", "circular"),
    ),
    "moving": (
        Panel("fan", "fan", ONE_BIN, exposure=2.5),
        Panel("corridor", "corridor", ONE_BIN, 1024),
        Panel("moving_mirror", "mirror and glass", ONE_BIN, 2048),
    ),
}
"""Panels of each rendered file `pictures/NAME.png`, from left to right."""


@dataclass(frozen=True)
class Plan:
    """A drawn plan of a scene with hidden objects, which a rendered picture would not show.

    Attributes:
        scene: Name of a built-in scene.
        view: "above" or "side", the `view` of `tofrender.plan_figure`.
    """

    scene: str
    view: str = "above"


PLANS: dict[str, tuple[tuple[Plan, ...], ...]] = {
    "plans_wall": (
        (Plan("nlos_z"), Plan("nlos_bunny")),
        (Plan("nlos_patch"), Plan("nlos_plane")),
    ),
    "plans_fog": ((Plan("nlos_behind_fog"), Plan("nlos_behind_fog", "side")),),
    "plans_box": (
        (
            Plan("wall_box_sphere_nlos"),
            Plan("wall_box_sphere_nlos", "side"),
            Plan("wall_box_spheres_nlos"),
        ),
        (Plan("wall_box_hi_nlos"), Plan("wall_box_behind"), Plan("ourbox_confocal")),
    ),
}
"""Rows of plans in each drawn file `pictures/NAME.png`."""

PLAN_SIZE = (4.0, 3.25)  # [inches]
PLAN_DPI = 96  # [pixels per inch]


def render_panel(panel: Panel, width: int = PANEL_WIDTH) -> np.ndarray:
    """Render a panel as an sRGB picture.

    Args:
        panel: The panel.
        width: Width [pixels], 1 to 65536. The height follows from the scene's proportions.

    Returns:
        uint8 (height, width, 3).
    """
    before = str(mi.variant())
    if panel.shown:
        mi.set_variant(POLARIZED)
    try:
        image = _rendered(panel, width)
    finally:
        mi.set_variant(before)
    rows = round(panel.cut * image.shape[0])
    return image[rows : image.shape[0] - rows]


def _rendered(panel: Panel, width: int) -> np.ndarray:
    """Render a panel in the active variant, without cutting it."""
    # Load the scene in the size of the panel
    builder = BUILT_IN[panel.scene]
    film = builder(**panel.options)["sensor"]["film"]
    height = max(1, round(width * film["height"] / film["width"]))
    described = builder(width=width, height=height, **panel.options)
    scene = tofrender.load_scene(described, sampler="padded_sobol")

    # Render the bins or the steady picture
    result = mi.render(scene, spp=panel.spp, seed=0)
    if panel.gated:
        image = np.array(result[1]).sum(axis=2)
    else:
        image = np.array(result[0] if isinstance(result, tuple) else result)

    # Convert to sRGB
    if panel.shown:
        stokes = image.reshape(*image.shape[:2], 4, -1)
        return tofrender.polarization_picture(stokes, panel.shown, exposure=panel.exposure)
    return tofrender.tonemap(image[..., :3], exposure=panel.exposure)


def picture(panels: Iterable[Panel], width: int = PANEL_WIDTH) -> np.ndarray:
    """Render panels with labels, side by side with a gap of two white pixels.

    Args:
        panels: Panels of equal height.
        width: Width of each panel [pixels].

    Returns:
        uint8 (height, columns, 3).
    """
    parts: list[np.ndarray] = []
    for panel in panels:
        image = labeled(render_panel(panel, width), panel.label)
        gap = np.full((image.shape[0], 2, 3), 255, np.uint8)
        parts += [gap, image] if parts else [image]
    return np.concatenate(parts, axis=1)


def draw_plan(plan: Plan) -> np.ndarray:
    """Draw the plan of a scene, uint8 (height, width, 3), in the same size for all scenes."""
    scene = tofrender.load_scene(BUILT_IN[plan.scene](), optimize=False)

    # The laser of confocal scenes is at the position of the camera
    laser = None
    if isinstance(scene.integrator(), tofrender.ConfocalTransientIntegrator):
        ray, _ = scene.sensors()[0].sample_ray(0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
        laser = np.array(ray.o).ravel().tolist()

    # Draw the figure to an array
    title = f"{plan.scene}, from {'the side' if plan.view == 'side' else plan.view}"
    figure = tofrender.plan_figure(scene, view=plan.view, laser=laser, title=title)
    figure.set_size_inches(*PLAN_SIZE)
    figure.set_dpi(PLAN_DPI)
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()


def plans_picture(rows: Iterable[Iterable[Plan]]) -> np.ndarray:
    """Draw plans in rows of equal length, uint8 (height, width, 3)."""
    return np.concatenate(
        [np.concatenate([draw_plan(plan) for plan in row], axis=1) for row in rows]
    )


def labeled(image: np.ndarray, text: str) -> np.ndarray:
    """Return the image with white text on black in its lower left corner.

    Example:
        >>> int(labeled(np.full((40, 80, 3), 128, np.uint8), "nee").max())
        255
    """
    if not text:
        return image
    from PIL import Image, ImageDraw, ImageFont

    canvas = Image.fromarray(image)
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(14)
    bottom = image.shape[0]
    draw.rectangle((0, bottom - 22, draw.textlength(text, font) + 11, bottom), fill=(0, 0, 0))
    draw.text((6, bottom - 7), text, (255, 255, 255), font, anchor="ls")
    return np.asarray(canvas)


def write(folder: Path, names: Iterable[str] = (), width: int = PANEL_WIDTH) -> list[Path]:
    """Render or draw pictures, and save them as `NAME.png`.

    Args:
        folder: Folder of the files, created if it does not exist.
        names: Names in `PICTURES` and `PLANS`. Without names, all pictures are made.
        width: Width of a rendered panel [pixels].

    Returns:
        The paths of the files.

    Raises:
        ValueError: If a name is unknown; one line, before a picture is rendered.
    """
    from PIL import Image

    known = [*PICTURES, *PLANS]
    chosen = [checks.one_of("NAME", name, known) for name in names] or known
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name in chosen:
        path = folder / f"{name}.png"
        if name in PLANS:
            # With 64 colors, the file has half the size
            image = Image.fromarray(plans_picture(PLANS[name])).quantize(64)
        else:
            image = Image.fromarray(picture(PICTURES[name], width))
        image.save(path, optimize=True)
        print(f"{path}: {path.stat().st_size // 1024} KiB")
        paths.append(path)
    return paths


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m scenes.gallery", description=__doc__)
    known = ", ".join([*PICTURES, *PLANS])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"pictures to make: {known}")
    options = parser.parse_args()
    try:
        write(FOLDER, options.names)
    except ValueError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")


if __name__ == "__main__":
    main()
