"""Runs one process of a cell with one defence taken out: `python -m tests.e2e.sabotage DEFECT MODULE ARGUMENTS...`.

Each defect is a few lines that undo one check from outside; the product has no switch for it. The step of the story that rests on the
check must then fail to be as told (tests/e2e/test_defences.py). One defect undoes nothing, it breaks a part that others must do without.
"""

import importlib
import os
import sys
from pathlib import Path

TOP = Path(__file__).parents[2]
DEFECTS = {}


def begin(by, defect, child, module, *arguments, environment):
    """A child of a cell with that defect, as `by` begins one without: `Child.begin` or `evaluation.harness.copies.begin`."""
    path = os.pathsep.join([str(TOP), os.environ.get("PYTHONPATH", "")])
    return by(child, "tests.e2e.sabotage", defect, module, *arguments, environment={**environment, "PYTHONPATH": path})


def defect(function):
    DEFECTS[function.__name__] = function
    return function


@defect
def idp_lends_more():
    """The identity provider no longer asks whether a child is narrower."""
    from capabilities.token import hop_rules
    from capabilities.values import algebra

    hop_rules._narrower = lambda parent, block: algebra.stated(parent, block.restriction)


@defect
def idp_takes_any_evidence():
    """The identity provider takes evidence that was made for another request."""
    from capabilities.statements import attestation as statement
    from capabilities.values.chain import EvidenceKind
    from ztpm_idp.domain.lending import attestation, issuance
    from ztpm_idp.domain.events import NonceConsumed

    def judge(rules, state, agent, evidence, *, delegator, request_digest, purpose, at_ms):
        spent = NonceConsumed(statement.open(evidence, {agent.key}, rules.caps).nonce, purpose)
        return attestation.AcceptedEvidence(spent, EvidenceKind.JWT)

    attestation.judge = issuance.judge = judge


@defect
def pep_takes_unattested_blocks():
    """Step 4 is gone, and so is asking for each key again: a block needs no attester."""
    from capabilities.token import static_verification as reading
    from capabilities.token.verify import Verifier

    reading._check_attested = lambda shape, signers, trust: None
    Verifier._check_signers = lambda self, read, at: None


@defect
def pep_grants_everything():
    """Steps 11 and 12 are gone: neither the compiled scope nor Biscuit's authorizer is asked."""
    from capabilities.token.verify import Verifier

    Verifier.check_request = lambda self, chain, **k: None


@defect
def pep_forgets_proofs():
    from pep.journal.replay_cache import ReplayCache

    ReplayCache.first_use = lambda self, jti, *, key, expires_ms: True


@defect
def pep_takes_any_key():
    """Step 10 does not ask whose key signed the proof."""
    from pep.request import authority

    check = authority.check_proof
    authority.check_proof = lambda proof, **k: check(proof, **{**k, "key": None})


@defect
def pep_trusts_a_token_it_knows():
    """Step 3 is answered from the last opened token, for any bytes, and step 5 does not compare."""
    from capabilities.token import biscuit
    from capabilities.token import static_verification as reading

    reading._check_canonical = lambda opened, token: None

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
    """CATP-3 holds for any score."""
    from policies.primitives.base import Holds
    from policies.primitives.propagation import DynamicTrust

    DynamicTrust.judge = lambda self, case: Holds()


@defect
def idp_charges_nobody():
    """An agent keeps the trust of a stranger after any attempt."""
    from policies.conduct import trust

    trust.observe = lambda state, report, parameters, *, now: state


@defect
def pep_is_blind_to_people():
    import dataclasses

    from pep.world import world

    def blind(honest):
        def look(robot, scene, *rest, **named):
            return honest(robot, scene and dataclasses.replace(scene, people=()), *rest, **named)

        return look

    world.assess, world.remaining = blind(world.assess), blind(world.remaining)


@defect
def pep_never_ends_an_ask():
    from pep.people.asks import Asks

    Asks.expire = lambda self: ()


@defect
def pep_ignores_the_ceiling():
    """TEA-4 sees every chain with the highest ceiling."""
    import dataclasses

    from capabilities.values.chain import Chain
    from capabilities.values.scope import Tier
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
    from capabilities.values import strict_json

    strict_json._constant = strict_json._finite = float


@defect
def pep_ignores_revocations():
    from capabilities.statements.revocation import RevocationView

    RevocationView.spares = lambda self, names, *, audience: True


@defect
def pep_ignores_sponsors():
    """Revocation of a person is not looked at."""
    from capabilities.statements.revocation import RevocationView

    honest = RevocationView.spares

    def spares(self, names, *, audience):
        # With the person its agents are revoked too: who does not look at people does not look at these either.
        person = any(kind == "sponsor" and (kind, name) in self.revoked for kind, name in names)
        return person or honest(self, names, audience=audience)

    RevocationView.spares = spares


