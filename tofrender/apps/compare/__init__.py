"""Comparison of two pictures, from techniques of the course or from files."""
