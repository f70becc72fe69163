"""Budgets at the gate: charged to every hop before the effect, given back where none began, told when spent."""

import asyncio
import secrets
from dataclasses import replace

import pytest
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.scope import Budget, Grant, Limit, Range, Restriction
from pep.base.declaration import Within, row
from pep.base.errors import ActuationRefusedError, JournalError, PepFault
from pep.base.ports import RegisteredTool
from pep.gate.gate import EffectResult
from pep.mcp.mapping import to_request
from pep.request.call import Call
from pep.request.charges import charges
from policies.decision.load import load_shipped
from policies.evidence import case_json
from policies.evidence.evidence import ToolReading
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.kit import AUDIENCE, Agent, Rig, full_scope, own_choice

from capabilities.keys import keys
from capabilities.token.delegate import delegate
from capabilities.values.chain import Attestation, EvidenceKind, HopGrant

pytestmark = pytest.mark.clause("BDG-1")

ELSEWHERE = "http://127.0.0.1:9999/mcp"
POUR = row("tank", "pour", {"volume": Within(0, 1_000, "mL", scale=1, above={900: 3})}, base_tier=1, exact=False)


def budget(most, per_s=600, *, of="", audience=AUDIENCE):
    return Budget(of, audience, per_s, most)


def grant(*budgets):
    limits = tuple(Limit(each.parameter, Range(0, 1_000)) for each in POUR.limits)
    return Grant("tank", "pour", limits, tuple(sorted(budgets)))


@pytest.fixture
def rig(tmp_path):
    made = Rig(tmp_path)
    made.policies = load_shipped("tools")
    made.gate.close()
    made.build()
    made.gate._robot = None
    yield made
    made.gate.close()
    made.journal.close()


def holder(rig, *budgets, below=None, **changes):
    """An agent that holds this grant; with `below`, through a hop that states those."""
    names = frozenset({"robotic-2", "robotic-3"})
    scope = replace(full_scope(rig.clock.wall_s()), grants=(grant(*budgets),), delegates=names, depth=1, **changes)
    parent = rig.agent(scope=scope)
    return parent if below is None else lent(rig, parent, "robotic-2", below)


def lent(rig, parent, name, budgets):
    """A delegate of this agent, with these budgets."""
    hop = HopGrant(
        hop_id=secrets.token_hex(16),
        agent=name,
        key=keys.public_raw(key := keys.generate()),
        delegator=parent.name,
        purpose="pour",
        request_digest=b"\1" * 32,
        attestation=Attestation(EvidenceKind.KEY, b"\2" * 32, int(rig.clock.wall_s()) - 1),
    )
    token = delegate(
        parent.token,
        chain=rig.credentials(parent).chain,
        attester=rig.made["attester"],
        trust=rig.trust,
        hop=hop,
        restriction=Restriction(grants=(Grant("tank", "pour", (), budgets),), delegates=frozenset()),
        caps=CAPS,
    )
    return Agent(name, key, token, hop.hop_id)


def call(rig, caller, volume=1):
    request = to_request(
        POUR, {"volume": volume}, request_id=secrets.token_hex(16), audience=AUDIENCE, at=rig.clock.wall_s()
    )
    rig.registry.tools["pour"] = RegisteredTool("pour", "d" * 64, "pour", POUR.base_tier)
    return Call(
        request=request,
        operation=POUR,
        tool=ToolReading("pour", "d" * 64, "d" * 64, POUR.base_tier),
        credentials=rig.credentials(caller),
        arrived_ms=rig.clock.monotonic_ms(),
        readiness=None,
        context=own_choice(request),
    )


def pour(rig, caller, volume=1, effect=None):
    return asyncio.run(rig.gate.run(call(rig, caller, volume), effect or rig.effect)).decision


