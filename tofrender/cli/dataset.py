"""The command `tofrender dataset`."""

import re
from pathlib import Path
from typing import Annotated, Any

from . import options as opt
from .checkpoints import AGAIN

LAST = 10_000_000


def numbers(name: str, value: Any) -> list[int]:
    """Check numbers and ranges, like 17 or 0-99,250, and list the numbers."""
    found: list[int] = []
    for part in str(value).split(","):
        ends = re.fullmatch(r"(\d{1,8})(-(\d{1,8}))?", part, re.ASCII)
        low, high = (int(ends[1]), int(ends[3] or ends[1])) if ends else (1, 0)
        if not low <= high <= LAST:
            raise ValueError(f"{name} = {value}: must be numbers of records, like 17 or 0-99,250")
        found += range(low, high + 1)
    return found


def dataset(
    config: Annotated[Path, opt.argument("CONFIG", "TOML file: what to make.")],
    out: Annotated[Path | None, opt.named("DIR", "Folder to write, ends in .zarr.")] = None,
    only: Annotated[
        Any, opt.checked(numbers, "Only these records, e.g. 17 or 0-99.", metavar="N,N-N")
    ] = None,
    plan: Annotated[bool, opt.switch("--plan", "Show the plan and stop.")] = False,
    variant: opt.Variant = None,
    workers: opt.Workers = None,
    scheduler: opt.Scheduler = None,
    resume: Annotated[bool, opt.switch("--resume", "Continue a stopped or killed run.")] = False,
) -> None:
    """Make a data set: many scenes with varied cameras, lights, materials and objects.

    CONFIG says how many, what is varied, and what each record holds; docs/datasets.md has all its
    keys. DIR is one Zarr group, which appears when all records are there. --resume continues a
    stopped or killed run; a complete DIR is not changed. With --only, some records are made alone,
    equal to those of the complete set.
    """
    if out is None and not plan:
        raise ValueError("--out: must be given, or --plan")
    opt.activate(variant)

    from tofrender.datasets.making import make_dataset, plan_dataset, require_complete, under_way
    from tofrender.datasets.store import Store

    if plan:
        opt.say(str(plan_dataset(config, only)))
        return
    assert out is not None
    if resume and not Store.planned(under_way(out)):
        if out.exists():
            count = require_complete(config, out, only).sizes["record"]
            opt.say(f"{out}: already complete, {count} record{'s' * (count != 1)}")
            return
        raise ValueError(f"--resume: no run that makes {out} was stopped; must be left out")
    with opt.client_of(workers, scheduler) as client:
        made = make_dataset(
            config, out, only=only, client=client, resume=resume, tell=opt.note, again=AGAIN
        )
    count = made.sizes["record"]
    small = {"made_with", "attempt", *made.attrs["parameters"].split()}
    large = [str(n) for n, v in made.data_vars.items() if n not in small and v.ndim > 2]
    opt.say(f"{out}: {count} record{'s' * (count != 1)}, {', '.join(large)}")
