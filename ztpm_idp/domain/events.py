"""Events, closed. The store writes each to its tables and to the ledger in one transaction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capabilities.statements import revocation
from ztpm_idp.domain.asking.envelope_acts import EnvelopeEvent
from ztpm_idp.domain.asking.latch_acts import LatchEvent
from ztpm_idp.domain.asking.pushes import PushFailed
from ztpm_idp.domain.login.events import LoginEvent
from ztpm_idp.domain.oauth.events import OAuthEvent
from ztpm_idp.domain.signed import AssertedAct as AssertedAct  # noqa: PLC0414, TC001  its readers take it from here
from ztpm_idp.domain.signed import SignedRequest as SignedRequest  # noqa: PLC0414, TC001  its readers take it from here
from ztpm_idp.domain.upkeep.acts import UpkeepEvent

if TYPE_CHECKING:
    from capabilities.values.chain import Chain, EvidenceKind, HopGrant, Sponsor
    from capabilities.values.scope import Restriction, Scope, Widening
    from policies.conduct.report import Report
    from policies.evidence.model import Decision
    from ztpm_idp.domain.agent_conduct import AgentConduct, Published
    from ztpm_idp.domain.asking.asks import AskRecord, AskState, OpeningRecord, VoteRecord
    from ztpm_idp.domain.changes import Change, ChangeState, Word
    from ztpm_idp.domain.parties import Party, PersonRole, RegisteredTool
    from ztpm_idp.domain.state import MandateRecord


RevocationKind = revocation.Revoked
"""Kind of subject that a revocation names."""


@dataclass(frozen=True, slots=True)
class PartyRegistered:
    """A party exists from now on."""

    party: Party


@dataclass(frozen=True, slots=True)
class KeyAdded:
    """A person has this key, too, from now on.

    `credential` is the id of a passkey, and "" for any other key.
    """

    person: str
    key: bytes
    credential: str = ""


@dataclass(frozen=True, slots=True)
class RolesChanged:
    """A person has these roles from now on, and no others."""

    person: str
    roles: frozenset[PersonRole]


@dataclass(frozen=True, slots=True)
class ChangeProposed:
    """A change of people waits for an answer; `told` are the administrators who see it on their next request."""

    change: Change
    told: tuple[str, ...]
    signed: SignedRequest | AssertedAct


@dataclass(frozen=True, slots=True)
class ChangeAnswered:
    """An administrator said a word on a change, or its proposer took it back."""

    change_id: str
    by: str
    word: Word
    reason: str
    signed: SignedRequest | AssertedAct


@dataclass(frozen=True, slots=True)
class ChangeEnded:
    """A change is over, in this state."""

    change_id: str
    state: ChangeState


@dataclass(frozen=True, slots=True)
class ToolRegistered:
    """A tool has this definition from now on."""

    tool: RegisteredTool


@dataclass(frozen=True, slots=True)
class TrustStated:
    """An agent's static trust is this from now on."""

    agent: str
    permille: int


@dataclass(frozen=True, slots=True)
class NonceGiven:
    """A nonce was handed to an agent. Not in the ledger: it is the hop or the attestation that counts."""

    nonce: str
    agent: str
    given_ms: int


@dataclass(frozen=True, slots=True)
class NonceConsumed:
    """A nonce is spent, on one hop or one attestation, for ever; and with it a platform's token.

    `credential` is the SHA-256 of that token, or empty, and `credential_until_ms` when it is over anyway.
    """

    nonce: str
    purpose: str
    credential: bytes = b""
    credential_until_ms: int = 0


@dataclass(frozen=True, slots=True)
class AgentAttested:
    """An agent showed that it holds its key and states the registered software; `kind` says who else states it."""

    agent: str
    measurement: bytes
    evidence: str
    kind: EvidenceKind


@dataclass(frozen=True, slots=True)
class TokenIssued:
    """A person lent authority: everything that the authority block will say.

    `mandate_id` is that of the mandate from which the agent drew it; then `signed` is the agent's request.
    """

    token_id: str
    sponsor: Sponsor
    hop: HopGrant
    scope: Scope
    evidence: str
    signed: SignedRequest
    mandate_id: str | None = None


@dataclass(frozen=True, slots=True)
class MandateSigned:
    """A sponsor's mandate is in force from now on."""

    mandate: MandateRecord
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class TokenDelegated:
    """A holder lent part of its authority: everything that the new hop will say. `chain` is the holder's, verified."""

    chain: Chain
    hop: HopGrant
    restriction: Restriction
    scope: Scope
    evidence: str
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class DelegationRefused:
    """Attempt of a holder to delegate more than it has, or at a time when it may not.

    It is recorded, though refused. `decision` is that of the policies, where they were asked.
    """

    token_id: str
    parent_hop: str
    holder: str
    delegate: str
    code: str
    widenings: tuple[Widening, ...]
    signed: SignedRequest
    decision: Decision | None = None


@dataclass(frozen=True, slots=True)
class RefusalCounted:
    """An agent has had so many refusals since a time. Not in the ledger: the refusals are."""

    agent: str
    since_ms: int
    number: int


@dataclass(frozen=True, slots=True)
class RefusalsSpent:
    """An agent has spent its budget of refusals: those that follow in the window are not recorded."""

    agent: str
    number: int
    window_s: int


@dataclass(frozen=True, slots=True)
class Revoked:
    """Something is revoked for ever; the store gives it the next epoch.

    Attributes:
        kind, id: the revoked subject.
        reason: as the caller stated it.
        party: the registered party that loses its standing by this, if any.
    """

    kind: RevocationKind
    id: str
    reason: str
    party: str | None


