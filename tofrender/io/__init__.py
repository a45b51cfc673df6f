"""Files: EXR stacks, NumPy archives, PNG frames and videos, each written whole or not at all.

No format can replace all others, because each format has readers or abilities that the others do
not have:

| content | format | reason |
|---|---|---|
| films | EXR stack | programs for images open each time bin, with channels and color |
| films | NumPy archive | one file with the exact arrays, which NumPy opens without this package |
| films, data sets | Zarr | grows part by part, for films that are larger than memory |
| captures | HDF5 | the layout of y-tal and related tools |
| measurements | NetCDF 3 | variables with different axes, which xarray opens with SciPy only |

NetCDF 3 limits the size of variables. Zarr groups are folders, and Zarr is not a dependency of the
core. HDF5 files of captures follow the layout of other programs,
which does not have a place for films. Seals detect damage in formats without checksums.
"""

from ..runtime.lazy import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
