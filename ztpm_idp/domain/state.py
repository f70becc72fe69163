"""The slice of the identity provider's state that one command looks at.

Loaded in the command's transaction, never changed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from ztpm_idp.domain.agent_conduct import Held
from ztpm_idp.domain.lending.amounts import Used
from ztpm_idp.domain.oauth.records import NOTHING, OAuthState

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ztpm_idp.domain.agent_conduct import Concerned
    from ztpm_idp.domain.asking.asks import Asked, OpeningRecord
    from ztpm_idp.domain.asking.envelope_acts import EnvelopeRecord
    from ztpm_idp.domain.asking.latch_acts import ClearingRecord, LatchRecord
    from ztpm_idp.domain.changes import Change
    from ztpm_idp.domain.login.records import Device, Offer, Session, SessionKey
    from ztpm_idp.domain.oauth.records import OAuthWanted
    from ztpm_idp.domain.parties import Party, RegisteredPep, Standing

NOTHING_HELD: Final = Held()
NOTHING_USED: Final = Used()


@dataclass(frozen=True, slots=True)
class Nonce:
    """An attestation nonce.

    Attributes:
        agent: the agent that it was given to.
        given_ms: when, wall clock.
        consumed: whether something was made with it already.
    """

    nonce: str
    agent: str
    given_ms: int
    consumed: bool


@dataclass(frozen=True, slots=True)
class HopRecord:
    """Hop that was made: enough to know the tree that it stands in."""

    hop_id: str
    token_id: str
    parent: str | None
    agent: str
    sponsor: str


@dataclass(frozen=True, slots=True)
class MandateRecord:
    """Part of a mandate that decides; all the rest is in its text.

    Attributes:
        mandate_id: 32 hex digits.
        digest: SHA-256 (hex) of its text.
        sponsor, agent: who promised, and to whom.
        key: thumbprint of the key that signed it.
        signed_at, not_after: seconds since the epoch.
        text: as it was signed.
        revoked: it is in the index of revocations.
    """

    mandate_id: str
    digest: str
    sponsor: str
    agent: str
    key: str
    signed_at: int
    not_after: int
    text: str
    revoked: bool = False


@dataclass(frozen=True, slots=True)
class Drawn:
    """Token that was drawn from a mandate.

    Attributes:
        token_id, hop_id: of the token and its first hop.
        drawn_ms: wall clock.
        not_after: its end, seconds since the epoch.
        revoked: its token or hop is in the index of revocations.
    """

    token_id: str
    hop_id: str
    drawn_ms: int
    not_after: int
    revoked: bool

    def live(self, at_ms: int) -> bool:
        """True where it is neither over nor revoked at this wall-clock time."""
        return not self.revoked and at_ms < self.not_after * 1_000


@dataclass(frozen=True, slots=True)
class Journal:
    """Progress in taking an enforcement point's journal.

    Attributes:
        seq: of the last record, 0 when there is none.
        head: hash of the last record, 64 zeros when there is none.
        digests: hashes of records already taken, for those that are offered again.
    """

    seq: int
    head: str
    digests: Mapping[int, str]


@dataclass(frozen=True, slots=True)
class AgentsOf:
    """Living agents of a sponsor."""

    sponsor: str


@dataclass(frozen=True, slots=True)
class TrustBeside:
    """Living agents with stated trust, but for this one: of its sponsor, and of all."""

    agent: str


@dataclass(frozen=True, slots=True)
class SuspendedBeside:
    """Suspended agents, but for this one: of its sponsor, and of all."""

    agent: str


@dataclass(frozen=True, slots=True)
class ToolsBeside:
    """Tools of an audience, but for this one."""

    audience: str
    name: str


@dataclass(frozen=True, slots=True)
class SensorsOf:
    """Living sensors of an audience."""

    audience: str


@dataclass(frozen=True, slots=True)
class PepsOf:
    """Living enforcement points: as many as serve the one of these audiences that most of them serve."""

    audiences: frozenset[str]


@dataclass(frozen=True, slots=True)
class Approvers:
    """Keys of active people who may approve."""


Crowd = AgentsOf | TrustBeside | SuspendedBeside | ToolsBeside | SensorsOf | PepsOf | Approvers
"""Crowd of parties whose number may be bounded."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """State that a command needs. The store loads exactly this."""

    parties: frozenset[str] = frozenset()
    keys: frozenset[bytes] = frozenset()
    nonces_of: str | None = None
    """An agent: its nonces that are young enough to count, consumed or not."""
    hop: str | None = None
    """A hop and, with it, every hop above it."""
    token: str | None = None
    """The first hop of this token."""
    thumbprint: str | None = None
    tool: tuple[str, str] | None = None
    """A tool, by audience and name."""
    picture: str | None = None
    """A picture, by its digest."""
    journal: str | None = None
    journal_seqs: frozenset[int] = frozenset()
    revocation: tuple[str, str] | None = None
    crowd: Crowd | None = None
    agents_of: str | None = None
    """A person: those of its agents that are not in the revocation index."""
    revocations_of: frozenset[tuple[str, str]] = frozenset()
    """Every (kind, id) of a token: those of them that are revoked or suspended are wanted."""
    revocations: bool = False
    """Every revocation, with its epoch, and every suspension: for judging a token."""
    ask: str | None = None
    """An ask, with its votes."""
    asks_of: str | None = None
    """An audience that asks.

    Every ask that may wait for people is loaded, and every one of this audience that may be granted.
    """
    opening: str | None = None
    openings_of: str | None = None
    """An audience: its openings that may be in force, and whether an enforcement point serves it."""
    every_opening: bool = False
    """Every audience's openings and envelopes that may be in force."""
    envelope: str | None = None
    envelopes_of: str | None = None
    """An audience: its envelopes that may be in force, and whether an enforcement point serves it."""
    latch: str | None = None
    """A latch, with its clearings and its enforcement point."""
    people: bool = False
    """The active administrators, and the changes of people that may be open."""
    change: str | None = None
    """A change of people, and all that it needs to take effect."""
    concerned: Concerned | None = None
    """Subjects in the journal: open PERMITs among these requests, the edges of these hops, and the agents of both."""
    conduct_of: frozenset[str] = frozenset()
    """Agents: their conduct."""
    refusals_of: str | None = None
    """An agent: its refusals of late."""
    thumbprints: frozenset[str] = frozenset()
    """Keys whose owners are wanted, with the parties themselves."""
    empty: bool = False
    """To be told that no party is registered at all."""
    points: bool = False
    """The active enforcement points, also while nothing is being restored."""
    mandate: str | None = None
    """A mandate, with its parties and the tokens that were drawn from it."""
    mandates_of: str | None = None
    """An agent: its mandates that may be in force."""
    mandates_by: str | None = None
    """A thumbprint: the mandates that its key signed and that may be in force."""
    mandates_from: str | None = None
    """A person: the mandates that it signed, with whichever key, and that may be in force."""
    oauth: OAuthWanted | None = None
    sessions_of: str | None = None
    """A person: its sessions that may last."""
    session: str | None = None
    """A session, by its id."""
    offer: bytes | None = None
    """A login link, by the digest of its secret."""
    login: str | None = None
    """A login at another provider: its owner."""
    devices: bool = False
    """Every device that may wait for a person."""
    session_keys_of: str | None = None
    """A person: its session-bound keys."""
    lent_by: str | None = None
    """A sponsor: the tokens that it has."""
    draws: bool = False
    """The tokens that the sponsor of the wanted mandate has are wanted."""
    promised_by: str | None = None
    """A sponsor: the mandates that it has."""
    tree: str | None = None
    """A token: the hops of it and of all that were made of it."""
    tokens_from: str | None = None
    """A person: the tokens that it lent, or that were drawn from its mandates, and that may be live."""


