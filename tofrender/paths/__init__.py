"""Paths of light: the path loop, its records, and its space, endpoints and scattering."""
