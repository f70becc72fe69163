"""Commands to the identity provider, closed; `ztpm_idp.domain.wanted` has the state that each needs.

Every field has been parsed strictly at the edge: ids match their grammar, keys are 32 bytes, texts are clean and
bounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ztpm_idp.domain.login.commands import LoginCommand
from ztpm_idp.domain.oauth.commands import OAuthCommand
from ztpm_idp.domain.upkeep.acts import UpkeepCommand

if TYPE_CHECKING:
    from capabilities.values.scope import Restriction, Scope
    from ztpm_idp.domain.changes import Change, Word
    from ztpm_idp.domain.events import AssertedAct, RevocationKind, SignedRequest
    from ztpm_idp.domain.parties import PersonRole, RegisteredPerson, RegisteredTool


@dataclass(frozen=True, slots=True)
class Initialise:
    """Puts the first people into an empty store.

    It has no caller: it is run beside the store, never over the wire.
    """

    people: tuple[RegisteredPerson, ...]


@dataclass(frozen=True, slots=True)
class RegisterPerson:
    """An administrator registers a person who only lends or only reads."""

    by: str
    id: str
    name: str
    key: bytes
    roles: frozenset[PersonRole]


@dataclass(frozen=True, slots=True)
class ProposeChange:
    """A person proposes a change of people, `signed` as it came; another person answers."""

    change: Change
    signed: SignedRequest | AssertedAct

    @property
    def by(self) -> str:
        """The proposer."""
        return self.change.by


@dataclass(frozen=True, slots=True)
class AnswerChange:
    """A person confirms a change of people or declines it."""

    by: str
    change_id: str
    word: Word
    reason: str
    signed: SignedRequest | AssertedAct


@dataclass(frozen=True, slots=True)
class Recover:
    """A recovery is proposed with the key that signed the request; nobody registered is behind it."""

    key: bytes
    change: Change
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class CompleteRecovery:
    """A recovery takes effect, when its time has come."""

    change_id: str


@dataclass(frozen=True, slots=True)
class RegisterAgent:
    """A sponsor, or an administrator for one, registers an agent; `workload` is "" where no platform knows it."""

    by: str
    id: str
    key: bytes
    software_digest: bytes
    model: str
    role: str
    sponsor: str
    workload: str = ""


@dataclass(frozen=True, slots=True)
class RegisterPep:
    """An administrator registers an enforcement point."""

    by: str
    id: str
    key: bytes
    audiences: frozenset[str]


@dataclass(frozen=True, slots=True)
class RegisterSensor:
    """An administrator registers a sensor."""

    by: str
    id: str
    key: bytes
    calibration: bytes
    transit_ms: int
    audience: str


@dataclass(frozen=True, slots=True)
class RegisterTool:
    """An administrator registers a tool, or a new definition of one."""

    by: str
    tool: RegisteredTool


@dataclass(frozen=True, slots=True)
class StateTrust:
    """An agent's sponsor, or an administrator, states its trust."""

    by: str
    agent: str
    permille: int


@dataclass(frozen=True, slots=True)
class SuspendAgent:
    """A person suspends an agent until one restores it."""

    by: str
    agent: str
    reason: str


@dataclass(frozen=True, slots=True)
class RestoreAgent:
    """A person ends an agent's suspension and takes its deviations off it.

    With `relearn` its baseline is learned anew, too.
    """

    by: str
    agent: str
    reason: str
    relearn: bool


@dataclass(frozen=True, slots=True)
class GiveNonce:
    """An agent asks for a nonce; `nonce` is fresh randomness."""

    by: str
    nonce: str


@dataclass(frozen=True, slots=True)
class Attest:
    """Attests an agent's key and software."""

    by: str
    agent: str
    evidence: str


@dataclass(frozen=True, slots=True)
class Issue:
    """A sponsor lends authority to an agent.

    Attributes:
        request_digest: SHA-256 of the canonical request as it was sent.
        evidence: the agent's, for exactly this request.
        token_id, hop_id: fresh randomness.
        signed: the request that the sponsor signed.
    """

    by: str
    agent: str
    purpose: str
    scope: Scope
    request_digest: bytes
    evidence: str
    token_id: str
    hop_id: str
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class Delegate:
    """Delegates part of a holder's authority.

    `token` is the holder's, `by` and `key` are who proved possession of which key. `agents` are the holders that the
    token names, as it was read beforehand: their conduct is loaded; only verified facts about them are believed here.
    `names` is every (kind, id) whose revocation concerns the token: read from its very bytes, they are the same under
    every bundle. None: the token could not be read, and all revocations are asked.
    """

    by: str
    key: bytes
    token: bytes
    delegate: str
    purpose: str
    restriction: Restriction
    request_digest: bytes
    evidence: str
    hop_id: str
    signed: SignedRequest
    agents: frozenset[str] = frozenset()
    resource: str | None = None
    """The one audience of an access token that the delegate gets, or None: it gets the capability itself."""
    names: frozenset[tuple[str, str]] | None = None


