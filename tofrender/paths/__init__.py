"""Paths of light: the loop that follows them, and what it is made of."""
