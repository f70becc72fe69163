"""Latch of one robot: durable from its stop on, until people have cleared it ([LSD-21], [LSD-22]).

    a stop ─▶ latched, at once ─▶ file and journal ─▶ a way out proposed, signed, told ─▶ clearings ─▶ cleared

The unknown keeps it latched: a file that cannot be read is a latch of its own, a file that is gone is made
again out of the journal, and an enforcement point that ended in the midst of an act latches when it is there again.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from msgspec import structs

from capabilities.keys.keys import public_raw
from capabilities.statements.people import latch as statement
from capabilities.statements.people.latch import Latch, LatchCause, Retreat, approvers_after
from capabilities.statements.people.vote import digest_of
from capabilities.values.errors import CapabilityError
from capabilities.values.scope import Tier
from pep.base.errors import PepFault
from pep.people.clearings import count
from pep.people.latch_file import InForce
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from capabilities.values.caps import Caps
    from pep.base.ports import Approvers, Clock, Journal
    from pep.people.ask_composer import Asker
    from pep.people.latch_file import LatchFile

LATCHED: Final = "latched"
CLEARED: Final = "latch-cleared"
RETREAT: Final = "latch-retreat"
"""Kinds of the journal's records."""
REJECTED: Final = 64
"""Most clearings of one latch of which it is told that they do not count."""


@dataclass(frozen=True, slots=True)
class LatchedStop:
    """A stop, as it may latch the robot.

    Attributes:
        cause: the sort of it.
        reason: its code, or "".
        tier: of the act that was stopped; None where that is not known.
        request_id: of that act, or "".
        person: whose signed word was on it, so that it latches under any policies; or "".
    """

    cause: LatchCause
    reason: str = ""
    tier: Tier | None = None
    request_id: str = ""
    person: str = ""


