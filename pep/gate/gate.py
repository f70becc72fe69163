"""Gate: the one place that knows every step from a request to its effect.

Every failure on the way is DENY.

    request -> collect evidence -> decide -> record -> effect -> record its outcome
               cheap before dear    pure     durable   within the verdict's lifetime, and only what was decided

One run stands for e4 and e5 together: the one that decides also holds the only connection that moves the robot.
"""

from __future__ import annotations

import asyncio
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeVar

from capabilities.values.chain import Chain
from capabilities.values.errors import Fault, StatementError
from pep.base.errors import ActuationRefusedError, JournalError
from pep.base.operation_row import OperationKind
from pep.base.operations import touchable
from pep.base.ports import Assessed
from pep.gate import advice, records
from pep.gate.budget_charge import BudgetCharge
from pep.gate.first_fault import first_fault
from pep.gate.last_look import LastLook
from pep.gate.observe_only import HIGHEST_MILLI, LASTS_MS, Marked
from pep.gate.robot_ports import robot_of, takes_slot, unpictured
from pep.journal.conduct import Conduct
from pep.people.deferral import AskState
from pep.request.denial import broken, denial
from pep.request.edge import Edge
from pep.request.permit import Permit, unfulfilled
from pep.request.standing import StandingAuthority
from pep.world.sequence import ARRIVED
from policies.decision.pdp import decide
from policies.decision.policy import requirement
from policies.evidence.evidence import NOT_COLLECTED, DeclaredImpact, Evidence, ImpactFault, ImpactReading
from policies.evidence.model import Decision, Effect, Finding, Request
from policies.evidence.tiers import FRESH, authorised_milli
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping

    from pep.base.ports import Clock, Facts, Journal, Registry
    from pep.gate.observe_only import Simulated
    from pep.gate.robot_ports import RobotPorts
    from pep.journal.budget_store import BudgetStore
    from pep.people.asks import Asks
    from pep.people.deferral import Announcer, AskNotice
    from pep.request.authority import Authority
    from pep.request.call import Call
    from policies.decision.policy import PolicySet

