"""Signed words of people on a stop, verified by the enforcement point itself ([STM-26]).

A word is looked at after the stop has begun. Its faults delay and refuse no stop: such a word only latches nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from capabilities.proof.freshness import retention_ms
from capabilities.statements.people import stop as statement
from capabilities.statements.statement_form import signer_thumbprint
from capabilities.values.errors import CapabilityError, FaultCode
from pep.base.errors import ReplayStoreError
from pep.people.votes import own_key

if TYPE_CHECKING:
    from capabilities.statements.people.stop import Stop
    from capabilities.values.caps import Caps
    from pep.base.ports import Approvers, Clock, ReplayStore


class StopFault(StrEnum):
    """Reason why a signed word on a stop does not count, beside the faults of a statement."""

    STOP_NOT_FOR_THIS_ROBOT = "STOP_NOT_FOR_THIS_ROBOT"
    STOP_NOT_YOURS = "STOP_NOT_YOURS"
    STOP_OUT_OF_TIME = "STOP_OUT_OF_TIME"
    STOP_USED = "STOP_USED"


@dataclass(frozen=True, slots=True)
class StopPlace:
    """The robot that a word must mean.

    Attributes:
        issuer: canonical URL of the identity provider.
        audience: canonical URL of the cell.
        robot: the robot's name in requests.
        started_s: earliest time that a word may state, seconds since the epoch: an older one may have counted already.
    """

    issuer: str
    audience: str
    robot: str
    started_s: float


def read_stop(
    text: str, place: StopPlace, people: Approvers, *, at: float, caps: Caps
) -> tuple[Stop, bytes] | StopFault | FaultCode:
    """The word with its signer's raw key, where it counts now for this robot; else the code of its fault.

    Whether it counted before is not asked here.

    Args:
        text: as it came.
        place: the robot.
        people: registered approvers, as of now.
        at: now, seconds since the epoch.
        caps: bounds.
    """
    known = people.approvers()
    try:
        stop = statement.open(text, list(known), caps)
    except CapabilityError as error:
        return error.code
    key = own_key(known, stop.person, signer_thumbprint(text))
    if key is None:
        return StopFault.STOP_NOT_YOURS
    # [STM-26] this cell, this robot
    if (stop.issuer, stop.audience, stop.robot) != (place.issuer, place.audience, place.robot):
        return StopFault.STOP_NOT_FOR_THIS_ROBOT
    if not (place.started_s <= stop.at <= at + caps.skew_s and at <= stop.not_after):
        return StopFault.STOP_OUT_OF_TIME
    return stop, key


@dataclass(frozen=True, slots=True)
class SpokenStop:
    """A word that counts: once, and now.

    Attributes:
        stop: its members.
        text: as it was signed.
        key: raw public key that signed it.
    """

    stop: Stop
    text: str
    key: bytes


class StopWords:
    """Reader of words on stops at one robot. From any thread.

    Args:
        place: the robot.
        people: registered approvers.
        replay: ids that counted.
        clock: both clocks.
        caps: bounds.
    """

    def __init__(self, place: StopPlace, *, people: Approvers, replay: ReplayStore, clock: Clock, caps: Caps) -> None:
        self._place = place
        self._people = people
        self._replay = replay
        self._clock = clock
        self._caps = caps

    def read(self, text: str) -> SpokenStop | StopFault | FaultCode:
        """The word, used up now; else the code of its fault."""
        found = read_stop(text, self._place, self._people, at=self._clock.wall_s(), caps=self._caps)
        if isinstance(found, str):
            return found
        stop, key = found
        expires_ms = self._clock.monotonic_ms() + retention_ms(self._caps)
        try:
            first = self._replay.first_use(stop.stop_id, key=key, expires_ms=expires_ms)
        except ReplayStoreError:
            first = False  # that it counted before cannot be excluded
        return SpokenStop(stop, text, key) if first else StopFault.STOP_USED
