"""`conformance authorization` of the MCP suite against a provider of its own; the figure is the last line.

    python -m tests.ztpm_idp.oauth.conformance

npm installs the suite, and Node comes from a wheel; without npm it ends with status 2.
"""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import pytest
import uvicorn
from tests.node_packages import installed, node
from tests.progress import telling
from tests.ztpm_idp import world as home
from tests.ztpm_idp.login import browser as browsing
from tests.ztpm_idp.oauth import speaking
from tests.ztpm_idp.test_process import free_port

SUITE = Path(__file__).parent / "mcp_suite"
LIMIT_S = 120


def main() -> int:
    with telling(lambda: "the suite is installed and asks"), tempfile.TemporaryDirectory() as folder:
        try:
            command = suite_command()
        except pytest.skip.Exception as absent:
            print(absent)
            return 2
        return judged(Path(folder), command)


def suite_command() -> list[str]:
    """The command of the suite, which is installed where it is not."""
    return [
        node(),
        str(installed(SUITE) / "node_modules" / "@modelcontextprotocol" / "conformance" / "dist" / "index.js"),
    ]


def judged(place: Path, command: list[str]) -> int:
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
            return suite(world, command, callback)
        finally:
            served.should_exit = True
            serving.result(10)


def suite(world, command: list[str], callback: int) -> int:
    asked = ["authorization", "--url", home.ISSUER, "--client-id", "suite", "--resource", home.AUDIENCE]
    run = subprocess.Popen(
        [*command, *asked, "--port", str(callback)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
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
