"""Blocks signed through the port: the very bytes of the library."""

from __future__ import annotations

import pytest
from capabilities.keys.keys import Algorithm
from capabilities.keys.signing_key import SigningKey
from capabilities.token import block_signatures
from capabilities.token.wire import MESSAGES
from capabilities.values.errors import BadKeyError, FaultCode, TokenError
from tests.capabilities.world import (
    LAST,
    SLOWER,
    add_hop,
    chain_of,
    check,
    key_of,
    mint_root,
)

from capabilities.keys import jws, keys, signatures
from capabilities.statements import statement_form


pytestmark = pytest.mark.clause("TOK-3", "TOK-4")


class Elsewhere(SigningKey):
    """A key behind the port; counts what it signs, and may sign with another secret than its own."""

    def __init__(self, key, *, secretly=None, high_s=False):
        super().__init__(keys.public_raw(key))
        self.key, self.high_s, self.signed = secretly or key, high_s, []

    def sign(self, message):
        self.signed.append(message)
        made = signatures.sign(self.key, message)
        if not self.high_s:
            return made
        return made[:32] + (signatures.P256_N - int.from_bytes(made[32:], "big")).to_bytes(32, "big")


def test_a_chain_by_keys_elsewhere_verifies_as_any_other():
    root, attester = Elsewhere(key_of("root")), Elsewhere(key_of("attester"))
    token = mint_root(root=root)
    assert chain_of(token).leaf.agent == "orchestrator"
    token = add_hop(token, "robotic", SLOWER, attester=attester)
    token = add_hop(token, "gripper", LAST, attester=key_of("attester-2"))
    assert [hop.agent for hop in chain_of(token).hops] == ["orchestrator", "robotic", "gripper"]
    assert (len(root.signed), len(attester.signed)) == (1, 1)


def test_the_bytes_are_those_of_the_library():
    """Ed25519 is deterministic: what the library made with the same keys is what is put in its place."""
    whole = mint_root()
    assert block_signatures.by_root(whole, Elsewhere(key_of("root"))) == whole
    assert block_signatures.by_root(mint_root(root=key_of("eve")), key_of("root")) != whole  # another next key
    for agent, restriction in (("robotic", SLOWER), ("gripper", LAST)):
        longer = add_hop(whole, agent, restriction)
        again = block_signatures.by_attester(whole, longer, Elsewhere(key_of("attester")))
        assert again == longer
        whole = longer


def test_a_block_of_another_signer_is_none_until_it_is_signed():
    foreign = mint_root(root=key_of("eve"))
    assert check(foreign).code is FaultCode.SIGNATURE_INVALID
    assert check(block_signatures.by_root(foreign, Elsewhere(key_of("root")))).leaf.agent == "orchestrator"
    longer = add_hop(mint_root(), "robotic", SLOWER)
    message = MESSAGES["Biscuit"].FromString(longer)
    message.blocks[0].externalSignature.signature = bytes(64)
    assert check(message.SerializeToString()).code is FaultCode.SIGNATURE_INVALID


@pytest.mark.parametrize("wrong", ["another secret", "a P-256 key"])
def test_a_holder_that_signs_wrongly_makes_no_token(wrong):
    root = Elsewhere(key_of("root"), secretly=key_of("eve"))
    attester = Elsewhere(key_of("attester"), secretly=key_of("eve"))
    if wrong == "a P-256 key":
        root = Elsewhere(keys.generate(Algorithm.P256))
        attester = Elsewhere(keys.generate(Algorithm.P256))
    with pytest.raises(BadKeyError) as caught:
        mint_root(root=root)
    assert caught.value.code is FaultCode.KEY_MALFORMED
    before = mint_root()
    with pytest.raises(BadKeyError) as caught:
        block_signatures.by_attester(before, add_hop(before, "robotic", SLOWER), attester)
    assert caught.value.code is FaultCode.KEY_MALFORMED


@pytest.mark.parametrize("algorithm", list(Algorithm))
def test_a_statement_by_a_key_elsewhere_is_the_same_text(algorithm):
    here = keys.generate(algorithm)
    for high_s in {False, algorithm is Algorithm.P256}:
        text = statement_form.sign("thing", {"a": 1}, Elsewhere(here, high_s=high_s))
        assert text == statement_form.sign("thing", {"a": 1}, here)
    assert jws.sign({}, b"x", Elsewhere(here)) == jws.sign({}, b"x", here)
    with pytest.raises(BadKeyError):
        jws.sign({}, b"x", Elsewhere(here, secretly=keys.generate(algorithm)))


def test_an_attester_elsewhere_is_one_of_the_bundles():
    with pytest.raises(TokenError) as caught:
        add_hop(mint_root(), "robotic", SLOWER, attester=Elsewhere(key_of("eve")))
    assert caught.value.code is FaultCode.KEY_WRONG_ROLE
