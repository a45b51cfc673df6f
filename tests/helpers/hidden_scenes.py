"""Captures of hidden patches by closed form: f1 of many small patches, exact path lengths."""

from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from oracles.nlos import Nodes, Rectangle, Setup, three_bounces
from scipy.fft import next_fast_len

from tofrender.nlos import hidden_depth, make_capture

FINE = 8  # Fine bins in a bin: path lengths are right to a sixteenth of a bin


def rectangle(x: tuple, y: tuple, z: float, step: float) -> Nodes:
    """Parallel to the wall and facing it."""
    middle, half = np.mean([x, y], axis=1), np.diff([x, y])[:, 0] / 2
    plate = Rectangle((*middle, z), (half[0], 0, 0), (0, -half[1], 0))
    return plate.nodes(*(max(1, round(2 * each / step)) for each in half))


def letter_z(z: float = 1.0, step: float = 0.04) -> Nodes:
    """Two bars and a diagonal from (-, -) to (+, +)."""
    top, bottom, diagonal = (
        rectangle((-0.4, 0.4), y, z, step) for y in ((0.3, 0.4), (-0.4, -0.3), (-0.05, 0.05))
    )
    diagonal.points[:, 1] += 0.75 * diagonal.points[:, 0]
    return top + bottom + diagonal


def letter_f(z: float = 1.0, step: float = 0.04) -> Nodes:
    """A letter that no turn or reflection maps to itself: it grows from the wall's (-, -)."""
    stem = rectangle((-0.3, -0.2), (-0.5, 0.5), z, step)
    arms = rectangle((-0.2, 0.3), (0.4, 0.5), z, step) + rectangle((-0.2, 0.1), (0, 0.1), z, step)
    return stem + arms


def sphere(center: tuple, radius: float, count: int = 2000) -> Nodes:
    """The front of a sphere, by a Fibonacci lattice."""
    index = np.arange(count) + 0.5
    cos = 1 - 2 * index / count
    phi = np.pi * (1 + 5**0.5) * index
    sin = np.sqrt(1 - cos * cos)
    normals = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)
    normals = normals[normals[:, 2] < 0]
    areas = np.full(len(normals), 4 * np.pi * radius**2 / count)
    return Nodes(np.asarray(center) + radius * normals, normals, areas)


def two_spheres() -> Nodes:
    """Of different size and distance, on one side of the wall's center."""
    return sphere((-0.35, 0.3, 1.1), 0.25) + sphere((0.45, -0.1, 0.9), 0.2)


@dataclass(frozen=True)
class Wall:
    """A square wall of side 2 m and its place in the world."""

    size: int = 32
    origin: tuple = (0.0, 0.0, 0.0)
    axes: tuple = ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0))
    side: float = 2.0

    def grid(self, size: int | None = None, side: float | None = None) -> np.ndarray:
        """Pixel centers in the wall's frame, (rows, columns, 3)."""
        size, side = size or self.size, side or self.side
        at = ((np.arange(size) + 0.5) / size - 0.5) * side
        x, y = np.meshgrid(at, at)
        return np.stack([x, y, 0 * x], axis=-1)

    def world(self, points: np.ndarray) -> np.ndarray:
        return np.asarray(self.origin) + points @ np.asarray(self.axes)

    def normals(self, grid: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.asarray(self.axes)[2], grid.shape)


STRAIGHT = Wall()  # At z = 0, facing +z


def turned(size: int = 32) -> Wall:
    """A wall anywhere, turned about a skew axis, its rows downwards: a left-handed frame."""
    a, b = 0.7, -1.1
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    axes = (about_x @ about_y).T * [[1], [-1], [1]]
    return Wall(size, (3.0, -2.0, 5.0), tuple(map(tuple, axes)))


