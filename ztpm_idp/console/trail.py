"""Pages of the trail: the ledger searched, one entry with its proof, and the whole way of one request."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from fastapi.responses import PlainTextResponse, Response, StreamingResponse

from capabilities.keys.keys import b64u
from capabilities.log import tree_head
from capabilities.values.units import INT_LIMIT
from ztpm_idp.console import journey, pictures
from ztpm_idp.console.pages import page
from ztpm_idp.console.viewing import Viewer, auditor_of
from ztpm_idp.domain.audit import KEY_CHARACTERS, AuditRow
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.login.session import NO_STORE
from ztpm_idp.provider import audit, cef
from ztpm_idp.provider.feed import ledger_export
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.audit import follower_of
from ztpm_idp.routes.caller import provider_of, since_of
from ztpm_idp.routes.ledger import picture_of
from ztpm_idp.store.audit import Search

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Mapping

    from ztpm_idp.provider.provider import Provider

router = APIRouter()
ROWS: Final = 50
"""Entries of one page."""
LOOKS: Final = 8
"""Looks at the ledger for one page: each of at most a thousand entries and four megabytes."""
RELATED: Final = 500
"""Most entries of one request's way."""
EXPORTED: Final = 100_000
"""Most entries of one export of a search; the whole ledger has no bound."""
WORDS: Final = ("kind", "actor", "agent", "token", "object", "request", "trace")
"""Columns that are searched exactly."""
_INSIDE: Final = ("reason", "tier")
"""Members of an entry that are searched by reading it."""
_TIMES: Final = ("since", "until")
_FORMS: Final = {"lines": "application/x-ndjson", "cef": "text/plain; charset=utf-8"}


@dataclass(frozen=True, slots=True)
class Question:
    """Question of the search form.

    Attributes:
        asked: of the index, the newest entries first.
        reason: code that an entry must state, or "".
        tier: that it must state, or None.
        given: fields as they were given, for the form and for links.
    """

    asked: Search
    reason: str
    tier: int | None
    given: Mapping[str, str]

    @property
    def reads(self) -> bool:
        """True where entries are read to be chosen."""
        return bool(self.reason) or self.tier is not None

    def meets(self, told: journey.EntryWords) -> bool:
        """True for an entry that states the reason and the tier."""
        return (not self.reason or self.reason in told.reasons) and (self.tier is None or self.tier == told.tier)


@dataclass(frozen=True, slots=True)
class Line:
    """One entry of an answer: its columns, its hash, and what it says itself."""

    row: AuditRow
    digest: str
    told: journey.EntryWords
    raw: bytes


@dataclass(frozen=True, slots=True)
class TrailPage:
    """Entries that meet a question, the newest first.

    Attributes:
        lines: at most as many as were asked for.
        before: number of the entry before which to go on; None where there is no more.
        looked: the number of the last entry that was looked at.
        size: entries of the ledger.
    """

    lines: tuple[Line, ...]
    before: int | None
    looked: int
    size: int


def question_of(request: Request) -> Question:
    """The question of a form; a field that is empty asks nothing.

    Raises:
        PageProblem: `QUERY_MALFORMED`.
    """
    pairs = [(name, value.strip()) for name, value in request.query_params.multi_items() if value.strip()]
    given = dict(pairs)
    allowed = {*WORDS, *_INSIDE, *_TIMES, "before", "form"}
    if len(given) != len(pairs) or given.keys() - allowed:
        raise PageProblem(IdpCode.QUERY_MALFORMED, "each field once, and no other than the form has")
    words = {name: given[name] for name in WORDS if name in given}
    reason = given.get("reason", "")
    if any(len(word) > KEY_CHARACTERS or "\x00" in word for word in (*words.values(), reason)):
        raise PageProblem(IdpCode.QUERY_MALFORMED, f"a word has at most {KEY_CHARACTERS} characters")
    tier = given.get("tier", "")
    if tier not in {"", "0", "1", "2", "3", "4"}:
        raise PageProblem(IdpCode.QUERY_MALFORMED, "tier is 0 to 4")
    asked = Search(
        **words,  # type: ignore[arg-type]  # texts by the names of its own fields
        since_ms=_time(given, "since"),
        until_ms=_time(given, "until"),
        before=_before(given),
        most=ROWS,
    )
    return Question(asked, reason, int(tier) if tier else None, given)


