"""A provider alone, by the commands of docs/provider.md as they stand there: real processes, no Python of the reader."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from ztpm.base.loopback import free_host

pytestmark = pytest.mark.e2e

PAGE = (Path(__file__).parents[2] / "docs/provider.md").read_text("utf-8")
MOST = 12
"""Commands that the page may take for all of it."""
WAIT_S = 60
COPIED = """
import json, os, sys
import mcp_types, capabilities.token.verify, capabilities.values.scope_json, ztpm_idp.client
from ztpm.cli import main
for line in sys.stdin:
    pid = os.fork()
    if not pid:
        sys.argv = ["ztpm", *json.loads(line)]
        os.dup2(2, 1)
        main()
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""
"""Process that is copied for each command, so that a dozen of them cost one import; two start from nothing."""


def block(mark):
    (found,) = re.findall(rf"<!-- {re.escape(mark)} -->\n```\w+\n(.*?)```", PAGE, re.DOTALL)
    return found


def test_a_provider_alone_is_run_by_the_pages_commands(tmp_path):
    host = free_host(os.urandom(16), lambda _: True)
    commands = [shlex.split(line.replace("127.0.0.1", host)) for line in block("commands: first hour").splitlines()]
    assert len(commands) <= MOST
    assert {words[0] for words in commands} == {"ztpm"}
    (tmp_path / "scope.json").write_text(block("file: scope.json").replace("127.0.0.1", host))
    definition = block("file: open_valve.json")
    for tool in ("open_valve", "read_gauge", "stop_plant"):
        (tmp_path / f"{tool}.json").write_text(definition.replace("open_valve", tool))
    (tmp_path / "mover.py").write_text("print('at work')\n")
    own = {"ZTPM_DATA": "provider", "ZTPM_AS": "alice", "ZTPM_PASSPHRASE": "a passphrase for tests"}
    from_nothing = {"cwd": tmp_path, "env": os.environ | own, "stdout": subprocess.PIPE, "text": True}
    first, second, *others = commands
    made = subprocess.run([sys.executable, "-m", *first, "--json"], timeout=WAIT_S, check=True, **from_nothing)
    assert sorted(json.loads(made.stdout)["keys"]) == ["alice", "bob"]
    assert second[-1] == "&"
    with (
        (tmp_path / "said").open("w+") as said,
        subprocess.Popen([sys.executable, "-m", *second[:-1]], **from_nothing) as server,
        subprocess.Popen([sys.executable, "-c", COPIED], stdin=subprocess.PIPE, stderr=said, **from_nothing) as copied,
    ):
        try:
            assert json.loads(server.stdout.readline())["ready"] is True
            for words in others:
                copied.stdin.write(json.dumps([*words[1:], "--json"]) + "\n")
                copied.stdin.flush()
                assert copied.stdout.readline() == "0\n", (words, (tmp_path / "said").read_text())
        finally:
            copied.stdin.close()
            server.terminate()
        assert server.wait(WAIT_S) == 0
    held = json.loads((tmp_path / "said").read_text().splitlines()[-1])
    assert (held["holder"], held["sponsor"], held["ceiling"], held["revocations"]) == ("mover", "alice", 2, 0)
