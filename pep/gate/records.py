"""Records of a PEP as plain JSON: decisions with their evidence, refusals at the edge, outcomes.

Each names the trace that is current where it is made, as `trace_id`; it is what the caller said, and proves nothing.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import rfc8785

from pep.base.traced import traced
from pep.journal.conduct import near_permille
from policies.evidence import case_json
from policies.evidence.evidence import Evidence
from policies.evidence.model import Effect
from policies.words.canonical import EXACT, plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pep.people.deferral import AskNotice
    from pep.request.authority import Credentials
    from pep.request.call import Call
    from policies.evidence.model import ApprovalUse, Decision, Request


POLICY, GATE = "policy", "gate"
"""Origin of a decision: the policies on the evidence, or a denial of the gate's own."""


def decision_body(decision: Decision, *, evidence_digest: str | None = None) -> dict[str, object]:
    """A decision, whole.

    Args:
        decision: to be told.
        evidence_digest: of its evidence, where that is known already.
    """
    return {
        "effect": str(decision.effect),
        "reason": str(decision.reason),
        "by": _by(decision),
        "primitive": decision.primitive,
        "tier": None if decision.tier is None else int(decision.tier),
        "index_milli": decision.index,
        "findings": [
            {"primitive": f.primitive, "reason": str(f.reason), "detail": jsonable(f.detail)} for f in decision.findings
        ],
        "obligations": [str(o.kind) for o in decision.obligations],
        "policy_digest": decision.policy_digest,
        "evidence_digest": decision.evidence_digest if evidence_digest is None else evidence_digest,
        "lifetime_ms": decision.lifetime_ms,
    }


def told(decision: Decision) -> dict[str, object]:
    """A decision as its holder is told of it: reason, tier, and the first finding with what would be permitted."""
    detail = jsonable(decision.findings[0].detail) if decision.findings else {}
    return {
        **detail,  # type: ignore[dict-item]  # a dict stays a dict
        "decision": str(decision.effect),
        "reason": str(decision.reason),
        "primitive": decision.primitive,
        "tier": None if decision.tier is None else int(decision.tier),
    }


def _by(decision: Decision) -> str:
    # Findings of policies come with their remedies (policies.primitives.base.found); those of the gate do not.
    own = (
        decision.effect is not Effect.PERMIT and bool(decision.findings) and "remedy" not in decision.findings[0].detail
    )
    return GATE if own else POLICY


def decision(call: Call, evidence: Evidence, decided: Decision, *, ask: AskNotice | None = None) -> dict[str, object]:
    """Record of a decision: request, evidence and answer. `policies.evidence.case_json` reads it back."""
    readings = case_json.evidence_to_plain(evidence, call.request)
    known = evidence.digest_of(readings) if decided.evidence is evidence else None
    body: dict[str, object] = {
        "form": case_json.FORM,
        "request": case_json.request_to_plain(call.request),
        "evidence": readings,
        "decision": decision_body(decided, evidence_digest=known),
        "proof": call.credentials.proof_name,
        "near_permille": near_permille(call.request, evidence),
    }
    if decided.approval is not None:
        body["approval"] = use_body(decided.approval)
    if ask is not None:
        body["ask"] = {"ask_id": ask.ask_id, "expires_at_ms": round(ask.expires_at * 1000)}
    return traced(body)


def advice(call: Call, evidence: Evidence, decided: Decision) -> dict[str, object]:
    """Record of advice: as of a decision, but no intent, and it uses up no approval."""
    return decision(call, evidence, replace(decided, approval=None))


def use_body(use: ApprovalUse) -> dict[str, object]:
    """One use of an approval: in the decision that consumes it, and in the outcome that returns it."""
    return {"ask_id": use.ask_id, "use": use.use}


def outcome(
    request: Request,
    record: str,
    what: str,
    *,
    reason: str | None = None,
    detail: str = "",
    result: Mapping[str, Any] | None = None,
    watch: Mapping[str, object] | None = None,
    returned: ApprovalUse | None = None,
) -> dict[str, object]:
    """Record of the outcome of a PERMIT.

    Args:
        request: that was permitted.
        record: hash of the decision's record.
        what: "done", "failed", "refused" (nothing was sent), "cancelled" or "unknown" (the PEP died in between).
        reason: a code, when it is not "done".
        detail: for the record.
        result: report of the effect.
        watch: finding of the watch that ended the effect.
        returned: the use of an approval that is free again, because nothing was sent and nothing can be any more.
    """
    body: dict[str, object] = {"request_id": request.request_id, "decision": record, "outcome": what}
    if reason is not None:
        body["reason"] = str(reason)
    if detail:
        body["detail"] = detail
    if result is not None:
        body["result"] = jsonable(result)
    if watch is not None:
        body["watch"] = jsonable(watch)
    if returned is not None:
        body["returned"] = use_body(returned)
    return traced(body)


def refusal(
    *, at: float, at_ms: int, reason: str, status: int, credentials: Credentials | None, where: Mapping[str, object]
) -> dict[str, object]:
    """Record of a request that was refused before any decision.

    Args:
        at: wall clock, seconds since the epoch.
        at_ms: monotonic clock.
        reason: the code.
        status: HTTP status of the answer; 200 for a tool result.
        credentials: as far as they were verified; None when they were not looked at.
        where: known parts of the request: method, path, tool, digest of the body.
    """
    evidence = Evidence(at=at, at_ms=at_ms)
    fault = None
    if credentials is not None:
        evidence = Evidence(at=at, at_ms=at_ms, chain=credentials.chain, proof=credentials.proof)
        fault = credentials.fault
    body: dict[str, object] = {
        "effect": "DENY",
        "reason": str(reason),
        "status": status,
        "where": dict(where),
        "evidence": case_json.evidence_to_plain(evidence, None),
    }
    if fault is not None:
        body["clause"] = fault.clause
        body["detail"] = fault.detail
    return traced(body)


def unfinished(records: Iterable[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Permitted requests without outcome, which an earlier process left.

    Args:
        records: of the whole journal, oldest first.

    Returns:
        (request id, hash of the decision's record) pairs.
    """
    permits: dict[str, str] = {}
    for record in records:
        body = record["body"]
        match record["kind"]:
            case "decision" if body["decision"]["effect"] == "PERMIT":
                permits[body["request"]["id"]] = hashlib.sha256(rfc8785.dumps(dict(record))).hexdigest()
            case "outcome":
                permits.pop(body["request_id"], None)
            case _:
                pass
    return list(permits.items())


def jsonable(value: object) -> object:
    """`value` with tuples as lists and keys as text, so that it is plain JSON; floats stay (they are measurements)."""
    match value:
        case dict():
            return {str(k): jsonable(v) for k, v in value.items()}
        case list() | tuple() | set() | frozenset():
            return [jsonable(v) for v in value]
        case float() if value.is_integer() and -EXACT <= value <= EXACT:
            return int(value)  # as RFC 8785 writes it, and read back quicker
        case None | bool() | int() | float() | str():
            return value
        case _:
            return plain(value)
