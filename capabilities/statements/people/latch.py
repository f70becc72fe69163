"""Latch of a robot after a stop, signed by its enforcement point.

It holds all that people read before they clear it. Clause [STM-22] in docs/spec.md.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Final

from msgspec import Meta

from capabilities.statements import statement_form
from capabilities.statements.claims import Id, IdOrEmpty, Name, NameOrEmpty, Signed, Url, Whole, malformed, read, unique
from capabilities.values.form import Form, plain, within
from capabilities.values.scope import Tier

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "latch"
JOINTS: Final = 6


class LatchCause(StrEnum):
    """Cause of a latch: the sort of stop after which a robot waits for a person."""

    SAFETY_STOP = "safety-stop"
    """The controller has stopped the arm: a protective or an emergency stop, a violation or fault of its own."""
    WATCH = "watch"
    """The watch has stopped it: the world was no longer as authorised, or could not be seen to be."""
    AUTHORITY = "authority"
    """Its authority was revoked, ran out or could no longer be told while it moved."""
    CLIENT_LOST = "client-lost"
    """The program that moved it was gone before the arm stood."""
    ROBOT_FAILED = "robot-failed"
    """The arm did not do what was permitted: it stood, was silent or took too long."""
    ASKED = "asked"
    """It was asked for, without a name or with the signed word of a known person ([STM-26])."""
    INTERRUPTED = "interrupted"
    """The enforcement point ended while an act was under way."""
    UNREADABLE = "unreadable"
    """The file of the latch cannot be read, so nobody knows that there is none."""


def approvers_after(tier: Tier) -> int:
    """Number of different people who have to clear it after the stop of an act of this tier."""
    return 2 if tier is Tier.SAFETY_CRITICAL else 1


class Turn(Form, frozen=True):
    """One joint of a retreat, 0 to 5, and how far it turns in µrad."""

    joint: Annotated[int, within(0, JOINTS - 1)]
    by_urad: Signed


class Retreat(Form, frozen=True):
    """A certified way out: a straight move in joint space. It is a proposal and permits nothing.

    Attributes:
        turns: joints that turn, rising.
        target_urad: joint angles at its end, six.
        speed_urad_s: highest speed of a joint.
        tier, index_milli: impact of it, as the physics had it from where the arm stood.
    """

    turns: Annotated[tuple[Turn, ...], Meta(min_length=1, max_length=JOINTS)]
    target_urad: Annotated[tuple[Signed, ...], Meta(min_length=JOINTS, max_length=JOINTS)]
    speed_urad_s: Whole
    tier: Tier
    index_milli: Annotated[int, within(0, 4_000)]


class Latch(Form, frozen=True):
    """Latch of one robot.

    Attributes:
        latch_id: 32 hex digits, random, so that no clearing of another latch fits.
        issuer: the identity provider that carries it.
        pep, audience, robot: the enforcement point, the canonical URL of its server, and its robot.
        cause: a `LatchCause`.
        reason: the code of the stop, or "".
        tier: of the act that was stopped; 0 where none was, the highest where it is not known.
        approvers: how many different people have to clear it.
        request_id: of the act that was stopped, or "".
        at: seconds since the epoch.
        retreat: the way out that the physics proposes, one or none.
        no_retreat: the code of why there is none; "" beside one.
        person: the person whose signed word was on the stop, or "".
    """

    latch_id: Id
    issuer: Url
    pep: Name
    audience: Url
    robot: Name
    cause: LatchCause
    reason: NameOrEmpty
    tier: Tier
    approvers: Annotated[int, within(1, 2)]
    request_id: IdOrEmpty
    at: Whole
    retreat: Annotated[tuple[Retreat, ...], Meta(min_length=1, max_length=1)] = ()
    no_retreat: Name = ""
    person: NameOrEmpty = ""


def sign(latch: Latch, key: PrivateKey) -> str:
    """The latch, signed by the enforcement point."""
    return statement_form.seal(KIND, plain(latch), key, _read)


def claims(latch: Latch) -> dict[str, object]:
    """The latch's members as plain JSON values."""
    members: dict[str, object] = plain(latch)
    return members


def read_claims(stated: dict[str, object]) -> Latch:
    """The latch of these members.

    Raises:
        StatementError: `STATEMENT_MALFORMED`.
    """
    return _read(stated)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Latch:  # noqa: A001 - read as latch.open
    """The latch, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for one that asks fewer people than its tier wants.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Latch:
    latch = read(Latch, claims)
    if latch.approvers < approvers_after(latch.tier):
        raise malformed("it asks fewer people than its tier wants")
    for way in latch.retreat:
        unique(way.turns, lambda turn: turn.joint, "a joint")
    if bool(latch.retreat) is bool(latch.no_retreat):
        raise malformed("a retreat, or else why there is none")
    return latch
