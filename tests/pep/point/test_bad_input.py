"""Bad input through a guarded server: each request has one answer with its reason, one record, and no effect."""

import asyncio
import json
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Annotated, Any, Literal

import httpx2
import pytest
from capabilities.statements.registry import ToolEntry
from capabilities.values.scope import Grant, Limit, Stems, Tier
from mcp.server import MCPServer
from pep.base.clock import SystemClock
from pep.base.declaration import declared
from pep.mcp.mapping import to_request
from pep.point.guard_config import GuardConfig
from pep.point.tool_server import GuardedServer
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE, FakeIssuer, agent, full_scope, issuer_keys
from tests.pep.point.test_guarded_server import PASSPHRASE, written  # noqa: F401 - a fixture

from capabilities.keys import keys
from pep import Free, Length, Within, Word, operation, pins

pytestmark = pytest.mark.real_time
REQUESTS = 300
DONE = []


@operation("plant", base_tier=1)
def act(
    query: str,
    path: Annotated[str, Word("path", under=["/srv"])],
    page: Annotated[str, Word("url", under=["https://docs.example"])],
    filter: Annotated[Any, Free(9_000)],  # noqa: A002 - an author's word
    tags: Annotated[list[str], Length(0, 4)],
    percent: Annotated[float, Within(0, 1_000, "permille", scale=10)],
    valve: Annotated[int, Within(1, 12)],
    bar: Annotated[float, Within(0, 6_000, "x-bar", scale=1_000)],
    bleed: bool,
    color: Literal["red", "white"],
    top: Annotated[int, Within(1, 9)] = 3,
) -> str:
    """Act on the plant."""
    DONE.append(dict(locals()))
    return "done"


GOOD = {
    "query": "pump 7", "path": "/srv/a", "page": "https://docs.example/x", "filter": {"a": [1, None]}, "tags": ["a"],
    "percent": 45.0, "valve": 3, "bar": 0.5, "bleed": True, "color": "red",
}  # fmt: skip
ROW = declared(act)
SPELLING, TYPE, LIMIT = Reason.NOT_CANONICAL, Reason.PARAMETERS_WRONG, Reason.LIMIT_EXCEEDED_BY_REQUEST
NUMBER, GRID, RANGE, FINITE = Reason.NOT_A_NUMBER, Reason.NOT_ON_GRID, Reason.OUT_OF_RANGE, Reason.NOT_FINITE
BODY, LARGE = Reason.BODY_MALFORMED, Reason.BODY_TOO_LARGE

