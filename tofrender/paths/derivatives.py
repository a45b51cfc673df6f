"""The path loop, differentiated: `walk`'s own `step`, one vertex at a time.

A step takes the state of a path to the next one and hands out light. All that a derivative of the
whole loop needs is therefore that of one step, which Dr.Jit differentiates while it traces it.

**Forwards**, each step takes the rates of the state along: `move` walks once.

**In reverse**, the gradient of the state goes from the last step to the first: `pull` walks once
to keep the states, and then goes back over them. A step is traced again from its state, with the
same random numbers, and the gradient of what follows is propagated through it. The states are in
memory of each lane; neither time nor memory has more than one factor of depth, and memory is that
of the threads at work, however many paths there are.

Whatever a step depends on has its derivative so: lengths, indices, shares, where mirrors lead.
How directions are chosen is the scattering's matter, see `attached`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ..films.derivatives import Changes
from .protocols import Parts
from .records import Path
from .tape import packed, tape, unpacked
from .walk import step

MOST_KEPT = 256
"""Vertices of a path whose states fit into the memory of a lane."""


@dr.syntax
def move(
    sampler: Any, path: Path, rate: Any, parts: Parts, changes: Changes, sums: list[Any]
) -> tuple[list[Any], Path]:
    """Follow paths and the rates of their states.

    Args:
        sampler: Random numbers.
        path: Where paths start.
        rate: Rate of that state, packed.
        parts: What they go along.
        changes: What becomes of their light.
        sums: Rates of what is summed so far.

    Returns:
        Rates of the sums, and the paths at their ends.
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


class Nothing:
    """A measurement of no light."""

    def add(self, contribution: Any) -> None:
        """Forget a contribution."""


@dr.syntax
def pull(sampler: Any, path: Path, parts: Parts, changes: Changes) -> Any:
    """Follow paths, and propagate the gradient of their light back to parameters.

    Args:
        sampler: Random numbers, whose `dimension` says which come next.
        path: Where paths start.
        parts: What they go along; bounded.
        changes: What their light counts.

    Returns:
        The gradient of the paths' first state, packed.
    """
    most = parts.limits.iterations if parts.limits.iterations > 0 else MOST_KEPT
    start, nothing = packed(path), Nothing()
    states, numbers = tape(path, most), dr.alloc_local(mi.UInt32, most)
    k = mi.UInt32(0)
    here = path
    while here.active & (k < most):
        states.write(packed(here), k)
        numbers.write(sampler.dimension, k)
        here = step(sampler, here, parts, nothing)
        k += 1
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
