"""A scene from above or from the side: what stands where, and what camera and laser look at."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from ..runtime import checks
from ..runtime.backend import tracing_lock
from ..runtime.canvas import figure_width, in_style, new_figure, palette
from ..runtime.plots import few_ticks, fit_height, wrap_text
from .figures import picture_aspect

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

# how a shape's id starts, what the legend calls it, and its colour, "ink" for that of text; the
# last one is any other's
KINDS = (
    ("relay", "relay wall", "#0072b2"),
    ("hidden", "hidden", "#d55e00"),
    ("occluder", "occluder", "ink"),
    ("", "other", "#8c8c8c"),
)
VIEWS = {"above": (0, 2), "side": (2, 1)}
"""Coordinates to the right and upwards."""

CAMERA, LASER = "#009e73", "#e69f00"

WIDEST = 3.0
"""Shapes this many times wider than the relay wall are cut off at the picture's edge."""


@in_style
def plan_figure(
    scene: mi.Scene,
    *,
    view: str = "above",
    laser: Sequence[float] | None = None,
    title: str | None = None,
) -> Figure:
    """Draw a plan of a scene.

    Each shape is drawn as its convex outline; shapes whose ids start with "relay", "hidden" and
    "occluder" in colours of their own. A camera has a wedge: the rays through the middle row of its
    film (seen from the side, the middle column), up to what they hit. Lights at a point are drawn
    too, and the middle ray of a projector.

    Args:
        scene: Any scene of the active variant.
        view: "above", x to the right and z upwards; or "side", z to the right and y upwards.
        laser: Where a laser is that is no light of the scene: (x, y, z) [m]. By default that of an
            integrator that has one: beside the first camera, or where its projector's `frame` is.
        title: Text above.

    Returns:
        A figure with axes in metres.

    Raises:
        ValueError: `scene` is no scene or has no shapes, there is no such view, or `laser` is no
            point; one line.

    Example:
        >>> from tofrender.scenes import cornell_box
        >>> figure = plan_figure(mi.load_dict(cornell_box(width=8, height=8)), title="Cornell box")
        >>> figure.axes[0].get_xlabel()
        'x [m]'
    """
    if not isinstance(scene, mi.Scene):
        kind = type(scene).__name__
        raise ValueError(f"scene = {kind}: must be an mi.Scene of variant {mi.variant()}")
    checks.text("title", title)
    if not scene.shapes():
        raise ValueError("scene: has no shapes to draw")
    shown = list(VIEWS[checks.one_of("view", view, VIEWS)])
    lamp = _integrators_laser(scene) if laser is None else np.array(checks.point("laser", laser))

    wide = figure_width(4.6)
    figure = new_figure(wide, wide, "compressed")
    axes = figure.add_subplot()
    outlines = [(_kind(s.id()), _outline(_points(s)[:, shown])) for s in scene.shapes()]
    outlines.sort(key=lambda each: -float(np.prod(np.ptp(each[1], axis=0))))
    for kind, outline in outlines:
        _draw_outline(axes, outline, kind)
    wedges = [_wedge(scene, sensor, view)[:, shown] for sensor in scene.sensors()]
    beams = [_beam(scene, light)[:, shown] for light in scene.emitters() if _at_a_point(light)]
    if lamp is not None:
        beams.append(lamp[None, shown])
    for wedge in wedges:
        _draw_camera(axes, wedge)
    for beam in beams:
        _draw_laser(axes, beam)

    low, high = _limits(outlines, wedges + beams)
    width, height = high - low
    figure.set_figheight(wide * picture_aspect(height, width, 0.3, 1.3) + 1.0)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    axes.set_xlabel(f"{'xyz'[shown[0]]} [m]")
    axes.set_ylabel(f"{'xyz'[shown[1]]} [m]")
    axes.grid(alpha=0.25)
    few_ticks(axes)
    if title is not None:
        axes.set_title(wrap_text(title, wide))
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(
        unique.values(), unique.keys(), loc="outside lower center", ncols=3, frameon=False
    )
    fit_height(figure)
    return figure


# ----------------------------------------------------------------------------------- shapes


def _kind(name: str) -> tuple[str, str, str]:
    return next(kind for kind in KINDS if name.startswith(kind[0]))


def _points(shape: Any) -> Array:
    """Points of a shape that hold its outline [m], shape (n, 3)."""
    parameters = mi.traverse(shape)
    if "vertex_positions" in parameters:
        positions = np.array(parameters["vertex_positions"], dtype=np.float64)
        return positions.reshape(-1, 3)
    line = dr.linspace(mi.Float, 0, 1, 65)
    try:
        sampled = shape.sample_position(0, mi.Point2f(*dr.meshgrid(line, line))).p
    except RuntimeError:  # Not every shape can be sampled
        return np.array([np.array(shape.bbox().corner(k)).ravel() for k in range(8)])
    return np.array(sampled, dtype=np.float64).T