UNSEEN = (
    *range(0x00, 0x20, 3), 0x7F, 0x85, 0xAD, 0x34F, 0x61C, 0x115F, 0x1160, 0x17B4, 0x180B, 0x180E, *range(0x200B, 0x2010),
    *range(0x2028, 0x202F), *range(0x2060, 0x2065), *range(0x2066, 0x206A), 0x3164, 0xFE00, 0xFE0F, 0xFEFF, 0xFFA0,
    0xFFF9, 0xE000, 0x378, 0xFFFF, 0x1D173, 0xE0001, 0xE0041, 0xE007F, 0xE0100, 0xF0000, 0x10FFFF,
)  # fmt: skip
"""Characters that no reader sees."""
UNCOMPOSED = (
    "e\u0301",
    "u\u0308",
    "\u212b",
    "\u212a",
    "\u2126",
    "\u1100\u1161",
    "\u0958",
    "\uf900",
    "q\u0323\u0307"[::-1],
)
"""Texts of another normal form than C."""
ALIKE = (
    "\u0440ump 7", "pum\u0440 7", "\uff50ump 7", "\U0001d429ump 7", "p\u03c5mp 7", "\u1d18ump 7", "PUMP 7", " pump 7", "pum",
    "\u2c63ump", "", "7 pump",
)  # fmt: skip
"""Texts that look like the beginning which the token has."""
PATHS = (
    "", ".", "..", "srv", "srv/a", "//", "//srv", "/srv/", "/srv//a", "/srv/.", "/srv/./a", "/srv/..", "/srv/../etc",
    "/srv/a/../../etc", "/../srv", "/srv/%2e%2e/etc", "/srv/%2E%2e/etc", "/srv/%2e", "/srv/..%2fetc", "/srv%2Fetc", "/srv/%2F",
    "/srv/%5c..", "/srv%5Cetc", "/srv/%00", "/srv\\etc", "\\srv", "/srv/..\\etc", "C:\\srv", "file:///srv", "/srv/a\0",
    "/srv\0/etc", "/srv/a\n", "\t/srv", "/srv/\u200b", "/srv/\u202ecod", "/srv/e\u0301", "~/srv", "./srv", "/srv/a/.",
)  # fmt: skip
BESIDE = (
    "/",
    "/etc",
    "/etc/passwd",
    "/srvx",
    "/sr",
    "/SRV/a",
    "/Srv",
    "/\u0455rv/a",
    "/\uff53rv",
    "/ srv",
    "/srv ",
    "/etc/srv/a",
)
"""Paths that are not under the directory."""
URLS = (
    "", "docs.example", "//docs.example", "https:docs.example", "https://", "HTTPS://docs.example", "https://DOCS.example",
    "https://docs.Example/x", "https://docs.example/", "https://docs.example/x/", "https://docs.example:443",
    "https://docs.example:443/x", "https://docs.example:", "https://docs.example:0", "https://docs.example:65536",
    "https://docs.example:+8", "https://docs.example:08", "http://docs.example:80", "https://user@docs.example",
    "https://user:pw@docs.example", "https://@docs.example", "https://docs.example@evil.example", "https://docs.example.",
    "https://d\u00f6cs.example", "https://d\u043ecs.example", "https://docs\u3002example", "https://\uff44ocs.example",
    "https://docs.example/x?q", "https://docs.example/x#f", "https://docs.example?", "https://docs.example/../x",
    "https://docs.example/./x", "https://docs.example/x/..", "https://docs.example//x", "https://docs.example/%2e%2e/x",
    "https://docs.example/%2Fx", "https://docs.example/%2fx", "https://docs.example/%5Cx", "https://docs.example\\x",
    "https://docs.example/%00", "https://docs.example/%41", "https://docs.example/%c3%a9", "https://docs.example/%C3",
    "https://docs.example/%", "https://docs.example/\u00e9", "https://docs.example/a b", " https://docs.example",
    "https://docs.example\n", "https://docs.example/\0", "https://127.1", "https://0x7f.0.0.1", "https://2130706433",
    "https://0177.0.0.1", "https://[::0001]", "https://[::ffff:7f00:1]", "https://[::1%25eth0]", "https://-docs.example",
    "wss://docs.example:443", "ftp://docs.example:21", "javascript:alert(1)",
)  # fmt: skip
ELSEWHERE = (
    "http://docs.example/x", "https://docs.example:8443/x", "https://docs.example.evil", "https://evil.example/docs.example",
    "https://xdocs.example", "https://xn--dcs-fka.example", "https://docs.examples/x", "wss://docs.example", "https://127.0.0.1",
)  # fmt: skip
"""URLs of another origin."""

CHANGED: list[tuple[str, Any, Reason]] = [
    *(("query", f"pump{chr(each)}7", SPELLING) for each in UNSEEN),
    *(("query", f"pump {each}", SPELLING) for each in UNCOMPOSED),
    *(("query", each, LIMIT) for each in ALIKE),
    *(("query", each, TYPE) for each in (7, True, None, ["pump"], {"pump": 1})),
    *(("query", "pump" + each * size, SPELLING) for each, size in (("x", 1_021), ("\u00e9", 511))),
    *(("path", each, SPELLING) for each in PATHS),
    *(("path", each, LIMIT) for each in BESIDE),
    *(("path", each, TYPE) for each in (1, None, ["/srv"])),
    *(("page", each, SPELLING) for each in URLS),
    *(("page", each, LIMIT) for each in ELSEWHERE),
    *(("filter", each, TYPE) for each in ("[1]", "null", "{}", "abc", "")),
    ("filter", ["x" * 9_000], LIMIT),
    *(("tags", each, TYPE) for each in ("a", "[]", None, {"0": "a"}, 1)),
    ("tags", ["a"] * 5, LIMIT), ("tags", ["a"] * 257, RANGE), ("tags", ["a"] * 100_000, LARGE),
    *(("tags", ["a", each], TYPE) for each in (1, None, ["a"], {})),
    *(("tags", ["a", each], SPELLING) for each in ("b\u200b", "e\u0301", "\0")),
    *(("percent", each, NUMBER) for each in ("45", "", "0x10", True, None, [45], {})),
    *(("percent", each, LIMIT) for each in (100.1, -0.1, 1e6, -1)),
    ("percent", 1e300, RANGE),
    *(("valve", each, NUMBER) for each in ("3", True, None, [3])),
    *(("valve", each, GRID) for each in (2.5, 3.0000001)),
    *(("valve", each, LIMIT) for each in (0, 13, -3)),
    *(("bar", each, GRID) for each in (0.0005, 1e-9)),
    *(("bar", each, LIMIT) for each in (6.001, -1)),
    ("bar", "0.5", NUMBER),
    *(("bleed", each, TYPE) for each in (1, 0, "true", "", None, [])),
    *(("color", each, LIMIT) for each in ("Red", "red ", "r\u0435d", "")),
    *(("color", each, TYPE) for each in (1, None, ["red"])),
    *(("top", each, NUMBER) for each in (None, "3")),
    ("further", 1, TYPE), ("Query", "pump", TYPE), ("qu\u0435ry", "pump", TYPE),
]  # fmt: skip
"""Argument, its value, and the reason of the refusal."""


