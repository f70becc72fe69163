"""Judge of a leased program's commands: each is a request of the lease's chain, and passes the one gate.

    held command -> request -> gate: evidence, decision, record -> spend the permit -> forward -> watch to its end

One command at a time moves the arm: the slot is taken until our own connection has seen it stand, and the outcome is on
record. A deferred command is held until people have answered, and then decided afresh, from the arm's place then.
"""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from contextlib import suppress
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from capabilities import tracing
from capabilities.values import trace_context
from capabilities.values.chain import Chain
from pep.base.errors import JournalError
from pep.base.traced import tell
from pep.people.deferral import AskState
from pep.request.call import Call
from pep.rtde.command import command_values as v
from pep.rtde.command.led_limits import granted
from pep.rtde.judge.command_requests import CommandedOperation, NoDecisionNeeded, as_granted, asked_of, request_of
from pep.rtde.judge.execution import ActiveCommand
from pep.rtde.judge.line_refusals import LineRefusals, refusal_of
from pep.rtde.judge.pose_targets import POSED
from pep.rtde.wire.client_texts import told
from pep.rtde.wire.refusal import InputRefusal
from policies.evidence.evidence import ToolReading
from policies.evidence.model import Effect
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pep.base.operation_row import Operation
    from pep.base.ports import Clock, Readiness, Registry
    from pep.gate.gate import Gate, GateResult
    from pep.people.asks import Asks
    from pep.rtde.judge.command_requests import ToolSetup
    from pep.rtde.judge.execution import LeasedEffects, Prepared
    from pep.rtde.robot.judge_port import PendingCommand, ProgramOwner, Stopper
    from policies.evidence.model import Decision

HOLD_MS: Final = 60_000
"""DESIGN section 8: time for which a program waits for people.

The ask stays open: the same command asks it again.
"""
LOOK_S: Final = 0.05
"""Pause between two looks for an answer."""
SETTLES_S: Final = 0.25
"""Longest wait for the end of the command before.

A program knows it some milliseconds before it is on record.
"""
MODE_ENDS: Final[Mapping[type, str]] = MappingProxyType(
    {
        v.ForceMode: "force mode is on: forceModeStop() first",
        v.FreedriveMode: "freedrive is on: endFreedriveMode() first",
        v.TeachMode: "teach mode is on: endTeachMode() first",
    }
)
"""Ends of the modes in which the arm is led, by the command that begins each."""
CLOSE_S: Final = 6.0
"""Longest wait for the end of a forwarded command, once it has been told to stop."""


