"""Joining renders of one scene that have different seeds, from any machines."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..labels import FILM, energy_outside_window, read
from ..runtime import checks
from ..runtime.progress import status
from .dataset import DIMS, ERRORS, HALVES, require_finite
from .labels import labelled

OWN = {
    *("seed", "spp", "render_seconds", "energy_outside_window", "complete"),
    *("contributions_not_finite", "scene", "versions"),
}
"""Attributes in which renders that are joined may differ."""

MOST_SPP = 1 << 48  # Samples per pixel of a render that was itself joined


@status("Joining renders")
def merge(renders: Sequence[Annotated[xr.Dataset, FILM]]) -> xr.Dataset:
    """Join renders of one scene into one with all their samples.

    Each is weighted by its samples per pixel. Standard errors are joined where all have them; four
    renders or more without any tell them by their scatter.

    Args:
        renders: Datasets of `render`, two or more, that differ in seed and samples alone. Films on
            disk stay there: the result is computed when it is used.

    Returns:
        A Dataset as `render` returns it. `spp` is the sum, `seed` a list as text.

    Raises:
        ValueError: There are fewer than two, two have the same seed, or they are not of the same
            scene, film and settings; one line that names what differs.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=8, height=8, temporal_bins=60, bin_width_opl=0.2)
        >>> parts = [tofrender.render(scene, spp=16, seed=seed) for seed in range(3)]
        >>> merge(parts).attrs["spp"]
        48
    """
    renders = list(checks.instance("renders", renders, list | tuple, "a list of Datasets"))
    if len(renders) < 2:
        raise ValueError(f"renders: has {len(renders)}; must have two or more")
    renders = [_read(render, f"renders[{number}]") for number, render in enumerate(renders)]
    _check_alike(renders)
    counts = np.array([int(render.attrs["spp"]) for render in renders])
    weights = (counts / counts.sum()).astype(np.float32)
    variables: dict[str, Any] = {}
    for name in DIMS:
        dims, parts = renders[0][name].dims, [render[name].data for render in renders]
        mean = sum(weight * part for weight, part in zip(weights, parts, strict=True))
        variables[name] = (dims, mean)
        error = _error(name, renders, parts, mean, weights)
        if error is not None:
            variables[f"{name}_error"] = (dims, error)
    first, attrs = renders[0], dict(renders[0].attrs)
    outside: list[Any] = [energy_outside_window(render, "renders") for render in renders]
    attrs |= {
        "spp": int(counts.sum()),
        "seed": ", ".join(str(render.attrs["seed"]) for render in renders),
        "complete": int(all(render.attrs["complete"] for render in renders)),
        "energy_outside_window": float(np.dot(weights, outside)),
    }
    for name in ("render_seconds", "contributions_not_finite"):
        attrs[name] = sum(render.attrs.get(name, 0) for render in renders)
    merged = first.assign(variables).assign_attrs(attrs).drop_encoding()  # It is no film on disk
    merged = merged.drop_vars(list(HALVES), errors="ignore")
    if len(variables) == len(DIMS):
        merged = merged.drop_vars(list(ERRORS), errors="ignore")
    return labelled(merged)


def _read(render: object, parameter: str) -> xr.Dataset:
    """Read a render. Refuse attributes that cannot be joined."""
    found = read(render, FILM, parameter)
    try:
        require_finite(found)
        checks.integer("spp", found.attrs.get("spp"), 1, MOST_SPP)
        for name in ("complete", "energy_outside_window", "render_seconds"):
            checks.number(name, found.attrs.get(name), low=0)
    except ValueError as error:
        raise ValueError(f"{parameter}: {error}") from None
    for name in ("seed", "fingerprint"):
        if name not in found.attrs:
            raise ValueError(
                f"{parameter}: the attribute {name} is missing. Pass a film of render before "
                "unwarp_camera, or a frame that was selected without drop, isel(frame=0)"
            )
    return found


def _error(
    name: str, renders: list[xr.Dataset], parts: list[Any], mean: Any, weights: np.ndarray
) -> Any | None:
    """Standard error of a mean: from those of the parts, or from their scatter."""
    if all(f"{name}_error" in render for render in renders):
        errors = [render[f"{name}_error"].data for render in renders]
        return np.sqrt(sum((w * e) ** 2 for w, e in zip(weights, errors, strict=True)))
    if len(parts) < 4:
        return None
    # Each part's variance goes as 1 / weight: all weighted squares estimate the same
    scatter = sum(w * (part - mean) ** 2 for w, part in zip(weights, parts, strict=True))
    return np.sqrt(scatter / np.float32(len(parts) - 1))


def _check_alike(renders: list[xr.Dataset]) -> None:
    """Refuse renders that are not of one scene, or share random numbers."""
    first = renders[0]
    for number, render in enumerate(renders[1:], 1):
        names = {*first.attrs, *render.attrs} - OWN
        for name in sorted(names, key=lambda name: (name == "fingerprint", name)):
            mine, its = first.attrs.get(name), render.attrs.get(name)
            if mine != its:
                raise ValueError(f"renders[{number}]: has {name} = {its!r}; must be {mine!r}")
        for axis in first["transient"].dims:
            if not np.array_equal(first[axis].values, render[axis].values):
                raise ValueError(f"renders[{number}]: has another {axis}; must be as the first")
    seeds = [seed for r in renders for seed in str(r.attrs["seed"]).split(", ")]
    twice = {seed for seed in seeds if seeds.count(seed) > 1}
    if twice:
        raise ValueError(f"seed = {min(twice)}: is that of two renders; must all be different")
