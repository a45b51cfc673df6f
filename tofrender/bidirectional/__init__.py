"""Paths from lights, and bidirectional paths: emission, the lens, light paths, MIS weights."""
