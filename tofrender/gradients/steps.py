"""Derivatives of the path loop: forward and reverse derivatives of `walk.step`, vertex by vertex.

A step maps the state of a path to the next state and adds contributions. Therefore the derivative
of the whole loop follows from the derivative of one step, which Dr.Jit differentiates.

**Forward mode** (`jvp`): each step propagates the derivatives of the state. The paths are traced
once.

**Reverse mode** (`vjp`): the gradient of the state is propagated from the last step to the first.
The paths are traced once to store the states. Then each step is traced again from its stored state
with the same random numbers, and the gradient is propagated through the step. The states are stored
in memory of each lane. Time and memory grow linearly with depth. Only active threads need memory,
so the memory does not depend on the number of paths.

Everything in a step has a derivative: lengths, indices of refraction, MIS weights, directions of
mirrors. For the sampling of directions, see `detached`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.contribution import Contribution
from ..paths.protocols import Parts
from ..paths.records import Path
from ..paths.walk import step
from ..runtime.lane_memory import packed, tape, unpacked
from .films import Changes

MOST_KEPT = 256  # Largest number of vertices of a path with states in the memory of a lane


@dr.syntax
def jvp(
    sampler: mi.Sampler, path: Path, rate: Any, parts: Parts, changes: Changes, sums: list
) -> tuple[list, Path]:
    """Trace paths together with the derivatives of their states and of the sums of their light.

    | loop state | meaning |
    |---|---|
    | `path` | state of the path |
    | `rate` | derivative of the state, packed |
    | `sums` | derivatives of the sums of light |

    Args:
        sampler: The sampler.
        path: Starts of the paths.
        rate: Derivatives of the starts, packed.
        parts: Parts of the path loop.
        changes: Derivatives of the film.
        sums: Derivatives of the sums of light at the start.

    Returns:
        The derivatives of the sums, and the paths at their ends.
    """
    while path.active:
        path, rate, sums = _jvp_of_step(sampler, path, rate, parts, changes, sums)
    return sums, path


def _jvp_of_step(sampler, path, rate, parts, changes, sums):
    """Trace one step, and propagate the derivatives of the state through it."""
    with dr.resume_grad():
        # Attach the derivative to the state
        state = packed(path)
        dr.enable_grad(state)
        dr.set_grad(state, rate)

        # Trace one step, and propagate the derivatives to its light and to the next state
        collected = changes.step()
        new = step(sampler, unpacked(state, path), parts, collected)
        after = packed(new)
        sums = changes.jvp(collected, sums, after)
        rate = dr.grad(after)
    return dr.detach(new), rate, sums


class _NoMeasurement:
    """Measurement that ignores all light, for tracing paths to store their states."""

    def add(self, contribution: Contribution) -> None:
        """Ignore a contribution."""


@dr.syntax
def vjp(sampler: mi.Sampler, path: Path, parts: Parts, changes: Changes) -> Any:
    """Propagate the film's gradient back through the paths.

    | loop state | meaning |
    |---|---|
    | `k` | index of the vertex |
    | `here` | state of the path at vertex k, while states are stored |
    | `gradient` | gradient by the state at vertex k, packed, on the way back |

    Args:
        sampler: The sampler.
        path: Starts of the paths.
        parts: Parts of the path loop.
        changes: Derivatives of the film.

    Returns:
        The gradient by the starts of the paths, packed.
    """
    # --------------------- Store the states of all vertices ---------------------

    most = parts.iterations if parts.iterations > 0 else MOST_KEPT
    start = packed(path)
    nothing = _NoMeasurement()
    states = tape(path, most)
    dimensions = dr.alloc_local(mi.UInt32, most)
    k = mi.UInt32(0)
    here = path
    while here.active & (k < most):
        states.write(packed(here), k)
        dimensions.write(sampler.dimension, k)
        here = step(sampler, here, parts, nothing)
        k += 1

    # --------------------- Propagate the gradient from the last vertex to the first -----------

    gradient = dr.grad(start)
    while k > 0:
        k -= 1
        sampler.dimension = dimensions.read(k)
        gradient = _vjp_of_step(sampler, states.read(k), path, gradient, parts, changes)
    return gradient


def _vjp_of_step(sampler, state, example, gradient, parts, changes):
    """Trace one step again from its state, and return the gradient by this state."""
    with dr.resume_grad():
        dr.enable_grad(state)
        collected = changes.step()
        new = step(sampler, unpacked(state, example), parts, collected)
        changes.vjp(collected, packed(new), gradient)
        return dr.grad(state)
