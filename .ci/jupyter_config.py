"""Settings of `make notebook`: notebooks are saved without outputs, as git has them."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from strip_notebooks import stripped  # noqa: E402


def save_without_outputs(model, **_):
    """Strip what is about to be saved; what the browser shows stays."""
    if model["type"] == "notebook" and model["content"]["nbformat"] == 4:
        stripped(model["content"])


c = get_config()  # noqa: F821, given by Jupyter
c.ContentsManager.pre_save_hook = save_without_outputs
c.ServerApp.root_dir = str(HERE.parent)
c.LabApp.default_url = "/lab/tree/notebooks"
c.LabApp.news_url = None  # nothing is asked of the network
c.LabApp.check_for_updates_class = "jupyterlab.NeverCheckForUpdate"