@dataclass(frozen=True, slots=True)
class State:
    """State that was loaded for a command.

    Attributes:
        parties: by id.
        key_owners: party ids by raw key.
        nonces: of the wanted agent, by nonce.
        hops: by hop id: the wanted one and those above it, or the first hop of the wanted token.
        owner_of_thumbprint: party that holds the wanted key, if any.
        journal: of the wanted enforcement point.
        revoked_at_epoch: of the wanted revocation, if it was made before.
        crowd, crowd_of_all: how many of the wanted crowd there are; of the same sponsor where sponsors are bounded
            singly, and then of all.
        agents_of: ids of the wanted person's agents that are not in the revocation index, in order.
        empty: no party is registered at all, where that was wanted.
        revoked: every (kind, id) that is revoked, and every agent that is suspended, when the command judges a
            token; of those alone that the token names, where they are known.
        epoch: of that set.
        asked: the wanted ask.
        standing: asks that may be open, and those of the wanted audience that may be granted.
        taken_ms: when each ask was taken that may be of the last hour, wall clock.
        approvers: number of the active ones; of both only with asks of an audience.
        opening: the wanted opening.
        openings: of the wanted audience or of every one, those that may be in force.
        served: the wanted audience, when a registered enforcement point serves it.
        administrators: ids of the active ones.
        open_changes: changes of people that may be open.
        change: the wanted change.
        refusals: since when, wall clock in milliseconds, and how many of the wanted agent were counted.
        held: of the conduct of the wanted agents and of those that the wanted records are about.
        line: of the chain of revocations.
        restoring: a restore waits for its end.
        points: the active enforcement points, while restoring or when they are wanted.
        owners: party ids by the wanted thumbprints.
        mandate: the wanted one.
        drawn: tokens of the wanted mandate that may be live.
        mandates: those that may be in force and are not revoked: of the wanted agent, of agents whose conduct is
            wanted or will change, by the wanted key, and from the wanted person.
        oauth: the wanted records of OAuth.
        tool: `ACTIVE` or `SUSPENDED`, as the wanted tool stands; None when it is not registered.
        picture: text of the wanted one; "" while it is only named, None where it is not named, or no longer kept.
        sessions: of the wanted person, those that may last, oldest first.
        session: the wanted one.
        offer: the wanted login link.
        devices: those that may wait for a person.
        session_keys: of the wanted person.
        session_key: the one that signed the command, if any.
        login_owner: the person whose login the wanted one is, if any.
        envelope: the wanted one.
        envelopes: of the wanted audience or of every one, those that may be in force.
        latch: the wanted one, and clearings: all of it.
        used: what the wanted sponsor, or token, has.
        tokens_from: ids of the wanted person's tokens that may be live and are not revoked, in order.
    """

    parties: Mapping[str, Party] = field(default_factory=dict)
    key_owners: Mapping[bytes, str] = field(default_factory=dict)
    nonces: Mapping[str, Nonce] = field(default_factory=dict)
    hops: Mapping[str, HopRecord] = field(default_factory=dict)
    owner_of_thumbprint: str | None = None
    journal: Journal | None = None
    revoked_at_epoch: int | None = None
    crowd: int = 0
    crowd_of_all: int = 0
    agents_of: tuple[str, ...] = ()
    empty: bool = False
    revoked: frozenset[tuple[str, str]] = frozenset()
    epoch: int = 0
    asked: Asked | None = None
    standing: tuple[Asked, ...] = ()
    taken_ms: tuple[int, ...] = ()
    approvers: int = 0
    opening: OpeningRecord | None = None
    openings: tuple[OpeningRecord, ...] = ()
    served: frozenset[str] = frozenset()
    administrators: frozenset[str] = frozenset()
    open_changes: tuple[Change, ...] = ()
    change: Change | None = None
    held: Held = NOTHING_HELD
    refusals: tuple[int, int] = (0, 0)
    line: int = 0
    restoring: bool = False
    points: tuple[RegisteredPep, ...] = ()
    owners: Mapping[str, str] = field(default_factory=dict)
    mandate: MandateRecord | None = None
    drawn: tuple[Drawn, ...] = ()
    mandates: tuple[MandateRecord, ...] = ()
    oauth: OAuthState = NOTHING
    tool: Standing | None = None
    picture: str | None = None
    sessions: tuple[Session, ...] = ()
    session: Session | None = None
    offer: Offer | None = None
    login_owner: str | None = None
    devices: tuple[Device, ...] = ()
    session_keys: tuple[SessionKey, ...] = ()
    session_key: SessionKey | None = None
    used: Used = NOTHING_USED
    tokens_from: tuple[str, ...] = ()
    envelope: EnvelopeRecord | None = None
    envelopes: tuple[EnvelopeRecord, ...] = ()
    latch: LatchRecord | None = None
    clearings: tuple[ClearingRecord, ...] = ()
