"""Commands to the identity provider, closed, with the state that each needs to be judged.

Every field has been parsed strictly at the edge: ids match their grammar, keys are 32 bytes, texts are clean and
bounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, assert_never

from capabilities.statements import mark
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError
from ztpm_idp.domain.asks import stated
from ztpm_idp.domain.changes import ChangeKind
from ztpm_idp.domain.conduct import concerned
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.state import (
    AgentsOf,
    Approvers,
    PepsOf,
    SensorsOf,
    SuspendedBeside,
    ToolsBeside,
    TrustBeside,
    Wanted,
)

if TYPE_CHECKING:
    from capabilities.values.scope import Restriction, Scope
    from ztpm_idp.domain.changes import Change, Word
    from ztpm_idp.domain.events import SignedRequest
    from ztpm_idp.domain.parties import PersonRole, RegisteredPerson, RegisteredTool


@dataclass(frozen=True, slots=True)
class Initialise:
    """Puts the first people into an empty store.

    It has no caller: it is run beside the store, never over the wire.
    """

    people: tuple[RegisteredPerson, ...]


@dataclass(frozen=True, slots=True)
class RegisterPerson:
    """An administrator registers a person who only lends."""

    by: str
    id: str
    name: str
    key: bytes
    roles: frozenset[PersonRole]


@dataclass(frozen=True, slots=True)
class ProposeChange:
    """A person proposes a change of people, `signed` as it came; another person answers."""

    change: Change
    signed: SignedRequest

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
    signed: SignedRequest


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
class TakeAsk:
    """An enforcement point asks people; `text` is its signed ask."""

    by: str
    text: str


@dataclass(frozen=True, slots=True)
class CastVote:
    """A person answers an ask; `text` is the signed vote, `signed` the request that brought it."""

    by: str
    ask_id: str
    text: str
    signed: SignedRequest


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
        suspended: agents that were suspended after it, and stayed so.
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
    | TakeAsk
    | CastVote
    | OpenTier4
    | CloseOpening
    | RestoreStore
    | TakeBack
    | TakeMark
    | ResumeStore
    | VouchAgent
)


def wanted(command: Command) -> Wanted:
    """State that must be loaded to judge `command`."""
    match command:
        case Initialise(people=people):
            return Wanted(parties=frozenset(p.id for p in people), keys=frozenset(p.key for p in people))
        case RegisterPerson(by=by, id=id_, key=key):
            return Wanted(parties=frozenset({by, id_}), keys=frozenset({key}))
        case ProposeChange(change=change) | Recover(change=change):
            return wanted_by_change(change)
        case AnswerChange(by=by, change_id=change_id):
            return Wanted(parties=frozenset({by}), change=change_id)
        case CompleteRecovery(change_id=change_id):
            return Wanted(change=change_id)
        case RegisterPep(by=by, id=id_, key=key, audiences=audiences):
            return Wanted(parties=frozenset({by, id_}), keys=frozenset({key}), crowd=PepsOf(audiences))
        case RegisterSensor(by=by, id=id_, key=key, audience=audience):
            return Wanted(parties=frozenset({by, id_}), keys=frozenset({key}), crowd=SensorsOf(audience))
        case RegisterAgent(by=by, id=id_, key=key, sponsor=sponsor):
            return Wanted(parties=frozenset({by, id_, sponsor}), keys=frozenset({key}), crowd=AgentsOf(sponsor))
        case RegisterTool(by=by, tool=tool):
            return Wanted(parties=frozenset({by}), crowd=ToolsBeside(tool.audience, tool.name))
        case StateTrust(by=by, agent=agent):
            return Wanted(parties=frozenset({by, agent}), crowd=TrustBeside(agent))
        case SuspendAgent(by=by, agent=agent):
            return Wanted(parties=frozenset({by, agent}), crowd=SuspendedBeside(agent))
        case RestoreAgent(by=by, agent=agent):
            return Wanted(parties=frozenset({by, agent}), conduct_of=frozenset({agent}))
        case GiveNonce(by=by):
            return Wanted(parties=frozenset({by}), nonces_of=by)
        case Attest(by=by, agent=agent) | Issue(by=by, agent=agent):
            return Wanted(parties=frozenset({by, agent}), nonces_of=agent)
        case Delegate(by=by, delegate=delegate, agents=agents):
            holders = agents | {by}
            return Wanted(
                parties=holders | {delegate}, nonces_of=delegate, revocations=True, conduct_of=holders, refusals_of=by
            )
        case Revoke():
            return _wanted_by_revocation(command)
        case TakeRecords(by=by, records=records):
            seqs = frozenset(seq for r in records if isinstance(seq := r.get("seq"), int) and not isinstance(seq, bool))
            about = concerned(records)
            return Wanted(parties=frozenset({by}), journal=by, journal_seqs=seqs, concerned=about)
        case TakeAsk(by=by, text=text):
            says = stated(text, DEFAULT)
            return Wanted(
                parties=frozenset({by, says.get("agent", by), says.get("sponsor", by)}),
                ask=says.get("ask_id"),
                asks_of=says.get("audience"),
                opening=says.get("opening_id"),
                refusals_of=by,
            )
        case CastVote(by=by, ask_id=ask_id, text=text):
            return Wanted(
                parties=frozenset({by}), ask=ask_id, thumbprint=stated(text, DEFAULT).get("kid"), refusals_of=by
            )
        case OpenTier4(by=by, text=text):
            says = stated(text, DEFAULT)
            return Wanted(
                parties=frozenset({by, says.get("agent", by)}),
                opening=says.get("opening_id"),
                openings_of=says.get("audience"),
                thumbprint=says.get("kid"),
                refusals_of=by,
            )
        case CloseOpening(by=by, opening_id=opening_id):
            return Wanted(parties=frozenset({by}), opening=opening_id, refusals_of=by)
        case RestoreStore(doubted=doubted):
            return Wanted(parties=doubted, points=True)
        case TakeBack(found=found):
            return _wanted_to_take_back(found, frozenset())
        case TakeMark(by=by, text=text):
            return _wanted_to_take_back(told(text), frozenset({by}))
        case ResumeStore(by=by):
            return Wanted(parties=frozenset({by}))
        case VouchAgent(by=by, agent=agent):
            return Wanted(parties=frozenset({by, agent}))
        case _:
            assert_never(command)


def wanted_by_change(change: Change) -> Wanted:
    """State that must be loaded to judge whether a change of people may take effect."""
    ends = change.kind is ChangeKind.END
    return Wanted(
        parties=frozenset({change.by, change.person}),
        keys=frozenset() if change.key is None else frozenset({change.key}),
        crowd=Approvers(),
        people=True,
        revocation=(RevocationKind.SPONSOR.value, change.person) if ends else None,
        agents_of=change.person if ends else None,
        every_opening=change.kind is ChangeKind.RECOVERY,
    )


def told(text: str) -> tuple[Lost, ...]:
    """Revocations that a mark tells, none of it verified; none for a text that cannot be read."""
    try:
        entries = mark.unverified(text, DEFAULT).entries
    except CapabilityError:
        return ()
    return tuple(Lost(RevocationKind(entry.kind), entry.id, "") for entry in entries)


def _wanted_to_take_back(found: tuple[Lost, ...], parties: frozenset[str]) -> Wanted:
    named = (lost.id for lost in found if lost.kind in {RevocationKind.AGENT, RevocationKind.SPONSOR})
    keys = (lost.id for lost in found if lost.kind is RevocationKind.KEY)
    return Wanted(parties=parties.union(named), thumbprints=frozenset(keys), revocations=True)


def _wanted_by_revocation(command: Revoke) -> Wanted:
    parties, revocation = frozenset({command.by}), (command.kind.value, command.id)
    match command.kind:
        case RevocationKind.HOP:
            return Wanted(parties=parties, hop=command.id, revocation=revocation)
        case RevocationKind.TOKEN:
            return Wanted(parties=parties, token=command.id, revocation=revocation)
        case RevocationKind.KEY:
            return Wanted(parties=parties, thumbprint=command.id, revocation=revocation, people=True)
        case RevocationKind.AGENT:
            return Wanted(parties=parties | {command.id}, revocation=revocation)
        case RevocationKind.SPONSOR:
            return Wanted(parties=parties | {command.id}, revocation=revocation, agents_of=command.id, people=True)
        case RevocationKind.AUDIENCE:
            return Wanted(parties=parties, revocation=revocation)
        case _:
            assert_never(command.kind)
