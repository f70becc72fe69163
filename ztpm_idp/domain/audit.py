"""Row of the ledger's index for an entry: by whom, about which agent, token, object and request. Pure.

An entry that names a request or a hop alone belongs to the token that an earlier entry named with it, so that one key
finds all that happened under a token: its issue, its hops, asks, votes, decisions, outcomes and its end.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from capabilities.keys import jws
from capabilities.values.errors import CapabilityError
from ztpm_idp.domain.ledger import RECORD_KINDS
from ztpm_idp.domain.parties import PersonRole, RegisteredPerson

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ztpm_idp.domain.parties import Party

KEY_CHARACTERS: Final = 256
"""Longest value of a column: an audience, or the id of a request."""
STATEMENT_BYTES: Final = 262_144
"""Longest signed ask that is looked into: that of a statement."""
AUDITORS: Final = frozenset({PersonRole.ADMIN, PersonRole.APPROVER, PersonRole.AUDITOR})
"""Roles that read the ledger."""
_PARTY_KINDS: Final = frozenset(
    {"person-registered", "agent-registered", "pep-registered", "sensor-registered", "person-key-added"}
)
_OBJECTS: Final = (
    "object", "operation", "tool", "mandate_id", "opening_id", "envelope_id", "latch_id", "change_id", "client_id",
    "person", "id",
)  # fmt: skip
"""Members of a body that say what an act is about, the nearest first."""


def may_audit(party: Party) -> bool:
    """True for a person who reads the ledger."""
    return isinstance(party, RegisteredPerson) and not party.roles.isdisjoint(AUDITORS)


@dataclass(frozen=True, slots=True)
class AuditRow:
    """Columns of one entry.

    Attributes:
        seq, at_ms: of the entry.
        kind: of the entry; of an enforcement point's record its own kind.
        actor: who did it.
        agent: the agent that it is about; of a hop its holder.
        token: id of the token that it belongs to.
        object: the thing that it is about: a robot or tool, a party, a mandate, an opening, a change.
        request: id of the request, and of its ask.
        trace: id of the trace that it is part of.
        effect: PERMIT, DENY or DEFER of a decision, the outcome of an act, the answer of a vote.
        hop: id of the hop that it names; a column of no table.
    """

    seq: int
    at_ms: int
    kind: str
    actor: str
    agent: str | None = None
    token: str | None = None
    object: str | None = None
    request: str | None = None
    trace: str | None = None
    effect: str | None = None
    hop: str | None = None


def row_of(line: bytes) -> AuditRow:
    """The row of an entry, from its own text alone.

    Args:
        line: the entry, as the ledger has it.
    """
    entry: dict[str, Any] = json.loads(line)
    kind, actor, body = str(entry["kind"]), str(entry["actor"]), entry["body"]
    if kind == "pep-record":
        record = body["record"]
        kind = record["kind"] if record["kind"] in RECORD_KINDS else kind
        body = record["body"]
    asked = _asked(body.get("ask"))
    request = object_of(body.get("request"))
    chain = object_of(object_of(body.get("evidence")).get("chain"))
    listed = chain.get("hops")
    hops = [object_of(hop) for hop in listed] if isinstance(listed, list) else []
    decided = object_of(body.get("decision"))
    revoked = body.get("kind") if kind == "revoked" else None
    return AuditRow(
        seq=entry["seq"],
        at_ms=entry["at_ms"],
        kind=kind,
        actor=actor,
        agent=_text(
            body.get("agent"),
            body.get("delegate"),
            hops[-1].get("agent") if hops else None,
            asked.get("agent"),
            body.get("id") if kind == "agent-registered" or revoked == "agent" else None,
            body.get("holder"),
        ),
        token=_text(
            body.get("token_id"),
            chain.get("token_id"),
            asked.get("token_id"),
            body.get("id") if revoked == "token" else None,
        ),
        object=_text(
            request.get("object"),
            asked.get("object"),
            *(body.get(name) for name in _OBJECTS if name != "id" or kind in _PARTY_KINDS or revoked),
            body.get("name") if kind == "tool-registered" else None,
        ),
        request=_text(request.get("id"), body.get("request_id"), body.get("ask_id"), asked.get("ask_id")),
        trace=_text(body.get("trace_id"), request.get("trace_id"), asked.get("trace_id")),
        effect=_text(
            decided.get("effect"), body.get("effect"), body.get("outcome"), body.get("answer"), body.get("state")
        ),
        hop=_text(
            body.get("hop_id"),
            body.get("id") if revoked == "hop" else None,
            body.get("parent") if kind == "delegation-refused" else None,
        ),
    )


def _asked(text: object) -> Mapping[str, Any]:
    """Claims of a signed ask; of a decision, the id and end of the ask that it opened."""
    return text if isinstance(text, dict) else claims_of(text)


def claims_of(text: object) -> dict[str, Any]:
    """Claims of a signed statement, which was verified when it was taken in; none of anything else."""
    if not isinstance(text, str):
        return {}
    try:
        return object_of(json.loads(jws.split(text, most_bytes=STATEMENT_BYTES).payload_raw))
    except (CapabilityError, ValueError):
        return {}


def object_of(value: object) -> dict[str, Any]:
    """The value, if it is an object; else an empty one."""
    return value if isinstance(value, dict) else {}


def _text(*candidates: object) -> str | None:
    """The first that is a text; cut where no column holds it."""
    return next((each[:KEY_CHARACTERS] for each in candidates if isinstance(each, str) and each), None)
