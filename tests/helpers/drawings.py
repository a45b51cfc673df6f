"""Pixels of figures."""

import base64

import numpy as np


def linear(colours):
    colours = np.asarray(colours, float)
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def drawn(figure):
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())


def part_of(player: str, kind: str) -> bytes:
    return base64.b64decode(player.split(f"data:{kind};base64,")[1].split('"')[0])
