"""JupyterLab for tests in a browser."""

import json
import os
import secrets
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from helpers.processes import ROOT, wait_for
from helpers.served import is_free


@contextmanager
def lab(folder: Path):
    """The address of a JupyterLab of this folder; it ends with the block, and its port is free."""
    pytest.importorskip("jupyterlab")
    log, token = folder / "lab.log", secrets.token_hex(16)
    own = {f"JUPYTER_{name}_DIR": str(folder / name) for name in ("CONFIG", "DATA", "RUNTIME")}
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    options = ["--ServerApp.port=0", f"--IdentityProvider.token={token}"]
    options += ["--ServerApp.ip=127.0.0.1"]
    options += [f"--ServerApp.root_dir={folder}", "--expose-app-in-browser"]
    with log.open("wb") as opened:
        server = subprocess.Popen(
            [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", *options],
            cwd=folder,
            env=os.environ | own | {"PYTHONPATH": paths, "HOME": str(folder)},
            stdout=subprocess.DEVNULL,
            stderr=opened,
            start_new_session=True,
        )
    told = folder / "RUNTIME" / f"jpserver-{server.pid}.json"

    def is_up() -> bool:
        assert server.poll() is None, log.read_text()
        return told.exists() and told.read_text().endswith("}")

    try:
        wait_for(is_up)
        port = json.loads(told.read_text())["port"]
        yield f"http://127.0.0.1:{port}", token
    finally:
        server.send_signal(signal.SIGTERM)
        server.wait()
    wait_for(lambda: is_free(port))


def wait_for_kernel(page) -> None:
    """Until it has been idle for two seconds: it is so for a moment before it connects."""
    told = "document.querySelector('.jp-Notebook-ExecutionIndicator')?.dataset.status"
    idle = 0
    while idle < 20:
        page.wait_for_timeout(100)
        idle = idle + 1 if page.evaluate(f"window.jupyterapp && {told}") == "idle" else 0
