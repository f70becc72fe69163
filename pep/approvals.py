"""Open deferrals: each asked once, each with an end. Silence denies.

The answers of people arrive by another way; here a deferral is opened, repeats are collapsed into it, and when its time
is over the denial is on record, even if nobody ever comes back for it.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final, TypeAlias

from policies.reasons import Reason

if TYPE_CHECKING:
    from capabilities.scope import Tier
    from pep.ports import Clock, Journal
    from policies.model import Decision, Request

CAPACITY: Final = 1_024
"""Deferrals held at once, open and expired; the oldest expired one is forgotten first."""


_Key: TypeAlias = tuple[str, str, str, "Tier | None"]


class AskState(Enum):
    """What has become of a deferral."""

    OPEN = "open"
    EXPIRED = "expired"


@dataclass(frozen=True, slots=True)
class Ask:
    """One deferral.

    Attributes:
        ask_id: the request id of the call that opened it.
        agent: leaf agent that asked.
        request_digest: what it asked for.
        reason: why it was deferred.
        expires_ms: monotonic time of its end.
        expires_at: the same in seconds since the epoch, for people.
    """

    ask_id: str
    agent: str
    request_digest: str
    reason: str
    expires_ms: int
    expires_at: float


class Asks:
    """All deferrals of one PEP.

    Args:
        clock: both clocks.
        journal: takes the record of each expiry.
        timeout_ms: how long a deferral stays open.
    """

    def __init__(self, *, clock: Clock, journal: Journal, timeout_ms: int) -> None:
        self._clock = clock
        self._journal = journal
        self._timeout_ms = timeout_ms
        self._lock = threading.Lock()
        self._open: OrderedDict[_Key, Ask] = OrderedDict()
        self._expired: OrderedDict[_Key, Ask] = OrderedDict()

    def consult(self, *, agent: str, request: Request, decision: Decision) -> tuple[AskState, Ask]:
        """The deferral that stands for this agent, this very request and this question, opened now when there is none.

        The question is reason and tier: what was asked about a glass is no answer about a person. An expired one is
        told once; the next identical request asks anew.

        Args:
            agent: the leaf agent.
            request: deferred.
            decision: the DEFER.

        Raises:
            pep.errors.JournalError: when an expiry could not be recorded.
        """
        self.expire()
        key = (agent, request.digest, str(decision.reason), decision.tier)
        with self._lock:
            told = self._expired.pop(key, None)
            if told is not None:
                return AskState.EXPIRED, told
            ask = self._open.get(key)
            if ask is None:
                if len(self._open) >= CAPACITY:
                    # A flood of questions is answered by silence, which denies.
                    return AskState.EXPIRED, self._ask(key, request, decision)
                ask = self._open[key] = self._ask(key, request, decision)
            return AskState.OPEN, ask

    def _ask(self, key: _Key, request: Request, decision: Decision) -> Ask:
        return Ask(
            ask_id=request.request_id,
            agent=key[0],
            request_digest=key[1],
            reason=str(decision.reason),
            expires_ms=self._clock.monotonic_ms() + self._timeout_ms,
            expires_at=self._clock.wall_s() + self._timeout_ms / 1000,
        )

    def expire(self) -> tuple[Ask, ...]:
        """The deferrals whose time was over now; for each a denial is on record.

        Raises:
            pep.errors.JournalError: when one could not be recorded; it then stays open, and the next call tries again.
        """
        ended: list[Ask] = []
        with self._lock:
            now = self._clock.monotonic_ms()
            for key, ask in list(self._open.items()):
                if now < ask.expires_ms:
                    continue
                self._journal.append("ask-expired", expired_body(ask.ask_id, ask.request_digest))
                del self._open[key]
                self._expired[key] = ask
                ended.append(ask)
            while len(self._expired) > CAPACITY:
                self._expired.popitem(last=False)
        return tuple(ended)


def expired_body(ask_id: str, request_digest: str) -> dict[str, object]:
    """The body of an "ask-expired" record."""
    return {
        "ask_id": ask_id,
        "request_digest": request_digest,
        "effect": "DENY",
        "reason": str(Reason.APPROVAL_TIMEOUT),
    }