def _outline(points: Array) -> Array:
    """The convex hull (Andrew's monotone chain), counter-clockwise; two points for a line."""
    points = np.unique(points.round(6), axis=0)
    if len(points) < 3:
        return points

    def half(ordered: Array) -> list[Array]:
        chain: list[Array] = []
        for p in ordered:
            while len(chain) > 1:
                (ax, ay), (bx, by) = chain[-1] - chain[-2], p - chain[-2]
                if ax * by - ay * bx > 1e-12:
                    break
                chain.pop()
            chain.append(p)
        return chain[:-1]

    return np.array(half(points) + half(points[::-1]))


def _draw_outline(axes: Axes, outline: Array, kind: tuple[str, str, str]) -> None:
    _, label, colour = kind
    colour = palette().ink if colour == "ink" else colour
    order = len(KINDS) - KINDS.index(kind)
    if len(outline) < 3:  # seen edge-on
        axes.plot(*outline.T, color=colour, lw=3, label=label, zorder=2 + order)
    else:
        face = "none" if label == "other" else colour
        axes.fill(*outline.T, fc=face, ec=colour, lw=1.5, alpha=0.75, label=label, zorder=1 + order)


def _limits(outlines: list, devices: list[Array]) -> tuple[Array, Array]:
    """Corners of the picture: everything, but for shapes much wider than the relay wall."""
    walls = [outline for kind, outline in outlines if kind is KINDS[0]]
    widest = WIDEST * max((np.ptp(each, axis=0).max() for each in walls), default=np.inf)
    kept = [outline for _, outline in outlines if np.ptp(outline, axis=0).max() <= widest]
    cut = [outline for _, outline in outlines if np.ptp(outline, axis=0).max() > widest]
    points = np.concatenate([*kept, *devices]) if kept or devices else np.concatenate(cut)
    low, high = points.min(axis=0), points.max(axis=0)
    for outline in cut:  # a wide wall is seen where it comes nearest
        inside = np.clip((low + high) / 2, outline.min(axis=0), outline.max(axis=0))
        low, high = np.minimum(low, inside), np.maximum(high, inside)
    margin = 0.08 * float((high - low).max())
    return low - margin, high + margin


# ------------------------------------------------------------------------ cameras and lights


def _wedge(scene: Any, sensor: Any, view: str) -> Array:
    """Corners of what a camera sees [m], its own place first, shape (n, 3)."""
    line = dr.linspace(mi.Float, 1e-3, 1 - 1e-3, 65)
    across = mi.Point2f(line, 0.5) if view == "above" else mi.Point2f(0.5, line)
    ray, _ = sensor.sample_ray_differential(0, 0.5, across, mi.Point2f(0.5))
    starts, ends = _reach(scene, ray)
    return np.concatenate([starts[:1], ends])


def _at_a_point(light: Any) -> bool:
    return bool(mi.has_flag(light.flags(), mi.EmitterFlags.DeltaPosition))


def _integrators_laser(scene: Any) -> Array | None:
    """Where the laser is that a confocal integrator has [m], None if it has none."""
    integrator, sensors = scene.integrator(), scene.sensors()
    if not hasattr(integrator, "projector") or not sensors:
        return None
    camera = sensors[0].world_transform() @ mi.Point3f(0)
    projector = integrator.projector
    place = camera if projector is None else projector.origin(camera)
    return np.array(place, dtype=np.float64).ravel()


def _beam(scene: Any, light: Any) -> Array:
    """Where a light is and, of a projector, where its middle ray ends [m]; shape (1 or 2, 3)."""
    if light.class_name() == "Projector":
        ray, _ = light.sample_ray(0, 0.5, mi.Point2f(0.5), mi.Point2f(0.5))
        return np.concatenate(_reach(scene, ray))
    reference = dr.zeros(mi.Interaction3f)
    reference.p = mi.Point3f(scene.bbox().center())
    ds, _ = light.sample_direction(reference, mi.Point2f(0.5))
    return np.array(ds.p, dtype=np.float64).reshape(1, 3)


def _draw_camera(axes: Axes, wedge: Array) -> None:
    axes.fill(*wedge.T, fc=CAMERA, ec=CAMERA, lw=1, alpha=0.18, zorder=1)
    axes.plot(*wedge[0], "^", color=CAMERA, ms=10, label="camera", zorder=9, linestyle="none")


def _draw_laser(axes: Axes, beam: Array) -> None:
    axes.plot(*beam.T, color=LASER, lw=1.2, zorder=8)
    axes.plot(*beam[0], "*", color=LASER, ms=11, label="laser", zorder=10, linestyle="none")


@tracing_lock()
def _reach(scene: Any, ray: Any) -> tuple[Array, Array]:
    """Where rays start and end [m], each of shape (n, 3).

    Those that hit nothing go as far as the middle of the scene is.
    """
    hit = scene.ray_intersect_preliminary(ray)
    far = dr.norm(mi.Point3f(scene.bbox().center()) - ray.o)
    ends = np.array(ray(dr.select(hit.is_valid(), hit.t, far)), dtype=np.float64).T
    return np.broadcast_to(np.array(ray.o, dtype=np.float64).T, ends.shape), ends
