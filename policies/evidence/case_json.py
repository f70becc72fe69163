"""Recorded case: a decision's request and evidence as plain JSON, to be decided again.

Of a verified chain everything is written that a decision looks at, and of each hop's grants only the one that the
request asks for: the token itself, and the rest of what it grants, are named by its digest. Reading is strict, and is
the inverse of writing; what it gives was once decided on and proves nothing. It must never reach an enforcement point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.values.arguments import kind_given, plain, restated
from capabilities.values.chain import Chain
from capabilities.values.errors import FaultCode, QuantityError, ScopeError
from capabilities.values.units import DeclaredUnit, Quantity, Unit, kind_of
from policies.evidence.evidence import Evidence
from policies.evidence.model import Point, Request
from policies.evidence.plain_reader import (
    expect_keys,
    read_integer,
    read_list,
    read_number,
    read_table,
    read_text,
    reader_of,
)
from policies.words import canonical
from policies.words.errors import PolicyError, PolicyFault

if TYPE_CHECKING:
    from capabilities.values.arguments import Value
    from capabilities.values.scope import Scope

FORM: Final = "ztpm/case/1"
"""Names this form; another one is refused."""


@dataclass(frozen=True, slots=True)
class RecordedCase:
    """Request and the evidence on which it was decided, as a record states them."""

    request: Request
    evidence: Evidence


# --- writing ---------------------------------------------------------------------------------------------------------


def request_to_plain(request: Request) -> dict[str, object]:
    """A request, whole."""
    return {
        "id": request.request_id,
        "digest": request.digest,
        "points": sorted(str(point) for point in request.points),
        "audience": request.audience,
        "object": request.object,
        "operation": request.operation,
        "values": [[v.name, str(kind_given(v)), plain(v)] for v in request.values],
        "at": canonical.plain(request.at),
    }


def evidence_to_plain(evidence: Evidence, request: Request | None) -> dict[str, object]:
    """Plain evidence for a decision about `request`; None: nothing was asked for, so no grant is written.

    Total: strange readings have a form, too, which is refused when it is read.
    """
    chain = evidence.chain
    if not isinstance(chain, Chain):
        return canonical.record(evidence, {})
    hops = [canonical.record(hop, {"scope": _only(hop.scope, request)}) for hop in chain.hops]
    return canonical.record(evidence, {"chain": canonical.record(chain, {"hops": hops})})


def to_plain(request: Request, evidence: Evidence) -> dict[str, object]:
    """The whole document, which `read` takes."""
    return {"form": FORM, "request": request_to_plain(request), "evidence": evidence_to_plain(evidence, request)}


def _only(scope: Scope, request: Request | None) -> dict[str, object]:
    """Plain scope with the grant of the request alone, if it has it."""
    grant = None if request is None else scope.find(request.object, request.operation)
    return canonical.record(scope, {"grants": [] if grant is None else [canonical.plain(grant)]})


# --- reading ---------------------------------------------------------------------------------------------------------


def read(document: object) -> RecordedCase:
    """The request and evidence of a document.

    Args:
        document: as `to_plain` gives it; a request's digest and any reading may be absent, and a float may be a plain
            number.

    Raises:
        PolicyError: with the fault and the place in the document.
    """
    table = read_table(document, "document")
    expect_keys(table, "", {"form", "request", "evidence"}, set())
    if table["form"] != FORM:
        raise PolicyError(PolicyFault.UNKNOWN_VALUE, "form", FORM)
    return RecordedCase(read_request(table["request"]), read_evidence(table["evidence"]))


def read_request(plain: object) -> Request:
    """The request of a document or record.

    Raises:
        PolicyError: also `UNKNOWN_VALUE` at `request.digest` when the digest is of another request.
    """
    table = read_table(plain, "request")
    names = {"id", "points", "audience", "object", "operation", "values", "at"}
    expect_keys(table, "request", names, {"digest"})
    points = read_list(table["points"], "request.points")
    words = [reader_of(Point)(point, f"request.points[{i}]") for i, point in enumerate(points)]
    if len(set(words)) != len(words):
        raise PolicyError(PolicyFault.DUPLICATE_VALUE, "request.points")
    request = Request(
        request_id=read_text(table["id"], "request.id"),
        points=frozenset(words),
        audience=read_text(table["audience"], "request.audience"),
        object=read_text(table["object"], "request.object"),
        operation=read_text(table["operation"], "request.operation"),
        values=tuple(
            _value(value, f"request.values[{i}]")
            for i, value in enumerate(read_list(table["values"], "request.values"))
        ),
        at=read_number(table["at"], "request.at"),
    )
    if table.get("digest", request.digest) != request.digest:
        raise PolicyError(PolicyFault.UNKNOWN_VALUE, "request.digest", "of another request")
    return request


def read_evidence(plain: object) -> Evidence:
    """The evidence of a document or record.

    Raises:
        PolicyError: with the fault and the place in the document.
    """
    evidence: Evidence = reader_of(Evidence)(plain, "evidence")
    return evidence


def _value(stated: object, where: str) -> Value:
    listed = read_list(stated, where)
    if len(listed) != 3:
        raise PolicyError(PolicyFault.OUT_OF_RANGE, where, "name, kind and value")
    name, spelled, value = listed
    try:
        kind = kind_of(read_text(spelled, f"{where}[1]"))
    except ScopeError:
        raise PolicyError(PolicyFault.UNKNOWN_VALUE, f"{where}[1]", "a unit, or another kind") from None
    named = read_text(name, f"{where}[0]")
    if isinstance(kind, (Unit, DeclaredUnit)):
        return Quantity(named, kind, read_integer(value, f"{where}[2]"))
    try:
        return restated(named, kind, value)
    except QuantityError as error:
        wrong = error.code is FaultCode.PARAMETERS_WRONG
        fault = PolicyFault.WRONG_TYPE if wrong else PolicyFault.OUT_OF_RANGE
        raise PolicyError(fault, f"{where}[2]", error.detail) from None