@dataclass(frozen=True, slots=True)
class RecordTaken:
    """One record of an enforcement point's journal is in the ledger.

    Attributes:
        pep, seq: the enforcement point, and the record's number in its journal.
        digest: the record's hash, hex.
        record: the record itself.
    """

    pep: str
    seq: int
    digest: str
    record: dict[str, object]


@dataclass(frozen=True, slots=True)
class PictureNamed:
    """A record of a journal names the picture with this SHA-256 (hex)."""

    digest: str


@dataclass(frozen=True, slots=True)
class PictureTaken:
    """The text of a picture that a record names has come, with its SHA-256 (hex)."""

    digest: str
    text: str


@dataclass(frozen=True, slots=True)
class PermitOpened:
    """An enforcement point recorded a PERMIT, in its record `seq`; `report` is as if nothing were ever sent."""

    pep: str
    seq: int
    report: Report


@dataclass(frozen=True, slots=True)
class PermitConcluded:
    """The outcome of a PERMIT has come."""

    pep: str
    request_id: str


@dataclass(frozen=True, slots=True)
class ConductObserved:
    """Conduct of an agent as known from now on. Not in the ledger: the records that say so are."""

    agent: str
    conduct: AgentConduct
    published: Published


@dataclass(frozen=True, slots=True)
class AgentSuspended:
    """A person suspended an agent: no token that it is in counts from now on."""

    agent: str
    reason: str


@dataclass(frozen=True, slots=True)
class SuspensionEnded:
    """A person ended an agent's suspension: its tokens count again, and it stands as before."""

    agent: str
    reason: str


@dataclass(frozen=True, slots=True)
class AgentRestored:
    """A person took an agent's deviations off it; `relearned`: its baseline, too."""

    agent: str
    reason: str
    relearned: bool
    conduct: AgentConduct
    published: Published


@dataclass(frozen=True, slots=True)
class AskTaken:
    """An enforcement point's ask is shown to people from now on, with the picture that it names, if any.

    `text` is as it was signed.
    """

    ask: AskRecord
    text: str
    picture: str = ""


@dataclass(frozen=True, slots=True)
class VoteCast:
    """A person answered an ask.

    Attributes:
        ask_id: which.
        place: 1 and upwards among the votes on this ask.
        vote: the answer, with its text.
        state: how the ask stands after it.
        trace_id: of the trace that was asked in; empty where none is known.
    """

    ask_id: str
    place: int
    vote: VoteRecord
    state: AskState
    trace_id: str = ""


@dataclass(frozen=True, slots=True)
class OpeningMade:
    """A person let a safety-critical act be asked for."""

    opening: OpeningRecord


@dataclass(frozen=True, slots=True)
class OpeningClosed:
    """An opening is over before its time."""

    opening_id: str
    reason: str


@dataclass(frozen=True, slots=True)
class ApprovalActRefused:
    """Attempt to ask, answer, open or close without the right to; recorded, though refused.

    Attributes:
        act: "ask", "vote", "opening", "closing", "latch" or "clearing".
        id: of the ask, opening or latch; empty when it is not known.
        by: the caller.
        code: the reason.
        digest: SHA-256 (hex) of the statement that was offered, empty for a closing.
        signed: the request, where it is small and shows whose key was behind it.
    """

    act: str
    id: str
    by: str
    code: str
    digest: str
    signed: SignedRequest | None


@dataclass(frozen=True, slots=True)
class StoreRestored:
    """The store is a copy that was put back: a new line begins, and it waits for these enforcement points.

    Attributes:
        line: the new one.
        epoch: of the copy.
        points: ids of those that are awaited.
        sources: words on what was read to take revocations back.
    """

    line: int
    epoch: int
    points: tuple[str, ...]
    sources: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LineBegun:
    """An enforcement point had followed a line as high as the store's, so the store begins a higher one."""

    line: int


@dataclass(frozen=True, slots=True)
class PointHeard:
    """An enforcement point told everything that it knows to be revoked.

    Attributes:
        pep: its id.
        line, epoch: the newest that it had accepted.
        signed_at: when it signed its mark, seconds since the epoch.
        digest: SHA-256 (hex) of the mark, or of its last part.
    """

    pep: str
    line: int
    epoch: int
    signed_at: int
    digest: str


@dataclass(frozen=True, slots=True)
class AgentsHeld:
    """Agents about which the ledger said something after the copy was made: an administrator must vouch for each."""

    agents: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StoreResumed:
    """The restored store serves again; where a point was not heard, an administrator must vouch for every agent."""

    unheard: tuple[str, ...]
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class AgentVouched:
    """An administrator vouched for an agent that was held since a restore."""

    agent: str
    reason: str


RestoringEvent = StoreRestored | LineBegun | PointHeard | AgentsHeld | StoreResumed | AgentVouched

Event = (
    PartyRegistered
    | KeyAdded
    | RolesChanged
    | ChangeProposed
    | ChangeAnswered
    | ChangeEnded
    | ToolRegistered
    | TrustStated
    | NonceGiven
    | NonceConsumed
    | AgentAttested
    | TokenIssued
    | TokenDelegated
    | DelegationRefused
    | RefusalCounted
    | RefusalsSpent
    | Revoked
    | RecordTaken
    | PictureNamed
    | PictureTaken
    | PermitOpened
    | PermitConcluded
    | ConductObserved
    | AgentSuspended
    | SuspensionEnded
    | AgentRestored
    | AskTaken
    | VoteCast
    | OpeningMade
    | OpeningClosed
    | ApprovalActRefused
    | RestoringEvent
    | MandateSigned
    | OAuthEvent
    | UpkeepEvent
    | LoginEvent
    | EnvelopeEvent
    | LatchEvent
    | PushFailed
)
