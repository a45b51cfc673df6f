"""Derivatives of the path loop: of `walk.step`, one vertex at a time.

A step maps the state of a path to the next one and adds contributions. A derivative of the whole
loop therefore needs that of one step only, which Dr.Jit differentiates while it traces it.

**Forwards**, each step propagates the derivatives of the state: `move` traces once.

**In reverse**, the gradient of the state goes from the last step to the first: `pull` traces once
to store the states, and then goes back over them. A step is traced again from its state, with the
same random numbers, and the gradient of what follows is propagated through it. The states are in
memory of each lane; neither time nor memory has more than one factor of depth, and memory is that
of the threads at work, however many paths there are.

So all that a step depends on has a derivative: lengths, indices, MIS weights, directions of
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

MOST_KEPT = 256  # vertices of a path whose states fit into the memory of a lane


@dr.syntax
def move(
    sampler: mi.Sampler, path: Path, rate: Any, parts: Parts, changes: Changes, sums: list
) -> tuple[list, Path]:
    """Trace paths with the derivatives of their states (`rate`, packed) and of sums over them.

    Returns the derivatives of the sums, and the paths at their ends.
    """
    while path.active:
        path, rate, sums = _moved(sampler, path, rate, parts, changes, sums)
    return sums, path


def _moved(sampler, path, rate, parts, changes, sums):
    with dr.resume_grad():
        state = packed(path)
        dr.enable_grad(state)
        dr.set_grad(state, rate)
        collected = changes.step()
        new = step(sampler, unpacked(state, path), parts, collected)
        after = packed(new)
        sums = changes.move(collected, sums, after)
        rate = dr.grad(after)
    return dr.detach(new), rate, sums


class _NoMeasurement:
    def add(self, contribution: Contribution) -> None:
        """Drop a contribution."""


@dr.syntax
def pull(sampler: mi.Sampler, path: Path, parts: Parts, changes: Changes) -> Any:
    """Propagate the gradient of paths' light back; returns that of their first state, packed."""
    most = parts.iterations if parts.iterations > 0 else MOST_KEPT
    start, nothing = packed(path), _NoMeasurement()
    states, numbers = tape(path, most), dr.alloc_local(mi.UInt32, most)
    k, here = mi.UInt32(0), path

    # Store the states of all vertices
    while here.active & (k < most):
        states.write(packed(here), k)
        numbers.write(sampler.dimension, k)
        here = step(sampler, here, parts, nothing)
        k += 1

    # Propagate the gradient from the last vertex to the first
    gradient = dr.grad(start)
    while k > 0:
        k -= 1
        sampler.dimension = numbers.read(k)
        gradient = _pulled(sampler, states.read(k), path, gradient, parts, changes)
    return gradient


def _pulled(sampler, state, example, gradient, parts, changes):
    with dr.resume_grad():
        dr.enable_grad(state)
        collected = changes.step()
        new = step(sampler, unpacked(state, example), parts, collected)
        changes.pull(collected, packed(new), gradient)
        return dr.grad(state)