@pytest.mark.clause("BDG-5")
def test_a_spent_budget_is_refused_and_the_rest_is_told(rig):
    caller = holder(rig, budget(2))
    assert [pour(rig, caller).effect for _ in range(2)] == [Effect.PERMIT] * 2
    refused = pour(rig, caller)
    assert (refused.effect, refused.reason) == (Effect.DENY, Reason.BUDGET_SPENT)
    told = refused.findings[0].detail
    assert (told["left"], told["asked"], told["budget"]) == (0, 1, {"most": 2, "per_s": 600})
    assert told["set_by"]["hop"] == 0
    assert 600 <= told["more_at"] - rig.clock.wall_s() <= 600 * 65 / 64 + 1
    assert len(rig.sent) == 2
    assert rig.records("decision")[-1]["body"]["decision"]["reason"] == "BUDGET_SPENT"
    rig.clock.advance(611_000)
    assert pour(rig, holder(rig, budget(2))).effect is Effect.PERMIT


def test_a_quantity_is_counted_by_its_value(rig):
    caller = holder(rig, budget(100, of="volume"))
    assert pour(rig, caller, 60).effect is Effect.PERMIT
    told = pour(rig, caller, 41).findings[0].detail
    assert (told["parameter"], told["left"], told["asked"]) == ("volume", 40, 41)
    assert pour(rig, caller, 0).effect is Effect.PERMIT
    assert pour(rig, caller, 40).effect is Effect.PERMIT
    assert pour(rig, caller, 500).findings[0].detail["more_at"] is None


def test_siblings_share_what_is_above_them(rig):
    parent = holder(rig, budget(3))
    left, right = (lent(rig, parent, name, (budget(2),)) for name in ("robotic-2", "robotic-3"))
    assert pour(rig, left).effect is pour(rig, left).effect is pour(rig, right).effect is Effect.PERMIT
    for each in (right, parent):
        told = pour(rig, each)
        assert (told.reason, told.findings[0].detail["set_by"]["hop"]) == (Reason.BUDGET_SPENT, 0)


def test_a_hop_that_states_no_budget_is_not_charged_twice(rig):
    chain = rig.credentials(holder(rig, budget(5), below=())).chain
    request = call(rig, holder(rig)).request
    (only,) = charges(chain, request)
    assert (only.hop, only.account.split(" ")[0]) == (0, chain.token_id), "charged to the sponsor's promise"
    (drawn,) = charges(replace(chain, mandate_id="6d" * 16), request)
    assert drawn.account.split(" ")[0] == "6d" * 16, "all that is drawn from a mandate shares its budgets"
    paced = rig.credentials(holder(rig, budget(5), below=(budget(1, 9), budget(5)))).chain
    assert [(each.hop, each.most) for each in charges(paced, request)] == [(0, 5), (1, 1)]
    assert charges(rig.credentials(holder(rig)).chain, request) == ()


def test_a_share_of_another_point_is_not_spent_here(rig):
    both = frozenset({AUDIENCE, ELSEWHERE})
    caller = holder(rig, budget(2), budget(1, audience=ELSEWHERE), audiences=both)
    assert [pour(rig, caller).effect for _ in range(2)] == [Effect.PERMIT] * 2
    assert pour(rig, caller).reason is Reason.BUDGET_SPENT


@pytest.mark.clause("BDG-3")
def test_what_did_not_begin_is_given_back(rig):
    caller = holder(rig, budget(1))

    async def refuses(permit):
        raise ActuationRefusedError(Reason.VERDICT_EXPIRED)

    async def late(permit):
        permit.spend(digest="0" * 64, stopped_ms=None)

    for effect in (refuses, late):
        assert pour(rig, caller, effect=effect).effect is Effect.DENY
    assert pour(rig, caller).effect is Effect.PERMIT


@pytest.mark.clause("BDG-3")
def test_what_began_and_failed_is_spent(rig):
    caller = holder(rig, budget(1))

    async def breaks(permit):
        permit.spend(digest=permit.digest, stopped_ms=None)
        raise OSError

    assert pour(rig, caller, effect=breaks).reason is Reason.EFFECT_FAILED
    assert pour(rig, caller).reason is Reason.BUDGET_SPENT


