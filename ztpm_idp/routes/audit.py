"""The ledger for auditors and holders of checkpoints: proofs, single entries, search."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

from fastapi import APIRouter, Depends, Request
from fastapi.responses import PlainTextResponse, Response

from ztpm_idp.domain.audit import KEY_CHARACTERS, may_audit
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.provider import audit
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import Call, authenticated, provider_of, query_of, since_of
from ztpm_idp.routes.described import media, query
from ztpm_idp.store.audit import Search

if TYPE_CHECKING:
    from ztpm_idp.provider.audit import LedgerFollower

router = APIRouter()
_HASH: Final = re.compile(r"[0-9a-f]{64}")
_FORMS: Final = {"rows": "application/json", "lines": "application/x-ndjson", "cef": "text/plain"}
_WORDS: Final = ("kind", "actor", "agent", "token", "object", "request", "trace")
_NUMBERS: Final = ("since_ms", "until_ms", "after", "most")
MORE: Final = "ztpm-more-after"
"""Header with the number after which a search goes on, where it does."""
_NO_STORE: Final = {"Cache-Control": "no-store"}


async def auditor(call: Annotated[Call, Depends(authenticated)]) -> Call:
    """Dependency of a route for those who read the ledger.

    Raises:
        Problem: `NOT_PERMITTED`.
    """
    if not may_audit(call.party):
        raise Problem(IdpCode.NOT_PERMITTED)
    return call


Caller = Annotated[Call, Depends(authenticated)]
Auditor = Annotated[Call, Depends(auditor)]


def follower_of(request: Request) -> LedgerFollower:
    """The one follower of this application."""
    follower: LedgerFollower = request.app.state.ledger_follower
    return follower


@router.get("/ledger/checkpoint", response_class=PlainTextResponse)
async def checkpoint(request: Request, call: Caller) -> PlainTextResponse:  # noqa: ARG001  being registered is all that is asked
    """The signed checkpoint of the ledger as it is (C2SP tlog-checkpoint), for every registered caller."""
    text = await audit.checkpoint(provider_of(request), follower_of(request))
    return PlainTextResponse(text, headers=_NO_STORE)


@router.get(
    "/ledger/proofs/inclusion", response_class=PlainTextResponse, openapi_extra=query(optional=("entry", "hash"))
)
async def inclusion(request: Request, call: Caller) -> PlainTextResponse:  # noqa: ARG001  it tells hashes alone
    """Proof that the entry with a number, or with a hash, stands in the ledger (C2SP tlog-proof)."""
    by_hash = "hash" in request.query_params
    (stated,) = query_of(request, "hash" if by_hash else "entry")
    if by_hash and not _HASH.fullmatch(stated):
        raise Problem(IdpCode.QUERY_MALFORMED, "hash: 64 hex digits")
    proof = await audit.entry_proof(provider_of(request), follower_of(request), stated if by_hash else since_of(stated))
    return PlainTextResponse(proof.text, headers=_NO_STORE)


@router.get("/ledger/proofs/consistency", openapi_extra=query("old"))
async def consistency(request: Request, call: Caller) -> dict[str, Any]:  # noqa: ARG001  it tells hashes alone
    """Proof that the ledger goes on from its first `old` entries: a path, and the checkpoint that it leads to."""
    (old,) = query_of(request, "old")
    path, signed = await audit.consistency(provider_of(request), follower_of(request), old=since_of(old))
    return {"old": since_of(old), "path": [each.hex() for each in path], "checkpoint": signed}


@router.get("/ledger/entries/{number}")
async def entry(request: Request, number: str, call: Auditor) -> Response:  # noqa: ARG001
    """One entry as the ledger has it: the bytes that its hash is over."""
    line = await audit.entry_line(provider_of(request), since_of(number))
    return Response(line, media_type="application/json", headers=_NO_STORE)


@router.get("/ledger/search", openapi_extra=query(optional=(*_WORDS, *_NUMBERS, "form")) | media(*_FORMS.values()))
async def search(request: Request, call: Auditor) -> Response:  # noqa: ARG001
    """Entries by kind, actor, agent, token, object, request, trace and time, page by page.

    `form` is `rows` (their columns as JSON), `lines` (the entries as JSON lines) or `cef`; `after` goes on behind an
    entry, and the header `ztpm-more-after` names the next.
    """
    asked, form = _question(request)
    found = await audit.search(provider_of(request), follower_of(request), asked, whole=form != "rows")
    headers = _NO_STORE | ({} if found.more_after is None else {MORE: str(found.more_after)})
    match form:
        case "rows":
            rows = [_told(row, digest) for row, digest in found.rows]
            answer = {"rows": rows, "more_after": found.more_after, "size": found.size}
            return Response(_json(answer), media_type=_FORMS[form], headers=headers)
        case "lines":
            return Response(b"".join(line + b"\n" for line in found.lines), media_type=_FORMS[form], headers=headers)
        case _:
            return PlainTextResponse(audit.as_cef(found), headers=headers)


def _question(request: Request) -> tuple[Search, Literal["rows", "lines", "cef"]]:
    given = dict(request.query_params)
    if len(given) != len(request.query_params.multi_items()) or given.keys() - {*_WORDS, *_NUMBERS, "form"}:
        raise Problem(IdpCode.QUERY_MALFORMED, f"each once, of {', '.join((*_WORDS, *_NUMBERS, 'form'))}")
    form = given.pop("form", "rows")
    if form not in _FORMS:
        raise Problem(IdpCode.QUERY_MALFORMED, "form is rows, lines or cef")
    words = {name: given[name] for name in _WORDS if name in given}
    if any(not 0 < len(word) <= KEY_CHARACTERS or "\x00" in word for word in words.values()):
        raise Problem(IdpCode.QUERY_MALFORMED, f"a word has 1 to {KEY_CHARACTERS} characters")
    numbers = {name: since_of(given[name]) for name in _NUMBERS if name in given}
    if not 1 <= numbers.get("most", 1) <= audit.MOST_ENTRIES:
        raise Problem(IdpCode.QUERY_MALFORMED, f"most is 1 to {audit.MOST_ENTRIES}")
    return Search(**words, **numbers), form  # type: ignore[arg-type, return-value]  # told apart by name


def _told(row: Any, digest: str) -> dict[str, object]:
    columns = asdict(row)
    del columns["hop"]
    return {name: value for name, value in columns.items() if value is not None} | {"hash": digest}


def _json(value: object) -> bytes:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode()
