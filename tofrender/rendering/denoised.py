"""Renders without noise: two halves of the samples, features of the first hits, and the filter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np

from ..denoising.filtering import denoise_film
from ..integrators.features import by_name, render_features
from ..labels import FILM, read, require_consecutive, require_whole_stokes, with_energy
from ..runtime.progress import status
from .dataset import HALVES
from .labels import labelled

if TYPE_CHECKING:
    import mitsuba as mi
    import xarray as xr

    from ..films.transient import TransientHDRFilm


@status("Removing noise")
def denoise(dataset: Annotated[xr.Dataset, FILM]) -> xr.Dataset:
    """Remove noise from a render whose samples are known in two halves.

    See also `denoise_film`, which has the method. Stokes components are mixed as S0 is. Errors
    stay unknown: what the filter leaves of the noise cannot be told from the halves.

    Args:
        dataset: The result of `render` with `denoise`; its `raw` film is filtered again.

    Returns:
        The Dataset with `transient` and `steady` without much of their noise, and the same energy.
        `raw` has the film as it was rendered, `direct` its part that the filter leaves, and
        `half_difference` and `features` what that goes by; `dataset.drop_vars(["raw", "direct",
        "half_difference", "features"])` saves their memory.

    Raises:
        ValueError: The Dataset has no halves or features, its pixels are not a rectangle without
            gaps, or values are not finite.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=60)
        >>> once = tofrender.render(scene, spp=16, window="auto", denoise=True)
        >>> denoise(once).identical(once)
        True
    """
    dataset = with_energy(read(dataset, FILM, "dataset"), "dataset")
    require_whole_stokes(dataset, "dataset")
    require_consecutive(dataset, "dataset")
    missing = [name for name in HALVES if name not in dataset]
    if missing:
        raise ValueError(f"dataset: has no {missing[0]}; must be of render(..., denoise=True)")
    mean, noise, direct = (
        dataset[name].values.reshape(*dataset[name].shape[:3], -1)
        for name in ("raw", "half_difference", "direct")
    )
    features = by_name(dataset["features"].values)
    found = direct + denoise_film(mean - direct, noise, features, dataset.sizes["channel"])
    earlier, steady = (dataset[name].variable for name in ("transient", "steady"))
    change = np.ones(mean.shape[2], np.float32) @ (found - earlier.values.reshape(mean.shape))
    variables = {
        "transient": earlier.copy(data=found.reshape(earlier.shape)),
        "steady": steady.copy(data=steady.values + change.reshape(steady.shape)),
    }
    return labelled(dataset.assign(variables).assign_attrs(denoised=1))


def denoised(
    dataset: xr.Dataset, scene: mi.Scene, camera: mi.Sensor, film: TransientHDRFilm
) -> xr.Dataset:
    """Add the features that a camera of the scene sees to a Dataset, and remove its noise."""
    features = HALVES["features"], render_features(scene, camera, film)
    return denoise(dataset.assign(raw=dataset["transient"].variable, features=features))
