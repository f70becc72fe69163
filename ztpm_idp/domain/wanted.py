"""State that each command to the identity provider needs to be judged: the store loads exactly that."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from capabilities.statements import mark
from capabilities.statements.people.picture import digest_of
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError
from ztpm_idp.domain.asking.asks import stated
from ztpm_idp.domain.changes import ChangeKind
from ztpm_idp.domain.commands import (
    AnswerChange,
    Attest,
    CastVote,
    ClearLatch,
    CloseOpening,
    CompleteRecovery,
    Delegate,
    DrawToken,
    GiveNonce,
    Initialise,
    Issue,
    Lost,
    OpenTier4,
    ProposeChange,
    Recover,
    RegisterAgent,
    RegisterPep,
    RegisterPerson,
    RegisterSensor,
    RegisterTool,
    RestoreAgent,
    RestoreStore,
    ResumeStore,
    Revoke,
    RevokeEnvelope,
    SignEnvelope,
    SignMandate,
    StateTrust,
    SuspendAgent,
    TakeAsk,
    TakeBack,
    TakeLatch,
    TakeMark,
    TakePicture,
    TakeRecords,
    VouchAgent,
)
from ztpm_idp.domain.conduct import concerned
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.login.commands import (
    AnswerDevice,
    AskDevice,
    EndLogin,
    EndSessionKey,
    EnterCode,
    LogIn,
    LogOut,
    OfferLogin,
    PollDevice,
)
from ztpm_idp.domain.oauth.commands import OAuthCommand
from ztpm_idp.domain.oauth.wanted import wanted as wanted_by_oauth
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
from ztpm_idp.domain.upkeep.acts import ChangeTool, ReplaceKey, RestorePart, RetirePart, SuspendPart

if TYPE_CHECKING:
    from ztpm_idp.domain.changes import Change
    from ztpm_idp.domain.commands import Command


def wanted(command: Command) -> Wanted:
    """State that must be loaded to judge `command`."""
    if isinstance(command, OAuthCommand):
        return wanted_by_oauth(command)
    match command:
        case Initialise(people=people):
            return Wanted(
                parties=frozenset(p.id for p in people), keys=frozenset(p.key for p in people), empty=True
            )  # fmt: skip
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
        case Attest(by=by, agent=agent):
            return Wanted(parties=frozenset({by, agent}), nonces_of=agent)
        case Issue(by=by, agent=agent):
            return Wanted(parties=frozenset({by, agent}), nonces_of=agent, lent_by=by)
        case Delegate(by=by, delegate=delegate, agents=agents, names=names):
            holders = agents | {by}
            return Wanted(
                parties=holders | {delegate},
                nonces_of=delegate,
                revocations=names is None,
                revocations_of=names or frozenset(),
                conduct_of=holders,
                refusals_of=by,
                tree=next((id_ for kind, id_ in names or () if kind == RevocationKind.TOKEN), None),
            )
        case Revoke():
            return _wanted_by_revocation(command)
        case TakeRecords(by=by, records=records):
            seqs = frozenset(seq for r in records if isinstance(seq := r.get("seq"), int) and not isinstance(seq, bool))
            about = concerned(records)
            return Wanted(parties=frozenset({by}), journal=by, journal_seqs=seqs, concerned=about)
        case TakePicture(by=by, text=text):
            return Wanted(parties=frozenset({by}), picture=digest_of(text))
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
        case RestoreStore(doubted=doubted, suspended=suspended):
            return Wanted(parties=doubted | suspended, points=True)
        case TakeBack(found=found):
            return _wanted_to_take_back(found, frozenset())
        case TakeMark(by=by, text=text):
            return _wanted_to_take_back(told(text), frozenset({by}))
        case ResumeStore(by=by):
            return Wanted(parties=frozenset({by}))
        case VouchAgent(by=by, agent=agent):
            return Wanted(parties=frozenset({by, agent}))
        case SignMandate(by=by, text=text):
            says = stated(text, DEFAULT)
            agent = says.get("agent", by)
            return Wanted(
                parties=frozenset({by, agent}),
                mandate=says.get("mandate_id"),
                mandates_of=agent,
                conduct_of=frozenset({agent}),
                promised_by=by,
            )
        case DrawToken(by=by, mandate_id=mandate_id):
            return Wanted(
                parties=frozenset({by}),
                mandate=mandate_id,
                draws=True,
                nonces_of=by,
                revocations=True,
                conduct_of=frozenset({by}),
            )
        case SuspendPart(by=by, id=id_) | RestorePart(by=by, id=id_) | RetirePart(by=by, id=id_):
            return Wanted(parties=frozenset({by, id_}))
        case ReplaceKey(by=by, id=id_, key=key):
            return Wanted(parties=frozenset({by, id_}), keys=frozenset({key}), mandates_of=id_)
        case ChangeTool(by=by, audience=audience, name=name):
            return Wanted(parties=frozenset({by}), tool=(audience, name))
        case OfferLogin(by=by):
            return Wanted(parties=frozenset({by}))
        case LogIn(by=by, offer=offer, how=how, former=former):
            login = how.login if how is not None and how.login else None
            return Wanted(parties=frozenset({by}), sessions_of=by, session=former, offer=offer, login=login)
        case EndLogin(by=by, login=login):
            return Wanted(parties=frozenset({by}), login=login)
        case AskDevice(device=device):
            return Wanted(keys=frozenset({device.key}), devices=True)
        case PollDevice():
            return Wanted(devices=True)
        case EnterCode(by=by) | AnswerDevice(by=by):
            return Wanted(parties=frozenset({by}), sessions_of=by, session_keys_of=by, devices=True)
        case EndSessionKey(by=by):
            return Wanted(parties=frozenset({by}), session_keys_of=by)
        case LogOut(by=by):
            return Wanted(parties=frozenset({by}), sessions_of=by)
        case SignEnvelope(by=by, text=text):
            says = stated(text, DEFAULT)
            return Wanted(
                parties=frozenset({by, says.get("agent", by), says.get("sponsor", by)}),
                ask=says.get("envelope_id"),
                envelope=says.get("envelope_id"),
                envelopes_of=says.get("audience"),
                thumbprint=says.get("kid"),
                refusals_of=by,
            )
        case TakeLatch(by=by, text=text):
            return Wanted(parties=frozenset({by}), latch=stated(text, DEFAULT).get("latch_id"), refusals_of=by)
        case ClearLatch(by=by, latch_id=latch_id, text=text):
            kid = stated(text, DEFAULT).get("kid")
            return Wanted(parties=frozenset({by}), latch=latch_id, thumbprint=kid, refusals_of=by)
        case RevokeEnvelope(by=by, envelope_id=envelope_id):
            return Wanted(parties=frozenset({by}), envelope=envelope_id, refusals_of=by)
        case _:
            assert_never(command)


def wanted_by_change(change: Change) -> Wanted:
    """State that must be loaded to judge whether a change of people may take effect."""
    ends, roles, recovers = (change.kind is kind for kind in (ChangeKind.END, ChangeKind.ROLES, ChangeKind.RECOVERY))
    return Wanted(
        parties=frozenset({change.by, change.person}),
        keys=frozenset() if change.key is None else frozenset({change.key}),
        crowd=Approvers(),
        people=True,
        revocation=(RevocationKind.SPONSOR.value, change.person) if ends else None,
        agents_of=change.person if ends else None,
        every_opening=ends or roles or recovers,
        mandates_from=change.person if roles or recovers else None,
        tokens_from=change.person if roles else None,
        login=change.login or None,
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
            return Wanted(
                parties=parties, thumbprint=command.id, revocation=revocation, people=True, mandates_by=command.id
            )
        case RevocationKind.AGENT:
            return Wanted(parties=parties | {command.id}, revocation=revocation)
        case RevocationKind.SPONSOR:
            return Wanted(
                parties=parties | {command.id},
                revocation=revocation,
                agents_of=command.id,
                people=True,
                every_opening=True,
            )
        case RevocationKind.MANDATE:
            return Wanted(parties=parties, mandate=command.id, revocation=revocation)
        case RevocationKind.AUDIENCE:
            return Wanted(parties=parties, revocation=revocation)
        case _:
            assert_never(command.kind)
