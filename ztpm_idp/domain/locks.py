"""Locks of commands: what a command was decided on holds until its commit.

A command that is not named in `locks_of` runs alone, which is always right. One that is named runs beside others: it
shares what `wanted` says that it reads, and holds alone what its events change. Events that it was not expected to have
are found before anything is written, and it is decided again alone. Databases with one writer need none of this.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from ztpm_idp.domain.asking.pushes import PushFailed
from ztpm_idp.domain.commands import (
    Attest,
    CastVote,
    CloseOpening,
    Delegate,
    DrawToken,
    GiveNonce,
    Issue,
    OpenTier4,
    RegisterAgent,
    Revoke,
    SignMandate,
    TakeAsk,
    TakePicture,
    TakeRecords,
)
from ztpm_idp.domain.events import (
    AgentAttested,
    ApprovalActRefused,
    AskTaken,
    ConductObserved,
    DelegationRefused,
    MandateSigned,
    NonceConsumed,
    NonceGiven,
    OpeningClosed,
    OpeningMade,
    PartyRegistered,
    PermitConcluded,
    PermitOpened,
    PictureNamed,
    PictureTaken,
    RecordTaken,
    RefusalCounted,
    RefusalsSpent,
    RevocationKind,
    Revoked,
    TokenDelegated,
    TokenIssued,
    VoteCast,
)
from ztpm_idp.domain.oauth.commands import DrawAccess
from ztpm_idp.domain.oauth.events import AccessMade
from ztpm_idp.domain.parties import RegisteredAgent
from ztpm_idp.domain.state import AgentsOf

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ztpm_idp.domain.commands import Command
    from ztpm_idp.domain.events import Event
    from ztpm_idp.domain.state import Wanted


class Part(IntEnum):
    """Parts of the state. They are locked in this order, so that no two commands wait for each other."""

    WHOLE = 0
    REGISTRY = 1
    """Parties and their standing, tools, trust, suspensions, changes of people."""
    REVOCATIONS = 2
    """The index, and with it the mandates and keys that end by it."""
    ASKS = 3
    """Asks, votes and openings: how many may wait is bounded over all of them."""
    JOURNAL = 4
    """One enforcement point's records and open PERMITs."""
    PARTY = 5
    """One party: an agent's nonces, attestation, conduct, refusals, mandates and drawn tokens; a sponsor's crowd."""


@dataclass(frozen=True, slots=True, order=True)
class Lock:
    """Name of what is locked: a part of the state, and the id in it, where it has several."""

    part: Part
    id: str = ""


@dataclass(frozen=True, slots=True)
class Locks:
    """Locks of one command.

    Attributes:
        shared: read; no other command changes it meanwhile.
        alone: changed; no other command reads it meanwhile.
    """

    shared: frozenset[Lock]
    alone: frozenset[Lock]

    def cover(self, events: Iterable[Event]) -> bool:
        """True where all that these events change is held alone."""
        return WHOLE in self.alone or all(
            (changed := changed_by(event)) is not None and changed <= self.alone for event in events
        )

    def with_alone(self, more: frozenset[Lock]) -> Locks:
        """These locks, and `more` of them alone."""
        return Locks(self.shared - more, self.alone | more)


WHOLE = Lock(Part.WHOLE)
REGISTRY = Lock(Part.REGISTRY)
REVOCATIONS = Lock(Part.REVOCATIONS)
ASKS = Lock(Part.ASKS)
NO_LOCKS = Locks(frozenset(), frozenset())
EVERYTHING = Locks(frozenset(), frozenset({WHOLE}))
"""Locks of a command that runs alone."""


def party(id_: str) -> Lock:
    """Lock of one party."""
    return Lock(Part.PARTY, id_)


