"""Motion lease: the right to move the robot now. One at a time; all other clients get state and stop.

A lease is opened with a token and a proof, as any request (`capabilities.proof.session_opening`), and lasts while all
of these do: the token, the view of revocations, the session, the beat of the one who holds it. Pure: time is an
    argument.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from capabilities.values.chain import Chain
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from capabilities.proof.session_frames import Session
    from capabilities.values.errors import Fault
    from pep.request.authority import Credentials

BEAT_MS: Final = 500
"""Period in which either end reports that it is still there."""
SILENCE_MS: Final = 1_500
"""DESIGN section 8: three beats that did not come end the lease."""
ID_BYTES: Final = 16
"""Bytes of a lease's id: nobody can guess it, and knowing it gives no key of the session."""


LEASE_OVER: Final = "LEASE_OVER"
"""First word of a program's notice that the lease is over, with the ending."""


class LeaseEnding(StrEnum):
    """Reason why a lease is over; the record's word."""

    CLOSED = "closed"
    """Closed by its holder."""
    LEFT = "left"
    """The program has closed the connection of its commands."""
    ROBOT = "robot"
    """The controller has closed the connection, or is silent."""
    CUT = "cut"
    """The connection that carried it is gone."""
    SILENT = "silent"
    MALFORMED = "malformed"
    """Input came that neither a program nor its side of the carriage sends."""
    AUTHORITY = "authority"
    """The token no longer holds, or its validity cannot be told."""
    STOPPED = "stopped"
    """The arm was stopped on the cell's page, or at the gateway's own address."""
    GATEWAY = "gateway"
    """The gateway ends."""


@dataclass(slots=True, eq=False)
class Lease:
    """One lease. Another token may take the place of the one that it was opened with ([LSD-10]).

    Attributes:
        id: `ID_BYTES` random bytes.
        agent: agent that holds it.
        credentials: token and proof it was opened or last renewed with, verified; looked up for each judgement.
        session: the gateway's end.
        not_after: end of the session, seconds since the epoch.
    """

    id: bytes
    agent: str
    credentials: Credentials
    session: Session
    not_after: int

    def unfit(self, chain: Chain) -> Reason | None:
        """Reason why a token with this verified chain cannot renew the lease; None where it can.

        It has to be for the same agent with the same key, and of the same mandate.
        """
        held = self.credentials.chain
        if not isinstance(held, Chain) or (held.leaf.agent, held.leaf.key) != (chain.leaf.agent, chain.leaf.key):
            return Reason.LEASE_OF_ANOTHER
        if held.mandate_id is None or chain.mandate_id is None:
            return Reason.MANDATE_MISSING
        return None if held.mandate_id == chain.mandate_id else Reason.MANDATE_DIFFERS

    def renew(self, credentials: Credentials, not_after: int, *, at: float) -> Fault | None:
        """Puts another token in the place of the lease's own, for all that is judged from now on.

        Args:
            credentials: verified, and not `unfit`.
            not_after: end of the session from now on, seconds since the epoch.
            at: seconds since the epoch.

        Returns:
            None; or the fault for which nothing has changed: the session is over.
        """
        fault = self.session.renew(not_after, at=at)
        if fault is None:
            self.credentials, self.not_after = credentials, not_after
        return fault


@dataclass(slots=True)
class _Held:
    lease: Lease
    heard_ms: int
    carried: bool = False


class Leases:
    """Lease of one robot, if there is one. Not for several threads."""

    def __init__(self) -> None:
        self._held: _Held | None = None

    @property
    def current(self) -> Lease | None:
        """Lease that is open."""
        return None if self._held is None else self._held.lease

    def open(self, lease: Lease, *, at_ms: int) -> bool:
        """True where `lease` is now the open one: there is no other.

        Its holder has `SILENCE_MS` to bring its carriage.
        """
        if self._held is not None:
            return False
        self._held = _Held(lease, at_ms)
        return True

    def carry(self, lease_id: bytes, *, at_ms: int) -> Lease | None:
        """Lease of that id, for the first connection that names it; None for any other."""
        held = self._held
        if held is None or held.carried or held.lease.id != lease_id:
            return None
        held.carried, held.heard_ms = True, at_ms
        return held.lease

    def silent(self, *, at_ms: int) -> bool:
        """True where the open lease has been silent for too long."""
        return self._held is not None and not at_ms - self._held.heard_ms <= SILENCE_MS

    def end(self, lease: Lease) -> bool:
        """True where it was open; now it is not, and another may be."""
        if self._held is None or self._held.lease is not lease:
            return False
        self._held = None
        return True
