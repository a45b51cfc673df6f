"""Samplers: random numbers for rendering."""
