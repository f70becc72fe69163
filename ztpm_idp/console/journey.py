"""Way of one request through the ledger: authority, evidence, what the policies said, outcome. Pure."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.errors import CapabilityError
from capabilities.values.units import DeclaredUnit, Unit, kind_of
from policies.evidence import case_json
from policies.evidence.evidence import NOT_COLLECTED
from policies.explain.explanation import explain
from policies.words.errors import PolicyError
from policies.words.reason_table import REASONS, Reason
from ztpm_idp.domain.audit import claims_of, object_of
from ztpm_idp.provider.ask_page import readable

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from policies.decision.policy import PolicySet
    from policies.explain.explanation import Explanation, PolicyExplanation, PredicateVerdict

LENT: Final = frozenset({"token-issued", "token-drawn", "token-delegated", "revoked", "delegation-refused"})
"""Kinds of entries about a token itself: how it was lent, and how it ended."""
_NOT_COLLECTED: Final = NOT_COLLECTED.value
"""Word of a record for a reading that was not collected."""
_JSON_CHARACTERS: Final = 20_000
"""Most characters of one reading that a page shows; the entry has it whole."""


@dataclass(frozen=True, slots=True)
class EntryWords:
    """Part of an entry that only the entry says.

    Attributes:
        reasons: codes, and of a revocation the sentence of its person.
        tier: of a decision or an ask; None of what has none.
        asks: ids of the asks that it is about.
        operation: "operation of object", or what it does to its subject.
    """

    reasons: tuple[str, ...]
    tier: int | None
    asks: tuple[str, ...]
    operation: str


def told(line: bytes) -> EntryWords:
    """Reason, tier and asks that an entry states; nothing of what is not of a form that is known.

    Args:
        line: of the ledger.
    """
    body = body_of(line)
    decision, stated = object_of(body.get("decision")), claims_of(body.get("ask"))
    asked = object_of(body.get("request"))
    findings = decision.get("findings")
    codes = [
        decision.get("reason"),
        body.get("reason"),
        body.get("code"),
        *(object_of(each).get("reason") for each in (findings if isinstance(findings, list) else [])),
    ]
    tier = decision.get("tier", stated.get("tier"))
    asks = (
        object_of(body.get("ask")).get("ask_id"),
        object_of(body.get("approval")).get("ask_id"),
        stated.get("ask_id"),
    )
    act = (asked.get("operation") or stated.get("operation"), asked.get("object") or stated.get("object"))
    named = [body.get(name) for name in ("kind", "id")] if isinstance(body.get("id"), str) else []
    return EntryWords(
        tuple(dict.fromkeys(code for code in codes if isinstance(code, str) and code)),
        tier if type(tier) is int else None,
        tuple(dict.fromkeys(ask for ask in asks if isinstance(ask, str))),
        f"{act[0]} of {act[1]}"
        if all(isinstance(part, str) for part in act)
        else " ".join(each for each in named if isinstance(each, str)),
    )


@dataclass(frozen=True, slots=True)
class Judged:
    """One policy's answer to the request, or that of a primitive inside it.

    Attributes:
        what: name of the policy, or id of the primitive.
        answer: its effect or verdict, in words.
        reasons: codes that it gives.
        depth: of a primitive, how deep it stands in the predicate.
    """

    what: str
    answer: str
    reasons: tuple[str, ...]
    depth: int = 0


@dataclass(frozen=True, slots=True)
class Decided:
    """A decision as it was recorded, with what each policy said.

    Attributes:
        effect, reason, primitive: of the record.
        words: sentence of the reason.
        tier, index: as text; "" of none.
        obligations, findings: of the record; a finding as primitive, reason and detail.
        judged: answers of the policies in the set's order; empty where another set decided.
        combined: how they make the decision, a sentence a step.
        policy_digest: of the set that decided.
    """

    effect: str
    reason: str
    words: str
    primitive: str
    tier: str
    index: str
    obligations: tuple[str, ...]
    findings: tuple[tuple[str, str, str], ...]
    judged: tuple[Judged, ...]
    combined: tuple[str, ...]
    policy_digest: str


@dataclass(frozen=True, slots=True)
class Way:
    """Way of one request.

    Attributes:
        act: "operation of object".
        audience: at which it was asked.
        values: name, readable value, exact value.
        sponsor: at whom the chain starts; "" where none was verified.
        token_id: of its token; "" of none.
        hops: agent and hop id of each, from the first on.
        missing: names of readings that were not collected, after a fault or where nothing asked for them.
        plain: name and text of each reading of one word or number.
        readings: name and JSON text of each other part of the evidence that was collected.
        decisions: in order.
        outcome: of the last act on record; "" of none.
    """

    act: str
    audience: str
    values: tuple[tuple[str, str, str], ...]
    sponsor: str
    token_id: str
    hops: tuple[tuple[str, str], ...]
    missing: tuple[str, ...]
    plain: tuple[tuple[str, str], ...]
    readings: tuple[tuple[str, str], ...]
    decisions: tuple[Decided, ...]
    outcome: str


def way_of(lines: Sequence[bytes], policies: PolicySet) -> Way:
    """The way that these entries tell of.

    Args:
        lines: of the ledger, in order.
        policies: of this provider; a decision of exactly this set is explained policy by policy.
    """
    bodies = [body_of(line) for line in lines]
    decided = [body for body in bodies if isinstance(body.get("decision"), dict)]
    first = decided[0] if decided else {}
    asked, evidence = object_of(first.get("request")), object_of(first.get("evidence"))
    chain = object_of(evidence.get("chain"))
    listed = chain.get("hops")
    hops = [object_of(hop) for hop in listed] if isinstance(listed, list) else []
    outcomes = [str(body["outcome"]) for body in bodies if isinstance(body.get("outcome"), str)]
    collected = {name: each for name, each in evidence.items() if name not in {"type", "chain"} and each is not None}
    act = f"{asked.get('operation')} of {asked.get('object')}" if asked else told(lines[0]).operation
    return Way(
        act=act,
        audience=str(asked.get("audience", "")),
        values=tuple(_value(value) for value in asked.get("values", ()) if isinstance(value, list)),
        sponsor=str(object_of(chain.get("sponsor")).get("subject", "")),
        token_id=str(chain.get("token_id", "")),
        hops=tuple((str(hop.get("agent")), str(hop.get("hop_id"))) for hop in hops),
        missing=tuple(name for name, reading in collected.items() if reading == _NOT_COLLECTED),
        plain=tuple(
            (name, str(reading))
            for name, reading in collected.items()
            if not isinstance(reading, dict | list) and reading != _NOT_COLLECTED
        ),
        readings=tuple(
            (name, pretty(reading)) for name, reading in collected.items() if isinstance(reading, dict | list)
        ),
        decisions=tuple(_decided(body, policies) for body in decided),
        outcome=outcomes[-1] if outcomes else "",
    )


def _decided(body: Mapping[str, Any], policies: PolicySet) -> Decided:
    said, explained = object_of(body.get("decision")), _explained(body, policies)
    reason = str(said.get("reason", ""))
    findings = said.get("findings")
    return Decided(
        effect=str(said.get("effect", "")),
        reason=reason,
        words=REASONS[Reason(reason)].text if reason in Reason.__members__ else "",
        primitive=str(said.get("primitive", "")),
        tier="" if said.get("tier") is None else str(said["tier"]),
        index="" if said.get("index_milli") is None else str(said["index_milli"]),
        obligations=tuple(map(str, said.get("obligations") or ())),
        findings=tuple(
            (str(each.get("primitive", "")), str(each.get("reason", "")), pretty(each.get("detail", {})))
            for each in map(object_of, findings if isinstance(findings, list) else [])
        ),
        judged=() if explained is None else tuple(_judged(explained)),
        combined=() if explained is None else explained.combined,
        policy_digest=str(said.get("policy_digest", "")),
    )


def _explained(body: Mapping[str, Any], policies: PolicySet) -> Explanation | None:
    """The explanation of a recorded case, where this very set decided it and decides it so again."""
    said = object_of(body.get("decision"))
    if said.get("policy_digest") != policies.digest:
        return None
    try:
        case = case_json.read({"form": body["form"], "request": body["request"], "evidence": body["evidence"]})
    except (PolicyError, KeyError):
        return None
    found = explain(case.request, case.evidence, policies)
    return found if str(found.decision.effect) == said.get("effect") else None


def _judged(explained: Explanation) -> list[Judged]:
    return [row for said in explained.said for row in _of_policy(said)]


def _of_policy(said: PolicyExplanation) -> list[Judged]:
    answer = "no opinion" if said.effect is None else str(said.effect)
    own = Judged(said.policy.id, answer, tuple(str(finding.reason) for finding in said.findings))
    return [own] if said.predicate is None else [own, *_of_predicate(said.predicate, 1)]


def _of_predicate(node: PredicateVerdict, depth: int) -> list[Judged]:
    own = Judged(node.what, node.verdict, tuple(str(finding.reason) for finding in node.findings), depth)
    return [own, *(row for part in node.parts for row in _of_predicate(part, depth + 1))]


def _value(stated: list[Any]) -> tuple[str, str, str]:
    name, spelled, value = (*stated, "", "", "")[:3]
    try:
        kind = kind_of(str(spelled))
    except CapabilityError:
        kind = None
    exact = f"{json.dumps(value)} {spelled}"
    if isinstance(kind, Unit | DeclaredUnit) and type(value) is int:
        return str(name), readable(value, kind), exact
    return str(name), str(value), exact


def pretty(value: object) -> str:
    """The value as JSON text, of at most as many characters as a page shows."""
    text = json.dumps(value, indent=2, ensure_ascii=True)
    return text if len(text) <= _JSON_CHARACTERS else text[:_JSON_CHARACTERS] + " …"


def body_of(line: bytes) -> dict[str, Any]:
    """Body of an entry, or of the record of an enforcement point in it."""
    body = object_of(object_of(json.loads(line)).get("body"))
    record = body.get("record")
    return object_of(record.get("body")) if isinstance(record, dict) else body