def call(arguments, **params):
    return {
        "jsonrpc": "2.0",
        "id": 1,
        "method": "tools/call",
        "params": {"name": "act", "arguments": arguments} | params,
    }


def spelled(**texts):
    """Body of a good call in which arguments are spelled so."""
    members = {name: json.dumps(value) for name, value in GOOD.items()} | texts
    inside = ",".join(f'"{name}":{text}' for name, text in members.items())
    return json.dumps(call("@")).replace('"@"', "{%s}" % inside).encode()


PLAIN = json.dumps(call(GOOD)).encode()
BODIES: list[tuple[bytes, str]] = [
    *((spelled(percent=each), FINITE) for each in ("NaN", "Infinity", "-Infinity", "1e400", "-1e999")),
    *((spelled(percent=each), RANGE) for each in ("9007199254740993", "1" + "0" * 400)),
    *((spelled(percent=each), BODY) for each in ("045", "+1", ".5", "1.", "0x10", "1_0", "\u0663")),
    *((spelled(filter=each), BODY) for each in ('{"a":1,"a":2}', '[{"b":[{"a":1,"a":1}]}]', '{"a":1,"\\u0061":2}')),
    *((spelled(filter="[" * depth + "]" * depth), BODY) for depth in (32, 1_000, 10_000)),
    *((spelled(filter=each), BODY) for each in ('"\\ud800"', '{"\\udc00":1}', "[1,]", "{a:1}", "'a'", "[1 /**/]")),
    *((spelled(filter=each), FINITE) for each in ("[NaN]", '{"a":1e999}')),
    (spelled(filter="9007199254740993"), RANGE),
    (spelled(filter='{"a":"%s"}' % ("x" * 2**20)), LARGE),
    (PLAIN.replace(b'"valve": 3', b'"valve": 3, "valve": 4'), BODY),
    (PLAIN.replace(b'"name": "act"', b'"name": "act", "name": "act"'), BODY),
    (PLAIN.replace(b'"id": 1', b'"id": 1, "id": 2'), BODY),
    (PLAIN.replace(b'"method"', b'"method": "ping", "method"'), BODY),
    (b"\xef\xbb\xbf" + PLAIN, BODY), (PLAIN.decode().encode("utf-16"), BODY), (PLAIN + b"x", BODY), (PLAIN * 2, BODY),
    (PLAIN.replace(b"pump", b"pu\xffmp"), BODY), (PLAIN.replace(b"pump", b"pu\xed\xa0\x80mp"), BODY), (PLAIN[:-1], BODY),
    (PLAIN.replace(b"pump", b"pu\x00mp"), BODY), (PLAIN.replace(b"pump", b"pu\nmp"), BODY), (b"[" + PLAIN + b"]", BODY),
    *((each, BODY) for each in (b"", b"null", b"1", b'"act"', b"[]", b"\x00")),
    *((json.dumps(call({k: v for k, v in GOOD.items() if k != gone})).encode(), TYPE) for gone in GOOD),
    (json.dumps(call({})).encode(), TYPE),
    *((json.dumps(call(GOOD, name=name)).encode(), Reason.TOOL_UNKNOWN) for name in ("Act", "act ", "\u0430ct", "", "a\u200bct")),
]  # fmt: skip
"""Whole bodies, and the reason of the refusal."""
FINE = [
    GOOD, GOOD | {"query": "pump \u00e9 \u6c34"}, GOOD | {"path": "/srv"}, GOOD | {"percent": 45.04}, GOOD | {"filter": 1.0},
    GOOD | {"filter": None}, GOOD | {"filter": [9.1e15, -1e20, 123456789012345680.0, 0.1, 5e-324]}, GOOD | {"filter": {"b": -0.0, "a": 1e21}}, GOOD | {"tags": []}, GOOD | {"top": 9, "bar": 6},
    GOOD | {"page": "https://docs.example"}, GOOD | {"query": "pump" + "x" * 1_020}, GOOD | {"filter": {"\u00e9": ""}},
]  # fmt: skip
"""Calls that are permitted: the table is not refused for another reason."""
CASES = [
    *((json.dumps(call(GOOD | {name: value})).encode(), reason) for name, value, reason in CHANGED),
    *BODIES,
]


