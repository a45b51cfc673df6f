"""Integrators of non-line-of-sight scenes."""
