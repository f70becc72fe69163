"""The MCP conformance suite of one version against a server at a URL."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path

from tests.ztpm_idp.oauth.conformance import suite_command

LIMIT_S = 120


def checked(url, requirements):
    """Statuses and errors of each check at a server, by scenario, id and name of the check.

    Args:
        url: of the server.
        requirements: revision of the protocol, whose frozen set is run.
    """
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [*suite_command(), "server", "--url", url, "--output-dir", folder, "--requirements", requirements],
            capture_output=True, timeout=LIMIT_S, check=False,
        )  # fmt: skip
        for file in sorted(Path(folder).glob("server-*/checks.json")):
            scenario = file.parent.name.removeprefix("server-").rsplit("-", 6)[0]
            for each in json.loads(file.read_text("utf-8")):
                told = each["status"], each.get("errorMessage") or ""
                found.setdefault((scenario, each["id"], each["name"]), []).append(told)
    return found


def passed(checks):
    """Those that succeeded, each time."""
    return {key for key, told in checks.items() if all(status == "SUCCESS" for status, _ in told)}


def failed(checks):
    """Scenarios of which one check failed."""
    return {key[0] for key, told in checks.items() if any(status == "FAILURE" for status, _ in told)}
