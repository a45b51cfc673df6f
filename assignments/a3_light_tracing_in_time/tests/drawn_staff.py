"""Random inputs of the staff's tests: cameras, lamps, colors."""

import numpy as np


def between(random, low, high, shape=None):
    """Even numbers of three digits or more: floats, or nested tuples of them."""
    return np.round(random.uniform(low, high, shape), 4).tolist()


def pixels(random, low=3, high=6):
    """Width and height of a picture that is not square."""
    width, height = random.choice(np.arange(low, high + 1), 2, replace=False).tolist()
    return width, height


def color(random, low=0.3, high=4.0):
    """Three numbers that differ."""
    return between(random, low, high, 3)


def over_floor(random, **more):
    """A camera that looks at a floor."""
    view = {
        "origin": [*between(random, -0.4, 0.4, 2), between(random, 1.6, 2.1)],
        "target": [*between(random, -0.3, 0.3, 2), 0.0],
        "size": pixels(random),
        "fov": between(random, 40, 58),
    }
    return view | more


def above(random, low=0.9, high=1.5):
    """A place for a lamp."""
    return [*between(random, -0.5, 0.5, 2), between(random, low, high)]


def inside(random, radius, fov=(60, 95)):
    """A camera in a sphere, away from its center."""
    origin = np.array(between(random, -0.25, 0.25, 3)) * radius
    target = origin + between(random, -1, 1, 3) + np.array([0, 0, 1.5])
    return {
        "origin": origin.tolist(),
        "target": target.tolist(),
        "size": pixels(random),
        "fov": between(random, *fov),
    }


def facing(random, height):
    """A camera and a spot over a floor, below `height`, that look at different parts of it."""
    turn = random.uniform(0, 2 * np.pi)
    side = np.array([np.cos(turn), np.sin(turn), 0])
    z = np.array([0, 0, 1])
    camera, lamp = (k * 0.33 * side + height * random.uniform(0.78, 0.9) * z for k in (1, -1))
    view = {
        "origin": camera.tolist(),
        "target": (0.36 * side).tolist(),
        "size": pixels(random, 2, 4),
        "fov": between(random, 45, 55),
    }
    cutoff = between(random, 32, 38)
    place = {"position": lamp.tolist(), "target": (-0.36 * side).tolist()}
    return view, place | {"cutoff": cutoff, "beam": 0.8 * cutoff}


def at_ceiling(random):
    """A panel under a ceiling at 1 m, and a camera that looks at the ceiling next to it."""
    turn = random.uniform(0, 2 * np.pi)
    side = np.array([np.cos(turn), np.sin(turn), 0])
    z = np.array([0, 0, 1])
    panel = [between(random, 0.8, 0.9), between(random, 0.28, 0.36)]
    view = {
        "origin": (0.85 * side + between(random, 0.45, 0.55) * z).tolist(),
        "target": (0.9 * side + z).tolist(),
        "size": pixels(random, 2, 4),
        "fov": between(random, 32, 40),
        "up": (side + 0.3 * np.cross(z, side)).tolist(),
    }
    return view, panel
