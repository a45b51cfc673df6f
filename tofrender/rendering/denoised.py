"""Denoising of renders, from two halves of the samples and features of the first hits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np

from ..denoising.filtering import denoise_film
from ..integrators.features import by_name, render_features
from ..labels import FILM, read, require_consecutive, require_whole_stokes, with_energy
from ..runtime.progress import status
from .dataset import HALVES
from .labels import labeled

if TYPE_CHECKING:
    import mitsuba as mi
    import xarray as xr

    from ..films.transient import TransientHDRFilm


@status("Removing noise")
def denoise(dataset: Annotated[xr.Dataset, FILM]) -> xr.Dataset:
    """Remove noise from a render with `denoise`, which contains two halves of the samples.

    The filter uses the same weights for all Stokes components as for S0. Standard errors are not
    available, because the two halves do not determine the noise that remains after the filter. See
    also `denoise_film`, which describes the method.

    Args:
        dataset: The result of `render` with `denoise`. The function filters its film `raw` again.

    Returns:
        The Dataset with less noise in `transient` and `steady`, and the same energy. `raw` is the
        film before the filter. `direct` is the part of the film that the filter does not change.
        `half_difference` and `features` are the inputs of the filter. To save memory, remove them:
        `dataset.drop_vars(["raw", "direct", "half_difference", "features"])`.

    Raises:
        ValueError: The halves or the features are missing, the pixels are not a rectangle without
            gaps, or values are not finite.

    Example:
        >>> import tofrender
        >>> scene = tofrender.cornell_box(width=16, height=16, temporal_bins=60)
        >>> once = tofrender.render(scene, spp=16, window="auto", denoise=True)
        >>> denoise(once).identical(once)
        True
    """
    # Check the Dataset
    dataset = with_energy(read(dataset, FILM, "dataset"), "dataset")
    require_whole_stokes(dataset, "dataset")
    require_consecutive(dataset, "dataset")
    missing = [name for name in HALVES if name not in dataset]
    if missing:
        raise ValueError(f"dataset: has no {missing[0]}; must be of render(..., denoise=True)")

    # Filter the film without direct light
    mean, noise, direct = (
        dataset[name].values.reshape(*dataset[name].shape[:3], -1)
        for name in ("raw", "half_difference", "direct")
    )
    features = by_name(dataset["features"].values)
    found = direct + denoise_film(mean - direct, noise, features, dataset.sizes["channel"])

    # Change the steady picture by the same energy
    earlier, steady = (dataset[name].variable for name in ("transient", "steady"))
    change = np.ones(mean.shape[2], np.float32) @ (found - earlier.values.reshape(mean.shape))
    variables = {
        "transient": earlier.copy(data=found.reshape(earlier.shape)),
        "steady": steady.copy(data=steady.values + change.reshape(steady.shape)),
    }
    return labeled(dataset.assign(variables).assign_attrs(denoised=1))


def denoised(
    dataset: xr.Dataset, scene: mi.Scene, camera: mi.Sensor, film: TransientHDRFilm
) -> xr.Dataset:
    """Render the features of a scene for a camera, add them to a Dataset, and denoise it."""
    features = HALVES["features"], render_features(scene, camera, film)
    return denoise(dataset.assign(raw=dataset["transient"].variable, features=features))
