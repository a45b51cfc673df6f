"""Choosing the Mitsuba variant, and an LLVM that Dr.Jit can use for it."""

import atexit
import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from . import checks, gpu, llvm, memory, plugins
from .progress import held_signals
from .variants import BackendError

# Address space [bytes] of Python, Mitsuba, Dr.Jit and LLVM, and of each of Dr.Jit's threads
START, THREAD = 480 << 20, 8 << 20

NO_VARIANT = "TOFRENDER_NO_VARIANT"
"""Environment variable. If it is set, `import tofrender` activates no variant."""

# With one thread, Mitsuba waits forever for pictures that it reads or writes
LEAST_THREADS = 2


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def tracing_lock() -> Iterator[None]:
    """Pause garbage collection and lock out other threads while a kernel is traced.

    An unused scene may live in a cycle until it is collected. Dr.Jit's virtual calls reach the
    parts of all living scenes: if one is collected in the middle, equal functions of one kernel are
    called in two ways, written twice, and LLVM aborts the process ("invalid redefinition"). If one
    is loaded in the middle, unfinished parts are called. So threads trace one after the other, and
    scenes that were dropped are freed in between.

    Also a decorator, and used for loading, too. One thread may enter it several times.
    """
    global _tracing_depth
    with _tracing_lock:
        if not _tracing_depth:
            _free_unused_scenes()
        _tracing_depth += 1
        was_enabled = gc.isenabled()
        gc.disable()
        try:
            yield
        finally:
            _tracing_depth -= 1
            if was_enabled:
                gc.enable()


_tracing_lock, _tracing_depth = threading.RLock(), 0
_scenes: list[Any] = []  # Loaded, and not yet dropped by all others
atexit.register(_scenes.clear)


def keep_alive(scene: Any) -> None:
    """Keep a loaded scene alive until no kernel is traced, whatever thread drops it last."""
    _scenes.append(scene)


def _free_unused_scenes() -> None:
    """Drop scenes with as many references as an object that is referenced here alone."""
    alone = [object()]
    counts = [[sys.getrefcount(each) for each in held] for held in (alone, _scenes)]
    _scenes[:] = [s for s, count in zip(_scenes, counts[1], strict=True) if count > counts[0][0]]


def activate(variant: str | None = None) -> str:
    """Activate a Mitsuba variant that works here, with our plugins registered in it.

    Args:
        variant: The variant to switch to. None keeps the one that is active; if there is none,
            chooses `cuda_ad_rgb` or, on a Mac, `metal_ad_rgb` if it can trace a ray. Otherwise
            chooses `llvm_ad_rgb`, and prints one line if a GPU is present but cannot be used.

    Returns:
        The name of the active variant.

    Raises:
        ValueError: Mitsuba has no such variant.
        BackendError: The variant cannot render on this machine.

    Example:
        >>> activate() in ("cuda_ad_rgb", "metal_ad_rgb", "llvm_ad_rgb")
        True
    """
    _require_address_space()
    _offer_llvm()
    with held_signals():  # An interrupted import of theirs hangs or aborts later
        import drjit as dr
        import mitsuba as mi

    if dr.thread_count() < LEAST_THREADS:
        dr.set_thread_count(LEAST_THREADS)
    if variant is not None:
        checks.one_of("variant", variant, mi.variants())
    if _on_variant_change not in _callbacks:
        _callbacks.append(_on_variant_change)
        mi.detail.add_variant_callback(_on_variant_change)
    if variant is not None:
        require_gpu(variant)
    chosen: str = variant or mi.variant() or default_variant()
    if chosen.startswith("llvm"):
        require_llvm()
    if chosen != mi.variant():
        mi.set_variant(chosen)
    plugins.register(chosen)
    return chosen


def default_variant() -> str:
    """Return the variant to use if none is set, and report a GPU that cannot be used."""
    for backend in gpu.BACKENDS:
        if not _is_started(backend):
            continue
        state = gpu.state(backend)
        if state.works:
            return f"{backend}_ad_rgb"
        print(f"tofrender: rendering on the CPU: {state.reason}; {state.remedy}", file=sys.stderr)
    return "llvm_ad_rgb"


def require_gpu(variant: str) -> None:
    """Raise a BackendError if a variant needs a GPU that cannot trace a ray."""
    backend = gpu.backend_of(variant)
    if backend is None:
        return
    if not _is_started(backend):
        device = "CUDA" if backend == gpu.CUDA else "Metal"
        raise BackendError(
            f"variant = {variant!r}: no {device} device or driver found; use an llvm_* variant"
        )
    state = gpu.state(backend)
    if not state.works:
        raise BackendError(
            f"variant = {variant!r}: {state.reason}; {state.remedy}, or use an llvm_* variant"
        )


def _is_started(backend: str) -> bool:
    """Whether Mitsuba has variants of a GPU backend, and Dr.Jit could start it."""
    import drjit as dr
    import mitsuba as mi

    kind = {gpu.CUDA: dr.JitBackend.CUDA, gpu.METAL: dr.JitBackend.Metal}[backend]
    return f"{backend}_ad_rgb" in mi.variants() and bool(dr.has_backend(kind))


def require_llvm() -> None:
    """Raise a BackendError if the loaded LLVM would abort the process at the first kernel."""
    import drjit as dr

    library, loads = llvm.choose(), dr.has_backend(dr.JitBackend.LLVM)
    major = dr.detail.llvm_version()[0] if loads else 0
    if major >= llvm.MINIMUM_MAJOR:
        return
    if library is None:
        raise BackendError(llvm.refusal())
    if not loads:
        raise BackendError(f"{library.path}: Dr.Jit cannot load this LLVM; run `tofrender doctor`")
    raise BackendError(
        f"Dr.Jit has loaded LLVM {major}, must be {llvm.MINIMUM_MAJOR} or newer: import tofrender "
        f"before mitsuba and drjit, or set {llvm.VARIABLE}={library.path}"
    )


_callbacks: list = []


def _require_address_space() -> None:
    """Raise a BackendError if `ulimit -v` would abort Mitsuba's import or the first kernel."""
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
    """Set the variable from which Dr.Jit reads the path of LLVM when it is imported."""
    if not os.environ.get(llvm.VARIABLE) and (library := llvm.choose()):
        os.environ[llvm.VARIABLE] = str(library.path)


def _on_variant_change(_old: str | None, new: str | None) -> None:
    if new is not None:
        plugins.register(new)