def _before(given: Mapping[str, str]) -> int:
    try:
        return since_of(given["before"]) if "before" in given else INT_LIMIT
    except Problem:
        raise PageProblem(IdpCode.QUERY_MALFORMED, "before") from None


def _time(given: Mapping[str, str], name: str) -> int | None:
    """UTC as a form's field has it, in milliseconds since the epoch."""
    if name not in given:
        return None
    try:
        at = datetime.fromisoformat(given[name])
        return int((at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp() * 1_000)
    except (ValueError, OverflowError):
        raise PageProblem(IdpCode.QUERY_MALFORMED, f"{name} is a time in UTC, as 2026-11-25T22:00") from None


async def found(request: Request, question: Question, *, most: int) -> TrailPage:
    """The newest entries that meet a question: those of the index, read where it asks what only an entry says."""
    provider, follower = provider_of(request), follower_of(request)
    lines, before = list[Line](), question.asked.before or INT_LIMIT
    size = looked = 0
    more: int | None = None
    for _ in range(LOOKS):
        wanted = audit.MOST_ENTRIES if question.reads else most - len(lines)
        asked = replace(question.asked, before=before, most=min(wanted, audit.MOST_ENTRIES))
        part = await audit.search(provider, follower, asked, whole=True)
        size, more = part.size, part.more_after
        for (row, digest), raw in zip(part.rows, part.lines, strict=True):
            looked, told = row.seq, journey.told(raw)
            if not question.meets(told):
                continue
            lines.append(Line(row, digest, told, raw))
            if len(lines) == most:
                last = more is None and row.seq == part.rows[-1][0].seq
                return TrailPage(tuple(lines), None if last else row.seq, looked, size)
        if more is None:
            break
        before = more
    return TrailPage(tuple(lines), more, looked, size)


@router.get("/console/trail", include_in_schema=False)
async def show_trail(request: Request) -> Response:
    """The ledger's entries by who, what, when, reason and tier, the newest first."""
    viewer = await auditor_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    question = question_of(request)
    answer = await found(request, question, most=ROWS)
    kept = {name: value for name, value in question.given.items() if name not in {"before", "form"}}
    return page(
        request,
        "trail.html",
        viewer,
        active="trail",
        words=WORDS,
        given=question.given,
        answer=answer,
        query=urlencode(kept),
        next=urlencode(kept | {"before": str(answer.before)}),
    )


@router.get("/console/trail/export", include_in_schema=False)
async def export(request: Request) -> Response:
    """The entries that meet a question, as JSON lines or CEF; without one the whole ledger with its checkpoint."""
    viewer = await auditor_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    question = question_of(request)
    form = question.given.get("form", "lines")
    if form not in _FORMS:
        raise PageProblem(IdpCode.QUERY_MALFORMED, "form is lines or cef")
    whole = form == "lines" and question.given.keys() <= {"form"}
    lines = ledger_export(provider_of(request)) if whole else _exported(request, question, form)
    name = f"ledger.{'ndjson' if form == 'lines' else 'cef'}"
    headers = NO_STORE | {"Content-Disposition": f'attachment; filename="{name}"', "X-Content-Type-Options": "nosniff"}
    return StreamingResponse(lines, media_type=_FORMS[form], headers=headers)


async def _exported(request: Request, question: Question, form: str) -> AsyncIterator[bytes]:
    left, before = EXPORTED, question.asked.before
    while left > 0:
        asked = replace(question, asked=replace(question.asked, before=before))
        part = await found(request, asked, most=min(left, audit.MOST_ENTRIES))
        for each in part.lines:
            text = each.raw if form == "lines" else cef.event(each.row, each.digest, each.raw).encode()
            yield text + b"\n"
        left, before = left - len(part.lines), part.before
        if before is None:
            return


@router.get("/console/trail/entries/{number}", include_in_schema=False)
async def show_entry(request: Request, number: str) -> Response:
    """One entry, whole, with the proof that it stands in the ledger, which the browser checks."""
    viewer = await auditor_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    provider = provider_of(request)
    line, proof = await _proven(request, number)
    async with provider.store.read() as view:
        rows = await view.audit.search(Search(after=proof.index, through=proof.index + 1, most=1))
    return page(
        request,
        "entry.html",
        viewer,
        active="trail",
        number=proof.index + 1,
        row=rows[0][0] if rows else None,
        pretty=json.dumps(json.loads(line), indent=2, ensure_ascii=True),
        **_log_of(provider),
    )


@router.get("/console/trail/entries/{number}/line", include_in_schema=False)
async def read_line(request: Request, number: str) -> Response:
    """The bytes of one entry that its hash is over."""
    viewer = await auditor_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    line, _ = await _proven(request, number)
    return Response(line, media_type="application/json", headers=NO_STORE)


@router.get("/console/trail/entries/{number}/proof", include_in_schema=False)
async def read_proof(request: Request, number: str) -> Response:
    """The proof of one entry, as C2SP tlog-proof has it."""
    viewer = await auditor_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    _, proof = await _proven(request, number)
    return PlainTextResponse(proof.text, headers=NO_STORE)


@router.get("/console/trail/pictures/{digest}", include_in_schema=False)
async def read_picture(request: Request, digest: str) -> Response:
    """The picture with this SHA-256 (hex), byte for byte; the browser compares it with the record."""
    viewer = await auditor_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    return await picture_of(request, digest)


def _log_of(provider: Provider) -> dict[str, str]:
    """The log's origin and keys, with which a browser checks a proof."""
    keys = sorted(map(b64u, provider.rules.trust.ledger))
    return {"origin": tree_head.origin_of(provider.settings.issuer), "keys": " ".join(keys)}


async def _proven(request: Request, number: str) -> tuple[bytes, tree_head.EntryProof]:
    provider = provider_of(request)
    try:
        proof = await audit.entry_proof(provider, follower_of(request), since_of(number))
        return await audit.entry_line(provider, proof.index + 1), proof
    except Problem as problem:
        raise PageProblem(IdpCode.ENTRY_UNKNOWN, problem.detail) from None


@router.get("/console/trail/requests/{request_id}", include_in_schema=False)
async def show_request(request: Request, request_id: str) -> Response:
    """The whole way of one request: authority, evidence, what each policy said, people's answers, outcome."""
    viewer = await auditor_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    if not 0 < len(request_id) <= KEY_CHARACTERS:
        raise PageProblem(IdpCode.ENTRY_UNKNOWN)
    lines = await _about(request, Search(request=request_id, most=RELATED))
    asks = sorted({ask for line in lines for ask in line.told.asks} - {request_id})
    for ask in asks[:8]:
        lines += await _about(request, Search(request=ask, most=RELATED))
    if not lines:
        raise PageProblem(IdpCode.ENTRY_UNKNOWN, "no entry names this request")
    lines.sort(key=lambda line: line.row.seq)
    way = journey.way_of([line.raw for line in lines], provider_of(request).rules.policies)
    made = list[Line]()
    if way.token_id:
        of_token = await _about(request, Search(token=way.token_id, most=RELATED))
        made = [line for line in of_token if line.row.kind in journey.LENT]
    raw = [line.raw for line in lines]
    named = pictures.pictures_of(raw)
    return page(
        request,
        "request.html",
        viewer,
        active="trail",
        request_id=request_id,
        lines=lines,
        way=way,
        made=made,
        pictures=named[: pictures.MOST],
        more=named[pictures.MOST :],
        ends=pictures.ends_of(raw),
        **_log_of(provider_of(request)),
    )


async def _about(request: Request, asked: Search) -> list[Line]:
    part = await audit.search(provider_of(request), follower_of(request), asked, whole=True)
    return [Line(row, digest, journey.told(raw), raw) for (row, digest), raw in zip(part.rows, part.lines, strict=True)]
