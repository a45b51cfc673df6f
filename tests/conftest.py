"""Every test starts under `llvm_ad_rgb` and leaves no other variant behind."""

from __future__ import annotations

import mitsuba as mi
import pytest

import tofrender  # noqa: F401  (picks the variant, registers the plugins)

VARIANT = "llvm_ad_rgb"


@pytest.fixture(autouse=True)
def _variant():
    """Start each test under the same variant, whatever the test before it did."""
    if mi.variant() != VARIANT:
        mi.set_variant(VARIANT)
    yield
    if mi.variant() != VARIANT:
        mi.set_variant(VARIANT)
