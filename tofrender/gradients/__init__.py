"""Derivatives of renders: detached sampling, and those of the loop's steps and of films."""
