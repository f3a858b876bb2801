"""A JupyterLab on a free port, and a browser that looks at it; without a browser, tests skip."""

import os
import secrets
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from driver import Reader

from ilctools.files import folder
from rodlib.paper.repository import ROOT

NAMES = (
    "chromium-headless-shell", "chromium", "chromium-browser", "google-chrome",
    "google-chrome-stable", "chrome",
)  # fmt: skip
PATIENCE = 300  # s, for what takes a few on a machine that is not busy: a last resort


def found_browser(own):
    """$CHROMIUM, a Chromium or Chrome on the path, or the one that playwright has installed."""
    named = os.environ.get("CHROMIUM")
    if named:
        assert shutil.which(named), f"CHROMIUM = {named!r} cannot be executed"
        return named
    on_path = [path for name in NAMES if (path := shutil.which(name))]
    return next(iter([*on_path, *([own] if Path(own).exists() else [])]), None)


@pytest.fixture(scope="session")
def browser():
    """A Chromium without a window."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as playwright:
        path = found_browser(playwright.chromium.executable_path)
        if path is None:
            pytest.skip("no browser: install chromium or Chrome, or name one in $CHROMIUM")
        # Pages of this test only: the sandbox is not missed, and root could not have one.
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def lab(tmp_path_factory):
    """Address of a JupyterLab as `make lab` starts it, with copies of the notebooks."""
    pytest.importorskip("jupyterlab")
    home = tmp_path_factory.mktemp("lab")
    shutil.copytree(
        ROOT / "notebooks", home / "notebooks", ignore=lambda *_: [".ipynb_checkpoints"]
    )
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    token = secrets.token_hex(16)
    ours = ("JUPYTER", "JPY")
    surroundings = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
    news = folder(home / "settings" / "@jupyterlab" / "apputils-extension")
    (news / "notification.jupyterlab-settings").write_text('{"fetchNews": "false"}')
    folders = {
        "JUPYTER_CONFIG_DIR": "config",
        "JUPYTER_DATA_DIR": "data",
        "JUPYTERLAB_SETTINGS_DIR": "settings",
        "JUPYTER_RUNTIME_DIR": "run",
        "JUPYTERLAB_WORKSPACES_DIR": "workspaces",
        "RODLIB_RESULTS": "",
        "IPYTHONDIR": "ipython",
    }
    surroundings |= {name: str(home / folder) for name, folder in folders.items()}
    surroundings |= {"JUPYTER_PREFER_ENV_PATH": "1", "JUPYTER_TOKEN": token}
    options = ["--no-browser", "--allow-root", f"--port={port}", "--ServerApp.port_retries=0"]
    with open(home / "log", "w") as log:
        server = subprocess.Popen(
            [sys.executable, "-m", "jupyterlab", *options, *options_of_make_lab()],
            cwd=home, env=surroundings, stdout=log, stderr=subprocess.STDOUT,
        )  # fmt: skip
        try:
            address = f"http://127.0.0.1:{port}"
            wait_for(f"{address}/api", server, home / "log")
            yield f"{address}/?token={token}"
        finally:
            server.terminate()
            try:
                server.wait(20)
            except subprocess.TimeoutExpired:
                server.kill()
                server.wait()


def options_of_make_lab():
    """What the Makefile tells JupyterLab."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    line = next(line for line in text.splitlines() if "jupyter lab " in line)
    options = line.split("jupyter lab ")[1].partition(" # ")[0]
    return options.replace("$(LAB) ", "").split()


def wait_for(address, server, log):
    """Until the server answers."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end and server.poll() is None:
        try:
            with urllib.request.urlopen(address, timeout=5):
                return
        except (urllib.error.URLError, OSError):
            time.sleep(0.1)
    pytest.fail(f"JupyterLab does not answer:\n{log.read_text()}")


@pytest.fixture(scope="session")
def shots():
    """Where screenshots go."""
    return folder(ROOT / "build" / "browser")


@pytest.fixture(scope="session")
def reader(browser, lab):
    """Somebody before a workbench that shows the paper's choice."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.grant_permissions(["clipboard-read", "clipboard-write"])
    return Reader(context.new_page(), lab, PATIENCE)