PHYSICS_TIMEOUT_S: Final = 3.0
"""An assessment that takes longer is a fault, and a fault is no tier."""
ATTEMPTS: Final = 8
"""Decisions taken on fresh evidence while the record outlasts their lifetime; after the last one DENY."""
HEARD_S: Final = 0.001
"""Time after which an act's conduct is worked out.

Its answer is on its way by then; what asks for it before has it at once.
"""
SEQUENCE: Final = "TEA-6"
"""Primitive behind `BUSY`: a command together with unfinished ones."""
STATE: Final = "TEA-5"
"""The primitive that looks at the robot's own state, which is cheap to have."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class EffectResult:
    """Report of an effect. `value` is plain JSON for the record; `carried` goes back to the shell."""

    value: Mapping[str, Any]
    carried: Any = None
    failed: bool = False


@dataclass(frozen=True, slots=True)
class GateResult:
    """End of one run: the decision, its outcome, and whether the outcome is on record (the decision always is)."""

    decision: Decision
    ask: AskNotice | None = None
    result: EffectResult | None = None
    recorded: bool = True
    observed: bool = False
    """The decision was not enforced (`unsafe_observe`)."""


class Gate(Edge):
    """Decides and enforces. All IO is in its ports.

    Args:
        clock: both clocks.
        authority: steps 1 to 10, and again at the last moment.
        registry: trust in agents, and what is known of their conduct.
        robot: ports of the robot; None where there is none, and each request for one breaks, which denies it.
        policies: the policies of decisions.
        journal: durable; nothing moves before its answer.
        budgets: durable; what is spent of them, by every worker of this point.
        asks: deferrals, what people answered, and what was used of it.
        announcer: tells people of a new deferral.
        facts: of sensors, for the rows that depend on them; None where nobody hears any, and each of them is missing.
        unsafe_observe: a simulated controller behind which nothing moves: what the policies deny or defer is recorded
            so, and happens all the same. None, as everywhere else, enforces.

    Attributes:
        conduct: holders' conduct; it hears of each record made here.
    """

    def __init__(
        self,
        *,
        clock: Clock,
        authority: Authority,
        registry: Registry,
        robot: RobotPorts | None,
        policies: PolicySet,
        journal: Journal,
        budgets: BudgetStore,
        asks: Asks,
        announcer: Announcer,
        facts: Facts | None = None,
        unsafe_observe: Simulated | None = None,
    ) -> None:
        journal = journal if unsafe_observe is None else Marked(journal)
        # Conduct learns of each record made here: this enforcement point's own findings count at once.
        self.conduct = Conduct(journal, registry=registry, clock=clock, parameters=policies.parameters)
        super().__init__(policies=policies, journal=self.conduct)
        self._unsafe_observe = unsafe_observe
        self._clock = clock
        self._authority = authority
        self._robot = robot
        self._pictured = unpictured if robot is None else robot.pictured
        self._registry = registry
        self._budgets = budgets
        self._asks = asks
        self._announcer = announcer
        self._facts = facts
        # A worker of its own, so that a long assessment never delays a record, nor a stop.
        self._assessor = ThreadPoolExecutor(1, "physics")

    def looked(self) -> None:
        """Notes that a caller was told the arm's place outside of the tools (`pep.world.sequence.Sequence.looked`)."""
        if self._robot is not None:
            self._robot.sequence.looked()

    async def run(self, call: Call, effect: Callable[[Permit], Awaitable[EffectResult]]) -> GateResult:
        """Answers one call; its effect has happened exactly when the decision is PERMIT.

        Args:
            call: of an operation that is not a stop.
            effect: sends, once, what the permit allows; raises `ActuationRefusedError` when it did not send.
        """
        permitted: Future[str] | None = None
        permit: Permit | None = None
        charge = BudgetCharge(self._budgets, recorder=self._recorder, clock=self._clock, request=call.request)
        try:
            physical, attempt = requirement(call.request, self._policies).physical, 0
            while True:
                attempt += 1
                evidence, decision, decided_ms = await self._decided(call, physical=physical)
                decision = await charge.charged(evidence, decision)
                if decision.effect is not Effect.PERMIT:
                    if self._unsafe_observe is None:
                        return await self._conclude(call, evidence, decision)
                    robot = robot_of(call, self._robot)
                    if not physical or robot is None or robot.slot.reserve(call.request.request_id):
                        return await self._observed(call, evidence, decision, effect)
                    return await self._conclude(call, evidence, _denied(decision, Reason.BUSY))
                undone = unfulfilled(decision, call.request)
                if undone is not None:
                    void = denial(decision, Reason.OBLIGATION_UNMET, obligation=str(undone.kind))
                    return await self._conclude(call, evidence, void)
                if not self._asks.consume(decision):
                    # the use went to another request, or out of time, since the evidence was collected
                    if attempt < ATTEMPTS:
                        continue
                    return await self._conclude(call, evidence, _denied(decision, Reason.APPROVAL_USED))
                permit = self._permit(call, evidence, decision, decided_ms)
                permitted = self._recorder.submit(
                    self._journal.append, "decision", records.decision(call, evidence, decision)
                )
                record = await asyncio.wrap_future(permitted)
                if self._clock.monotonic_ms() <= permit.deadline_ms:
                    sent = charge.watched(effect)
                    return await self._effect(call, evidence, decision, permit, record=record, effect=sent)
                await self._refused(call, decision, permit, record, ActuationRefusedError(Reason.VERDICT_EXPIRED))
                permitted = None
                if attempt == ATTEMPTS:
                    return await self._conclude(call, evidence, _denied(decision, Reason.VERDICT_EXPIRED))
        except asyncio.CancelledError:
            # The caller has gone, and the shell has stopped the motion. A caller who goes waits for no record.
            if permitted is not None and not (permit is not None and permit.concluded):
                self._recorder.submit(copy_context().run, self._abandoned, call.request, permitted)
            raise
        except Exception as error:  # noqa: BLE001 - any exception on the way is DENY; a narrower net would leak
            return await self._broken(call, error)
        finally:
            charge.settle()
            self._asks.release(call.request.request_id)
            self._free(call)

    async def advise(self, call: Call) -> advice.Advice:
        """Verdict on a call that is only asked about: nothing is permitted, charged, used, moved or asked of people."""
        charge = BudgetCharge(self._budgets, recorder=self._recorder, clock=self._clock, request=call.request)
        return await advice.advised(
            call,
            lambda: self._judged(call, self._cheap(call)),
            asks=self._asks,
            charge=charge,
            policy_digest=self._policies.digest,
        )

    def _free(self, call: Call) -> None:
        if self._robot is not None:
            self._robot.slot.release(call.request.request_id)

    async def _decided(self, call: Call, *, physical: bool) -> tuple[Evidence, Decision, int]:
        """Evidence as far as it is worth having, the verdict on it, and the time of asking.

        They are asked once of what is cheap and of the robot's own state, and once more when physics has answered.
        """
        evidence = self._cheap(call)
        ports = robot_of(call, self._robot)
        if ports is not None and call.operation.kind is not OperationKind.READ and not first_fault(evidence):
            latch_id = ports.latched()
            if latch_id is not None:  # [LSD-21] after authority: no stranger is told of it
                decided_ms, decision = self._clock.monotonic_ms(), decide(call.request, evidence, self._policies)
                return evidence, _denied(decision, Reason.ROBOT_LATCHED, STATE, latch_id=latch_id), decided_ms
        if ports is not None and call.readiness is not None and physical and not first_fault(evidence):
            robot = call.readiness.reading()
            evidence = replace(evidence, robot=robot)
            decided_ms = self._clock.monotonic_ms()
            decision = decide(call.request, evidence, self._policies)
            ready = all(finding.primitive != STATE for finding in decision.findings)
            # A request without the arm takes no slot from the one that has it.
            if (robot.exclusive or ready) and not takes_slot(call, evidence, ports.slot):
                return evidence, _denied(decision, Reason.BUSY), decided_ms
            if not ready:
                return evidence, decision, decided_ms
            evidence = await self._dear(call, evidence, ports)
        decided_ms = self._clock.monotonic_ms()
        return *self._judged(call, evidence), decided_ms

    def _judged(self, call: Call, evidence: Evidence) -> tuple[Evidence, Decision]:
        """The evidence with people's answers, and the verdict on it, for a call or a question about one."""
        if not first_fault(evidence):
            evidence = self._asks.witness(call.request, evidence)
        return evidence, decide(call.request, evidence, self._policies)

    def _declared(self, call: Call) -> DeclaredImpact:
        """Impact by the operation's rows: over the request's values, and over facts as they are now."""
        rows = call.operation.facts
        facts = tuple(row.unheard() for row in rows) if self._facts is None or not rows else self._facts.readings(rows)
        return DeclaredImpact(*call.operation.tier_of(call.request.values, facts), facts)

    def _cheap(self, call: Call) -> Evidence:
        """Everything but physics, in order, up to the first fault."""
        at, at_ms, proof = self._clock.wall_s(), self._clock.monotonic_ms(), call.credentials.proof
        chain = self._standing(call)
        if isinstance(chain, Fault) or proof is not True:
            return Evidence(at=at, at_ms=at_ms, proof=proof, chain=chain)
        tool, request = call.tool, call.request
        seen = partial(Evidence, at=at, at_ms=at_ms, proof=proof, chain=chain, tool=tool, context=call.context)
        if tool.base_tier is None or tool.approved_digest != tool.actual_digest:
            return seen()
        refused = self._authority.verifier.check_request(
            chain,
            object=request.object,
            operation=request.operation,
            values=request.values,
            base_tier=tool.base_tier,
            at=at,
        )
        if refused is not None:
            return seen(request_fault=refused)
        unfit = call.operation.refuse(request)
        if unfit is not None:
            return seen(request_fault=None, robot_fault=unfit)
        return seen(
            request_fault=None,
            robot_fault=None,
            trust=self.conduct.trust(chain, at=at),
            behaviour=self.conduct.behaviour(chain.leaf.agent, at=at),
            impact=self._declared(call) if call.operation.robot is None else NOT_COLLECTED,
        )

    async def _dear(self, call: Call, seen: Evidence, ports: RobotPorts) -> Evidence:
        """Physics, and then authority once more: a revocation may arrive during an assessment."""
        touch = touchable(seen.chain) if isinstance(seen.chain, Chain) else frozenset()
        answer = await self._in_time(partial(ports.physics.assess, call.request, touch=touch))
        found = Assessed(answer, NOT_COLLECTED) if isinstance(answer, ImpactFault) else answer
        # The request joined with the recent acts: small steps are no smaller than their sum.
        joined = ports.sequence.joined(call.request, impact=found.impact)
        together = None
        if joined is not None:
            start = joined.start_urad
            whole = partial(ports.physics.together, joined.request, start_urad=start, touch=touch)
            together = await self._in_time(whole)
        at, at_ms = self._clock.wall_s(), self._clock.monotonic_ms()
        chain = self._standing(call)
        seen = replace(seen, at=at, at_ms=at_ms, impact=found.impact, perception=found.perception, chain=chain)
        # the slot is this request's, or its running stream's: nothing else is unfinished
        sequence = ports.sequence.reading(
            call.request,
            agent=_agent(call),
            impact=seen.impact,
            robot=seen.robot,
            unfinished=False,
            together=together,
        )
        return replace(seen, sequence=sequence)

    async def _in_time(self, assess: Callable[[], T]) -> T | ImpactFault:
        try:
            return await asyncio.wait_for(
                asyncio.get_running_loop().run_in_executor(self._assessor, assess), PHYSICS_TIMEOUT_S
            )
        except TimeoutError:
            return ImpactFault(Reason.PHYSICS_FAULT, "the assessment took too long")

    def _standing(self, call: Call) -> Chain | Fault:
        """Steps 1 to 9 as of now, with the lease that the policies want for the request."""
        return self._authority.standing(call.credentials, lease_ms=self.lease_ms(call.request))

    def _permit(self, call: Call, evidence: Evidence, decision: Decision, decided_ms: int) -> Permit:
        touch = touchable(evidence.chain) if isinstance(evidence.chain, Chain) else frozenset()
        lease_ms = self.lease_ms(call.request)
        return Permit(
            request_id=call.request.request_id,
            digest=decision.request_digest,
            since_ms=call.arrived_ms,
            deadline_ms=decided_ms + decision.lifetime_ms,
            clock=self._clock,
            standing=StandingAuthority(
                call, self._authority, lease_ms=lease_ms, tier=decision.tier, touch=touch, clock=self._clock
            ),
            request=call.request,
            index_milli=authorised_milli(decision, self._policies.parameters),
            sighted=isinstance(evidence.impact, ImpactReading) and evidence.impact.perception == FRESH,
            touch=touch,
            agent=_agent(call),
            tier=decision.tier,
            again=None if call.operation.robot else self._last_look(call, decision),
        )

    def _last_look(self, call: Call, decision: Decision) -> LastLook:
        return LastLook(call, decision, self._cheap, self._registry, self._asks, lambda: self._policies)

    async def _effect(
        self,
        call: Call,
        evidence: Evidence,
        decision: Decision,
        permit: Permit,
        *,
        record: str,
        effect: Callable[[Permit], Awaitable[EffectResult]],
    ) -> GateResult:
        """The effect, with its outcome on record."""
        robot = robot_of(call, self._robot)
        if robot is not None:
            robot.sequence.begins(call.request, agent=permit.agent, impact=evidence.impact)
            self._pictured(call.request.request_id, record, moves=True)
        try:
            result = await effect(permit)
        except ActuationRefusedError as refused:
            await self._refused(call, decision, permit, record, refused)
            return GateResult(denial(decision, refused.reason, SEQUENCE))
        except Exception as error:  # noqa: BLE001 - an error of an effect is an outcome
            fault, failed = type(error).__name__, Reason.EFFECT_FAILED
            body = records.outcome(call.request, record, "failed", reason=failed, detail=fault)
            recorded = await self._concluded(call, permit, body)
            return GateResult(denial(decision, Reason.EFFECT_FAILED), recorded=recorded)
        if robot is not None:
            if call.operation.kind is OperationKind.READ:
                robot.sequence.looked()
            robot.sequence.ended(call.request, arrived=not result.failed and result.value.get("outcome") == ARRIVED)
        what = "failed" if result.failed else "done"
        body = records.outcome(call.request, record, what, result=result.value, watch=permit.watched)
        return GateResult(decision, result=result, recorded=await self._concluded(call, permit, body))

    async def _observed(
        self, call: Call, evidence: Evidence, decision: Decision, effect: Callable[[Permit], Awaitable[EffectResult]]
    ) -> GateResult:
        """Effect of a denied or deferred request, observed in the simulator: recorded before, and reported as such."""
        record = await self.record("decision", records.decision(call, evidence, decision))
        robot = robot_of(call, self._robot)
        assessed = isinstance(evidence.impact, ImpactReading)
        if robot is not None and call.operation.kind is OperationKind.MOTION and not assessed:
            await self._in_time(partial(robot.physics.remember, call.request))
        permit = Permit(
            request_id=call.request.request_id,
            digest=call.request.digest,
            since_ms=call.arrived_ms,
            deadline_ms=self._clock.monotonic_ms() + LASTS_MS,
            clock=self._clock,
            standing=lambda: None,
            request=call.request,
            index_milli=HIGHEST_MILLI,
            sighted=False,
            agent=_agent(call),
        )
        return replace(
            await self._effect(call, evidence, decision, permit, record=record, effect=effect), observed=True
        )

    async def _concluded(self, call: Call, permit: Permit, body: dict[str, object]) -> bool:
        """True where the outcome of an effect is on record. A failing record undoes no effect, so it denies none."""
        permit.concluded = True
        try:
            if call.operation.robot is None:
                # An act is over: its answer waits for no disk. A power cut makes it an outcome that is not known.
                self.note("outcome", body)
                asyncio.get_running_loop().call_later(HEARD_S, self.conduct.hear)
                return True
            # Shielded: a caller who goes now leaves one outcome behind, not two and not none.
            await asyncio.shield(self.record("outcome", body))
        except JournalError:
            return False
        return True

    async def _refused(
        self, call: Call, decision: Decision, permit: Permit, record: str, why: ActuationRefusedError
    ) -> None:
        """Records a PERMIT that was not acted on; its use is returned where nothing was sent."""
        returned = decision.approval if permit.void() else None
        body = records.outcome(call.request, record, "refused", reason=why.reason, detail=why.detail, returned=returned)
        await self.record("outcome", body)
        if returned is not None:
            self._asks.give_back(decision)

    async def _conclude(self, call: Call, evidence: Evidence, decision: Decision) -> GateResult:
        """A DENY or DEFER, on record; a deferral is asked once, and its silence is a DENY."""
        ask: AskNotice | None = None
        state: AskState | None = None
        if decision.effect is Effect.DEFER and isinstance(evidence.chain, Chain):
            consult = partial(self._asks.consult, request=call.request, evidence=evidence, decision=decision)
            state, loop = AskState.LOST, asyncio.get_running_loop()
            try:
                while state is AskState.LOST:  # one that was lost with a process before people saw it is put anew
                    # On the recorder: a question or an expiry is on record before people are told.
                    state, ask = await loop.run_in_executor(self._recorder, copy_context().run, consult)
                    if state is AskState.OPEN and ask is not None:
                        # nothing will move: the slot waits for no provider
                        self._free(call)
                        state = await self._announcer.announce(ask)
            except StatementError as error:
                # People are asked nothing that they could not read.
                state, decision = None, denial(decision, Reason(error.code), decision.primitive, cause=error.detail)
            if state is AskState.EXPIRED:
                decision = denial(decision, Reason.APPROVAL_TIMEOUT, decision.primitive)
            elif state is AskState.REFUSED:
                decision = denial(decision, Reason.ASK_BUDGET_SPENT, decision.primitive)
        record = await self.record("decision", records.decision(call, evidence, decision, ask=ask))
        if ask is None or state is AskState.REFUSED:  # else the ask has its own
            self._pictured(call.request.request_id, record, moves=False)
        return GateResult(decision, ask=ask)

    async def _broken(self, call: Call, error: Exception) -> GateResult:
        """An exception on the way: DENY, recorded if that is still possible."""
        reason = Reason.RECORD_FAILED if isinstance(error, JournalError) else Reason.EVIDENCE_MISSING
        decision = broken(call.request, reason, error, policy_digest=self._policies.digest)
        if reason is not Reason.RECORD_FAILED:
            unknown = Evidence(at=self._clock.wall_s(), at_ms=self._clock.monotonic_ms())
            try:
                await self.record("decision", records.decision(call, unknown, decision))
            except JournalError:
                return GateResult(replace(decision, reason=Reason.RECORD_FAILED))
        return GateResult(decision)

    def _abandoned(self, request: Request, decided: Future[str]) -> None:
        """Records the outcome of a PERMIT after its caller went away, behind the decision's own record."""
        if not decided.cancelled() and decided.exception() is None:
            self._journal.append("outcome", records.outcome(request, decided.result(), "cancelled"))

    def close(self) -> None:
        """Ends the workers, and closes the store of budgets."""
        self._assessor.shutdown(wait=False, cancel_futures=True)
        super().close()
        self._budgets.close()


def _denied(decided: Decision, reason: Reason, primitive: str = SEQUENCE, **detail: object) -> Decision:
    """Denial of the gate itself, over the digests of the decision."""
    return replace(denial(decided, reason, primitive), findings=(Finding(primitive, reason, detail),))


def _agent(call: Call) -> str:
    """Holder that calls, or "" while none is known."""
    chain = call.credentials.chain
    return chain.leaf.agent if isinstance(chain, Chain) else ""
