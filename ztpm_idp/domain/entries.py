"""Ledger entries, one for each event.

No capability token, no private key; requests and evidence as they were signed, so that an auditor can verify them.
Evidence may hold a platform's workload token: it is over within minutes and good for one key and this provider alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, assert_never

from capabilities.keys.keys import thumbprint
from capabilities.values.scope_json import scope_to_json
from ztpm_idp.domain.asking.envelope_acts import EnvelopeRevoked, EnvelopeSigned
from ztpm_idp.domain.asking.latch_acts import ClearingSigned, LatchTaken
from ztpm_idp.domain.asking.pushes import PushFailed
from ztpm_idp.domain.events import (
    AgentAttested,
    AgentRestored,
    AgentsHeld,
    AgentSuspended,
    AgentVouched,
    ApprovalActRefused,
    AskTaken,
    AssertedAct,
    ChangeAnswered,
    ChangeEnded,
    ChangeProposed,
    ConductObserved,
    DelegationRefused,
    KeyAdded,
    LineBegun,
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
    PointHeard,
    RecordTaken,
    RefusalCounted,
    RefusalsSpent,
    Revoked,
    RolesChanged,
    StoreRestored,
    StoreResumed,
    SuspensionEnded,
    TokenDelegated,
    TokenIssued,
    ToolRegistered,
    TrustStated,
    VoteCast,
)
from ztpm_idp.domain.login.entries import login_entry
from ztpm_idp.domain.login.events import LoginEvent
from ztpm_idp.domain.oauth.entries import entry_of as oauth_entry
from ztpm_idp.domain.oauth.events import OAuthEvent
from ztpm_idp.domain.parties import RegisteredAgent, RegisteredPep, RegisteredPerson, RegisteredSensor, kind_of
from ztpm_idp.domain.upkeep.acts import KeyReplaced, PartRestored, PartSuspended, ToolAct, ToolChanged

if TYPE_CHECKING:
    from policies.evidence.model import Decision
    from ztpm_idp.domain.events import Event, SignedRequest
    from ztpm_idp.domain.parties import Party

Json = dict[str, object]
TRACE: Final = "trace_id"
"""Member of a body: the id of a trace, by the word of a caller."""
DONE: Final = {ToolAct.SUSPEND: "suspended", ToolAct.RESTORE: "restored", ToolAct.RETIRE: "retired"}
"""Word of a tool's entry for each act."""


