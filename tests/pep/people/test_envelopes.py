"""Envelopes at the gate: inside each bound an act is permitted and counted; outside of any one people are asked."""

from __future__ import annotations

import secrets
from dataclasses import replace

import pytest
from capabilities.statements.people import envelope as envelopes
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.scope import Tier
from msgspec import structs
from pep.base.errors import ActuationRefusedError
from policies.evidence.evidence import Contribution
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE
from tests.pep.people.test_approvals import BOX, NEAR, PERSON, People, closing
from tests.unread import unread

from capabilities.keys import keys
from capabilities.statements.people import ask as ask_statement

SLOW = replace(NEAR, tcp_speed_um_s=200_000)


@pytest.fixture
def rig(tmp_path):
    """A rig whose agent has asked, and nobody has answered: what is inside an envelope is permitted all the same."""
    rig = People(tmp_path)
    rig.physics.answer = SLOW
    rig.ask()
    rig.asked = ask_statement.open(rig.text, [keys.public_raw(rig.pep_key)], DEFAULT)
    yield rig
    closing(rig)


def sides(names, values, room=1_000):
    return tuple(envelopes.Side(name, value - room, value + room) for name, value in zip(names, values, strict=True))


def around(rig, asked, **changes):
    at = int(rig.clock.wall_s())
    stated = dict(
        envelope_id=secrets.token_hex(16),
        approver="bob",
        audience=AUDIENCE,
        sponsor=asked.sponsor,
        agent=asked.agent,
        agent_key=asked.agent_key,
        object=asked.object,
        operation=asked.operation,
        model_digest=asked.model_digest,
        policy_digest=asked.policy_digest,
        reasons=asked.reasons,
        tier=asked.tier,
        index_milli=2_600,
        speed_um_s=250_000,
        box=sides([v.name for v in asked.values], [v.value for v in asked.values]),
        start_urad=sides([f"joint{n}" for n in range(6)], asked.start_urad),
        seen=tuple(envelopes.Seen(c.kind, c.object) for c in asked.contributors),
        uses=3,
        not_before=at,
        not_after=at + 600,
    )
    return envelopes.Envelope(**(stated | changes))


def signed(rig, *, signer="bob", key=None, **changes):
    """The envelope, told by the provider."""
    made = around(rig, rig.asked, **changes)
    rig.issuer.envelopes = [unread(envelopes, made, key or rig.people[signer].key)]
    rig.pull()
    return made


def permitted(rig):
    return rig.go().decision


@pytest.mark.clause("ENV-2")
def test_inside_an_act_is_permitted_as_often_as_was_said_and_then_asked(rig):
    made = signed(rig, uses=3)
    for use in (1, 2, 3):
        decision = permitted(rig)
        assert (decision.effect, decision.approval.ask_id, decision.approval.use) == (
            Effect.PERMIT, made.envelope_id, use,
        )  # fmt: skip
        assert rig.decisions()[-1]["approval"] == {"ask_id": made.envelope_id, "use": use}
    answer = rig.go()
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DEFER, Reason.TIER_NEEDS_APPROVAL)
    assert (answer.ask.ask_id, len(rig.sent)) == (rig.ask_id, 3)


def world(**changes):
    return lambda rig: setattr(rig.physics, "answer", replace(SLOW, **changes))


def told(**changes):
    return lambda rig: signed(rig, **changes)


def box(name, *, low=0, high=0):
    def narrowed(rig):
        sides_ = [
            structs.replace(side, low=side.low + low, high=side.high + high) if side.name == name else side
            for side in around(rig, rig.asked).box
        ]
        signed(rig, box=tuple(sides_))

    return narrowed


def start(joint, low):
    def moved(rig):
        found = list(around(rig, rig.asked).start_urad)
        found[joint] = structs.replace(found[joint], low=found[joint].low + low, high=found[joint].high + low)
        signed(rig, start_urad=tuple(found))

    return moved


def less(rig):
    signed(rig, box=around(rig, rig.asked).box[:-1])


def more(rig):
    signed(rig, box=(*around(rig, rig.asked).box, envelopes.Side("force", 0, 1)))


def late(rig):
    signed(rig, not_after=int(rig.clock.wall_s()) + 1)
    rig.clock.advance(2_001)
    rig.pull()


def revoked(rig):
    signed(rig)
    rig.issuer.envelopes = []
    rig.pull()


def unheard(rig):
    """The provider's last word is older than the lease of motion."""
    signed(rig)
    rig.clock.advance(2_500)


def disabled(rig):
    signed(rig)
    rig.registry.people = {key: who for key, who in rig.registry.people.items() if who != "bob"}


