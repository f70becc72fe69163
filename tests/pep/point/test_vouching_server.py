"""A guarded server that vouches: a receipt for each answer, and taint of a context that reaches its holder's calls."""

import asyncio

import pytest
from pep.context.flow import Flow
from pep.context.json_value import plain
from pep.mcp.guard import DECISION_META
from pep.mcp.provenance import RECEIPT, RESPONSE, Vouching
from pep.point.guard_config import GuardConfig
from pep.point.tool_server import GuardedServer
from tests.pep.kit import AUDIENCE, issuer_keys
from tests.pep.point.alive import CALLED, living, open_valve, sdk, valve_scope
from tests.pep.point.test_guarded_server import PASSPHRASE, written  # noqa: F401 - a fixture

from capabilities.keys import keys
from capabilities.statements.context import response
from capabilities.values.caps import DEFAULT as CAPS
from pep import pins
from policies.words.labels import Integrity, Label, Source

pytestmark = pytest.mark.real_time


def answer(path, *, vouches, tainted=False):
    """Answer to one call that asks for a receipt, at a server that vouches or does not."""
    flows = []

    def vouching(point):
        config, flow = GuardConfig.read(path), Flow(point.clock)
        flows.append(flow)
        key = keys.from_pem(config.pep_key_file.read_bytes(), PASSPHRASE.encode())
        own = {AUDIENCE: keys.public_raw(key)}
        return Vouching(key=key, audience=AUDIENCE, admitters=own.copy, flow=flow, caps=CAPS)

    made, trust = issuer_keys()
    (path.parent / "trust.json").write_bytes(trust.to_json())
    server = sdk()
    guarded = GuardedServer(server, GuardConfig.read(path), vouching=vouching if vouches else None)
    CALLED.clear()

    async def go():
        scope = valve_scope(open_valve)
        async with living(path, server, pins_of, scope, (made, trust), guarded) as client:
            if tainted:
                read = Label(frozenset({Source.TEXT}), frozenset(), Integrity.NONE, 0, tainted=True)
                leaf = guarded.authority.verify(client.holder.token, lease_ms=30_000).leaf
                assert flows[0].enter(flows[0].context(leaf), read) is None
            return await client.call_tool("open_valve", {"percent": 45}, meta={RECEIPT: True})

    pins_of = pins(server)
    return asyncio.run(go())


def test_an_answer_comes_with_a_receipt_where_the_server_vouches(written):  # noqa: F811
    assert {RECEIPT, RESPONSE} <= answer(written(), vouches=True).meta.keys()


def test_it_comes_with_the_signed_response_alone_where_nobody_follows_contexts(written):  # noqa: F811
    path = written()
    found = answer(path, vouches=False)
    key = keys.from_pem(GuardConfig.read(path).pep_key_file.read_bytes(), PASSPHRASE.encode())
    said = response.open(found.meta[RESPONSE], frozenset({keys.public_raw(key)}), CAPS)
    told = found.meta[DECISION_META]
    assert RECEIPT not in found.meta
    assert (said.request, said.definition, said.tool) == (told["request_digest"], told["tool_digest"], "open_valve")
    assert (said.result, said.tainted) == (plain(found.structured_content).digest, True)
    assert said.result != plain({**found.structured_content, "more": 1}).digest


def test_a_holder_whose_context_is_tainted_makes_tainted_arguments(written):  # noqa: F811
    told = answer(written(), vouches=True, tainted=True).meta[DECISION_META]
    assert (told["decision"], told["primitive"]) == ("DENY", "CII-5")
    assert CALLED == []
