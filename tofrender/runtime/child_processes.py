"""Start Python processes that do not import from the working folder.

Python puts the working folder first on the path of `python -c` and `python -m`, and also of helper
processes such as the tracker of `multiprocessing`. A file `selectors.py` in a downloaded folder
would then run instead of the standard library's module. The variable `PYTHONSAFEPATH` (Python 3.11)
prevents this in a process and in all its children.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

SAFE_PATH = "PYTHONSAFEPATH"


def safe_environment(**more: str) -> dict[str, str]:
    """Return the environment of a new Python process, with more variables.

    Example:
        >>> safe_environment(LANG="C")["PYTHONSAFEPATH"], safe_environment(LANG="C")["LANG"]
        ('1', 'C')
    """
    return os.environ | {SAFE_PATH: "1"} | more


@contextmanager
def safe_children() -> Iterator[None]:
    """Set the variable for processes that other packages start inside the block."""
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(SAFE_PATH, None)
        else:
            os.environ[SAFE_PATH] = before
