"""Variants of Mitsuba that support time-resolved rendering, and the error for all others."""

KINDS = "llvm_*, cuda_* or metal_*"
"""Variants that support time-resolved rendering."""


class BackendError(RuntimeError):
    """Error if rendering is not possible. The message is one line with the command that helps."""


def require_unpolarized() -> None:
    """Raise a BackendError in polarized variants, for results without Stokes vectors."""
    import mitsuba as mi

    if mi.is_polarized:
        plain = str(mi.variant()).replace("_polarized", "")
        raise BackendError(
            f"variant = {mi.variant()!r}: its Stokes vectors cannot be kept here. Use a variant "
            f"like {plain}, or call `tofrender render`"
        )


def require_vectorized() -> None:
    """Raise a BackendError if the variant is a scalar variant, or no variant is active."""
    import mitsuba as mi

    variant = mi.variant()
    if variant is None or variant.startswith("scalar"):
        raise BackendError(
            f"variant = {variant!r}: cannot render in time, must be an {KINDS} variant; "
            "call mi.set_variant('llvm_ad_rgb') first"
        )
