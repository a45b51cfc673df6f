"""Integrators: each integrator chooses the parts of the path loop, and renders on a film."""
