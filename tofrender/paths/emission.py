"""Deprecated name of `bidirectional.emission`, for starters of assignments that are released."""

import warnings


def __getattr__(name: str) -> object:
    from ..bidirectional import emission

    if name not in ("Emission", "Emitted"):
        raise AttributeError(name)
    old, new = __name__, emission.__name__
    warnings.warn(f"{old} is deprecated: import {new}", DeprecationWarning, stacklevel=2)
    return getattr(emission, name)