class Latches:
    """The latch of one robot. From any thread.

    Args:
        file: of it.
        journal: takes the latch and its clearing.
        clock: both clocks.
        author: this enforcement point, which signs the latch.
        robot: the robot's name in requests.
        causes: stops that latch it, as the policies say.
        approvers: the registered approvers' keys.
        caps: bounds on statements.
        new_id: 32 random hex digits.
    """

    def __init__(
        self,
        file: LatchFile,
        *,
        journal: Journal,
        clock: Clock,
        author: Asker,
        robot: str,
        causes: Collection[LatchCause],
        approvers: Approvers,
        caps: Caps,
        new_id: Callable[[], str],
    ) -> None:
        self._file = file
        self._journal = journal
        self._clock = clock
        self._author = author
        self._robot = robot
        self._causes = frozenset(causes)
        self._approvers = approvers
        self._caps = caps
        self._new_id = new_id
        self._lock = threading.Lock()
        self._writing = threading.Lock()
        self._found: InForce | None = None
        self._unkept = False
        self._rejected: set[str] = set()

    @property
    def in_force(self) -> InForce | None:
        """The latch; None while there is none."""
        return self._found

    @property
    def latch_id(self) -> str | None:
        """Id of the latch; None while there is none."""
        found = self._found
        return None if found is None else found.latch.latch_id

    @property
    def unkept(self) -> bool:
        """True while the latch is not on disk and on record yet."""
        return self._unkept

    # -- latching

    def stopped(self, stop: LatchedStop) -> bool:
        """Latches the robot after that stop, at once; false where it does not latch.

        The latch is on disk and on record with the next `keep`. A further stop is part of the same until people were
        told of it, and may raise its tier or name a person; from then on it is a latch of its own in place of the
        other, which no earlier clearing fits.
        """
        with self._lock:
            before, tier = self._found, Tier.SAFETY_CRITICAL if stop.tier is None else stop.tier
            if not (stop.cause in self._causes or stop.person or stop.cause is LatchCause.UNREADABLE):
                return False
            if before is not None and not before.text:
                tier, person = max(tier, before.latch.tier), before.latch.person or stop.person
                if (tier, person) != (before.latch.tier, before.latch.person):
                    # more was stopped than was known, or by somebody known: it is kept anew
                    more = structs.replace(before.latch, tier=tier, approvers=approvers_after(tier), person=person)
                    self._found, self._unkept = InForce(more), True
                return False
            self._latch(stop, tier if before is None else max(tier, before.latch.tier))
            return True

    def _latch(self, stop: LatchedStop, tier: Tier) -> None:
        latch = Latch(
            latch_id=self._new_id(),
            issuer=self._author.issuer,
            pep=self._author.pep,
            audience=self._author.audience,
            robot=self._robot,
            cause=stop.cause,
            reason=stop.reason,
            tier=tier,
            approvers=approvers_after(tier),
            request_id=stop.request_id,
            at=int(self._clock.wall_s()),
            no_retreat=str(Reason.EVIDENCE_MISSING),  # until it is worked out
            person=stop.person,
        )
        self._found, self._unkept = InForce(latch), True

    def keep(self) -> None:
        """The latch is on disk, and on record.

        Raises:
            OSError, JournalError: when it could not be made durable. It is in force all the same, and the next call
                tries again.
        """
        with self._writing:
            found = self._found
            if found is None or not self._unkept:
                return
            self._file.write(found)
            self._journal.append("latched", statement.claims(found.latch))
            with self._lock:
                self._unkept = self._found is not found

    def propose(self, way: Retreat | str) -> None:
        """Puts the way out, or the code of why there is none, into the latch's signed text.

        No second call changes it.

        Args:
            way: as the physics has it from where the arm stands.

        Raises:
            OSError, JournalError: as `keep`; the next call tries again.
        """
        with self._writing:
            found = self._found
            if found is None or found.text or self._unkept:
                return
            shown: dict[str, object] = {"retreat": (way,), "no_retreat": ""}
            if not isinstance(way, Retreat):
                shown = {"retreat": (), "no_retreat": way}
            latch = structs.replace(found.latch, **shown)
            told = InForce(latch, statement.sign(latch, self._author.key))
            self._file.write(told)
            members = statement.claims(latch)
            body: dict[str, object] = {
                name: members[name] for name in ("latch_id", "robot", "retreat", "no_retreat") if name in members
            }
            self._journal.append("latch-retreat", body)
            with self._lock:
                if self._found is found:
                    self._found = told

    # -- clearing

    def accept(self, texts: Iterable[str], *, stands: bool) -> None:
        """Clears the latch where enough different people have cleared exactly it, and the arm stands.

        What does not count is told once.

        Args:
            texts: clearings, as the identity provider carries them.
            stands: whether the arm is seen to stand, and no stop is under way.

        Raises:
            OSError, JournalError: when the clearing could not be made durable. The robot stays latched.
        """
        with self._writing:
            found = self._found
            if found is None or not found.text:
                return
            counted = count(texts, found.latch, found.text, self._approvers, at=self._clock.wall_s(), caps=self._caps)
            self._tell(found, counted.rejected)
            if len(counted.approvers) < found.latch.approvers or not stands:
                return
            # [LSD-22] on record before it counts; a file that is left over is known by that record
            cleared: dict[str, object] = {
                "latch_id": found.latch.latch_id,
                "robot": found.latch.robot,
                "cause": str(found.latch.cause),
                "approvers": list(counted.approvers),
                "clearings": list(counted.texts),
            }
            self._journal.append("latch-cleared", cleared)
            self._file.remove()
            with self._lock:
                if self._found is found:  # a stop since is another latch
                    self._found = None
            self._rejected.clear()

    def _tell(self, found: InForce, rejected: Mapping[str, str]) -> None:
        for text, code in rejected.items():
            digest = digest_of(text) if text.isascii() else ""
            if digest not in self._rejected and len(self._rejected) < REJECTED:
                self._rejected.add(digest)
                told: dict[str, object] = {
                    "what": "clearing",
                    "fault": str(code),
                    "latch_id": found.latch.latch_id,
                    "clearing": digest,
                }
                self._journal.append("incident", told)

    # -- a new process

    def recover(self, records: Iterable[Mapping[str, Any]], interrupted: Iterable[LatchedStop]) -> None:
        """State that an earlier process left, on disk again.

        Args:
            records: of the whole journal, oldest first.
            interrupted: acts that it left under way.

        Raises:
            OSError, JournalError: when a latch could not be made durable.
        """
        on_record: Mapping[str, Any] | None = None
        cleared = set[str]()
        for record in records:
            if record["kind"] == LATCHED:
                on_record = record["body"]
            elif record["kind"] == CLEARED:
                cleared.add(record["body"]["latch_id"])
        fault = ""
        try:
            found = self._file.read()
        except (OSError, ValueError, CapabilityError) as error:
            found, fault = None, type(error).__name__
            self._file.set_aside()
        if found is not None and found.latch.latch_id in cleared:
            self._file.remove()
            found = None
        lost = found is None and on_record is not None and on_record["latch_id"] not in cleared
        self._found = None if found is None else self._readable(found)
        if not fault and lost and on_record is not None:
            try:
                self._found = InForce(statement.read_claims(dict(on_record)))
                self._file.write(self._found)
            except CapabilityError as error:
                fault = type(error).__name__
        if fault:
            told: dict[str, object] = {"what": "latch", "fault": str(PepFault.STATE_UNREADABLE), "detail": fault}
            self._journal.append("incident", told)
            self.stopped(LatchedStop(LatchCause.UNREADABLE, str(Reason.EVIDENCE_MALFORMED)))
        for stop in interrupted:
            self.stopped(stop)
        self.keep()

    def _readable(self, found: InForce) -> InForce:
        """The latch, without a text by another key than this point's: it is signed anew."""
        try:
            own = statement.open(found.text, [public_raw(self._author.key)], self._caps) == found.latch
        except CapabilityError:
            own = False
        return found if own or not found.text else InForce(found.latch)

    def summary(self) -> dict[str, object]:
        """Summary for people: the latch, or that there is none."""
        found = self._found
        if found is None:
            return {"latched": False}
        kept = ("latch_id", "cause", "reason", "tier", "approvers", "at", "person")
        members = statement.claims(found.latch)
        return {"latched": True, **{name: members[name] for name in kept if name in members}}
