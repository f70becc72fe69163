"""The provider, a gateway, and servers behind it with everything that the suite asks for, over HTTP and over stdio."""

from __future__ import annotations

import json
import subprocess
import sys

from tests.e2e.conformance.everything import SCHEMAS
from tests.e2e.test_any_tool import TOP
from tests.e2e.test_tool_gateway import Front
from tests.ztpm_idp.test_process import free_port

from pep import grant

DESK_TOOLS = ("test_sampling", "test_touch_resource", "test_trigger_tool_change")
"""Tools that the server over stdio is mapped with."""
KINDS = {"string": '"text"', "integer": '{ low = 0, high = 1000000, unit = "count", integer = true }'}
FREE = '{ kind = "free", most_bytes = 1024 }'


def declared(server, name):
    """Declaration of a tool in TOML."""
    arguments = "".join(
        f"{argument} = {KINDS.get(each.get('type'), FREE)}\n" for argument, each in SCHEMAS[name]["properties"].items()
    )
    table = f"upstream.{server}.tool.{name}"
    return f'[{table}]\nobject = "all"\nbase_tier = 0\n[{table}.arguments]\n{arguments}'


class Everything(Front):
    """All of it, each a process of its own."""

    def __init__(self, folder):
        super().__init__(folder)
        self.port = free_port()
        self.bare = f"http://127.0.0.1:{self.port}/mcp"

    def serve(self):
        command = [sys.executable, "-m", "tests.e2e.conformance.everything", str(self.port)]
        self.slow = subprocess.Popen(command, cwd=TOP, env=self.environment)
        assert self.answers(self.bare, self.slow) in {400, 405, 406}

    def write(self):
        self.configure(f"""
            [upstream.all]
            url = "{self.bare}"
            resources = true
            prompts = true
            [upstream.desk]
            command = [{json.dumps(sys.executable)}, "-m", "tests.e2e.conformance.everything"]
            folder = {json.dumps(str(TOP))}
            prefix = "desk_"
            sessions = 1
            resources = true
            {"".join(declared("all", name) for name in SCHEMAS)}
            {"".join(declared("desk", name) for name in DESK_TOOLS)}
        """)

    def holder(self, name):
        """An agent, and a token of its own for every tool."""
        agent = self.agent(name)
        return agent, self.lend(agent, *(grant(row) for row in self.rows.values()))