@defect
def pep_ignores_the_age_of_its_view():
    import dataclasses

    from pep.provider.feed import ProviderFollower

    honest = ProviderFollower.view
    ProviderFollower.view = lambda self: dataclasses.replace(honest(self), age_ms=0)


@defect
def pep_moves_without_asking():
    """The decision is always PERMIT."""
    import dataclasses

    from pep.gate import gate
    from policies.evidence.model import Effect
    from policies.words.reason_table import Reason

    honest = gate.decide

    def decide(*a, **k):
        return dataclasses.replace(honest(*a, **k), effect=Effect.PERMIT, reason=Reason.PERMITTED, lifetime_ms=5_000)

    gate.decide = decide


@defect
def pep_never_uses_an_approval_up():
    """A use that was consumed is there again."""
    from pep.people.deferral import Deferral

    honest = Deferral.consume

    def consume(self, request_id, use, now_ms):
        consumed = honest(self, request_id, use, now_ms)
        self.used.clear()
        return consumed

    Deferral.consume = consume


@defect
def pep_ignores_what_was_shown():
    """An approval counts in any world."""
    from policies.decision import approval

    approval._differences = lambda case, reading, reasons, policies: iter(())


@defect
def idp_lets_anybody_vote():
    """Any registered party may vote; the PEP still counts registered approvers only."""
    from ztpm_idp.domain.asking import approvals

    approvals.active_person = lambda state, id_, role: state.parties.get(id_)


@defect
def pep_sees_no_zones():
    import dataclasses

    from pep.world import world

    def zoneless(honest):
        def look(robot, scene, *rest, **named):
            return honest(robot, scene and dataclasses.replace(scene, zones=()), *rest, **named)

        return look

    world.assess, world.remaining = zoneless(world.assess), zoneless(world.remaining)


@defect
def pep_takes_one_for_two():
    """Tier 4 is content with one person, who may be the sponsor."""
    from msgspec import structs
    from pep.people import deferral
    from policies.decision import approval

    honest = deferral.tally
    approval.APPROVERS_OF_TIER = {}

    def tally(ballots, asked, registered):
        return honest(ballots, structs.replace(asked, approvers=1), registered)

    deferral.tally = tally


@defect
def pep_sees_no_age():
    """Every frame is new."""
    from pep.perception.sensor_frames import SensorFrame

    SensorFrame.age_ms = lambda self, now_ms: 0


@defect
def pep_believes_any_frame():
    """Any key may sign a frame in a sensor's name."""
    from capabilities.statements import observation
    from evaluation.redteam.taken_out.world import UNSEALED

    observation.statement_form = UNSEALED


@defect
def pep_touches_anything():
    """The grant of a touch is not asked for."""
    from pep.gate import gate

    gate.touchable = lambda chain: frozenset({"table"})


@defect
def pep_does_not_watch_the_world():
    from pep.watch.watch import Watch

    Watch._world = lambda self, now, q_rad: None


@defect
def pep_does_not_watch_authority():
    from pep.watch.watch import Watch

    Watch._authority = lambda self, now: None


@defect
def gateway_is_open():
    """A client without a lease is served as the controller itself would serve it."""
    from pep.rtde.line.gateway import StatePorts
    from pep.rtde.robot.connections import Upstream

    class Raw:
        def __init__(self, back):
            self.robot = Upstream(back.send, back.close)
            self.received, self.left = self.robot.send, self.robot.close

    async def opened(self, lease, port, back):
        line = Raw(back)
        return await line.robot.reach(self._robot, port) or line

    StatePorts.open = opened


@defect
def gateway_lends_twice():
    """A lease that is open keeps nobody from opening another."""
    from pep.rtde.lease.lease_endpoint import LeaseEndpoint

    honest = LeaseEndpoint._opened

    def opened(self, *arguments):
        self.leases._held = None
        return honest(self, *arguments)

    LeaseEndpoint._opened = opened


@defect
def gateway_look_breaks():
    """Every other look at the leases ends in an error."""
    from itertools import cycle

    from pep.rtde.lease.lease_port import LeasePort

    honest, breaks = LeasePort.look, cycle((True, False))

    def look(self):
        if next(breaks):
            raise RuntimeError("a look that broke")
        honest(self)

    LeasePort.look = look


def main() -> None:
    name, module, *arguments = sys.argv[1:]
    DEFECTS[name]()
    sys.argv = [module, *arguments]
    sys.exit(importlib.import_module(module).main())


if __name__ == "__main__":
    main()
