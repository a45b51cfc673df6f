"""Choosing the Mitsuba variant, and an LLVM that Dr.Jit can use for it."""

from __future__ import annotations

import atexit
import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from . import checks, llvm, memory, plugins
from .progress import held_signals

START = 480 << 20
"""Address space that Python, Mitsuba, Dr.Jit and LLVM take before anything is rendered [bytes]."""

THREAD = 8 << 20
"""Address space of each of Dr.Jit's threads, one a core [bytes]."""


LEAST_THREADS = 2
"""With one, Mitsuba waits forever for pictures that it reads or writes: the waiter blocks it."""


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def uncollected() -> Iterator[None]:
    """Let Python's garbage collector and other threads wait while a kernel is traced.

    A scene that nobody holds any more may live in a cycle until it is collected. Dr.Jit calls the
    parts of all scenes that live: if one goes in the middle, equal functions of one kernel are
    called in two ways, written twice, and LLVM ends the process ("invalid redefinition"). If one
    is loaded in the middle, parts that are not finished are called. So threads take turns, and
    scenes that another thread drops go before the next turn.

    Also a decorator, for loading, too. One thread may enter it several times.
    """
    global _turns
    with _turn:
        if not _turns:
            _let_go()
        _turns += 1
        collects = gc.isenabled()
        gc.disable()
        try:
            yield
        finally:
            _turns -= 1
            if collects:
                gc.enable()


_turn, _turns = threading.RLock(), 0
_scenes: list[Any] = []
atexit.register(_scenes.clear)


def hold(scene: Any) -> None:
    """Let a scene that a thread beside the main one has loaded live until no kernel is traced."""
    if threading.current_thread() is not threading.main_thread():
        _scenes.append(scene)


def _let_go() -> None:
    """Drop scenes that nobody else holds: as many references as to an object held here alone."""
    alone = [object()]
    counts = [[sys.getrefcount(each) for each in held] for held in (alone, _scenes)]
    _scenes[:] = [s for s, count in zip(_scenes, counts[1], strict=True) if count > counts[0][0]]


class BackendError(RuntimeError):
    """No variant can render here; the message is one line with the command that mends it."""


def activate(variant: str | None = None) -> str:
    """Make sure that a usable Mitsuba variant is active and our plugins are registered in it.

    Args:
        variant: The variant to switch to. None keeps the one that is active; if there is none,
            picks `cuda_ad_rgb` if CUDA works, else `llvm_ad_rgb`.

    Returns:
        The name of the active variant.

    Raises:
        ValueError: Mitsuba has no such variant.
        BackendError: The variant cannot render on this machine.

    Example:
        >>> activate() in ("cuda_ad_rgb", "llvm_ad_rgb")
        True
    """
    _require_address_space()
    _offer_llvm()
    with held_signals():  # An import of theirs that is interrupted hangs or aborts later
        import drjit as dr
        import mitsuba as mi

    if dr.thread_count() < LEAST_THREADS:
        dr.set_thread_count(LEAST_THREADS)
    if variant is not None:
        checks.one_of("variant", variant, mi.variants())
    if _on_variant_change not in _callbacks:
        _callbacks.append(_on_variant_change)
        mi.detail.add_variant_callback(_on_variant_change)
    if variant is None and mi.variant() is None:
        variant = "cuda_ad_rgb" if cuda_works() else "llvm_ad_rgb"
    if variant is not None and variant.startswith("llvm"):
        require_llvm()
    if variant is not None and variant.startswith("cuda") and not cuda_works():
        raise BackendError(
            f"variant = {variant!r}: no CUDA device or driver found; use an llvm_* variant"
        )
    if variant is not None and variant != mi.variant():
        mi.set_variant(variant)
    active = str(mi.variant())
    if active.startswith("llvm"):
        require_llvm()
    plugins.register(active)
    return active


def require_unpolarised() -> None:
    """Refuse variants with polarisation, whose light files and some pictures cannot hold.

    Raises:
        BackendError: One line that says what can.
    """
    import mitsuba as mi

    if mi.is_polarized:
        plain = str(mi.variant()).replace("_polarized", "")
        raise BackendError(
            f"variant = {mi.variant()!r}: has Stokes vectors, which are not kept here; must be one "
            f"like {plain}, or call `tofrender render`"
        )


def require_vectorised() -> None:
    """Refuse to render under a scalar variant, or under none.

    Raises:
        BackendError: One line that says which call helps.
    """
    import mitsuba as mi

    variant = mi.variant()
    if variant is None or variant.startswith("scalar"):
        raise BackendError(
            f"variant = {variant!r}: cannot render in time, must be an llvm_* or cuda_* variant; "
            "call mi.set_variant('llvm_ad_rgb') first"
        )


def cuda_works() -> bool:
    """Whether Dr.Jit can use a CUDA device on this machine."""
    import drjit as dr

    return bool(dr.has_backend(dr.JitBackend.CUDA))


def require_llvm() -> None:
    """Refuse an LLVM that would abort the process at the first kernel.

    Raises:
        BackendError: One line: what was found and the command that mends it.
    """
    import drjit as dr

    library = llvm.choose()
    if not dr.has_backend(dr.JitBackend.LLVM):
        raise BackendError(
            llvm.refusal()
            if library is None
            else f"{library.path}: Dr.Jit cannot load this LLVM; run `tofrender doctor`"
        )
    major = dr.detail.llvm_version()[0]
    if major < llvm.MINIMUM_MAJOR:
        raise BackendError(
            llvm.refusal()
            if library is None
            else f"Dr.Jit has loaded LLVM {major}, must be {llvm.MINIMUM_MAJOR} or newer: import "
            f"tofrender before mitsuba and drjit, or set {llvm.VARIABLE}={library.path}"
        )


_callbacks: list = []


def _require_address_space() -> None:
    """Refuse a limit under which Mitsuba's import would abort, or crash at the first kernel."""
    if "drjit" in sys.modules:
        return
    limit, left = memory.address_space()
    needed = START + THREAD * max(LEAST_THREADS, os.cpu_count() or 1)
    if left < needed:
        raise BackendError(
            f"ulimit -v = {limit >> 10}: must be at least {(limit - left + needed) >> 10} for "
            "Mitsuba to start, or unlimited"
        )


def _offer_llvm() -> None:
    """Name the LLVM that Dr.Jit shall load; it reads the variable when it is imported."""
    if not os.environ.get(llvm.VARIABLE):
        library = llvm.choose()
        if library is not None:
            os.environ[llvm.VARIABLE] = str(library.path)


def _on_variant_change(_old: str | None, new: str | None) -> None:
    if new is not None:
        plugins.register(new)
