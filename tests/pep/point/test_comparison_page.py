"""The page that compares four ways to guard six tools: each is run over MCP and counted."""

import asyncio
import json
import re
import secrets
import time
from contextlib import asynccontextmanager
from difflib import ndiff
from pathlib import Path
from types import SimpleNamespace

import biscuit_auth
import httpx2
import jwt
import pytest
from capabilities.token.delegate import delegate
from capabilities.token.verify import Verifier
from capabilities.statements.revocation import RevocationView
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.chain import Attestation, EvidenceKind, HopGrant
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from mcp import Client
from mcp.client.streamable_http import streamable_http_client
from pep.base.clock import SystemClock
from tests.house.pages import rows
from tests.pep import kit
from tests.pep.mcp.test_mcp import Signed
from tests.pep.point.alive import lifespan, living
from tests.pep.point.test_guarded_server import written  # noqa: F401 - a fixture

import capabilities
from capabilities.keys import keys
from pep import grant, pins
from ztpm_idp.client import Operator

pytestmark = [pytest.mark.real_time, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
TOP = Path(__file__).parents[3]
PAGE = (TOP / "docs" / "comparison.md").read_text("utf-8")
CODE = {
    (way, part): text
    for way, part, text in re.findall(r"<!-- code: (\w+) (\w+) -->\n```\w+\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
}
COLUMNS = ("OAuth scope", "Biscuit by hand", "Tenuo", "ztpm")
HOST = "http://127.0.0.1:8900"
CALLS = (
    ("planner", "open_valve", {"valve": 3, "percent": 60.5}),
    ("planner", "open_valve", {"valve": 3, "percent": -5.0}),
    ("worker", "open_valve", {"valve": 3, "percent": 40.5}),
    ("worker", "open_valve", {"valve": 3, "percent": 60.5}),
    ("worker", "delete_record", {"id": 1}),
    ("planner", "open_valve", {"valve": 3, "percent": 60.0}),
)


def ran(part, names):
    exec(compile(CODE[part], f"docs/comparison.md: {part}", "exec"), names)  # noqa: S102 - the page itself
    return names


@asynccontextmanager
async def connected(app, url, **options):
    http = httpx2.AsyncClient(transport=httpx2.ASGITransport(app=app), **options)
    async with http, Client(streamable_http_client(url, http_client=http)) as client:
        yield client


def bearer(way, names, *secret_names):
    """The way's answers, where a token is a bearer's."""
    names |= {"AUDIENCE": f"{HOST}/mcp", "ISSUER": "https://idp.example", "time": time.time}
    ran((way, "server"), names)
    ran((way, "lend"), names)

    async def go():
        found = []
        async with lifespan(names["app"]):
            for who, tool, arguments in CALLS:
                headers = {"Authorization": f"Bearer {names[who]}"}
                async with connected(names["app"], f"{HOST}/mcp", headers=headers) as client:
                    found.append(not (await client.call_tool(tool, arguments)).is_error)
        return found

    return asyncio.run(go())


def oauth(_):
    key = Ed25519PrivateKey.generate()
    return bearer("oauth", {"jwt": jwt, "ISSUER_KEY": key, "KEY": key.public_key()})


def biscuit(_):
    key = biscuit_auth.KeyPair()
    return bearer("biscuit", {**vars(biscuit_auth), "ROOT_KEY": key.private_key, "ROOT": key.public_key})


def tenuo(_):
    package = pytest.importorskip("tenuo", reason="the extra `bench` is not installed")
    core = pytest.importorskip("tenuo_core")
    root, planner, worker = (package.SigningKey.generate() for _ in range(3))
    names = ran(("tenuo", "server"), {"ROOT": root.public_key})
    lent = ran(("tenuo", "lend"), vars(package) | {"ROOT_KEY": root, "PLANNER": planner, "WORKER": worker})
    chains = {"planner": ([lent["planner"]], planner), "worker": ([lent["planner"], lent["worker"]], worker)}

    async def go():
        found = []
        async with lifespan(names["app"]), connected(names["app"], f"{HOST}/mcp") as client:
            for who, tool, arguments in CALLS:
                chain, key = chains[who]
                signed = core.sign_meta(chain, key, tool, json.dumps(arguments), int(time.time()), None)
                answer = await client.call_tool(tool, arguments, meta={"tenuo": signed})
                found.append(not answer.is_error)
                if found[-1]:
                    again = await client.call_tool(tool, arguments, meta={"tenuo": signed})
                    assert not again.is_error, "the same call sent again works"
        return found

    return asyncio.run(go())


class Lending:
    """The provider's part in the page's lending: keys, and hops signed with them."""

    def __init__(self, made, trust):
        self.made, self.trust = made, trust
        self.held = {}
        self._now = time.time

    lend = Operator.lend

    def issue(self, who, scope, *, purpose):
        assert purpose
        self.held[who.id] = kit.agent(self.made, time.time(), name=who.id, scope=scope)
        return SimpleNamespace(token=self.held[who.id].text)

    def delegating(self, who):
        def go(token, other, restriction, *, purpose):
            holder, key, at = self.held[who], keys.generate(), time.time()
            assert token == holder.text
            chain = Verifier(self.trust, CAPS).verify(
                holder.token, at=at, audience=kit.AUDIENCE, view=RevocationView(0, 0, frozenset()), lease_ms=1_000
            )
            hop = HopGrant(
                secrets.token_hex(16), other.id, keys.public_raw(key), who, purpose, b"\1" * 32,
                Attestation(EvidenceKind.KEY, b"\2" * 32, int(at) - 1),
            )  # fmt: skip
            token = delegate(
                holder.token, chain=chain, hop=hop, restriction=restriction, attester=self.made["attester"],
                trust=self.trust, caps=CAPS,
            )  # fmt: skip
            self.held[other.id] = kit.Agent(other.id, key, token, hop.hop_id)

        return go


def ztpm(written):  # noqa: F811
    path = written()
    made, trust = kit.issuer_keys()
    (path.parent / "trust.json").write_bytes(trust.to_json())
    server = ran(("ztpm", "server"), {"__name__": "page"})
    approved = pins(server["server"])
    lending = Lending(made, trust)
    planner = SimpleNamespace(id="planner", delegate=lending.delegating("planner"))
    names = server | {
        **{name: getattr(capabilities, name) for name in capabilities.__all__}, "grant": grant,
        "AUDIENCE": kit.AUDIENCE, "alice": lending, "planner": planner, "worker": SimpleNamespace(id="worker"),
    }  # fmt: skip
    ran(("ztpm", "lend"), names)

    async def go():
        found = []
        async with living(path, None, approved, kit.full_scope, (made, trust), server["app"]):
            for who, tool, arguments in CALLS:
                auth = Signed(lending.held[who], SystemClock())
                async with connected(server["app"], kit.AUDIENCE, auth=auth) as client:
                    found.append(not (await client.call_tool(tool, arguments)).is_error)
        return found

    return asyncio.run(go())


WAYS = {"oauth": oauth, "biscuit": biscuit, "tenuo": tenuo, "ztpm": ztpm}


@pytest.mark.parametrize("way", [pytest.param("tenuo", marks=pytest.mark.version), "oauth", "biscuit", "ztpm"])
def test_each_way_answers_as_its_column_says(way, written, monkeypatch):  # noqa: F811
    monkeypatch.chdir(written().parent)
    column = 1 + list(WAYS).index(way)
    told = [row[column] == "permitted" for row in rows(PAGE, "call", *COLUMNS)]
    assert WAYS[way](written) == told


def lines(text):
    return [line for line in text.splitlines() if line.strip()]


def test_the_lines_of_each_way_are_counted():
    plain = lines(CODE["plain", "server"])
    counted = {
        way: [
            sum(line.startswith("+ ") for line in ndiff(plain, lines(CODE[way, "server"]))),
            len(lines(CODE[way, "lend"])),
        ]
        for way in WAYS
    }
    configured = len(lines(CODE["ztpm", "configuration"]))
    added, configuration, lent, _ = (row[1:] for row in rows(PAGE, "lines", *COLUMNS))
    assert [[int(each) for each in pair] for pair in zip(added, lent, strict=True)] == list(counted.values())
    assert configuration == ["0", "0", "0", str(configured)]
    assert counted["ztpm"][0] + configured <= 30, "what an author adds to guard six tools"
    for page in (TOP / "README.md", TOP / "docs" / "guard.md"):
        words = " ".join(page.read_text("utf-8").replace("[", "").split())
        assert f"{counted['ztpm'][0] + configured} lines" in words, page.name
