"""Rendering of a scene to a labeled Dataset, in this process or with workers."""
