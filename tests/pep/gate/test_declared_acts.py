"""Acts of tools without a robot at the gate: class and rows alone, no slot, no physics."""

import asyncio
import secrets

import pytest
from capabilities.values.arguments import argument, plain
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.scope import Grant, Limit, Range, Tier
from capabilities.values.units import Sort
from hypothesis import given, settings
from hypothesis import strategies as st
from pep.base.declaration import row
from pep.base.operations import MOVE_JOINT
from pep.base.ports import RegisteredTool
from pep.base.stated_values import Free, Length, Listed, Within, Word
from pep.mcp.mapping import to_request
from pep.request.call import Call
from policies.decision.load import load_shipped
from policies.evidence.evidence import NOT_COLLECTED, DeclaredImpact, ToolReading
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE, Rig, full_scope, own_choice

from capabilities.keys import keys
from capabilities.statements.people import ask as ask_statement

VALVE = row(
    "valve-7",
    "open_valve",
    {"opening": Within(0, 1_000, "permille", above={800: 3, 950: 4}), "speed": Within(0, 100)},
    base_tier=1,
    exact=False,
)
SEND = row(
    "hall", "send", {"notes": Listed(Word(), Length(0, 20)), "body": Free(4_000)}, base_tier=3, exact=False
)  # fmt: skip
STOP = row("plant", "stop", {}, base_tier=2, exact=False)
GRANTS = {
    "open_valve": Grant(
        "valve-7", "open_valve", tuple(Limit(p, Range(0, 980)) for p in VALVE.parameters)
    ),
    "send": Grant("hall", "send", tuple(Limit(each.parameter, each.bound) for each in SEND.limits)),
    "stop": Grant("plant", "stop"),
}  # fmt: skip


@pytest.fixture
def rig(tmp_path):
    made = Rig(tmp_path)
    made.policies = load_shipped("tools")
    made.build()
    made.gate._robot = None
    yield made
    made.gate.close()
    made.journal.close()


def holder(rig, *operations, **changes):
    scope = full_scope(rig.clock.wall_s(), **changes)
    return rig.agent(scope=type(scope)(**{**vars_of(scope), "grants": tuple(GRANTS[name] for name in operations)}))


def vars_of(scope):
    return {name: getattr(scope, name) for name in scope.__dataclass_fields__ if scope.__dataclass_fields__[name].init}


def call(rig, caller, arguments, *, operation=VALVE, registered=Tier.REVERSIBLE):
    request = to_request(
        operation, arguments, request_id=secrets.token_hex(16), audience=AUDIENCE, at=rig.clock.wall_s()
    )
    rig.registry.tools[operation.name] = RegisteredTool(operation.name, "d" * 64, operation.name, registered)
    return Call(
        request=request,
        operation=operation,
        tool=ToolReading(operation.name, "d" * 64, "d" * 64, registered),
        credentials=rig.credentials(caller),
        arrived_ms=rig.clock.monotonic_ms(),
        readiness=None,
        context=own_choice(request),
    )


def run(rig, made):
    return asyncio.run(rig.gate.run(made, rig.effect))


def test_an_act_needs_no_robot(rig):
    caller = holder(rig, "open_valve")
    assert rig.slot.reserve("another motion")
    answer = run(rig, call(rig, caller, {"opening": 0.5, "speed": 3}))
    assert (answer.decision.effect, answer.decision.tier, answer.decision.index) == (Effect.PERMIT, 1, None)
    seen = answer.decision.evidence
    assert seen.impact == DeclaredImpact(Tier.REVERSIBLE)
    assert {seen.robot, seen.perception, seen.sequence} == {NOT_COLLECTED}
    assert [r["kind"] for r in rig.records()] == ["decision", "outcome"], "the record is before the effect"
    assert len(rig.sent) == 1


def test_a_row_raises_the_tier_and_names_its_parameter(rig):
    caller = holder(rig, "open_valve")
    assert run(rig, call(rig, caller, {"opening": 0.8, "speed": 3})).decision.tier == 1
    raised = run(rig, call(rig, caller, {"opening": 0.801, "speed": 3}))
    assert (raised.decision.effect, raised.decision.reason) == (Effect.DEFER, Reason.TIER_NEEDS_APPROVAL)
    assert raised.decision.findings[0].detail["raised_by"] == ["opening"]
    assert raised.ask.reason == Reason.TIER_NEEDS_APPROVAL
    assert len(rig.sent) == 1


def test_people_are_asked_in_words_and_their_answer_binds_the_act(rig):
    """No perception, no index: what would be done, of which tier, and who asks."""
    caller = holder(rig, "open_valve")
    deferred = run(rig, call(rig, caller, {"opening": 0.9, "speed": 3}))
    text = rig.issuer.asks[deferred.ask.ask_id]
    asked = ask_statement.open(text, [keys.public_raw(rig.pep_key)], CAPS)
    assert (asked.perception, asked.index_milli, asked.contributors, asked.start_urad) == ("none", 0, (), ())
    assert [(v.name, v.value) for v in asked.values] == [("opening", 900), ("speed", 3)]
    rig.issuer.cast(asked.ask_id, rig.people["bob"].vote(text, at=rig.clock.wall_s()))
    rig.pull()
    other = run(rig, call(rig, caller, {"opening": 0.901, "speed": 3}))
    assert other.decision.effect is Effect.DEFER, "another request is another question"
    approved = run(rig, call(rig, caller, {"opening": 0.9, "speed": 3}))
    assert (approved.decision.effect, approved.decision.approval.ask_id) == (Effect.PERMIT, asked.ask_id)


