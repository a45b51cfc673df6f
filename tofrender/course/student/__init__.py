"""What a student uses: `tofrender start` and `submit`, and the notebook's `%%solution` cells.

%load_ext tofrender.course.student
"""

from .cells import load_ipython_extension

__all__ = ["load_ipython_extension"]
