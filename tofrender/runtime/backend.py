"""Choice of the Mitsuba variant, and of an LLVM that Dr.Jit can use for it."""

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

# Address space [bytes] of Python, Mitsuba, Dr.Jit and LLVM, and of each thread of Dr.Jit
START = 480 << 20
THREAD = 8 << 20

NO_VARIANT = "TOFRENDER_NO_VARIANT"
"""Environment variable. If it is set, `import tofrender` activates no variant."""

# With a single thread, Mitsuba would wait forever while it reads or writes pictures
LEAST_THREADS = 2


def cores() -> int:
    """Return the number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def tracing_lock() -> Iterator[None]:
    """Pause garbage collection and exclude other threads while a kernel is traced.

    An unused scene may be part of a reference cycle until it is collected. Dr.Jit's virtual calls
    include the objects of all scenes in memory. If a scene is collected during tracing, equal
    functions of a kernel are called in two ways and written twice, and LLVM aborts the process
    ("invalid redefinition"). If a scene is loaded during tracing, incomplete objects are called.
    Therefore only one thread traces at a time, and unused scenes are freed in between.

    The lock is also used for loading, and as a decorator. A thread may enter it several times.
    """
    global _tracing_depth
    # The first entry of a thread frees unused scenes
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


_tracing_lock = threading.RLock()
_tracing_depth = 0

# Loaded scenes that may still be in use
_scenes: list[Any] = []
atexit.register(_scenes.clear)


def keep_alive(scene: Any) -> None:
    """Keep a loaded scene alive until no kernel is traced, independent of other references."""
    _scenes.append(scene)


def _free_unused_scenes() -> None:
    """Drop scenes that are referenced only here.

    Such a scene has the same reference count as a new object that is stored in a similar list.
    """
    alone = [object()]
    counts = [[sys.getrefcount(each) for each in held] for held in (alone, _scenes)]
    _scenes[:] = [s for s, count in zip(_scenes, counts[1], strict=True) if count > counts[0][0]]


def activate(variant: str | None = None) -> str:
    """Activate a Mitsuba variant that works on this machine, and register our plugins in it.

    Args:
        variant: The variant to activate. None keeps the active variant. If none is active, None
            chooses `cuda_ad_rgb` or (on a Mac) `metal_ad_rgb` if it can trace a ray. Otherwise None
            chooses `llvm_ad_rgb`, and prints one line if a GPU is present but cannot be used.

    Returns:
        The name of the active variant.

    Raises:
        ValueError: Mitsuba does not have this variant.
        BackendError: The variant cannot render on this machine.

    Example:
        >>> activate() in ("cuda_ad_rgb", "metal_ad_rgb", "llvm_ad_rgb")
        True
    """
    # Import Mitsuba and Dr.Jit. If their import is interrupted, they hang or abort later
    _require_address_space()
    _offer_llvm()
    with held_signals():
        import drjit as dr
        import mitsuba as mi

    # Register plugins whenever the variant changes
    if dr.thread_count() < LEAST_THREADS:
        dr.set_thread_count(LEAST_THREADS)
    if variant is not None:
        checks.one_of("variant", variant, mi.variants())
    if _on_variant_change not in _callbacks:
        _callbacks.append(_on_variant_change)
        mi.detail.add_variant_callback(_on_variant_change)

    # Choose the variant, and check that it works
    if variant is not None:
        require_gpu(variant)
    chosen: str = variant or mi.variant() or default_variant()
    if chosen.startswith("llvm"):
        require_llvm()

    # Activate it
    if chosen != mi.variant():
        mi.set_variant(chosen)
    plugins.register(chosen)
    return chosen


def default_variant() -> str:
    """Return the default variant, and report a GPU that cannot be used."""
    for backend in gpu.BACKENDS:
        if not _is_started(backend):
            continue
        state = gpu.state(backend)
        if state.works:
            return f"{backend}_ad_rgb"
        print(f"tofrender: rendering on the CPU: {state.reason}; {state.remedy}", file=sys.stderr)
    return "llvm_ad_rgb"


def require_gpu(variant: str) -> None:
    """Raise a BackendError if a variant needs a GPU, and the GPU cannot trace a ray."""
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
    """Return whether Mitsuba has variants of a GPU backend, and Dr.Jit could start the backend."""
    import drjit as dr
    import mitsuba as mi

    kind = {gpu.CUDA: dr.JitBackend.CUDA, gpu.METAL: dr.JitBackend.Metal}[backend]
    return f"{backend}_ad_rgb" in mi.variants() and bool(dr.has_backend(kind))


def require_llvm() -> None:
    """Raise a `BackendError` if LLVM is missing, or would abort the process at the first kernel."""
    import drjit as dr

    library = llvm.choose()
    loads = dr.has_backend(dr.JitBackend.LLVM)
    major = dr.detail.llvm_version()[0] if loads else 0
    if major >= llvm.MINIMUM_MAJOR:
        return

    # Name the problem
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
    """Raise a BackendError if `ulimit -v` would abort the import of Mitsuba or the first kernel."""
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
    """Register our plugins in a variant that was activated."""
    if new is not None:
        plugins.register(new)
