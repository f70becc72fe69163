"""The capability behind an access token must be that very token's, and no more than a client may have."""

from __future__ import annotations

from dataclasses import replace

import pytest
from capabilities.values.chain import Attestation, Chain, EvidenceKind, Hop, Sponsor
from capabilities.values.errors import FaultCode
from capabilities.values.scope import Grant, Scope, Tier
from pep.base.access_token import Looked, disagreement, is_access_token

from capabilities.keys import keys

AT = 1_800_000_000
AUDIENCE = "http://127.0.0.1:8800/mcp"
KEY = keys.public_raw(keys.generate())
SCOPE = Scope((Grant("camera", "read"),), Tier(1), frozenset({AUDIENCE}), frozenset(), 0, AT - 5, AT + 600)


def hop(agent, hop_id, kind=EvidenceKind.CLIENT, scope=SCOPE):
    return Hop(0, hop_id, agent, KEY, "alice", "p", bytes(32), Attestation(kind, bytes(32), AT), scope)


def chain(*hops):
    return Chain("t" * 22, bytes(32), Sponsor("i", "alice", "operator-key", AT), 1, hops, 1, 0)


CLIENT = chain(hop("viewer", "a" * 32))
LOOKED = Looked("a" * 32, AUDIENCE, "alice", ("viewer",), AT + 600, None, "AAAA")
pytestmark = pytest.mark.clause("OAT-3", "OAT-4", "OAT-5")


def code(looked, found=CLIENT, audience=AUDIENCE):
    fault = disagreement(looked, found, audience=audience)
    return None if fault is None else fault.code


def test_a_capability_of_another_token_is_refused():
    assert code(LOOKED) is None
    assert code(replace(LOOKED, jkt="j" * 43)) is None
    for changes in ({"jti": "b" * 32}, {"sponsor": "bob"}, {"actors": ("other",)}, {"actors": ("viewer", "alice")}):
        assert code(replace(LOOKED, **changes)) is FaultCode.WRONG_PROFILE, changes
    assert code(replace(LOOKED, audience="http://127.0.0.1:9/mcp")) is FaultCode.WRONG_PROFILE
    assert code(LOOKED, audience="http://127.0.0.1:9/mcp") is FaultCode.WRONG_PROFILE


def test_nothing_above_tier_1_stands_behind_an_access_token():
    above = chain(hop("viewer", "a" * 32, scope=replace(SCOPE, ceiling=Tier(2))))
    assert code(LOOKED, above) is FaultCode.WRONG_PROFILE


def test_an_agents_hop_is_bound_to_its_own_key():
    agents = chain(hop("planner", "c" * 32, EvidenceKind.KEY), hop("viewer", "a" * 32, EvidenceKind.KEY))
    looked = replace(LOOKED, actors=("viewer", "planner"))
    assert code(looked, agents) is FaultCode.PROOF_MISSING
    assert code(replace(looked, jkt="j" * 43), agents) is FaultCode.PROOF_WRONG_KEY
    assert code(replace(looked, jkt=keys.thumbprint(KEY)), agents) is None


ANSWER = {"jti": "a", "aud": AUDIENCE, "sub": "alice", "exp": AT, "act": {"sub": "viewer"}, "ztpm_capability": "AAAA"}


def test_an_answer_of_another_form_is_none():
    assert Looked.read(ANSWER).actors == ("viewer",)
    assert Looked.read(ANSWER | {"cnf": {"jkt": "j"}}).jkt == "j"
    for changes in (
        *({name: None} for name in ANSWER),
        {"exp": True},
        {"exp": "soon"},
        {"aud": [AUDIENCE]},
        {"act": {}},
        {"act": {"sub": "a", "act": {"sub": 7}}},
        {"cnf": {}},
        {"cnf": None},
        {"cnf": {"jkt": 7}},
    ):
        assert Looked.read(ANSWER | changes) is None, changes


@pytest.mark.clause("OAT-1")
def test_only_a_text_with_two_dots_is_an_access_token():
    assert [is_access_token(text) for text in ("a.b.c", "a.b", "abc", "a.b.c.d", "")] == [
        True,
        False,
        False,
        False,
        False,
    ]
