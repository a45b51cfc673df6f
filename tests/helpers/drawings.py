"""Pixels of figures."""

import base64

import numpy as np


def linear(colors):
    colors = np.asarray(colors, float)
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)


def drawn(figure):
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())


def part_of(player: str, kind: str) -> bytes:
    return base64.b64decode(player.split(f"data:{kind};base64,")[1].split('"')[0])
