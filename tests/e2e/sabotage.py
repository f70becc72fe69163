"""Runs one process of a cell with one defence taken out: `python -m tests.e2e.sabotage DEFECT MODULE ARGUMENTS...`.

Each defect is a few lines that undo one check from outside; the product has no switch for it. The step of the story that rests on the
check must then fail to be as told (tests/e2e/test_defences.py).
"""

import runpy
import sys

DEFECTS = {}


def defect(function):
    DEFECTS[function.__name__] = function
    return function


@defect
def idp_lends_more():
    """The identity provider no longer asks whether a child is narrower."""
    from capabilities import algebra, links

    links._narrower = lambda parent, block: algebra.stated(parent, block.restriction)


@defect
def idp_takes_any_evidence():
    """The identity provider takes evidence that was made for another request."""
    from ztpm_idp.domain import attestation, issuing
    from ztpm_idp.domain.events import NonceConsumed

    from capabilities.statements import attestation as statement

    def judge(rules, state, agent, evidence, *, delegator, request_digest, purpose, at_ms):
        return NonceConsumed(statement.open(evidence, {agent.key}, rules.caps).nonce, purpose)

    attestation.judge = issuing.judge = judge


@defect
def pep_takes_unattested_blocks():
    """Step 4 is gone: a block needs no attester."""
    import importlib

    # The package exports a function of the module's name.
    verify = importlib.import_module("capabilities.verify")
    verify._check_attested = lambda shape, signers, trust: None


@defect
def pep_grants_everything():
    """Steps 11 and 12 are gone: neither the compiled scope nor Biscuit's authorizer is asked."""
    from capabilities.verify import Verifier

    Verifier.check_request = lambda self, chain, **k: None


@defect
def pep_forgets_proofs():
    from pep.replay import ReplayCache

    ReplayCache.first_use = lambda self, jti, *, key, expires_ms: True


@defect
def pep_takes_any_key():
    """Step 10 does not ask whose key signed the proof."""
    from pep import authority

    check = authority.check_proof
    authority.check_proof = lambda proof, **k: check(proof, **{**k, "key": None})


@defect
def pep_trusts_a_token_it_knows():
    """Step 3 is answered from the last token that was opened, whatever the bytes are now, and step 5 does not compare."""
    import importlib

    from capabilities import biscuit

    importlib.import_module("capabilities.verify")._check_canonical = lambda opened, token: None

    honest, last = biscuit.open_token, []

    def open_token(token, root):
        try:
            last[:] = [honest(token, root)]
        except Exception:
            if not last:
                raise
        return last[0]

    biscuit.open_token = open_token


@defect
def pep_ignores_trust():
    """CATP-3 holds whatever the score is."""
    from policies.primitives.base import Holds
    from policies.primitives.propagation import DynamicTrust

    DynamicTrust.judge = lambda self, case: Holds()


@defect
def pep_is_blind_to_people():
    import dataclasses

    from pep import world

    def blind(honest):
        def look(robot, scene, *rest, **named):
            return honest(robot, scene and dataclasses.replace(scene, people=()), *rest, **named)

        return look

    world.assess, world.remaining = blind(world.assess), blind(world.remaining)


@defect
def pep_never_ends_an_ask():
    from pep.approvals import Asks

    Asks.expire = lambda self: ()


@defect
def pep_ignores_the_ceiling():
    """TEA-4 sees every chain with the highest ceiling."""
    import dataclasses

    from capabilities.chain import Chain
    from capabilities.scope import Tier
    from policies.primitives import tools

    honest = tools.verified_chain

    def verified_chain(primitive, case):
        chain = honest(primitive, case)
        if not isinstance(chain, Chain):
            return chain
        scope = dataclasses.replace(chain.leaf.scope, ceiling=Tier.SAFETY_CRITICAL)
        return dataclasses.replace(chain, hops=(*chain.hops[:-1], dataclasses.replace(chain.leaf, scope=scope)))

    tools.verified_chain = verified_chain


@defect
def pep_reads_nan():
    from capabilities import strict_json

    strict_json._constant = strict_json._finite = float


@defect
def pep_ignores_revocations():
    from capabilities.statements.revocation import RevocationView

    RevocationView.why = lambda self, chain, *, audience=None: None


@defect
def pep_ignores_sponsors():
    """Revocation of a person is not looked at."""
    from capabilities.statements.revocation import RevocationView

    honest = RevocationView.why

    def why(self, chain, *, audience=None):
        found = honest(self, chain, audience=audience)
        return None if found and found[0] == "sponsor" else found

    RevocationView.why = why


@defect
def pep_ignores_the_age_of_its_view():
    import dataclasses

    from pep.feed import Follower

    honest = Follower.view
    Follower.view = lambda self: dataclasses.replace(honest(self), age_ms=0)


@defect
def pep_moves_without_asking():
    """The decision is always PERMIT."""
    import dataclasses

    from pep import gate
    from policies.model import Effect
    from policies.reasons import Reason

    honest = gate.decide

    def decide(*a, **k):
        return dataclasses.replace(honest(*a, **k), effect=Effect.PERMIT, reason=Reason.PERMITTED, lifetime_ms=5_000)

    gate.decide = decide


def main() -> None:
    name, module, *arguments = sys.argv[1:]
    DEFECTS[name]()
    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
