"""The command `tofrender dataset`."""

import re
from pathlib import Path
from typing import Annotated, Any

from . import options as opt
from .checkpoints import AGAIN

LAST = 10_000_000


def numbers(name: str, value: Any) -> list[int]:
    """Check indices and ranges of records, like 17 or 0-99,250, and return all indices."""
    found: list[int] = []
    for part in str(value).split(","):
        ends = re.fullmatch(r"(\d{1,8})(-(\d{1,8}))?", part, re.ASCII)
        low, high = (int(ends[1]), int(ends[3] or ends[1])) if ends else (1, 0)
        if not low <= high <= LAST:
            raise ValueError(f"{name} = {value}: must be indices of records, like 17 or 0-99,250")
        found += range(low, high + 1)
    return found


@opt.with_groups
def dataset(
    config: Annotated[Path, opt.argument("CONFIG", "TOML file that describes the data set.")],
    out: Annotated[
        Path | None, opt.named("DIR", "Folder to write. Its name ends in .zarr.")
    ] = None,
    only: Annotated[
        Any,
        opt.checked(
            numbers,
            "Indices of the records to make, from 0, for example 17 or 0-99.",
            metavar="N,N-N",
            show_default="all records",
        ),
    ] = None,
    plan: Annotated[
        bool, opt.switch("--plan", "Print the size of the data set without making it.")
    ] = False,
    variant: opt.Variant = None,
    *,
    processes: opt.Processes,
    resume: Annotated[bool, opt.switch("--resume", "Continue a stopped or killed run.")] = False,
) -> None:
    """Make a data set of varied scenes.

    CONFIG defines the number of records, their contents, and the cameras, lights, materials and
    objects that vary. The page docs/datasets.md describes its keys. DIR is one Zarr group. It
    appears when all records are complete. With --resume the command continues a stopped or killed
    run. A complete data set is not changed. With --only, the command makes some of the records.
    These records are the same as in the whole data set.

    Examples:
        tofrender dataset boxes.toml --plan
        tofrender dataset boxes.toml --only 0-3 --out boxes.zarr
    """
    if out is None and not plan:
        raise ValueError("--out is missing. Add --out DIR, or --plan to see the size only")
    opt.activate(variant)

    from tofrender.datasets.making import make_dataset, plan_dataset, require_complete, under_way
    from tofrender.datasets.stored_records import StoredRecords

    if plan:
        opt.say(str(plan_dataset(config, only)))
        return
    assert out is not None
    if resume and not StoredRecords.planned(under_way(out)):
        if out.exists():
            count = require_complete(config, out, only).sizes["record"]
            opt.say(f"{out}: already complete, {count} record{'s' * (count != 1)}")
            return
        raise ValueError(f"--resume: {out} has no stopped run. Remove the option, or correct --out")
    with processes.client() as client:
        made = make_dataset(
            config, out, only=only, client=client, resume=resume, tell=opt.note, again=AGAIN
        )
    count = made.sizes["record"]
    small = {"made_with", "attempt", *made.attrs["parameters"].split()}
    large = [str(n) for n, v in made.data_vars.items() if n not in small and v.ndim > 2]
    opt.say(f"{out}: {count} record{'s' * (count != 1)}, {', '.join(large)}")