def locks_of(command: Command, wanted: Wanted) -> Locks:
    """Locks that a command takes before its state is loaded."""
    match command:
        case GiveNonce(by=by) | DrawToken(by=by) | DrawAccess(by=by):
            alone = {party(by)}
        case Attest(agent=agent) | Issue(agent=agent):
            alone = {party(agent)}
        case Delegate(by=by, delegate=delegate):
            alone = {party(by), party(delegate)}
        case SignMandate():
            alone = set() if wanted.mandates_of is None else {party(wanted.mandates_of)}
        case RegisterAgent(id=id_, sponsor=sponsor):
            alone = {party(id_), party(sponsor)}
        case TakeRecords(by=by):
            # The agents that the records are about are known, and locked, once its open PERMITs are.
            return Locks(frozenset({WHOLE, REGISTRY, REVOCATIONS}), frozenset({Lock(Part.JOURNAL, by)}))
        case TakePicture():
            alone = set()
        case TakeAsk(by=by) | CastVote(by=by) | OpenTier4(by=by) | CloseOpening(by=by):
            alone = {ASKS, party(by)}
        case Revoke(kind=RevocationKind.TOKEN | RevocationKind.HOP | RevocationKind.MANDATE | RevocationKind.AUDIENCE):
            alone = {REVOCATIONS}
        case Revoke():
            alone = {REGISTRY, REVOCATIONS}
        case _:
            return EVERYTHING
    return Locks(_read(wanted) - alone, frozenset(alone))


def _read(wanted: Wanted) -> frozenset[Lock]:
    """Locks of all that a command reads, among those that may run beside others."""
    read = {WHOLE, REGISTRY, *map(party, wanted.parties | wanted.conduct_of)}
    read |= {party(id_) for id_ in (wanted.nonces_of, wanted.refusals_of, wanted.mandates_of) if id_ is not None}
    read |= {party(wanted.crowd.sponsor)} if isinstance(wanted.crowd, AgentsOf) else set()
    asks = (wanted.ask, wanted.asks_of, wanted.opening, wanted.openings_of)
    read |= set() if asks == (None,) * len(asks) else {ASKS}
    # Hops are made once and never change: only their revocation does.
    indexed = (wanted.mandate, wanted.mandates_of, wanted.mandates_by, wanted.revocation)
    judged = wanted.revocations or wanted.revocations_of or wanted.conduct_of
    read |= {REVOCATIONS} if judged or indexed != (None,) * len(indexed) else set()
    return frozenset(read)


def changed_by(event: Event) -> frozenset[Lock] | None:
    """Locks of what an event changes; None where a command with such an event runs alone."""
    match event:
        case NonceGiven(agent=agent) | AgentAttested(agent=agent) | RefusalCounted(agent=agent):
            return frozenset({party(agent)})
        case ConductObserved(agent=agent):
            return frozenset({party(agent)})
        case TokenIssued(hop=hop):
            return frozenset({party(hop.agent)})
        case MandateSigned(mandate=mandate):
            return frozenset({party(mandate.agent)})
        case PartyRegistered(party=RegisteredAgent(id=id_, sponsor=sponsor)):
            return frozenset({party(id_), party(sponsor)})
        case RecordTaken(pep=pep) | PermitOpened(pep=pep) | PermitConcluded(pep=pep):
            return frozenset({Lock(Part.JOURNAL, pep)})
        case AskTaken() | VoteCast() | OpeningMade() | OpeningClosed():
            return frozenset({ASKS})
        case Revoked(kind=kind, party=ended):
            people = ended is not None or kind in {RevocationKind.KEY, RevocationKind.SPONSOR, RevocationKind.AGENT}
            return frozenset({REVOCATIONS, REGISTRY} if people else {REVOCATIONS})
        case AccessMade() | PictureNamed() | PictureTaken():
            return frozenset()  # a row of its own
        case PushFailed():
            return frozenset()  # an entry of the ledger
        case NonceConsumed() | TokenDelegated() | DelegationRefused() | ApprovalActRefused() | RefusalsSpent():
            # A nonce's own row says that it is unspent; a new hop changes nothing, nor does an entry of the ledger.
            return frozenset()
        case _:
            return None
