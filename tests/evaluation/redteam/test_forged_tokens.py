"""Forged tokens: each is refused for the one thing in which it is wrong."""

import secrets
import time

import pytest
from evaluation.redteam.acts import forged_tokens
from tests.pep.kit import issuer_keys

from capabilities.keys import keys
from capabilities.statements.revocation import RevocationView
from capabilities.token.delegate import delegate
from capabilities.token.mint import mint
from capabilities.token.token_text import token_from_text, token_to_text
from capabilities.token.verify import verify
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, Chain, EvidenceKind, HopGrant, Sponsor
from capabilities.values.errors import FaultCode
from capabilities.values.scope import Grant, Restriction, Scope, Tier
from ztpm.stage.stage import StageError

AUDIENCE = "http://127.0.0.1:8800/mcp"
NOW = int(time.time())
MADE, TRUST = issuer_keys()
ROOT, ATTESTER = MADE["root"], MADE["attester"]
SCOPE = Scope(
    (Grant("files", "read_file"), Grant("web", "fetch")), Tier.REVERSIBLE, frozenset({AUDIENCE}),
    frozenset({"worker"}), 2, NOW - 5, NOW + 3_000,
)  # fmt: skip
LESS = Restriction(grants=(Grant("files", "read_file"),), delegates=frozenset())


class Holder:
    """An agent as a forger knows it."""

    def __init__(self, id_):
        self.id, self.key, self.measurement = id_, keys.generate(), bytes(32)


def hop(agent, key, delegator, purpose):
    attested = Attestation(EvidenceKind.KEY, bytes(32), NOW)
    return HopGrant(secrets.token_hex(16), agent, keys.public_raw(key), delegator, purpose, bytes(32), attested)


def opened(text):
    view = RevocationView(epoch=0, age_ms=0, revoked=frozenset())
    token = token_from_text(text, DEFAULT)
    return verify(token, at=int(time.time()), audience=AUDIENCE, view=view, lease_ms=1_000, trust=TRUST, caps=DEFAULT)


@pytest.fixture(scope="module")
def lent():
    """Tokens of a planner and of its worker."""
    first = mint(
        root=ROOT, root_key_id=1, token_id=secrets.token_urlsafe(16), sponsor=Sponsor("http://idp", "alice", "key", NOW),
        hop=hop("planner", keys.generate(), "alice", "plan the work"), scope=SCOPE, caps=DEFAULT,
    )  # fmt: skip
    chain = opened(token_to_text(first))
    assert isinstance(chain, Chain), chain
    second = delegate(
        first, chain=chain, attester=ATTESTER, trust=TRUST, hop=hop("worker", keys.generate(), "planner", "read"),
        restriction=LESS, caps=DEFAULT,
    )  # fmt: skip
    assert isinstance(opened(token_to_text(second)), Chain)
    return token_to_text(first), token_to_text(second)


@pytest.mark.parametrize("part", ["signature", "next key", "attester", "secret"])
def test_one_bit_is_enough(lent, part) -> None:
    assert opened(forged_tokens.flipped(lent[1], part)).code is FaultCode.SIGNATURE_INVALID


@pytest.mark.parametrize("how", ["last hop", "first block", "truncated", "doubled"])
def test_blocks_do_not_go_together_in_another_way(lent, how) -> None:
    worker = lent[1]
    other = forged_tokens.minted(Holder("planner"), SCOPE, sponsor="alice", issuer="http://idp", root_key_id=1)
    source = worker if how == "last hop" else other
    assert opened(forged_tokens.spliced(worker, source, how)).code in {
        FaultCode.SIGNATURE_INVALID, FaultCode.TOKEN_MALFORMED,
    }  # fmt: skip


def test_text_of_a_token_is_what_was_signed(lent) -> None:
    assert opened(forged_tokens.altered(lent[0], "plan the work", "plan the rest")).code is FaultCode.SIGNATURE_INVALID
    for before, after in (("plan the work", "shorter"), ("not in it at all", "nor is this one")):
        with pytest.raises(StageError):
            forged_tokens.altered(lent[0], before, after)


@pytest.mark.parametrize("restriction", [LESS, Restriction(), Restriction(grants=(Grant("files", "delete_file"),))])
def test_a_hop_of_a_key_that_attests_nothing_is_refused_for_that(lent, restriction) -> None:
    forged = forged_tokens.grafted(
        lent[0], Holder("worker"), restriction, audience=AUDIENCE, trust=TRUST, attester=keys.generate()
    )
    assert opened(forged).code is FaultCode.HOP_NOT_ATTESTED


def test_a_graft_that_the_provider_attests_is_a_hop(lent) -> None:
    honest = forged_tokens.grafted(lent[0], Holder("worker"), LESS, audience=AUDIENCE, trust=TRUST, attester=ATTESTER)
    assert isinstance(opened(honest), Chain)


def test_a_token_of_another_root_is_none() -> None:
    forged = forged_tokens.minted(Holder("planner"), SCOPE, sponsor="alice", issuer="http://idp", root_key_id=1)
    assert opened(forged).code is FaultCode.SIGNATURE_INVALID
