"""Latching of a robot: which ends of motions and leases latch it, its file kept, its way out worked out.

    end of a motion, end of a lease, safety mode ─▶ `Latches` at once, every earlier permit void ─▶ on disk ─▶ a way out

What latches is the policies' to say; what an end means is said here ([LSD-21]).
"""

from __future__ import annotations

import asyncio
import secrets
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Protocol

from capabilities.statements.people.latch import LatchCause, Retreat
from capabilities.values.scope import Tier
from capabilities.values.units import Unit
from pep.base.errors import PepError, PepFault
from pep.base.operation_row import OperationKind
from pep.base.operations import operation_of
from pep.base.stop_model import SAFE_MODES
from pep.people.latches import LatchedStop
from pep.rtde.lease.lease import LeaseEnding
from pep.watch.watch import MotionOutcome
from pep.world.retreat import proposed
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from capabilities.statements.people.answers import Answers
    from pep.base.ports import Assessed, Clock
    from pep.people.latches import Latches
    from pep.request.permit import Permit
    from pep.rtde.motion.motions import AssessedStarts
    from pep.rtde.motion.standstill import MotionEnd
    from pep.rtde.robot.state_receiver import Package
    from policies.evidence.model import Request

LOOK_S: Final = 0.1
"""Pause between two looks at what is still to be kept or worked out."""
STANDS_MS: Final = 10_000
"""Longest wait for standstill before the latch is told without a way out; twice the limit of a stop."""
WAY_MS: Final = 5_000
"""Longest time for working out a way: then the best that was found is told."""
MILLI: Final = 1_000
WORD_MS: Final = 60_000
"""Time for which a person's word also means the act that an earlier stop has ended: the signature comes later."""
LOST: Final = frozenset({LeaseEnding.LEFT, LeaseEnding.CUT, LeaseEnding.SILENT, LeaseEnding.MALFORMED})
"""Endings of a lease by which its program is gone; in the midst of a motion that is a loss."""
_OF_OUTCOME: Final = {
    MotionOutcome.AUTHORITY_LOST: LatchCause.AUTHORITY,
    MotionOutcome.WORLD_CHANGED: LatchCause.WATCH,
}
_CODES: Final = frozenset(Reason.__members__) | frozenset(PepFault.__members__)


class AssessedWays(Protocol):
    """The physics: `pep.world.world.CellPhysics`."""

    def assess(self, request: Request, *, touch: frozenset[str]) -> Assessed:
        """See `pep.base.ports.Physics.assess`."""
        ...


def stop_of(end: MotionEnd | None, permit: Permit, *, late: bool, safety_mode: int | None) -> LatchedStop | None:
    """The stop that ended a motion, as it may latch the robot; None for any ordinary end.

    Args:
        end: how it ended; None where following it broke.
        permit: of the motion.
        late: whether it was stopped because it could not be looked at often enough.
        safety_mode: of the controller, afterwards; None while it says nothing.
    """
    outcome = MotionOutcome.ROBOT_FAILED if end is None else end.end
    reason = "" if end is None else end.reason
    cause = _OF_OUTCOME.get(outcome)
    if safety_mode is not None and safety_mode not in SAFE_MODES:
        cause, reason = LatchCause.SAFETY_STOP, str(Reason.ROBOT_SAFETY_STOP)
    elif cause is None and late:
        cause, reason = LatchCause.WATCH, str(Reason.WATCH_LATE)
    elif cause is None and outcome is MotionOutcome.ROBOT_FAILED:
        cause, reason = LatchCause.ROBOT_FAILED, reason if reason in _CODES else str(Reason.EFFECT_FAILED)
    return None if cause is None else LatchedStop(cause, reason, tier_of(permit), permit.request_id)


