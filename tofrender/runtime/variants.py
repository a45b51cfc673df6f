"""Variants of Mitsuba that render in time, and the error for all others."""

KINDS = "llvm_*, cuda_* or metal_*"  # Variants that render in time


class BackendError(RuntimeError):
    """Error where no variant can render; the message is one line with the command that helps."""


def require_unpolarised() -> None:
    """Raise a BackendError under polarised variants, for files that hold no Stokes vectors."""
    import mitsuba as mi

    if mi.is_polarized:
        plain = str(mi.variant()).replace("_polarized", "")
        raise BackendError(
            f"variant = {mi.variant()!r}: has Stokes vectors, which are not kept here; must be one "
            f"like {plain}, or call `tofrender render`"
        )


def require_vectorised() -> None:
    """Raise a BackendError under a scalar variant, or under none."""
    import mitsuba as mi

    variant = mi.variant()
    if variant is None or variant.startswith("scalar"):
        raise BackendError(
            f"variant = {variant!r}: cannot render in time, must be an {KINDS} variant; "
            "call mi.set_variant('llvm_ad_rgb') first"
        )
