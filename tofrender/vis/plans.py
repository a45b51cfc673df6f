"""Plan of a scene from above or from the side, with cameras and lasers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..runtime import checks
from ..runtime.backend import tracing_lock
from ..runtime.canvas import figure_width, in_style, new_figure, palette
from ..runtime.interface import POSITIONS, name_of, rows, world_transform
from ..runtime.plots import few_ticks, fit_height, wrap_text
from .transient_figures import picture_aspect

Array = NDArray[np.float64]

# Prefix of a shape's id, label, and color ("ink" is the color of text). The last row is the default
KINDS = (
    ("relay", "relay wall", "#0072b2"),
    ("hidden", "hidden", "#d55e00"),
    ("occluder", "occluder", "ink"),
    ("", "other", "#8c8c8c"),
)
VIEWS = {"above": (0, 2), "side": (2, 1)}  # Coordinates to the right and upwards

CAMERA = "#009e73"
LASER = "#e69f00"

MAX_RELATIVE_WIDTH = 3.0
"""Largest width of a shape in widths of the relay wall. Wider shapes are cut off."""


@in_style()
def plan_figure(
    scene: mi.Scene,
    *,
    view: str = "above",
    laser: Sequence[float] | None = None,
    title: str | None = None,
) -> Figure:
    """Draw a plan of a scene.

    Each shape is drawn as its convex hull. Shapes have a color if their id starts with "relay",
    "hidden" or "occluder". The wedge of a camera contains the rays through the middle row of its
    film up to their intersections. In the view from the side, it contains the rays through the
    middle column. Point lights and the middle ray of a projector are drawn, too.

    Args:
        scene: Any scene of the active variant.
        view: "above", x to the right and z upwards; or "side", z to the right and y upwards.
        laser: Position (x, y, z) of a laser that is not a light of the scene [m]. By default the
            position of the integrator's laser, if it has a laser. This is the position of the first
            camera, or of the projector's `frame`.
        title: Title of the figure.

    Raises:
        ValueError: Not a scene, a scene without shapes, an unknown view, or a laser that is not a
            point.

    Example:
        >>> from tofrender.scenes import cornell_box
        >>> figure = plan_figure(mi.load_dict(cornell_box(width=8, height=8)), title="Cornell box")
        >>> figure.axes[0].get_xlabel()
        'x [m]'
    """
    checks.instance("scene", scene, mi.Scene, f"an mi.Scene of variant {mi.variant()}")
    checks.text("title", title)
    if not scene.shapes():
        raise ValueError("scene: a plan needs shapes, but the scene contains none. Add a shape")
    shown = list(VIEWS[checks.one_of("view", view, VIEWS)])
    device = _integrators_laser(scene) if laser is None else np.array(checks.point("laser", laser))

    # Draw the shapes, the largest first
    wide = figure_width(4.6)
    figure = new_figure(wide, wide, "compressed")
    axes = figure.add_subplot()
    kinds = [next(kind for kind in KINDS if s.id().startswith(kind[0])) for s in scene.shapes()]
    hulls = [_convex_hull(_points(shape)[:, shown]) for shape in scene.shapes()]
    outlines = list(zip(kinds, hulls, strict=True))
    outlines.sort(key=lambda each: -float(np.prod(np.ptp(each[1], axis=0))))
    for kind, outline in outlines:
        _draw_outline(axes, outline, kind)

    # Draw cameras and lasers
    wedges = [_wedge(scene, sensor, view)[:, shown] for sensor in scene.sensors()]
    points = [e for e in scene.emitters() if mi.has_flag(e.flags(), mi.EmitterFlags.DeltaPosition)]
    beams = [_beam(scene, light)[:, shown] for light in points]
    if device is not None:
        beams.append(device[None, shown])
    for wedge in wedges:
        axes.fill(*wedge.T, fc=CAMERA, ec=CAMERA, lw=1, alpha=0.18, zorder=1)
        axes.plot(*wedge[0], "^", color=CAMERA, ms=10, label="camera", ls="none", zorder=9)
    for beam in beams:
        axes.plot(*beam.T, color=LASER, lw=1.2, zorder=8)
        axes.plot(*beam[0], "*", color=LASER, ms=11, label="laser", ls="none", zorder=10)

    # Choose the limits, and label the axes
    low, high = _limits(outlines, wedges + beams)
    width, height = high - low
    figure.set_figheight(wide * picture_aspect(height, width, 0.3, 1.3) + 1.0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel=f"{'xyz'[shown[0]]} [m]", ylabel=f"{'xyz'[shown[1]]} [m]")
    axes.grid(alpha=0.25)
    few_ticks(axes)
    if title is not None:
        axes.set_title(wrap_text(title, wide))

    # Explain each color once
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    options = {"loc": "outside lower center", "ncols": 3, "frameon": False}
    figure.legend(unique.values(), unique.keys(), **options)
    fit_height(figure)
    return figure


def _points(shape: Any) -> Array:
    """Return points with the same convex hull as a shape [m], (n, 3)."""
    parameters = mi.traverse(shape)
    if name_of(parameters, POSITIONS):
        return rows(parameters, POSITIONS)
    line = dr.linspace(mi.Float, 0, 1, 65)
    try:
        sampled = shape.sample_position(0, mi.Point2f(*dr.meshgrid(line, line))).p
    except RuntimeError:  # Not every shape can be sampled
        return np.array([np.array(shape.bbox().corner(k)).ravel() for k in range(8)])
    return np.array(sampled, dtype=np.float64).T


def _convex_hull(points: Array) -> Array:
    """Return the convex hull, counter-clockwise. For a line, return its ends."""
    from scipy.spatial import ConvexHull, QhullError

    points = np.unique(points.round(6), axis=0)
    if len(points) < 3:
        return points
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:  # All points on a line
        return points[[0, -1]]


def _draw_outline(axes: Axes, outline: Array, kind: tuple[str, str, str]) -> None:
    _, label, color = kind
    color = palette().ink if color == "ink" else color
    order = len(KINDS) - KINDS.index(kind)
    if len(outline) < 3:  # Seen from its edge
        axes.plot(*outline.T, color=color, lw=3, label=label, zorder=2 + order)
    else:
        face = "none" if label == "other" else color
        axes.fill(*outline.T, fc=face, ec=color, lw=1.5, alpha=0.75, label=label, zorder=1 + order)


def _limits(outlines: list, devices: list[Array]) -> tuple[Array, Array]:
    """Return the corners of a picture that cuts off shapes much wider than the relay wall."""
    # Separate the wide shapes
    sizes = [(kind, outline, np.ptp(outline, axis=0).max()) for kind, outline in outlines]
    walls = [size for kind, _, size in sizes if kind is KINDS[0]]
    widest = MAX_RELATIVE_WIDTH * max(walls, default=np.inf)
    whole = [outline for _, outline, size in sizes if size <= widest]
    cut = [outline for _, outline, size in sizes if size > widest]
    points = np.concatenate([*whole, *devices] if whole or devices else cut)
    low = points.min(axis=0)
    high = points.max(axis=0)

    # Include the nearest point of each wide shape
    for outline in cut:
        inside = np.clip((low + high) / 2, outline.min(axis=0), outline.max(axis=0))
        low = np.minimum(low, inside)
        high = np.maximum(high, inside)
    margin = 0.08 * float((high - low).max())
    return low - margin, high + margin


def _wedge(scene: Any, sensor: Any, view: str) -> Array:
    """Return the position of a camera, followed by intersections of its rays [m], (n, 3)."""
    line = dr.linspace(mi.Float, 1e-3, 1 - 1e-3, 65)
    film = mi.Point2f(line, 0.5) if view == "above" else mi.Point2f(0.5, line)
    ray, _ = sensor.sample_ray_differential(0, 0.5, film, mi.Point2f(0.5))
    origins, ends = _intersect(scene, ray)
    return np.concatenate([origins[:1], ends])


def _integrators_laser(scene: Any) -> Array | None:
    """Return the position of a confocal integrator's laser [m]. Other integrators give None."""
    integrator = scene.integrator()
    sensors = scene.sensors()
    if not hasattr(integrator, "projector") or not sensors:
        return None
    camera = world_transform(sensors[0]) @ mi.Point3f(0)
    projector = integrator.projector
    position = camera if projector is None else projector.origin(camera)
    return np.array(position, dtype=np.float64).ravel()


def _beam(scene: Any, light: Any) -> Array:
    """Return the position of a light [m], (1, 3). A projector adds the end of its middle ray."""
    if light.class_name() == "Projector":
        ray, _ = light.sample_ray(0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
        return np.concatenate(_intersect(scene, ray))
    reference = dr.zeros(mi.Interaction3f)
    reference.p = mi.Point3f(scene.bbox().center())
    ds, _ = light.sample_direction(reference, mi.Point2f(0.5))
    return np.array(ds.p, dtype=np.float64).reshape(1, 3)


@tracing_lock()
def _intersect(scene: Any, ray: Any) -> tuple[Array, Array]:
    """Return origins and ends of rays [m], (n, 3).

    The length of a ray without a hit is the distance to the middle of the scene.
    """
    hit = scene.ray_intersect_preliminary(ray)
    far = dr.norm(mi.Point3f(scene.bbox().center()) - ray.o)
    ends = np.array(ray(dr.select(hit.is_valid(), hit.t, far)), dtype=np.float64).T
    return np.broadcast_to(np.array(ray.o, dtype=np.float64).T, ends.shape), ends
