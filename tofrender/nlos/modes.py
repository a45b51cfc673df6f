"""Modes of captures. This module has no imports, so that plugins can use it without xarray."""

MODES = ("single", "confocal", "exhaustive")
"""One laser spot for all pixels, the laser at the point of each pixel, or a grid of laser spots."""