@pytest.mark.clause("BDG-3")
@pytest.mark.parametrize("begun", [True, False])
def test_a_caller_who_goes_away_keeps_what_began(rig, begun):
    """A permit in the hands of its effect is spent, however far it came."""
    caller = holder(rig, budget(1))

    async def goes():
        entered = asyncio.Event()

        async def effect(permit):
            if begun:
                permit.spend(digest=permit.digest, stopped_ms=None)
            entered.set()
            await asyncio.Event().wait()

        running = asyncio.ensure_future(rig.gate.run(call(rig, caller), effect))
        await entered.wait()
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    asyncio.run(goes())
    assert pour(rig, caller).reason is Reason.BUDGET_SPENT


def test_the_charge_is_durable_before_the_effect(rig):
    """The charge is on disk when the effect begins: a crash then leaves it spent."""
    caller = holder(rig, budget(1))
    seen = []

    async def looks(permit):
        due = charges(rig.credentials(caller).chain, permit.request)
        seen.append(rig.budgets.look(due, wall_ms=int(rig.clock.wall_s() * 1000)))
        permit.spend(digest=permit.digest, stopped_ms=None)
        return EffectResult(value={})

    assert pour(rig, caller, effect=looks).effect is Effect.PERMIT
    assert seen[0].left == 0
    rig.restart()
    rig.gate._robot = None
    assert pour(rig, caller).reason is Reason.BUDGET_SPENT


def test_a_recorded_case_with_budgets_is_read_again(rig):
    assert pour(rig, holder(rig, budget(5), below=(budget(4),))).effect is Effect.PERMIT
    body = rig.records("decision")[-1]["body"]
    read = case_json.read({name: body[name] for name in ("form", "request", "evidence")})
    assert [hop.scope.grants[0].budgets for hop in read.evidence.chain.hops] == [(budget(5),), (budget(4),)]
    assert read.evidence.digest == body["decision"]["evidence_digest"]


def test_without_the_store_nothing_happens(rig, monkeypatch):
    def broken(due, *, wall_ms):
        raise JournalError(PepFault.JOURNAL_BROKEN)

    monkeypatch.setattr(rig.budgets, "charge", broken)
    assert pour(rig, holder(rig, budget(1))).reason is Reason.RECORD_FAILED
    assert pour(rig, holder(rig)).effect is Effect.PERMIT
    assert len(rig.sent) == 1


@pytest.mark.clause("BDG-5")
def test_nobody_is_asked_about_what_a_budget_refuses(rig):
    caller = holder(rig, budget(1))
    assert pour(rig, caller, 901).effect is Effect.DEFER
    assert pour(rig, caller).effect is Effect.PERMIT, "a question takes nothing"
    assert pour(rig, caller, 902).reason is Reason.BUDGET_SPENT
    assert len(rig.records("ask")) == 1


@pytest.mark.clause("BDG-1")
def test_what_waits_for_people_is_not_charged_meanwhile(rig, monkeypatch):
    made = []
    monkeypatch.setattr(rig.budgets, "charge", lambda due, **_: made.append(due))
    assert pour(rig, holder(rig, budget(1)), 901).effect is Effect.DEFER
    assert made == []


def test_a_permit_that_is_decided_anew_is_charged_once(rig, monkeypatch):
    caller, slow, append = holder(rig, budget(1)), [60_000], rig.journal.append

    def late(kind, body):
        if slow and kind == "decision":
            rig.clock.advance(slow.pop())
        return append(kind, body)

    monkeypatch.setattr(rig.journal, "append", late)
    assert pour(rig, caller).effect is Effect.PERMIT
    assert [record["kind"] for record in rig.records()] == ["decision", "outcome", "decision", "outcome"]
    assert pour(rig, caller).reason is Reason.BUDGET_SPENT


def test_one_budget_is_shared_by_calls_at_once(rig):
    caller = holder(rig, budget(5))

    async def all_at_once():
        return await asyncio.gather(*(rig.gate.run(call(rig, caller), rig.effect) for _ in range(12)))

    answers = asyncio.run(all_at_once())
    assert sum(each.decision.effect is Effect.PERMIT for each in answers) == len(rig.sent) == 5
    assert CAPS.budgets == 64
