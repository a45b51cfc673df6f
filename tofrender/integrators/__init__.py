"""Integrators: each picks a light strategy and a measurement for `walk`."""