def lost_with(ending: LeaseEnding, permit: Permit) -> LatchedStop | None:
    """The stop of a motion whose lease ends; None for an end by its owner or by the gateway's own.

    Args:
        ending: of the lease.
        permit: of the motion that is under way.
    """
    if ending in LOST:
        cause = LatchCause.CLIENT_LOST
    elif ending is LeaseEnding.AUTHORITY:
        cause = LatchCause.AUTHORITY
    elif ending is LeaseEnding.ROBOT:
        cause = LatchCause.ROBOT_FAILED
    else:
        return None
    return LatchedStop(cause, "", tier_of(permit), permit.request_id)


def interrupted(records: Iterable[Mapping[str, Any]]) -> list[LatchedStop]:
    """Motions that an earlier process left under way, oldest first: permitted, and without an outcome.

    Args:
        records: of the whole journal, oldest first.
    """
    left: dict[str, LatchedStop] = {}
    for record in records:
        body = record["body"]
        match record["kind"]:
            case "decision" if body["decision"]["effect"] == "PERMIT":
                request, tier = body["request"], body["decision"]["tier"]
                operation = operation_of(request["object"], request["operation"])
                if operation is not None and operation.kind is OperationKind.MOTION:
                    known = None if tier is None else Tier(tier)
                    left[request["id"]] = LatchedStop(LatchCause.INTERRUPTED, "", known, request["id"])
            case "outcome":
                left.pop(body["request_id"], None)
            case _:
                pass
    return list(left.values())