@asynccontextmanager
async def served(app):
    """The app while it lives, as a server runs it."""
    begin, end, started = asyncio.Event(), asyncio.Event(), asyncio.get_running_loop().create_future()

    async def receive():
        if not begin.is_set():
            begin.set()
            return {"type": "lifespan.startup"}
        await end.wait()
        return {"type": "lifespan.shutdown"}

    async def send(message):
        if not started.done():
            started.set_result(message)

    running = asyncio.ensure_future(app({"type": "lifespan", "state": {}}, receive, send))
    assert (await started)["type"] == "lifespan.startup.complete"
    try:
        yield app
    finally:
        end.set()
        await running


class Answers:
    """Answers of a guard to bodies, with its records and the acts of its tool."""

    def __init__(self, path):
        server = MCPServer("plant", log_level="ERROR")
        server.tool()(act)
        config, (made, trust) = GuardConfig.read(path), issuer_keys()
        (path.parent / "trust.json").write_bytes(trust.to_json())
        entries = [ToolEntry(p.name, p.definition_digest, p.operation, p.base_tier) for p in pins(server)]
        pep_key = keys.from_pem(config.pep_key_file.read_bytes(), PASSPHRASE.encode())
        self.clock = SystemClock()
        self.issuer = FakeIssuer(made, self.clock, tools=entries, pep_key=keys.public_raw(pep_key))
        self.point = GuardedServer(server, config)
        for part in (self.point.follower, self.point.shipper, self.point._asking):
            part._http = self.issuer.client()
        held = {"query": Stems(frozenset({"pump"}), "")}
        limits = tuple(Limit(each.parameter, held.get(each.parameter.name, each.bound)) for each in ROW.limits)
        scope = replace(full_scope(self.clock.wall_s()), grants=(Grant("plant", "act", limits),), ceiling=Tier(1))
        self.holder = agent(made, self.clock.wall_s(), scope=scope)
        self.kept, self.ended = [], {}
        append = self.point.journal.append

        def keeping(kind, body):
            done = append(kind, body)
            if kind in {"decision", "refusal"}:
                self.kept.append((kind, json.loads(json.dumps(body))))
            return done

        self.point.journal.append = keeping

    async def ask(self, http, body):
        """Reason, and the records, of one body."""
        before = len(self.kept)
        headers = {
            "authorization": f"DPoP {self.holder.text}", "content-type": "application/json", "mcp-protocol-version": "2025-06-18",
            "dpop": self.holder.proof(body, at=self.clock.wall_s(), url=AUDIENCE), "accept": "application/json, text/event-stream",
        }  # fmt: skip
        answer = await http.post(AUDIENCE, content=body, headers=headers)
        text = next((line[6:] for line in answer.text.splitlines() if line.startswith("data: ")), answer.text)
        said = json.loads(text)
        told = said["result"]["_meta"]["dev.ztpm/decision"] if "result" in said else said
        return told["reason"], self.kept[before:]

    async def run(self, bodies):
        found = []
        async with served(self.point) as app:
            async with httpx2.AsyncClient(transport=httpx2.ASGITransport(app=app)) as http:
                for body in bodies:
                    before = len(DONE)
                    found.append((*await self.ask(http, body), DONE[before:]))
            bodies = (record["body"] for record in self.point.journal.records() if record["kind"] == "outcome")
            self.ended = {each["request_id"]: each["outcome"] for each in bodies}
        return found


def test_each_bad_request_has_one_answer_and_no_effect(written):  # noqa: F811
    assert len(CASES) >= REQUESTS
    assert len({body for body, _ in CASES}) == len(CASES)
    DONE.clear()
    answers = Answers(written())
    found = asyncio.run(answers.run([body for body, _ in CASES] + [json.dumps(call(fine)).encode() for fine in FINE]))

    for (body, reason), (said, records, done) in zip(CASES, found, strict=False):
        assert (said, done) == (str(reason), []), body[:400]
        ((kind, record),) = records
        recorded = record if kind == "refusal" else record["decision"]
        assert (recorded["effect"], recorded["reason"]) == ("DENY", str(reason)), body[:400]
    for fine, (said, records, done) in zip(FINE, found[len(CASES) :], strict=True):
        # A decision that was too old when its record was durable is made anew.
        *_, (_, decision) = records
        assert len({each["request"]["id"] for _, each in records}) == 1
        ended = answers.ended[decision["request"]["id"]]
        assert (said, decision["decision"]["effect"], ended) == ("PERMITTED", "PERMIT", "done"), fine
        (arguments,) = done
        again = to_request(ROW, arguments, request_id="", audience=AUDIENCE, at=0.0)
        assert again.digest == decision["request"]["digest"], "the tool got what was decided, and nothing else"
        assert {name: arguments[name] for name in fine if name != "percent"} == {
            k: v for k, v in fine.items() if k != "percent"
        }
    assert len(DONE) == len(FINE)