@dataclass(frozen=True, slots=True)
class SignMandate:
    """A sponsor promises authority to an agent; `text` is the signed mandate, `signed` the request that brought it."""

    by: str
    text: str
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class DrawToken:
    """An agent draws a token from a mandate.

    Attributes:
        lifetime_s: longest life that it asks for.
        request_digest: SHA-256 of the canonical request as it was sent.
        evidence: its own, for exactly this request, with the mandate's sponsor as delegator.
        token_id, hop_id: fresh randomness.
        signed: the request.
    """

    by: str
    mandate_id: str
    lifetime_s: int
    request_digest: bytes
    evidence: str
    token_id: str
    hop_id: str
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class Revoke:
    """Revokes one subject, for ever."""

    by: str
    kind: RevocationKind
    id: str
    reason: str


@dataclass(frozen=True, slots=True)
class TakeRecords:
    """An enforcement point ships its journal."""

    by: str
    records: tuple[dict[str, object], ...]


@dataclass(frozen=True, slots=True)
class TakePicture:
    """An enforcement point brings the text of a picture that a record of a journal names."""

    by: str
    text: str


@dataclass(frozen=True, slots=True)
class TakeAsk:
    """An enforcement point asks people.

    `text` is its signed ask, `trace_id` that of the request that brought it, `picture` the text of the picture that the
    ask names, or "" where it names none.
    """

    by: str
    text: str
    trace_id: str = ""
    picture: str = ""


@dataclass(frozen=True, slots=True)
class CastVote:
    """A person answers an ask.

    Attributes:
        ask_id: of the ask.
        text: the signed vote, or the vote by passkey.
        signed: the request that brought it; None for a vote by passkey, which is its own proof.
        read: of a vote by passkey, the text of the ask and its enforcement point's key, as they were read beforehand.
    """

    by: str
    ask_id: str
    text: str
    signed: SignedRequest | None
    read: tuple[str, bytes] | None = None


@dataclass(frozen=True, slots=True)
class OpenTier4:
    """A person lets a safety-critical act be asked for; `text` is the signed opening."""

    by: str
    text: str
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class CloseOpening:
    """A person takes an opening back."""

    by: str
    opening_id: str
    reason: str


@dataclass(frozen=True, slots=True)
class Lost:
    """Revocation that a ledger or a mark holds, and the restored store may not.

    `reason` is for the ledger.
    """

    kind: RevocationKind
    id: str
    reason: str


@dataclass(frozen=True, slots=True)
class RestoreStore:
    """Begins the restore of a store that is a copy.

    It has no caller: it is run beside the store, never over the wire.

    Attributes:
        line: the highest that any ledger names.
        doubted: ids that ledgers name after the copy was made; those of agents count.
        suspended: agents and parts that were suspended after it, and stayed so.
        sources: words on what was read.
    """

    line: int
    doubted: frozenset[str]
    suspended: frozenset[str]
    sources: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class TakeBack:
    """Takes revocations back that ledgers hold. It has no caller, as `RestoreStore` has none."""

    found: tuple[Lost, ...]


@dataclass(frozen=True, slots=True)
class TakeMark:
    """An enforcement point tells what it knows to be revoked; `text` is its signed mark, or a part of it."""

    by: str
    text: str


@dataclass(frozen=True, slots=True)
class ResumeStore:
    """An administrator ends a restore, and names the enforcement points that were not heard."""

    by: str
    unheard: frozenset[str]
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class VouchAgent:
    """An administrator vouches for an agent that is held since a restore."""

    by: str
    agent: str
    reason: str


@dataclass(frozen=True, slots=True)
class SignEnvelope:
    """A person approves beforehand; `text` is the signed envelope, `signed` the request that brought it."""

    by: str
    text: str
    signed: SignedRequest


@dataclass(frozen=True, slots=True)
class RevokeEnvelope:
    """A person revokes an envelope."""

    by: str
    envelope_id: str
    reason: str


@dataclass(frozen=True, slots=True)
class TakeLatch:
    """An enforcement point tells of its latch; `text` is that, signed."""

    by: str
    text: str


@dataclass(frozen=True, slots=True)
class ClearLatch:
    """A person clears a latch; `text` is the clearing, `signed` the request that brought it, if a key signed one."""

    by: str
    latch_id: str
    text: str
    signed: SignedRequest | None


Command = (
    Initialise
    | RegisterPerson
    | ProposeChange
    | AnswerChange
    | Recover
    | CompleteRecovery
    | RegisterAgent
    | RegisterPep
    | RegisterSensor
    | RegisterTool
    | StateTrust
    | SuspendAgent
    | RestoreAgent
    | GiveNonce
    | Attest
    | Issue
    | Delegate
    | Revoke
    | TakeRecords
    | TakePicture
    | TakeAsk
    | CastVote
    | OpenTier4
    | CloseOpening
    | RestoreStore
    | TakeBack
    | TakeMark
    | ResumeStore
    | VouchAgent
    | SignMandate
    | DrawToken
    | OAuthCommand
    | UpkeepCommand
    | LoginCommand
    | SignEnvelope
    | RevokeEnvelope
    | TakeLatch
    | ClearLatch
)
