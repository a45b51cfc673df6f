"""Merging of renders of one scene with different seeds, also from different machines."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
import xarray as xr

from ..labels import FILM, energy_outside_window, read, require_same_labels
from ..runtime import checks
from ..runtime.progress import status
from .dataset import DIMS, ERRORS, HALVES, require_finite
from .labels import labeled

# Attributes that may differ between the renders
OWN = {
    "seed",
    "spp",
    "render_seconds",
    "energy_outside_window",
    "complete",
    "contributions_not_finite",
    "scene",
    "versions",
}

# Largest number of samples per pixel of a render, which may itself be a merged render
MOST_SPP = 1 << 48


@status("Joining renders")
def merge(renders: Sequence[Annotated[xr.Dataset, FILM]]) -> xr.Dataset:
    """Merge renders of one scene into one render with all their samples.

    Each render is weighted by its samples per pixel. If all renders have standard errors, the
    errors are merged. Otherwise, the standard errors of at least four renders are estimated from
    the scatter of the renders.

    Args:
        renders: Two or more Datasets of `render`. They may differ only in seed and samples. Films
            on disk are not loaded: the result is computed when it is used.

    Returns:
        A Dataset as `render` returns it. `spp` is the sum, `seed` a list as text.

    Raises:
        ValueError: The list has fewer than two renders, two renders have the same seed, or scene,
            film or settings differ. One line names the difference.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=8, height=8, temporal_bins=60, bin_width_opl=0.2)
        >>> parts = [tofrender.render(scene, spp=16, seed=seed) for seed in range(3)]
        >>> merge(parts).attrs["spp"]
        48
    """
    # Check the renders
    renders = list(checks.instance("renders", renders, list | tuple, "a list of Datasets"))
    if len(renders) < 2:
        raise ValueError(f"renders: has {len(renders)}; must have two or more")
    renders = [_read(render, f"renders[{number}]") for number, render in enumerate(renders)]
    _check_alike(renders)

    # Weight each render by its samples per pixel
    counts = np.array([int(render.attrs["spp"]) for render in renders])
    weights = (counts / counts.sum()).astype(np.float32)
    variables: dict[str, Any] = {}
    for name in DIMS:
        dims = renders[0][name].dims
        parts = [render[name].data for render in renders]
        mean = sum(weight * part for weight, part in zip(weights, parts, strict=True))
        variables[name] = (dims, mean)
        error = _error(name, renders, parts, mean, weights)
        if error is not None:
            variables[f"{name}_error"] = (dims, error)

    # Merge the attributes
    first = renders[0]
    attrs = dict(renders[0].attrs)
    outside: list[Any] = [energy_outside_window(render, "renders") for render in renders]
    attrs |= {
        "spp": int(counts.sum()),
        "seed": ", ".join(str(render.attrs["seed"]) for render in renders),
        "complete": int(all(render.attrs["complete"] for render in renders)),
        "energy_outside_window": float(np.dot(weights, outside)),
    }
    for name in ("render_seconds", "contributions_not_finite"):
        attrs[name] = sum(render.attrs.get(name, 0) for render in renders)

    # Remove the path of the file, the halves of the first render, and errors that were not merged
    merged = first.assign(variables).assign_attrs(attrs).drop_encoding()
    merged = merged.drop_vars(list(HALVES), errors="ignore")
    if len(variables) == len(DIMS):
        merged = merged.drop_vars(list(ERRORS), errors="ignore")
    return labeled(merged)


def _read(render: object, parameter: str) -> xr.Dataset:
    """Read a render, and raise a ValueError if an attribute is missing or wrong."""
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
    """Return the standard error of a mean, from the errors or the scatter of the parts.

    The result is None if errors are missing and there are fewer than four parts.

    Args:
        name: Name of the variable.
        renders: The renders.
        parts: Arrays of the variable, one for each render.
        mean: Weighted mean of the parts.
        weights: Weights of the renders; their sum is 1.
    """
    if all(f"{name}_error" in render for render in renders):
        errors = [render[f"{name}_error"].data for render in renders]
        return np.sqrt(sum((w * e) ** 2 for w, e in zip(weights, errors, strict=True)))
    if len(parts) < 4:
        return None

    # The variance of a part is proportional to 1 / weight, so all weighted squares have the same
    # expected value
    scatter = sum(w * (part - mean) ** 2 for w, part in zip(weights, parts, strict=True))
    return np.sqrt(scatter / np.float32(len(parts) - 1))


def _check_alike(renders: list[xr.Dataset]) -> None:
    """Raise a ValueError if renders have different settings, or equal seeds."""
    # Compare the attributes, the fingerprint last, and the coordinates
    first = renders[0]
    for number, render in enumerate(renders[1:], 1):
        names = {*first.attrs, *render.attrs} - OWN
        for name in sorted(names, key=lambda name: (name == "fingerprint", name)):
            mine = first.attrs.get(name)
            its = render.attrs.get(name)
            if mine != its:
                raise ValueError(f"renders[{number}]: has {name} = {its!r}; must be {mine!r}")
        labels = {str(axis): first[axis].values for axis in first["transient"].dims}
        require_same_labels(render, labels, f"renders[{number}]", "renders[0]")

    # Do two renders have the same random numbers?
    seeds = [seed for r in renders for seed in str(r.attrs["seed"]).split(", ")]
    twice = {seed for seed in seeds if seeds.count(seed) > 1}
    if twice:
        raise ValueError(f"seed = {min(twice)}: is that of two renders; must all be different")
