"""Derivatives of renders: detached sampling, derivatives of path steps and of films."""
