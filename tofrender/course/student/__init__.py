"""Commands `tofrender start` and `submit`, and notebook cells that are files.

`%load_ext tofrender.course.student` adds the cells to a notebook.
"""

from .cells import load_ipython_extension

__all__ = ["load_ipython_extension"]
