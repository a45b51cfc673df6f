"""Reconstruction of the hidden scene from a capture: five methods, depth and its error."""
