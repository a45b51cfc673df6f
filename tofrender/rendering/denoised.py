"""Renders without noise: two halves of the samples, features of the first hits, and the filter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..denoising.filtering import filtered
from ..integrators.features import by_name, render_features
from ..runtime.progress import status
from .dataset import HALVES, check_dataset, components_of, require_finite
from .labels import labelled

if TYPE_CHECKING:
    import xarray as xr

    from .job import Job


@status("Removing noise")
def denoise(dataset: xr.Dataset) -> xr.Dataset:
    """Remove noise from a render whose samples are known in two halves.

    See also `denoise_halves`, which has the method. Stokes components are mixed as S0 is. Errors
    stay unknown: what the filter leaves of the noise cannot be told from the halves.

    Args:
        dataset: The result of `render` with `denoise`; its `raw` film is filtered again.

    Returns:
        The Dataset with `transient` and `steady` without much of their noise, and the same energy.
        `raw` has the film as it was rendered, `half_difference` and `features` what the filter
        goes by; `dataset.drop_vars(["raw", "half_difference", "features"])` saves their memory.

    Raises:
        ValueError: The Dataset has no halves or features, or values that are not finite; one line.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=60, bin_width_opl=0.1)
        >>> once = tofrender.render(scene, spp=16, denoise=True)
        >>> denoise(once).identical(once)
        True
    """
    for component in components_of(dataset):
        check_dataset(component)
    missing = [name for name in ("half_difference", "features") if name not in dataset]
    if missing:
        raise ValueError(f"dataset: has no {missing[0]}; must be of render(..., denoise=True)")
    require_finite(dataset)
    raw = dataset["raw" if "raw" in dataset else "transient"]
    mean, noise = (
        each.values.reshape(*each.shape[:3], -1) for each in (raw, dataset["half_difference"])
    )
    colours = dataset.sizes["channel"]
    found = filtered(mean, noise, by_name(dataset["features"].values), colours)
    before = dataset["transient"].sum("opl", dtype=np.float64)
    transient = raw.copy(data=found.reshape(raw.shape))
    change = transient.sum("opl", dtype=np.float64) - before
    steady = (dataset["steady"] + change).astype(np.float32)
    variables: dict[str, Any] = {"transient": transient, "raw": raw}
    variables["steady"] = dataset["steady"].copy(data=steady.values)
    return labelled(dataset.assign(variables).assign_attrs(denoised=1))


def denoised(job: Job, dataset: xr.Dataset) -> xr.Dataset:
    """Add the features of a job's camera to its Dataset, and remove noise."""
    features = render_features(job.scene, job.camera, job.film)
    return denoise(dataset.assign(features=(HALVES["features"], features)))
