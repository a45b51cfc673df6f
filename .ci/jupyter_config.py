"""Settings of `make notebook`. Saved notebooks keep their outputs; git stores them without."""

from pathlib import Path


def without_announcements(_, page):
    """Leave out the extension that asks, over the first figure, whether to subscribe to news."""
    page["disabledExtensions"] += ["@jupyterlab/apputils-extension:announcements"]
    return page


c = get_config()  # noqa: F821, given by Jupyter
c.ServerApp.root_dir = str(Path(__file__).resolve().parents[1])
c.ServerApp.tornado_settings = {"page_config_hook": without_announcements}
c.LabApp.default_url = "/lab/tree/notebooks"
c.LabApp.news_url = None  # nothing is asked of the network
c.LabApp.check_for_updates_class = "jupyterlab.NeverCheckForUpdate"