def entry_of(event: Event) -> tuple[str, Json] | None:
    """Kind and body of the event's ledger entry; None for an event that other entries imply.

    The trace of a nonce is the act that it was spent on; the trace of an agent's conduct is the records about it.
    """
    if isinstance(event, LoginEvent):
        return login_entry(event)
    if isinstance(event, OAuthEvent):
        return oauth_entry(event, _signed)
    match event:
        case PartyRegistered(party=party):
            return f"{kind_of(party)}-registered", _party(party)
        case KeyAdded(person=person, key=key, credential=""):
            return "person-key-added", {"id": person, "key": thumbprint(key)}
        case KeyAdded(person=person, key=key, credential=credential):
            return "person-passkey-added", {"id": person, "key": thumbprint(key), "credential": credential}
        case RolesChanged(person=person, roles=roles):
            return "person-roles-changed", {"id": person, "roles": sorted(role.value for role in roles)}
        case ChangeProposed(change=change, told=told, signed=signed):
            return "change-proposed", {
                "change_id": change.change_id,
                "kind": change.kind.value,
                "person": change.person,
                **({"login": change.login} if change.login else {}),
                "by": change.by,
                "until_ms": change.until_ms,
                "told": list(told),
                "signed": _signed(signed),
            }
        case ChangeAnswered(change_id=change_id, word=word, reason=reason, signed=signed):
            return f"change-{word.value}", {
                "change_id": change_id,
                "by": event.by,
                "reason": reason,
                "signed": _signed(signed),
            }
        case ChangeEnded(change_id=change_id, state=state):
            return "change-ended", {"change_id": change_id, "state": state.value}
        case ToolRegistered(tool=tool):
            body: Json = {
                "audience": tool.audience,
                "name": tool.name,
                "definition_digest": tool.definition_digest.hex(),
                "operation": tool.operation,
                "base_tier": int(tool.base_tier),
            }
            return "tool-registered", body
        case TrustStated(agent=agent, permille=permille):
            return "trust-stated", {"agent": agent, "permille": permille}
        case NonceGiven() | NonceConsumed() | PermitOpened() | PermitConcluded() | ConductObserved() | RefusalCounted():
            return None
        case PictureNamed() | PictureTaken():  # the record is the entry
            return None
        case AgentSuspended(agent=agent, reason=reason):
            return "agent-suspended", {"agent": agent, "reason": reason}
        case SuspensionEnded(agent=agent, reason=reason):
            return "suspension-ended", {"agent": agent, "reason": reason}
        case AgentRestored(agent=agent, reason=reason, relearned=relearned):
            return "agent-restored", {"agent": agent, "reason": reason, "relearned": relearned}
        case AgentAttested(agent=agent, measurement=measurement, evidence=evidence, kind=kind):
            return "agent-attested", {
                "agent": agent,
                "measurement": measurement.hex(),
                "evidence": evidence,
                "evidence_kind": kind.value,
            }
        case TokenIssued(mandate_id=None):
            return "token-issued", _made(event) | {"token_id": event.token_id, "sponsor": event.sponsor.subject}
        case TokenIssued(mandate_id=mandate_id):
            return "token-drawn", _made(event) | {
                "token_id": event.token_id,
                "sponsor": event.sponsor.subject,
                "mandate_id": mandate_id,
            }
        case MandateSigned(mandate=mandate, signed=signed):
            return "mandate-signed", {
                "mandate_id": mandate.mandate_id,
                "sponsor": mandate.sponsor,
                "agent": mandate.agent,
                "mandate": mandate.text,
                "signed": _signed(signed),
            }
        case TokenDelegated():
            chain = event.chain
            return "token-delegated", _made(event) | {
                "token_id": chain.token_id,
                "sponsor": chain.sponsor.subject,
                "parent": chain.leaf.hop_id,
                "index": len(chain.hops),
            }
        case DelegationRefused():
            return "delegation-refused", {
                "token_id": event.token_id,
                "parent": event.parent_hop,
                "holder": event.holder,
                "delegate": event.delegate,
                "code": event.code,
                "widenings": [
                    {
                        "dimension": w.dimension,
                        "what": w.what,
                        "parent": w.parent,
                        "child": w.child,
                        "nearest": w.nearest,
                    }
                    for w in event.widenings
                ],
                "signed": _signed(event.signed),
                "decision": None if event.decision is None else _decision(event.decision),
            }
        case RefusalsSpent(agent=agent, number=number, window_s=window_s):
            return "refusals-spent", {"agent": agent, "number": number, "window_s": window_s}
        case Revoked(kind=kind, id=id_, reason=reason, party=party_id):
            return "revoked", {"kind": kind.value, "id": id_, "reason": reason, "party": party_id}
        case RecordTaken(record=record):
            return "pep-record", {"record": record}
        case AskTaken(ask=ask, text=text):
            taken: Json = {"ask_id": ask.ask_id, "agent": ask.agent, "sponsor": ask.sponsor, "ask": text}
            return "ask-taken", taken | _traced(ask.trace_id)
        case VoteCast(ask_id=ask_id, vote=vote, state=state):
            return "vote-cast", _traced(event.trace_id) | {
                "ask_id": ask_id,
                "approver": vote.approver,
                "answer": vote.answer.value,
                "state": state.value,
                "vote": vote.text,
            }
        case OpeningMade(opening=opening):
            return "opening-made", {
                "opening_id": opening.opening_id,
                "opener": opening.opener,
                "agent": opening.agent,
                "opening": opening.text,
            }
        case OpeningClosed(opening_id=opening_id, reason=reason):
            return "opening-closed", {"opening_id": opening_id, "reason": reason}
        case EnvelopeSigned(envelope=envelope):
            return "envelope-signed", {
                "envelope_id": envelope.envelope_id,
                "approver": envelope.approver,
                "agent": envelope.agent,
                "envelope": envelope.text,
            }
        case LatchTaken(latch=latch):
            return "latch-taken", {
                "latch_id": latch.latch_id,
                "pep": latch.pep,
                "object": latch.robot,
                "cause": latch.cause,
                "latch": latch.text,
            }
        case ClearingSigned(latch_id=latch_id, clearing=made, released=released):
            return "latch-clearing", {
                "latch_id": latch_id,
                "approver": made.approver,
                "released": released,
                "clearing": made.text,
            }
        case EnvelopeRevoked(envelope_id=envelope_id, reason=reason):
            return "envelope-revoked", {"envelope_id": envelope_id, "reason": reason}
        case ApprovalActRefused(signed=signed):
            return f"{event.act}-refused", {
                "id": event.id,
                "by": event.by,
                "code": event.code,
                "digest": event.digest,
                "signed": None if signed is None else _signed(signed),
            }
        case PushFailed(push=push):
            return "push-failed", {
                f"{push.subject.matter}_id": push.subject.id,
                "webhook": push.webhook,
                "event": push.event.value,
                "code": "" if push.code is None else push.code.value,
                "tries": push.tries,
            }
        case StoreRestored():
            return "store-restored", {
                "line": event.line,
                "epoch": event.epoch,
                "waits_for": list(event.points),
                "sources": list(event.sources),
            }
        case LineBegun(line=line):
            return "line-begun", {"line": line}
        case PointHeard():
            return "point-heard", {
                "pep": event.pep,
                "line": event.line,
                "epoch": event.epoch,
                "signed_at": event.signed_at,
                "digest": event.digest,
            }
        case AgentsHeld(agents=agents):
            return "agents-held", {"agents": list(agents)}
        case StoreResumed(unheard=unheard, signed=signed):
            return "store-resumed", {"unheard": list(unheard), "signed": _signed(signed)}
        case AgentVouched(agent=agent, reason=reason):
            return "agent-vouched", {"agent": agent, "reason": reason}
        case PartSuspended(kind=part, id=id_, reason=reason):
            return f"{part.value}-suspended", {"id": id_, "reason": reason}
        case PartRestored(kind=part, id=id_, reason=reason):
            return f"{part.value}-restored", {"id": id_, "reason": reason}
        case KeyReplaced(kind=whose, id=id_, key=key, before=before, reason=reason):
            replaced: Json = {"id": id_, "key": thumbprint(key), "before": thumbprint(before), "reason": reason}
            return f"{whose}-key-replaced", replaced
        case ToolChanged(audience=audience, name=name, act=act, reason=reason):
            return f"tool-{DONE[act]}", {"audience": audience, "name": name, "reason": reason}
        case _:
            assert_never(event)


