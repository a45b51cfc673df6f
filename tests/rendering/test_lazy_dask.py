"""Datasets of arrays in memory do without Dask, and those of its arrays are as ever."""

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys
import numpy as np, xarray as xr
from tofrender.rendering.lazy_dask import defer_dask

defer_dask()
dataset = xr.Dataset({"light": ("x", np.arange(4.0))}, {"x": np.arange(4)})
print(dataset["light"].sum().item(), "dask" in sys.modules)

from xarray.namedarray.pycompat import array_type, mod_version
print(array_type("dask"), str(mod_version("dask"))[:2])

import dask.array as da
masked = xr.Variable("x", da.ma.masked_greater(da.arange(4, chunks=2), 2))
print(masked.chunks, masked.values)
lazy = dataset.chunk(x=2)
print(lazy["light"].chunks, (lazy + 1)["light"].chunks, lazy.equals(dataset))
"""
PRINTED = """\
6.0 False
() 20
((2, 2),) [ 0.  1.  2. nan]
((2, 2),) ((2, 2),) True
"""


def test_dask_is_imported_for_its_own_arrays_only():
    command = [sys.executable, "-c", PROGRAM]
    root = Path(__file__).parents[2]
    done = subprocess.run(command, capture_output=True, text=True, cwd=root)
    assert (done.stdout, done.stderr) == (PRINTED, "")