def leaf(rig):
    """The agent's own key, registered as bob's by a provider gone wrong."""
    rig.registry.people = {**rig.registry.people, keys.public_raw(rig.holder.key): "bob"}
    signed(rig, key=rig.holder.key)


NEW = Contribution("person", 100, "wrist_3", "erin", 100, 900_000, 0, "camera-1")
GLASS = Contribution("fragile", 100, "gripper", "glass", 100, 900_000, 0)
BOUNDS = {
    "index": world(index_milli=2_601),
    "speed": world(tcp_speed_um_s=250_001),
    "a new person": world(contributions=(PERSON, BOX, NEW)),
    "a new object": world(contributions=(PERSON, BOX, GLASS)),
    "another kind of one that was named": world(contributions=(PERSON, replace(BOX, kind="fragile"))),
    "another robot model": world(model_digest="9" * 64),
    "stale perception": world(perception="stale"),
    "no perception": world(perception="missing"),
    "a violation": world(violations=("zone",)),
    "tier 2 where tier 3 was said": told(tier=Tier(2), index_milli=2_000),
    "a parameter below": box("q0", low=1_500, high=1_500),
    "a parameter above": box("speed", low=-5_000, high=-1_500),
    "a parameter that nobody bounded": less,
    "a bound of no parameter": more,
    "the start": start(3, 1_500),
    "another agent": told(agent="vision"),
    "another key of the agent": told(agent_key="k" * 43),
    "another sponsor": told(sponsor="bob"),
    "another object": told(object="ur5e"),
    "another operation": told(operation="move_linear"),
    "another audience": told(audience="http://127.0.0.1:1/mcp"),
    "another policy": told(policy_digest="8" * 64),
    "another reason": told(reasons=("TRUST_LOW",)),
    "over": late,
    "not begun": told(not_before=4_000_000_000, not_after=4_000_000_600),
    "signed by nobody registered": told(key=keys.generate()),
    "in another's name": told(approver="carol"),
    "above tier 3": told(tier=Tier(4)),
    "for too long": lambda rig: signed(rig, not_after=int(rig.clock.wall_s()) + 601),
    "too fast": told(speed_um_s=250_001),
    "too often": told(uses=11),
    "by an approver who is none any more": disabled,
    "by the agent's own key": leaf,
    "revoked": revoked,
    "of an old word": unheard,
}


@pytest.mark.parametrize("bound", BOUNDS)
@pytest.mark.clause("ENV-1", "ENV-2")
def test_each_bound_broken_alone_asks_people_as_before(rig, bound):
    signed(rig)
    BOUNDS[bound](rig)
    decision = permitted(rig)
    assert (decision.effect, rig.sent) == (Effect.DENY if bound == "a violation" else Effect.DEFER, []), decision.reason
    assert decision.approval is None


@pytest.mark.clause("ENV-2")
def test_a_use_is_counted_over_a_restart_and_comes_back_only_where_nothing_was_sent(rig):
    made = signed(rig, uses=2)
    assert permitted(rig).effect is Effect.PERMIT

    async def refuses(permit):
        raise ActuationRefusedError(Reason.BUSY)

    rig.effect, kept = refuses, rig.effect
    rig.go()
    rig.effect = kept
    rig.restart()
    rig.issuer.envelopes = [rig.issuer.envelopes[0]]
    rig.pull()
    assert permitted(rig).approval.use == 2
    rig.restart()
    rig.pull()
    assert permitted(rig).effect is Effect.DEFER
    assert made.uses == 2


@pytest.mark.clause("ENV-2")
def test_a_denial_of_the_very_act_beats_the_envelope(rig):
    signed(rig)
    rig.cast(rig.vote(answer="deny"))
    assert permitted(rig).reason is Reason.APPROVAL_DENIED


@pytest.mark.clause("ENV-1")
def test_what_no_person_may_sign_is_not_sealed(rig):
    made = around(rig, rig.asked)
    key = rig.people["bob"].key
    assert envelopes.open(envelopes.sign(made, key), [keys.public_raw(key)], DEFAULT) == made
    for changes in (
        {"tier": Tier(4)},
        {"uses": 11},
        {"uses": 0},
        {"not_after": made.not_before},
        {"not_after": made.not_before + 601},
        {"speed_um_s": 250_001},
        {"index_milli": 3_001},
        {"reasons": ()},
        {"start_urad": made.start_urad[:5]},
        {"box": (*made.box, made.box[0])},
        {"box": (envelopes.Side("q0", 1, 0),)},
        {"seen": (made.seen[0], made.seen[0])},
    ):
        with pytest.raises(StatementError) as raised:
            envelopes.sign(structs.replace(made, **changes), key)
        assert raised.value.code is FaultCode.STATEMENT_MALFORMED