def traced(kind: str, body: Json, trace_id: str | None) -> Json:
    """The body with the trace that it was written in, unless it is a point's record or names one.

    Args:
        kind: of the entry.
        body: of it.
        trace_id: of the request that brought it about, or None.
    """
    if trace_id is None or kind == "pep-record" or TRACE in body:
        return body
    return body | _traced(trace_id)


def _traced(trace_id: str) -> Json:
    return {TRACE: trace_id} if trace_id else {}


def _party(party: Party) -> Json:
    common: Json = {"id": party.id, "key": thumbprint(party.key)}
    match party:
        case RegisteredPerson(name=name, roles=roles):
            return common | {"name": name, "roles": sorted(role.value for role in roles)}
        case RegisteredAgent():
            return common | {
                "software_digest": party.software_digest.hex(),
                "model": party.model,
                "role": party.role,
                "sponsor": party.sponsor,
                "workload": party.workload,
            }
        case RegisteredPep(audiences=audiences):
            return common | {"audiences": sorted(audiences)}
        case RegisteredSensor():
            return common | {
                "calibration": party.calibration.hex(),
                "transit_ms": party.transit_ms,
                "audience": party.audience,
            }
        case _:
            assert_never(party)


def _made(event: TokenIssued | TokenDelegated) -> Json:
    hop = event.hop
    return {
        "hop_id": hop.hop_id,
        "agent": hop.agent,
        "key": thumbprint(hop.key),
        "delegator": hop.delegator,
        "purpose": hop.purpose,
        "request_digest": hop.request_digest.hex(),
        "measurement": hop.attestation.measurement.hex(),
        "evidence_kind": hop.attestation.kind.value,
        "scope": scope_to_json(event.scope),
        "evidence": event.evidence,
        "signed": _signed(event.signed),
    }


def _decision(decision: Decision) -> Json:
    return {
        "effect": str(decision.effect),
        "reason": str(decision.reason),
        "primitive": decision.primitive,
        "findings": [{"primitive": f.primitive, "reason": str(f.reason)} for f in decision.findings],
        "policy_digest": decision.policy_digest,
        "evidence_digest": decision.evidence_digest,
    }


def _signed(signed: SignedRequest | AssertedAct) -> Json:
    if isinstance(signed, AssertedAct):
        return {"passkey": signed.key, "said": signed.said, "authenticator": signed.authenticator,
                "client": signed.client, "signature": signed.signature}  # fmt: skip
    return {"method": signed.method, "url": signed.url, "body": signed.body, "proof": signed.proof}
