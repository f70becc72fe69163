"""A verifier under a newer bundle: chains go on where their keys are trusted still, and end elsewhere."""

from __future__ import annotations

from dataclasses import replace

import pytest
from capabilities.token.verify import FORMER
from capabilities.values.chain import Chain
from capabilities.values.errors import FaultCode
from capabilities.values.scope import Tier
from tests.capabilities.world import CELL, LEASE_MS, NOW, ROOT_ID, TRUST, VIEW, chain_of_four, raw_of, verifier

pytestmark = pytest.mark.clause("TRB-2", "TRB-5")
ASK = {"at": NOW, "audience": CELL, "view": VIEW, "lease_ms": LEASE_MS}


def test_a_chain_goes_on_under_a_newer_bundle():
    checker = verifier()
    chain = checker.verify(chain_of_four(), **ASK)
    for version in range(2, 2 + FORMER):
        checker.renew(replace(TRUST, version=version, roots={**TRUST.roots, 100 + version: raw_of(f"root-{version}")}))
        chain = checker.still(chain, **ASK)
        assert isinstance(chain, Chain)
    assert checker.check_request(
        chain, object="ur3e", operation="read_state", values=(), base_tier=Tier.NO_EFFECT, at=NOW
    ) is None  # fmt: skip


@pytest.mark.parametrize(
    ("newer", "code"),
    [
        ({"roots": {8: raw_of("root-2")}}, FaultCode.UNKNOWN_ROOT_KEY),
        ({"attesters": frozenset({raw_of("attester")})}, FaultCode.HOP_NOT_ATTESTED),
    ],
)
def test_a_chain_ends_with_a_key_under_it(newer, code):
    checker = verifier()
    token = chain_of_four()
    chain = checker.verify(token, **ASK)
    checker.renew(replace(TRUST, version=2, **newer))
    assert checker.still(chain, **ASK).code is code
    assert checker.verify(token, **ASK).code is code
    found = checker.check_request(
        chain, object="ur3e", operation="read_state", values=(), base_tier=Tier.NO_EFFECT, at=NOW
    )  # fmt: skip
    assert found.code is code
    checker.renew(replace(TRUST, version=3))
    assert isinstance(checker.verify(token, **ASK), Chain)
    assert TRUST.roots[ROOT_ID] == raw_of("root")