def capture_of(
    patches: Nodes,
    wall: Wall = STRAIGHT,
    mode: str = "confocal",
    *,
    start: float = 1.5,
    width: float = 0.006,
    bins: int = 256,
    legs: bool = False,
    lasers: int = 4,
    delay: float = 0.0,
    noise: float = 0.0,
):
    """The capture of patches in the wall's frame: 1 W, albedos 1, pulse of one bin (sigma).

    Args:
        start: Path from wall to wall where the window starts; with `legs`, those of the wall's
            center are added.
        delay: An error in all path lengths [m], planted.
        noise: Standard deviation of noise over the largest value.
    """
    sensors = wall.grid()
    devices = {"sensor": np.array([0.4, 0.3, 1.7]), "laser": np.array([-0.6, 0.1, 1.4])}
    lit = {"single": np.array([[[0.1, -0.2, 0.0]]]), "confocal": sensors}
    lit["exhaustive"] = wall.grid(lasers, 1.6)
    points, lit_points = sensors.reshape(-1, 3), lit[mode].reshape(-1, 3)
    pairs = [(points, points)] if mode == "confocal" else [(p[None], points) for p in lit_points]
    sensor_leg, laser_leg = (
        np.linalg.norm(p - devices[d], axis=1)
        for d, p in (("sensor", points), ("laser", lit_points))
    )
    first = start + (np.linalg.norm(devices["sensor"]) + np.linalg.norm(devices["laser"])) * legs
    away = [laser_leg] if mode == "confocal" else laser_leg
    offsets = [legs * (sensor_leg + leg) + delay - first for leg in away]
    each = zip(pairs, offsets, strict=True)
    light = np.stack([_light(patches, *pair, offset, width, bins) for pair, offset in each])
    several = (lasers, lasers) if mode == "exhaustive" else ()
    light = light.reshape(*several, *sensors.shape[:2], bins)
    light = light + np.random.default_rng(1).normal(0, noise * light.max(), light.shape)
    more = {}
    if mode != "confocal":
        grid = lit[mode]
        more = {"laser_grid": wall.world(grid), "laser_normals": wall.normals(grid)}
    more |= {"sensor_grid": wall.world(sensors), "sensor_normals": wall.normals(sensors)}
    more |= {f"{name}_origin": wall.world(place) for name, place in devices.items()}
    more |= {"start_opl": first, "bin_width_opl": width, "counts_first_and_last_legs": legs}
    return make_capture(light, mode=mode, **more)


def _light(patches, lit, seen, offset, width, bins) -> np.ndarray:
    """(points, bins) by f1."""
    margin = 6  # bins, for what the pulse carries over the edges
    fine = (bins + 2 * margin) * FINE
    result = np.zeros((len(seen), fine))
    setup = Setup(albedo=1, legs=False)
    offset = np.broadcast_to(offset, len(seen))
    for number, point in enumerate(seen):
        opl, light = three_bounces(setup, patches, 1, lit[number if len(lit) > 1 else 0], point)
        at = np.floor(((opl + offset[number]) / width + margin) * FINE).astype(int)
        kept = (at >= 0) & (at < fine)
        result[number] = np.bincount(at[kept], light[kept], fine)
    t = np.arange(-margin * FINE, margin * FINE + 1) / FINE
    pulse = np.exp(-t * t / 2)
    size = next_fast_len(fine + len(t) - 1, real=True)
    spread = np.fft.irfft(np.fft.rfft(result, size) * np.fft.rfft(pulse / pulse.sum(), size), size)
    spread = spread[:, margin * FINE : margin * FINE + fine].reshape(len(seen), -1, FINE).sum(2)
    return np.maximum(spread[:, margin:-margin], 0)


def true_depth(patches: Nodes, volume) -> np.ndarray:
    """Distance from the wall of the nearest patch, each a square, NaN where there is none.

    A column of voxels is as deep as what it meets anywhere, not only at its center: the mean over
    nine rays.
    """
    side = np.sqrt(patches.areas)[:, None] / 2
    across = np.cross(patches.normals, [0.3, 1.0, 0.2])
    across *= side / np.linalg.norm(across, axis=1, keepdims=True)
    if np.ptp(patches.normals, axis=0).max() == 0:  # Rectangles, whose squares must not overlap
        across = side * [1.0, 0, 0]
    along = np.cross(patches.normals, across)
    corners = [patches.points + s * across + t * along for s, t in SQUARE]
    points = volume["frame_origin"].values + np.stack(corners, axis=1) @ volume["frame_axes"].values
    squares = mi.Mesh("hidden", 4 * len(points), 2 * len(points))
    parameters = mi.traverse(squares)
    parameters["vertex_positions"] = points.ravel()
    first = 4 * np.arange(len(points))[:, None]
    parameters["faces"] = np.stack([first + np.array(k) for k in ([0, 1, 2], [0, 2, 3])]).ravel()
    parameters.update()
    fine = {}
    for axis in ("y", "x"):
        centers = volume[axis].values
        thirds = (centers[1] - centers[0]) / 3 * np.array([-1, 0, 1])
        fine[axis] = (centers[:, None] + thirds).ravel()
    rays = volume[["frame_axes", "frame_origin"]].drop_vars(["y", "x"], errors="ignore")
    depth = hidden_depth(
        mi.load_dict({"type": "scene", "hidden": squares}), rays.assign_coords(fine)
    ).values
    rows, columns = depth.shape[0] // 3, depth.shape[1] // 3
    blocks = depth.reshape(rows, 3, columns, 3).transpose(0, 2, 1, 3).reshape(rows, columns, 9)
    met = np.isfinite(blocks)
    sums = np.where(met, blocks, 0).sum(-1)
    return np.divide(sums, met.sum(-1), out=np.full((rows, columns), np.nan), where=met.any(-1))


SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def small_capture():
    """A capture of a patch by 4 x 4 points, in 24 bins."""
    patch = rectangle((-0.1, 0.1), (-0.1, 0.1), 1.0, 0.1)
    return capture_of(patch, Wall(4), bins=24, width=0.05)