def tier_of(permit: Permit) -> Tier | None:
    """Tier of a stopped act: of its decision, or a higher one that the watch saw; None where nothing says."""
    seen = None if permit.watched is None else permit.watched.get("index_milli")
    if permit.tier is None:
        return None
    return max(permit.tier, Tier(min(max(Tier), -(-seen // MILLI)))) if isinstance(seen, int) else permit.tier


class Latching:
    """The latch of one robot over its motions and leases. On one event loop, but for `heard`.

    Args:
        latches: of the robot.
        starts: of what was assessed.
        ways: assesses ways out.
        newest: newest package of the controller.
        halted: whether no stop is under way.
        under_way: permit of the motion that is being followed; None while there is none.
        counted: makes every earlier permit void.
        audience: canonical URL of the server.
        clock: both clocks.
        failed: told of what could not be kept, each time.
    """

    def __init__(
        self,
        latches: Latches,
        *,
        starts: AssessedStarts,
        ways: AssessedWays,
        newest: Callable[[], Package],
        halted: Callable[[], bool],
        under_way: Callable[[], Permit | None],
        counted: Callable[[], None],
        audience: str,
        clock: Clock,
        failed: Callable[[Exception], None],
    ) -> None:
        self.latches = latches
        self._starts = starts
        self._ways = ways
        self._newest = newest
        self._halted = halted
        self._under_way = under_way
        self._counted = counted
        self._audience = audience
        self._clock = clock
        self._failed = failed
        self._unsafe = False
        self._since_ms: tuple[str, int] = "", 0
        self._asked: tuple[LatchedStop, int] | None = None  # newest asked stop of a moving arm, and when
        self._worker = ThreadPoolExecutor(1, "latch")

    # ---- what latches

    async def after(self, end: MotionEnd | None, permit: Permit, *, late: bool) -> None:
        """See `pep.rtde.motion.motions.MotionEnded`; a latch is on disk when this returns, or told as not kept."""
        state = self._newest().state
        self._stopped(stop_of(end, permit, late=late, safety_mode=None if state is None else state.safety_mode))
        await self.keep()

    def lease_ended(self, ending: LeaseEnding) -> None:
        """Latches where a lease ends in the midst of a motion, and not by its owner.

        The end of the motion keeps the latch.
        """
        moving = self._under_way()
        if moving is not None:
            self._stopped(lost_with(ending, moving))

    def asked(self, person: str = "") -> None:
        """Latches after a stop that was asked for: always by a known person's word, else where the policies say so.

        Args:
            person: whose signed word on it counts ([STM-26]), or "" ([LIV-2]).
        """
        now_ms, moving = self._clock.monotonic_ms(), self._under_way()
        stop = LatchedStop(LatchCause.ASKED, "", Tier.NO_EFFECT, "", person)
        if moving is not None:
            stop = replace(stop, tier=tier_of(moving), request_id=moving.request_id)
            self._asked = stop, now_ms
        elif person and self._asked is not None and now_ms - self._asked[1] <= WORD_MS:
            stop = replace(self._asked[0], person=person)
        self._stopped(stop)

    def look(self) -> None:
        """Latches where the controller has stopped for safety since the last look."""
        state = self._newest().state
        unsafe = state is not None and state.safety_mode not in SAFE_MODES
        if unsafe and not self._unsafe:
            moving = self._under_way()
            tier, act = (Tier.NO_EFFECT, "") if moving is None else (tier_of(moving), moving.request_id)
            self._stopped(LatchedStop(LatchCause.SAFETY_STOP, str(Reason.ROBOT_SAFETY_STOP), tier, act))
        self._unsafe = unsafe if state is not None else self._unsafe

    def _stopped(self, stop: LatchedStop | None) -> None:
        if stop is not None and self.latches.stopped(stop):
            self._counted()  # what was decided before and not yet sent is sent no more

    # ---- what follows

    async def run(self) -> None:
        """Keeps the latch and works out its way. Runs until it is cancelled."""
        while True:
            self.look()
            await self.keep()
            found = self.latches.in_force
            if found is not None and not found.text:
                try:
                    await self._propose(found.latch.latch_id, found.latch.request_id)
                except (OSError, PepError) as error:
                    self._failed(error)
            await asyncio.sleep(LOOK_S)

    async def keep(self) -> None:
        """The latch is on disk and on record; a failure is told, and the next look tries again."""
        if self.latches.unkept:
            try:
                await asyncio.to_thread(self.latches.keep)
            except (OSError, PepError) as error:
                self._failed(error)  # latched all the same

    async def _propose(self, latch_id: str, request_id: str) -> None:
        now_ms = self._clock.monotonic_ms()
        if self._since_ms[0] != latch_id:
            self._since_ms = latch_id, now_ms
        way: Retreat | str = str(Reason.ROBOT_NOT_RUNNING)
        if self.stands:
            back = self._starts.start_of(request_id)
            way = await asyncio.get_running_loop().run_in_executor(self._worker, self._way, back)
        elif now_ms - self._since_ms[1] <= STANDS_MS:
            return
        await asyncio.get_running_loop().run_in_executor(self._worker, self.latches.propose, way)

    def _way(self, back_rad: Sequence[float] | None) -> Retreat | str:
        state = self._newest().state
        if state is None:
            return str(Reason.ROBOT_NOT_RUNNING)
        until_ms = self._clock.monotonic_ms() + WAY_MS
        return proposed(
            _urad(state.q_rad),
            None if back_rad is None else _urad(back_rad),
            lambda request: self._ways.assess(request, touch=frozenset()).impact,
            audience=self._audience,
            at=self._clock.wall_s(),
            new_id=lambda: secrets.token_hex(16),
            late=lambda: self._clock.monotonic_ms() > until_ms,
        )

    @property
    def stands(self) -> bool:
        """True where the arm is seen to stand, and no stop is under way."""
        return self._newest().still and self._halted()

    # ---- clearing

    def heard(self, answers: Answers) -> None:
        """Takes in the clearings of a verified word of the provider. On any thread."""
        try:
            self.latches.accept(answers.clearings, stands=self.stands)
        except OSError as error:
            self._failed(error)

    def summary(self) -> Mapping[str, object]:
        """Summary for people."""
        return self.latches.summary()

    def close(self) -> None:
        """Ends its thread; what is latched is latched again by the next process."""
        self._worker.shutdown(wait=True, cancel_futures=True)


def _urad(angles_rad: Sequence[float]) -> tuple[int, ...]:
    return tuple(round(angle * Unit.MICRORADIAN.per_si) for angle in angles_rad)
