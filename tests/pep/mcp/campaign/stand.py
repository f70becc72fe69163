"""The processes of the campaign: a provider, `ztpm mcp gateway`, and behind it two servers that write their own JSON."""

from __future__ import annotations

import json
import secrets
import sys
import time

import httpx2
from capabilities.values.scope import Tier
from tests.e2e.test_any_tool import DEADLINE_S, TOP
from tests.e2e.test_tool_gateway import Front
from tests.pep.mcp.campaign.evidence_changes import ENVELOPE, told_in
from tests.pep.mcp.campaign.raw_upstream import CALLS, SAYS

from capabilities.proof.proof import prove
from pep import grant

MAPPING = """
[tool.act]
object = "plant"
base_tier = 1
[tool.act.arguments]
title = "text"
stars = { low = -1000000, high = 1000000, unit = "count", integer = true, above = { 900000 = 3 } }
ratio = { low = -1000, high = 1000, unit = "permille", scale = 10 }
on = "flag"
body = { kind = "free", most_bytes = 4000 }
"""
ACT = {
    "name": "act",
    "title": "Act",
    "description": "Act on the plant \u2b50 of caf\u00e9 \U0001f31f.",
    "inputSchema": {
        "$defs": {"star": {"type": "integer", "minimum": -1_000_000, "maximum": 1_000_000}},
        "type": "object",
        "properties": {
            "title": {"type": "string", "description": "Of the act.", "maxLength": 400},
            "stars": {"type": "integer", "minimum": 0, "maximum": 1_000_000, "examples": [1, 2]},
            "ratio": {"type": "number", "minimum": -100, "exclusiveMaximum": 100.5},
            "on": {"type": "boolean", "description": "Whether it is on."},
            "body": {"description": "Anything.", "anyOf": [{"type": "object"}, {"type": "array"}, {"type": "null"}]},
        },
        "required": ["title", "stars", "ratio", "on", "body"],
        "additionalProperties": False,
    },
    "outputSchema": {
        "type": "object",
        "properties": {"done": {"type": "string", "enum": ["yes", "no"]}},
        "required": ["done"],
    },
    "annotations": {"title": "Act", "readOnlyHint": False, "destructiveHint": True, "idempotentHint": False},
    "icons": [{"src": "https://plant.example/act.png", "mimeType": "image/png", "sizes": ["48x48"]}],
    "_meta": {"ui": {"resourceUri": "ui://plant/act.html", "visibility": ["model"]}},
}
OTHERS = (
    {"name": "wipe", "description": "Delete all.", "inputSchema": {"type": "object", "properties": {}}},
    {"name": "read", "description": "Read it.", "inputSchema": {"type": "object", "properties": {}}},
)
PROMPT = {"name": "greet", "description": "Greet."}
TEMPLATE = {"name": "note", "uriTemplate": "note://{id}", "description": "A note."}
GOOD = {"title": "a", "stars": 3, "ratio": 1.5, "on": True, "body": {"b": [1, None]}}
DONE = {"content": [{"type": "text", "text": "done"}], "structuredContent": {"done": "yes"}}
BUSY = {"VERDICT_EXPIRED", "REVOCATION_VIEW_STALE", "BEHAVIOUR_OLD"}
"""Reasons that a busy machine has."""
MODERN = {
    "content-type": "application/json", "accept": "application/json, text/event-stream",
    "mcp-protocol-version": "2026-07-28",
}  # fmt: skip


def begun(name):
    """Text of the answer to `initialize`."""
    able = {"tools": {}, "prompts": {}, "resources": {}}
    who = {"name": name, "version": "1"}
    return json.dumps(
        {"protocolVersion": "2025-11-25", "capabilities": able, "serverInfo": who, "instructions": "Mind."}
    )