def test_people_are_asked_of_words_and_their_answer_binds_each_of_them(rig):
    caller = holder(rig, "send")
    given = {"notes": ["a", "b"], "body": {"to": "hall 2"}}
    deferred = run(rig, call(rig, caller, given, operation=SEND))
    text = rig.issuer.asks[deferred.ask.ask_id]
    asked = ask_statement.open(text, [keys.public_raw(rig.pep_key)], CAPS)
    assert [plain(value) for value in asked.values] == [["a", "b"], plain(argument("body", Sort.FREE, given["body"]))]
    rig.issuer.cast(asked.ask_id, rig.people["bob"].vote(text, at=rig.clock.wall_s()))
    rig.pull()
    for other in ({"notes": ["b", "a"]}, {"body": {"to": "hall 3"}}):
        assert run(rig, call(rig, caller, given | other, operation=SEND)).decision.effect is Effect.DEFER
    assert run(rig, call(rig, caller, given, operation=SEND)).decision.effect is Effect.PERMIT


def test_people_are_not_asked_what_they_could_not_read(rig):
    """The act is denied with its reason, and on record."""
    caller = holder(rig, "send")
    answer = run(rig, call(rig, caller, {"notes": ["x" * 1_000] * 17, "body": 1}, operation=SEND))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.STATEMENT_MALFORMED)
    assert answer.ask is None and rig.issuer.asks == {} and rig.sent == []
    assert rig.records()[-1]["body"]["decision"]["reason"] == "STATEMENT_MALFORMED"


def test_the_class_of_the_registry_counts_where_it_is_higher(rig):
    caller = holder(rig, "open_valve")
    answer = run(rig, call(rig, caller, {"opening": 0.1, "speed": 3}, registered=Tier.HIGH_CONSEQUENCE))
    assert (answer.decision.effect, answer.decision.tier) == (Effect.DEFER, 3)


def test_a_row_above_the_ceiling_is_refused_and_asks_nobody(rig):
    caller = holder(rig, "open_valve", ceiling=Tier.CONSEQUENTIAL)
    answer = run(rig, call(rig, caller, {"opening": 0.9, "speed": 3}))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.ABOVE_CEILING)


def test_the_highest_row_counts(rig):
    answer = run(rig, call(rig, holder(rig, "open_valve"), {"opening": 0.96, "speed": 3}))
    assert (answer.decision.reason, answer.decision.tier) == (Reason.ABOVE_CEILING, 4)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"opening": 0.99, "speed": 3}, Reason.LIMIT_EXCEEDED_BY_REQUEST),  # the token's limit
        ({"opening": 0.5, "speed": 101}, Reason.ROBOT_LIMIT),  # the row's own
    ],
)
def test_the_limits_of_token_and_row_hold(rig, arguments, reason):
    decision = run(rig, call(rig, holder(rig, "open_valve"), arguments)).decision
    assert (decision.effect, decision.reason) == (Effect.DENY, reason)


def test_no_name_of_a_tool_is_an_exception(rig):
    """A tool of the user's that is called `stop` is an act like any other."""
    stranger = holder(rig, "open_valve")
    assert run(rig, call(rig, stranger, {}, operation=STOP)).decision.reason is Reason.NOT_GRANTED
    assert run(rig, call(rig, holder(rig, "stop"), {}, operation=STOP)).decision.tier == 2


def test_an_operation_of_a_robot_is_denied_where_there_is_none(rig):
    answer = asyncio.run(rig.gate.run(rig.call(rig.agent(), "move_joint"), rig.effect))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.EVIDENCE_MISSING)
    assert rig.sent == []
    assert MOVE_JOINT.robot is not None


def test_the_view_of_revocations_must_be_as_fresh_as_for_a_motion(rig):
    made = call(rig, holder(rig, "open_valve"), {"opening": 0.5, "speed": 3})
    rig.feed.age_ms = 2_001
    assert run(rig, made).decision.reason is Reason.REVOCATION_VIEW_STALE


@settings(max_examples=50)
@given(st.integers(0, 1_000), st.integers(0, 4))
def test_rows_only_raise(opening, base):
    edges = {at: to for at, to in ((800, 3), (950, 4)) if to > base}
    made = row("v", "o", {"x": Within(0, 1_000, above=edges)}, base_tier=base, exact=False)
    request = to_request(made, {"x": opening}, request_id="r", audience="a", at=0.0)
    tier, raised_by = made.tier_of(request.values)
    assert tier == max([base, *(to for at, to in edges.items() if opening > at)])
    assert raised_by == (("x",) if tier > base else ())
