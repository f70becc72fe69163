"""Text never becomes Datalog: hostile strings in every text field are refused, or come back as the very same text."""

from __future__ import annotations

from dataclasses import replace

import pytest
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.errors import CapabilityError, FaultCode
from capabilities.values.scope import Grant, Limit, Range, Restriction
from capabilities.values.units import Parameter, Unit
from tests.capabilities.world import (
    SCOPE,
    SLOWER,
    SPONSOR,
    Forge,
    add_hop,
    chain_of,
    check,
    grant_to,
    mint_root,
    saying,
)

from capabilities.token import block

pytestmark = pytest.mark.clause("BLK-10")

HOSTILE = [
    '"',
    '\\"',
    '"); req("ur3e", "fly"); x("',
    '"), true; allow if true; //',
    "'; drop table hops; --",
    "{p0}",
    "{p1}{p2}",
    "$v0",
    "$time",
    "}{",
    "{{}}",
    "{",
    "}",
    ";",
    "check if true",
    " or true",
    "a, b",
    "trusting authority",
    "hex:00",
    "ed25519/00",
    "//",
    "/* x */",
    "\n",
    "a\nb",
    "\r\n",
    "\t",
    "\0",
    "a\0b",
    "\x7f",
    "\x1b[2J",
    "\u200b",
    "a\u200db",
    "\u202e",
    "\u2066x\u2069",
    "\ufeff",
    "\u2028",
    "\u2029",
    "\ue000",
    "\U000e0041",
    "e\u0301",
    "ﬁ",
    "Å",
    "аdmin",
    "ａ",
    "İ",
    "ß",
    "﷽",
    "🤖",
    "👩‍🚀",
    "\ud800",
    "<script>alert(1)</script>",
    "${jndi:ldap://x}",
    "%s%n",
    "../../etc/passwd",
    "file:///etc/passwd",
    "role:",
    "role:planner",
    "http://a.example/x\nSet-Cookie: y",
    "",
    " ",
    "  x",
    "x ",
    "x" * 257,
    "x" * 10_000,
    "null",
    "true",
    "0",
    "-1",
    "NaN",
    "__proto__",
    "*",
    "ur3e\u0000",
]


def limit(name: str) -> Grant:
    return Grant("ur3e", "op", (Limit(Parameter(name, Unit.COUNT), Range(0, 1)),))


FIELDS = {
    "purpose": lambda text: mint_root(hop=grant_to("orchestrator", "alice", purpose=text)),
    "agent": lambda text: mint_root(hop=grant_to(text, "alice")),
    "role": lambda text: mint_root(hop=grant_to("orchestrator", "alice", role=text)),
    "sponsor subject": lambda text: mint_root(
        sponsor=replace(SPONSOR, subject=text), hop=grant_to("orchestrator", text)
    ),
    "sponsor method": lambda text: mint_root(sponsor=replace(SPONSOR, method=text)),
    "sponsor issuer": lambda text: mint_root(sponsor=replace(SPONSOR, issuer=text)),
    "token id": lambda text: mint_root(token_id=text),
    "hop id": lambda text: mint_root(hop=grant_to("orchestrator", "alice", hop_id=text)),
    "object": lambda text: mint_root(replace(SCOPE, grants=(Grant(text, "op"),))),
    "operation": lambda text: mint_root(replace(SCOPE, grants=(Grant("ur3e", text),))),
    "parameter": lambda text: mint_root(replace(SCOPE, grants=(limit(text),))),
    "audience": lambda text: mint_root(replace(SCOPE, audiences=SCOPE.audiences | {text})),
    "delegate": lambda text: mint_root(replace(SCOPE, delegates=frozenset({text}))),
    "delegated purpose": lambda text: add_hop(mint_root(), "robotic", SLOWER, purpose=text),
    "delegated agent": lambda text: add_hop(
        mint_root(replace(SCOPE, delegates=frozenset({"robotic", "role:planner"}))),
        text,
        Restriction(delegates=frozenset()),
    ),
    "delegated names": lambda text: add_hop(mint_root(), "robotic", replace(SLOWER, delegates=frozenset({text}))),
}


@pytest.mark.parametrize("field", FIELDS)
def test_text_stays_text(field):
    clean = chain_of(mint_root())
    carried = 0
    for text in HOSTILE:
        try:
            token = FIELDS[field](text)
        except CapabilityError:
            continue
        chain = check(token)
        assert isinstance(chain, Chain), (field, text, chain)
        told = (
            chain.token_id,
            chain.sponsor,
            *((hop.agent, hop.role, hop.purpose, hop.hop_id, hop.scope) for hop in chain.hops),
        )
        assert repr(text) in repr(told), (field, text)
        assert len(chain.hops) <= 2
        assert {grant.operation for grant in chain.scope.grants} <= {
            grant.operation for grant in clean.scope.grants
        } | {"op", text}
        carried += 1
    if "purpose" in field:
        assert carried > 20  # sentences may hold quotes, braces and semicolons: they are bound


@pytest.mark.parametrize("text", HOSTILE)
def test_an_issuer_that_binds_hostile_text_gains_nothing(text):
    """A hostile name under the real root key, without our checks, is refused on reading or harmless text."""

    try:
        token = Forge.authority(fact=saying(lambda members: members.update(agent=text)))
    except (CapabilityError, UnicodeEncodeError):
        return  # the library itself binds no lone surrogate
    chain = check(token)
    if isinstance(chain, Chain):
        assert chain.leaf.agent == text
        block.well_formed(
            block.AuthorityBlock(chain.token_id, chain.sponsor, 0, grant_to(text, "alice"), chain.scope),
            DEFAULT,
        )


@pytest.mark.clause("VAL-4")
@pytest.mark.parametrize(
    "text",
    [
        "\n",
        "\t",
        "a\0b",
        "\x7f",
        "\x1b[2J",
        "\u200b",
        "\u202e",
        "\u2066x",
        "\ufeff",
        "\u2028",
        "\u2029",
        "\ue000",
        "\U000e0041",
        "\ud800",
    ]
    + ["e\u0301", "\u212b", "ä" * 257, "x" * 513],
)
def test_a_purpose_that_people_read_differently_than_machines_is_refused(text):
    with pytest.raises(CapabilityError) as caught:
        mint_root(hop=grant_to("orchestrator", "alice", purpose=text))
    assert caught.value.code is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("VAL-2")
@pytest.mark.parametrize("text", ["role:", "role:planner", "role:x"])
def test_no_agent_is_called_like_a_role(text):
    with pytest.raises(CapabilityError) as caught:
        mint_root(hop=grant_to(text, "alice"))
    assert caught.value.code is FaultCode.STATEMENT_MALFORMED
