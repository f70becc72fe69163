"""The right to one effect: made by the gate, spent once by the sender, worthless a moment later."""

from __future__ import annotations

import threading
from contextvars import ContextVar
from typing import TYPE_CHECKING, Final

from pep.base.errors import ActuationRefusedError
from policies.evidence.model import ObligationKind
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from capabilities.values.errors import Fault
    from capabilities.values.scope import Tier
    from capabilities.values.units import Quantity
    from pep.base.ports import Clock
    from policies.evidence.model import Decision, Obligation, Request


def unfulfilled(decision: Decision, request: Request) -> Obligation | None:
    """The first obligation of a PERMIT that will not be fulfilled here; a PERMIT with one is void.

    A gate records, consumes approvals and sends nothing but what was decided; the watch of its shell watches. What else
    a policy may ask for, nobody does yet.
    """
    for obligation in decision.obligations:
        match obligation.kind:
            case ObligationKind.RECORD | ObligationKind.WATCH | ObligationKind.CONSUME:
                continue
            case ObligationKind.CLAMP if _within(obligation.at_most, request):
                continue
            case _:
                return obligation
    return None


def _within(at_most: Quantity | None, request: Request) -> bool:
    """True where the request has that parameter, in that unit, no higher."""
    return at_most is not None and any(
        (value.name, value.unit) == (at_most.name, at_most.unit) and value.value <= at_most.value
        for value in request.quantities
    )


START_TOLERANCE_RAD: Final = 2e-3
"""The arm may differ this much from where the assessment began; as an approval binds it."""


class Permit:
    """One decided effect. The gate makes it; `spend` is the only way to use it, and works once.

    Attributes:
        request_id: of the request that was decided.
        agent: agent of the request; "" when nobody needs to know.
        tier: of the decision; None where it had none.
        digest: `Request.digest` of what was decided.
        since_ms: monotonic time at which the request arrived; a stop after that voids the permit.
        deadline_ms: monotonic time after which nothing may be sent.
        request: the decided request, for judgements of the rest of its motion; None only where nothing moves.
        index_milli: the authorised impact index in thousandths; 0 allows no impact at all.
        sighted: whether it was given on fresh perception; then it lasts only while there is some.
        touch: objects that the token grants to be touched.
        spent: whether `spend` has succeeded.
        refusal: reason why the last `spend` failed, or None.
        concluded: whether its outcome has been handed to the journal.
        watched: finding of the watch that ended the effect, as plain JSON for its record; None while it has not.
    """

    def __init__(
        self,
        *,
        request_id: str,
        digest: str,
        since_ms: int,
        deadline_ms: int,
        clock: Clock,
        standing: Callable[[], Fault | None],
        request: Request | None = None,
        index_milli: int = 0,
        sighted: bool = True,
        touch: frozenset[str] = frozenset(),
        agent: str = "",
        tier: Tier | None = None,
        again: Callable[[], Reason | None] | None = None,
    ) -> None:
        self.request_id = request_id
        self.agent = agent
        self.tier = tier
        self.digest = digest
        self.since_ms = since_ms
        self.deadline_ms = deadline_ms
        self.request = request
        self.index_milli = index_milli
        self.sighted = sighted
        self.touch = touch
        self.spent = False
        self.refusal: Reason | None = None
        self.concluded = False
        self.watched: Mapping[str, object] | None = None
        self._clock = clock
        self._standing = standing
        self._again = self._ended if again is None else again
        self._lock = threading.Lock()

    def spend(self, *, digest: str, stopped_ms: int | None) -> None:
        """Spends the permit: the one effect may be sent now.

        Args:
            digest: of what is about to be sent, computed from the very numbers that will be.
            stopped_ms: monotonic time of the newest stop, or None when there was none.

        Raises:
            ActuationRefusedError: `NOT_WHAT_WAS_DECIDED` for another digest or a second use, `VERDICT_EXPIRED` when it
                is too late or a stop came in between. The permit is then spoilt for good.
        """
        with self._lock:
            reason, detail = self._why_not(digest, stopped_ms)
            if reason is not None:
                self.refusal = reason
                raise ActuationRefusedError(reason, detail)
            self.spent = True

    def spend_act(self, *, digest: str) -> None:
        """Spends the permit of an act that nothing watches: all that it rests on is looked at once more.

        Args:
            digest: as for `spend`.

        Raises:
            ActuationRefusedError: as `spend`; the reason for which it would not be permitted now.
        """
        reason = self._again()
        if reason is not None:
            with self._lock:
                self.refusal = reason
            raise ActuationRefusedError(reason, "it was permitted, and would not be now")
        self.spend(digest=digest, stopped_ms=None)

    def _ended(self) -> Reason | None:
        fault = self._standing()
        return None if fault is None else Reason(fault.code)

    def _why_not(self, digest: str, stopped_ms: int | None) -> tuple[Reason | None, str]:
        if self.refusal is not None:
            return self.refusal, "the permit is spoilt"
        if self.spent:
            return Reason.NOT_WHAT_WAS_DECIDED, "the permit was used before"
        if digest != self.digest:
            return Reason.NOT_WHAT_WAS_DECIDED, "what would be sent differs from what was decided"
        if stopped_ms is not None and stopped_ms >= self.since_ms:
            return Reason.VERDICT_EXPIRED, "a stop came after the request"
        if not self._clock.monotonic_ms() <= self.deadline_ms:
            return Reason.VERDICT_EXPIRED, "the decision is too old"
        return None, ""

    def begins(self, *, assessed_rad: Sequence[float] | None, at_rad: Sequence[float]) -> None:
        """Checks that the motion begins here: each joint within 2 mrad of the start of its assessment.

        Args:
            assessed_rad: joint angles from which the request was assessed; None when it was not.
            at_rad: measured joint angles now.

        Raises:
            ActuationRefusedError: `NOT_WHAT_WAS_DECIDED`. The permit is then spoilt for good.
        """
        near = assessed_rad is not None and len(assessed_rad) == len(at_rad)
        if near and all(abs(a - b) <= START_TOLERANCE_RAD for a, b in zip(assessed_rad or (), at_rad, strict=True)):
            return
        with self._lock:
            self.refusal = Reason.NOT_WHAT_WAS_DECIDED
        raise ActuationRefusedError(self.refusal, "the arm is not where the assessment began")

    def void(self) -> bool:
        """True when nothing was sent on it, and nothing can be any more."""
        with self._lock:
            self.refusal = self.refusal or Reason.VERDICT_EXPIRED
            return not self.spent

    def standing(self) -> Fault | None:
        """Fault of the authority behind it; None while the chain is valid and the revocation view fresh."""
        return self._standing()


_CURRENT: Final[ContextVar[Permit | None]] = ContextVar("ztpm_permit", default=None)


def current_permit() -> Permit | None:
    """The permit of the gate run inside which this code is called, or None outside of any."""
    return _CURRENT.get()


class PermitScope:
    """A block inside which `current_permit` gives this permit."""

    def __init__(self, permit: Permit) -> None:
        self._permit = permit

    def __enter__(self) -> None:
        self._token = _CURRENT.set(self._permit)

    def __exit__(self, *_: object) -> None:
        _CURRENT.reset(self._token)
