"""Threads for work on many frames, and for several writers."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any

from ..runtime.progress import progress_bar


def for_each(
    function: Callable[[int], Any], items: Iterable[int], description: str, *, progress: bool
) -> None:
    """Call `function` on every item in threads; the first error or Ctrl-C cancels the rest.

    OpenEXR and Pillow release the GIL while they (de)compress.
    """
    with ThreadPoolExecutor(min(16, os.cpu_count() or 1)) as pool:
        futures = [pool.submit(function, item) for item in items]
        try:
            with progress_bar(description, len(futures), enabled=progress) as bar:
                for future in as_completed(futures):
                    future.result()
                    bar.update()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def at_once(first: Callable[[], Any], *others: Callable[[], Any]) -> None:
    """Call functions concurrently, the first one in this thread; raise the first error last."""
    with ThreadPoolExecutor(max(1, len(others))) as pool:
        futures = [pool.submit(each) for each in others]
        first()
        for each in futures:
            each.result()
