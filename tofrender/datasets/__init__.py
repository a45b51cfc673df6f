"""Data sets to train on: many scenes, each rendered with all that is known of it."""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