class Stand(Front):
    """The processes, and a holder."""

    def __init__(self, folder):
        super().__init__(folder)
        self.raw, self.twin = folder / "raw", folder / "twin"
        for each in (self.raw, self.twin):
            each.mkdir()

    @property
    def environment(self):
        return super().environment | {"UPSTREAM_SECRET": "the gateway's own"}

    def begin(self):
        """Everything is begun, and the tools are registered as they are."""
        self.says()
        self.says(folder=self.twin)
        self.write()
        self.pinned()
        self.start()
        self.holder = self.agent("keeper")
        self.token = self.lend(self.holder, grant(self.rows["act"]), ceiling=Tier.HIGH_CONSEQUENCE)
        return self

    def write(self):
        (self.folder / "act.toml").write_text(MAPPING)
        command = [sys.executable, "-m", "tests.pep.mcp.campaign.raw_upstream"]
        self.configure(f"""
            [upstream.raw]
            command = {json.dumps([*command, str(self.raw)])}
            folder = {json.dumps(str(TOP))}
            mapping = "act.toml"
            timeout_s = 5
            prompts = true
            resources = true
            [upstream.twin]
            command = {json.dumps([*command, str(self.twin)])}
            folder = {json.dumps(str(TOP))}
            mapping = "act.toml"
            prefix = "twin_"
            timeout_s = 5
        """)

    def says(self, listed=None, *, folder=None, done=None, **more):
        """The server behind says this from now on.

        Args:
            listed: text of its list of tools, or texts of its pages.
            folder: of the server; None: the first one's.
            done: text of its answers to calls.
            more: texts of its answers to other methods, `/` written as `_`.
        """
        folder = folder or self.raw
        told = {
            "initialize": begun(folder.name),
            "tools/list": listed or json.dumps({"tools": [ACT, *OTHERS]}),
            "tools/call": done or json.dumps(DONE),
            "prompts/list": json.dumps({"prompts": [PROMPT]}),
            "prompts/get": json.dumps({"messages": [{"role": "user", "content": {"type": "text", "text": "hello"}}]}),
            "resources/list": json.dumps({"resources": []}),
            "resources/templates/list": json.dumps({"resourceTemplates": [TEMPLATE]}),
            **{name.replace("_", "/"): text for name, text in more.items()},
        }
        beside = folder / "next.json"
        beside.write_text(json.dumps(told))
        beside.replace(folder / SAYS)

    def called(self, folder=None):
        """Lines of the calls that a server got, byte for byte."""
        path = (folder or self.raw) / CALLS
        return path.read_bytes().splitlines() if path.exists() else []

    def settled(self):
        """Notes that the calls so far were right."""
        self.right = len(self.called()) + len(self.called(self.twin))

    def unsettled(self):
        """Number of calls that the servers got since then."""
        return len(self.called()) + len(self.called(self.twin)) - self.right

    # ---- requests, byte for byte

    def body(self, arguments, *, tool="act", id_=1, meta=None):
        """Body of a call; its arguments as a text stand in it as they are."""
        text = arguments if isinstance(arguments, str) else json.dumps(arguments)
        meta = json.dumps({**ENVELOPE, **(meta or {})})
        params = f'{{"name":{json.dumps(tool)},"arguments":{text},"_meta":{meta}}}'
        return f'{{"jsonrpc":"2.0","id":{id_},"method":"tools/call","params":{params}}}'.encode(
            "utf-8", "surrogatepass"
        )

    def signed(self, content, **spoil):
        """Headers with token and a new proof over exactly this body; any part may be another one."""
        token = spoil.pop("token", self.token)
        proof = prove(
            spoil.pop("key", self.holder.key),
            **{"method": "POST", "url": self.audience, "body": content, "token": token, "at": int(time.time()),
               "jti": secrets.token_urlsafe(16), **spoil},
        )  # fmt: skip
        return {"authorization": f"DPoP {token}", "dpop": proof}

    def headers(self, content, tool="act", **spoil):
        """All headers of a call."""
        return {**MODERN, "mcp-method": "tools/call", "mcp-name": tool, **self.signed(content, **spoil)}

    def post(self, content, *, headers=None, method="POST", path="", url=None, **more):
        """The response to a request; by default to a signed call."""
        headers = self.headers(content) if headers is None else headers
        with httpx2.Client(timeout=30) as http:
            return http.request(method, url or self.audience + path, content=content, headers=headers, **more)

    def call(self, arguments=None, *, tool="act", **options):
        """The decision on a call; asked again where a busy machine was too slow."""
        until = time.monotonic() + DEADLINE_S
        while True:
            content = self.body(GOOD if arguments is None else arguments, tool=tool)
            told = told_in(self.post(content, headers=self.headers(content, tool), **options))
            if told.get("reason") not in BUSY or time.monotonic() > until:
                return told

    def ask(self, method, params=None, **spoil):
        """The message that answers a signed request of any method."""
        params = json.dumps({**(params or {}), "_meta": ENVELOPE})
        content = f'{{"jsonrpc":"2.0","id":1,"method":"{method}","params":{params}}}'.encode()
        named = {"mcp-name": json.loads(params)["name"]} if "name" in json.loads(params) else {}
        headers = {**MODERN, "mcp-method": method, **named, **self.signed(content, **spoil)}
        text = self.post(content, headers=headers).text
        if not text.startswith("{"):
            text = next(line.removeprefix("data:") for line in text.splitlines() if line.startswith("data:"))
        return json.loads(text)

    def shown(self):
        """Definitions of tools that the holder is shown."""
        return self.ask("tools/list")["result"]["tools"]
