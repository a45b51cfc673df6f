"""Commands `tofrender start` and `submit`, and cells: `%load_ext tofrender.course.student`."""

from .cells import load_ipython_extension

__all__ = ["load_ipython_extension"]
