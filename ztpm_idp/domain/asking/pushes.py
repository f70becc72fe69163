"""Pushes of questions and latches as the identity provider keeps them, and what is to be sent at an instant.

A push is of one question or latch, by one webhook, once for each event; the store has one row of it, which a worker
takes for a turn before it sends. It ends when it was taken, when it cannot be, or with its question or latch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

TURN_MS: Final = 30_000
"""Ours: milliseconds for which a push is its worker's alone.

A try takes 5 s at most, and its record far less.
"""
MINUTE_MS: Final = 60_000
PAUSES_S: Final = (1, 2, 4, 8, 16, 32, 60)
"""Ours: seconds before each further try; an ask lives for ten minutes at most."""
LATCH_PAUSES_S: Final = (*PAUSES_S, 600, 600, 600, 600, 600, 600)
"""Ours: likewise for a latch, which waits until people come: an hour of a silent webhook loses none."""


class PushCode(StrEnum):
    """Reasons for which a question or latch was not pushed."""

    PUSH_UNREACHABLE = "PUSH_UNREACHABLE"
    PUSH_NOT_TAKEN = "PUSH_NOT_TAKEN"
    PUSH_REFUSED = "PUSH_REFUSED"
    PUSH_OVER_BUDGET = "PUSH_OVER_BUDGET"


class PushEvent(StrEnum):
    """Event that a webhook is told of: people are waited for, or no more."""

    OPENED = "opened"
    ENDED = "ended"


class Matter(StrEnum):
    """Kind of what people are told of."""

    ASK = "ask"
    LATCH = "latch"


@dataclass(frozen=True, slots=True, order=True)
class Occasion:
    """Occasion of a push, its subject: one ask or one latch, by its id."""

    matter: Matter
    id: str


@dataclass(frozen=True, slots=True)
class Awaited:
    """Occasion as far as it matters when it is pushed: whether it waits for people now."""

    subject: Occasion
    waits: bool


Key: TypeAlias = tuple[Occasion, str, PushEvent]


@dataclass(frozen=True, slots=True)
class Push:
    """Push of one subject, by one webhook, of one event.

    Attributes:
        subject, webhook, event: which one it is.
        tries: times that it was sent.
        begun_ms: when it was sent first, milliseconds since the epoch; 0: not yet.
        due_ms: when it is to be sent again; while a worker has it, the end of its turn.
        code: reason of the last try's failure, or of waiting; None: there is none.
        done: nothing more is sent.
    """

    subject: Occasion
    webhook: str
    event: PushEvent
    tries: int = 0
    begun_ms: int = 0
    due_ms: int = 0
    code: PushCode | None = None
    done: bool = False

    @property
    def key(self) -> Key:
        """The names of it."""
        return self.subject, self.webhook, self.event

    @property
    def taken(self) -> bool:
        """True once the webhook has it."""
        return self.done and self.code is None

    def tried(self, code: PushCode | None, *, again: bool, again_s: int, at_ms: int) -> Push:
        """The push after a try.

        Args:
            code: the reason of its failure; None: the webhook took it.
            again: it may be sent once more.
            again_s: pause that the webhook asks for, at least.
            at_ms: now.
        """
        pauses = LATCH_PAUSES_S if self.subject.matter is Matter.LATCH else PAUSES_S
        left = pauses[self.tries - 1 :]
        if code is None or not again or not left:
            return replace(self, code=code, done=True, due_ms=at_ms)
        return replace(self, code=code, due_ms=at_ms + max(left[0], again_s) * 1_000)


@dataclass(frozen=True, slots=True)
class Listed:
    """Webhook as far as it matters when something is pushed.

    Attributes:
        name: of it.
        ends: it is told of ends, too.
    """

    name: str
    ends: bool


@dataclass(frozen=True, slots=True)
class PushFailed:
    """A question or latch was not pushed, and is not any more.

    The ledger's entry is all there is of it.

    Attributes:
        push: as it ended, with its reason.
    """

    push: Push


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan of an instant: pushes, each as it is to be kept.

    Attributes:
        send: are sent now, in their worker's turn.
        wait: have no room in their webhook's minute, for the first time or again.
        given_up: nobody was waited for any more before they were taken.
    """

    send: tuple[Push, ...] = ()
    wait: tuple[Push, ...] = ()
    given_up: tuple[Push, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.send or self.wait or self.given_up)


def planned(
    awaited: Sequence[Awaited],
    pushes: Mapping[Key, Push],
    webhooks: Iterable[Listed],
    *,
    a_minute: int,
    most: int,
    at_ms: int,
) -> Plan:
    """The plan of now.

    Args:
        awaited: of what may wait for people, or did a moment ago; the oldest first.
        pushes: of these subjects.
        webhooks: all of them.
        a_minute: questions that a webhook is told of in a minute, and as many latches, so that no agent's questions
            delay a latch.
        most: pushes that may be sent now.
        at_ms: wall clock.
    """
    send, wait, given_up = list[Push](), list[Push](), list[Push]()
    for webhook in webhooks:
        begun = {matter: _begun(pushes.values(), webhook, matter, since_ms=at_ms - MINUTE_MS) for matter in Matter}
        for each in awaited:
            opened = pushes.get((each.subject, webhook.name, PushEvent.OPENED))
            if not each.waits:
                if opened is not None and not opened.done:
                    if opened.due_ms <= at_ms:  # else it is in a worker's turn, which may end well
                        code = opened.code or PushCode.PUSH_NOT_TAKEN
                        given_up.append(replace(opened, code=code, done=True, due_ms=at_ms))
                elif webhook.ends and opened is not None and opened.taken:
                    key = (each.subject, webhook.name, PushEvent.ENDED)
                    send += _due(pushes.get(key, Push(*key)), at_ms)
                continue
            push = Push(each.subject, webhook.name, PushEvent.OPENED) if opened is None else opened
            told = begun[each.subject.matter]
            for due in _due(push, at_ms):
                if due.tries > 1 or len(told) < a_minute:
                    told += [at_ms] if due.tries == 1 else []
                    send.append(due)
                else:
                    wait.append(replace(push, code=PushCode.PUSH_OVER_BUDGET, due_ms=told[-a_minute] + MINUTE_MS))
    # A latch goes before questions, and what is new before what a webhook did not take.
    send.sort(key=lambda push: (push.subject.matter is not Matter.LATCH, push.tries))
    return Plan(tuple(send[:most]), tuple(wait), tuple(given_up))


def _begun(pushes: Iterable[Push], webhook: Listed, matter: Matter, *, since_ms: int) -> list[int]:
    """Times at which the webhook was first told of each, rising."""
    return sorted(
        each.begun_ms
        for each in pushes
        if (each.webhook, each.subject.matter, each.event) == (webhook.name, matter, PushEvent.OPENED)
        and each.begun_ms > since_ms
    )


def _due(push: Push, at_ms: int) -> list[Push]:
    """The push as a worker takes it for its turn; nothing where it is another's, done, or not due."""
    if push.done or push.due_ms > at_ms:
        return []
    return [replace(push, tries=push.tries + 1, begun_ms=push.begun_ms or at_ms, due_ms=at_ms + TURN_MS)]