class LeasedJudge:
    """`pep.rtde.robot.judge_port.Judge` over the gate. On one event loop.

    Args:
        gate: decides and records.
        effects: execution of permitted commands.
        asks: state of deferrals.
        registry: may ask for a higher base tier of an operation, by a tool of its name.
        readiness: of the robot, for the holder of the lease.
        stopper: of the arm.
        fitted: tool and payload now.
        audience: canonical URL of the robot.
        clock: both clocks.
    """

    def __init__(
        self,
        *,
        gate: Gate,
        effects: LeasedEffects,
        asks: Asks,
        registry: Registry,
        readiness: Readiness,
        stopper: Stopper,
        fitted: Callable[[], ToolSetup],
        audience: str,
        clock: Clock,
    ) -> None:
        self._gate = gate
        self._effects = effects
        self._asks = asks
        self._registry = registry
        self._readiness = readiness
        self._stopper = stopper
        self._fitted = fitted
        self._audience = audience
        self._clock = clock
        self._cases: list[ActiveCommand] = []
        self._line = LineRefusals(gate.record, clock)

    def judge(self, held: PendingCommand) -> None:
        """See `Judge.judge`."""
        before = [case.task for case in self._cases if case.task is not None]
        case = ActiveCommand(held, held.command)
        self._cases.append(case)
        case.task = asyncio.get_running_loop().create_task(self._judged(case, before))

    def withdrawn(self, held: PendingCommand) -> None:
        """Withdraws as `Judge.withdrawn` says. A forwarded command is watched to its end all the same."""
        for case in self._cases:
            if case.held == held and not case.forwarded and case.task is not None:
                case.withdrawn = True
                case.task.cancel()

    def refused(self, holder: ProgramOwner, refused: InputRefusal, what: str) -> None:
        """See `Judge.refused`."""
        self._line.note(holder, refused, what)

    async def close(self) -> None:
        """Stops every motion and waits for its end; nothing is decided any more."""
        self._stopper.stop(Reason.EFFECT_FAILED)
        tasks = [case.task for case in self._cases if case.task is not None]
        for case in self._cases:
            self.withdrawn(case.held)
        if tasks:
            await asyncio.wait(tasks, timeout=CLOSE_S)
        await self._line.close()
        self._effects.close()

    async def _judged(self, case: ActiveCommand, before: list[asyncio.Task[None]]) -> None:
        try:
            if before:
                await asyncio.wait(before, timeout=SETTLES_S)
            # A trace for each command: a program's bytes name none.
            with tracing.entered(trace_context.REQUEST, None, random=secrets.token_bytes):
                await self._decide(case)
        except Exception:  # noqa: BLE001 - any failure on the way is a denial; a narrower net would leave it waiting
            if not (case.forwarded or case.withdrawn):
                case.held.deny(Reason.EVIDENCE_MISSING, told(Reason.EVIDENCE_MISSING))
        finally:
            self._cases.remove(case)

    async def _decide(self, case: ActiveCommand) -> None:
        held = case.held
        deadline_ms, waited_for = self._clock.monotonic_ms() + HOLD_MS, set[str]()
        while True:
            # Anew for each run of the gate: the held object may have changed while people were asked.
            fitted = self._fitted()
            said = await self._effects.rewritten(case.command) if isinstance(case.command, POSED) else case.command
            if isinstance(said, InputRefusal):
                await self._refuse(held, said)
                return
            case.rewritten = said
            has = partial(granted, held.lease.credentials.chain)
            asked = asked_of(said, path=held.path, fitted=fitted, granted=has)
            if isinstance(asked, NoDecisionNeeded):
                case.forwarded = True
                held.forward()
                return
            if not isinstance(asked, InputRefusal) and (led := self._led()):
                asked = InputRefusal(Reason.BUSY, led)
            answer = asked if isinstance(asked, InputRefusal) else await self._run(case, asked, fitted)
            if isinstance(answer, InputRefusal):
                await self._refuse(held, answer)
                return
            if case.forwarded or case.withdrawn:
                return
            if case.renewed:
                continue  # decided afresh, by the token that stands now
            ask = answer.ask
            if answer.decision.effect is not Effect.DEFER or ask is None or ask.ask_id in waited_for:
                held.deny(answer.decision.reason, _why(answer.decision))
                return
            waited_for.add(ask.ask_id)
            held.defer(_why(answer.decision))
            if not await self._answered(ask.ask_id, deadline_ms):
                held.deny(Reason.APPROVAL_TIMEOUT, told(Reason.APPROVAL_TIMEOUT))
                return

    def _led(self) -> str:
        """End of the mode that leads the arm now ([LSD-20]); "" for none."""
        ends = (MODE_ENDS.get(type(each.command), "") for each in self._cases if each.forwarded)
        return next(filter(None, ends), "")

    async def _run(
        self, case: ActiveCommand, asked: CommandedOperation, fitted: ToolSetup
    ) -> GateResult | InputRefusal:
        """One run of the gate, from now."""
        lease = case.held.lease
        case.credentials = credentials = lease.credentials
        if isinstance(credentials.chain, Chain):
            asked = as_granted(asked, credentials.chain)
        request = request_of(asked, request_id=secrets.token_hex(16), audience=self._audience, at=self._clock.wall_s())
        if isinstance(request, InputRefusal):
            return request
        call = Call(
            request=request,
            operation=asked.operation,
            tool=self._tool(asked.operation),
            credentials=credentials,
            arrived_ms=self._clock.monotonic_ms(),
            readiness=self._readiness,
            renewed=lambda: lease.credentials,
        )
        prepared: Prepared | None = None
        if asked.stream and isinstance(credentials.chain, Chain):
            # Before it is decided: a view takes longer to tell than a verdict lasts.
            found = await self._effects.prepare(credentials.chain, request)
            if isinstance(found, InputRefusal):
                return found
            prepared = found

        effect = partial(self._effects.carry_out, case, asked, prepared, fitted)
        with tracing.step(trace_context.DECIDE, {trace_context.OPERATION: asked.operation.name}) as span:
            answer = await self._gate.run(call, effect)
            tell(span, answer.decision)
        return answer

    def _tool(self, operation: Operation) -> ToolReading:
        """The operation as its own tool: this enforcement point is its definition."""
        tier, registered = operation.base_tier, self._registry.tool(operation.name)
        if registered is not None and registered.operation == operation.name:
            tier = max(tier, registered.base_tier)
        spelt = [operation.object, operation.name, *(f"{p.name}:{p.kind}" for p in operation.parameters)]
        digest = hashlib.sha256(" ".join(spelt).encode()).hexdigest()
        return ToolReading(operation.name, digest, digest, tier)

    async def _answered(self, ask_id: str, deadline_ms: int) -> bool:
        """True where people have answered in time."""
        while self._asks.state_of(ask_id) is AskState.OPEN:  # answers come on a thread
            if not self._clock.monotonic_ms() < deadline_ms:
                return False
            await asyncio.sleep(LOOK_S)
        return True

    async def _refuse(self, held: PendingCommand, refused: InputRefusal) -> None:
        """Denies before there was a request to decide, on record."""
        body = refusal_of(held.lease, refused, type(held.command).__name__, clock=self._clock)
        with suppress(JournalError):  # refused either way
            await self._gate.record("refusal", body)
        held.deny(refused.reason, told(refused.reason, refused.place))


_TOLD: Final = ("parameter", "unit", "nearest_permitted", "highest_speed_of_lower_tier", "latch_id", "cause")


def _why(decision: Decision) -> str:
    """Text of a denial for the program: the parameter, what would be permitted, what physics could not do."""
    detail = decision.findings[0].detail if decision.findings else {}
    said = [f"{name}={detail[name]}" for name in _TOLD if detail.get(name) is not None]
    return told(decision.reason, ", ".join(said))
