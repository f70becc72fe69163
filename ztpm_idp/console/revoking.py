"""Pages on which what was lent is taken back: the question, the passkey's word, what died, who confirmed it.

A session shows pages and takes nothing back by itself: each revocation is a person's own word, by a passkey that
asserts exactly it, or by an operator key at a terminal ([CON-2], [CON-3] in docs/spec.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from fastapi.responses import Response  # noqa: TC002  the framework reads the annotations
from pydantic import ValidationError

from capabilities.statements.people.assertion import Word, challenge, relying_party
from capabilities.statements.revocation import check_id
from capabilities.values.errors import StatementError
from ztpm_idp.console import forest, words
from ztpm_idp.console.pages import page
from ztpm_idp.console.tree import forest_of
from ztpm_idp.console.viewing import Viewer, session_over, to, viewer_of
from ztpm_idp.domain import commands
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent
from ztpm_idp.login.forms import fields_of, own_form
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.provider import confirmations, wire
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import provider_of, since_of

if TYPE_CHECKING:
    from ztpm_idp.console.forest import Branch
    from ztpm_idp.console.tree import Forest
    from ztpm_idp.store.points import FollowedPoint
    from ztpm_idp.store.revocations import MadeRevocation

router = APIRouter()
KINDS: Final = frozenset({RevocationKind.TOKEN, RevocationKind.HOP, RevocationKind.AGENT, RevocationKind.MANDATE})
"""Kinds that these pages take back: what was lent, and agents; people, keys and audiences need a terminal."""
PURPOSE: Final = "console revocation"
"""Purpose under which the page's nonce is sealed; it is no cookie's name."""
WATCHED_MS: Final = 30_000
"""Milliseconds after a revocation for which its page asks for confirmations: a point is gone then, too."""
REASON_CHARACTERS: Final = 256
"""Longest reason that the page takes."""
_SHOWN: Final = 64
"""Most hops that a question or an answer names; the rest is counted."""


@dataclass(frozen=True, slots=True)
class Subject:
    """Subject of a revocation that is asked for, or was made.

    Attributes:
        kind, id: as the index has them.
        hit: hops that it kills, of those that the viewer sees.
    """

    kind: RevocationKind
    id: str
    hit: list[Branch]

    @property
    def shown(self) -> list[Branch]:
        """Those of the hops that are named."""
        return self.hit[:_SHOWN]

    @property
    def agents(self) -> list[str]:
        """Agents that hold one of the hops."""
        return sorted({branch.hop.agent for branch in self.hit})


@dataclass(frozen=True, slots=True)
class Answered:
    """An enforcement point beside one revocation.

    Attributes:
        pep: its id.
        word: name of the text: confirmed, waiting, or gone.
        after_ms: from the revocation to its mark; None where that is not known.
    """

    pep: str
    word: str
    after_ms: int | None


def bound(issuer: str, nonce: str, *, by: str, kind: str, id_: str, reason: str) -> bytes:
    """The challenge, 32 bytes, of a passkey that takes something back: the whole of what it does.

    Args:
        issuer: of the provider.
        nonce: the provider's, fresh for this question.
        by: id of the person.
        kind: of what is revoked.
        id_: of that.
        reason: as the person wrote it.
    """
    told = {"by": by, "id": id_, "issuer": issuer, "kind": kind, "nonce": nonce, "reason": reason}
    return challenge(Word.REVOCATION, told)


@router.get("/console/revoke", include_in_schema=False)
async def show_question(request: Request) -> Response:
    """Asks whether to take something back, and says what would die; a reason may have been written before."""
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    given = request.query_params
    subject = await _subject(request, viewer, given.get("kind", ""), given.get("id", ""))
    provider = provider_of(request)
    party = relying_party(provider.settings.issuer)
    question = await words.ask(request, viewer, PURPOSE, nonce=words.fresh())
    return page(
        request,
        "revoke.html",
        viewer,
        active="tree",
        subject=subject,
        command=f"ztpm revoke {subject.kind.value} {subject.id} --reason 'WHY' --as {viewer.person.id}",
        rp="" if party is None or not viewer.person.passkeys else party.rp_id,
        passkeys=party is not None,
        reason=given.get("reason", "")[:REASON_CHARACTERS],
        most=REASON_CHARACTERS,
        nonce=question.nonce,
        sealed=question.sealed,
    )


@router.post("/console/revocations", include_in_schema=False)
async def take_back(request: Request) -> Response:
    """Takes something back on the word of a passkey of the person who is logged in."""
    fields = await fields_of(request)
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        kept = {name: fields.get(name, "") for name in ("kind", "id", "reason")}
        raise session_over(request, f"/revoke?{urlencode(kept)}")
    form = own_form(request, fields, "kind", "id", "reason", "sealed", *words.ASSERTED)
    try:
        stated = wire.RevocationBody.model_validate({name: form[name] for name in ("kind", "id", "reason")})
    except ValidationError:
        raise PageProblem(IdpCode.FORM_MALFORMED, "no revocation") from None
    said = words.assertion_in(form)
    if stated.kind not in KINDS:
        raise PageProblem(IdpCode.NOT_PERMITTED, "people, keys and audiences are revoked at a terminal")
    provider, by = provider_of(request), viewer.person.id
    # The question was asked in this session; the passkey asserts this revocation, and its word counts once ([CON-3]).
    question = await words.asked(request, viewer, PURPOSE, form["sealed"])
    expected = bound(
        provider.settings.issuer, question.nonce, by=by, kind=stated.kind.value, id_=stated.id, reason=stated.reason
    )
    once, _ = await words.word_on(request, viewer, question, said, expected)
    done = await words.done_once(request, viewer, commands.Revoke(by, stated.kind, stated.id, stated.reason), once)
    async with provider.store.read() as view:
        made = await view.revocations.among({(stated.kind.value, stated.id)})
    return to(request, f"/revocations/{made.get((stated.kind.value, stated.id), done.epoch)}")


@router.get("/console/revocations/{epoch}", include_in_schema=False)
async def show_revocation(request: Request, epoch: str) -> Response:
    """A revocation: what died by it, and which enforcement points have confirmed it."""
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    provider, at_ms, number = provider_of(request), provider_of(request).now_ms(), _epoch(epoch)
    async with provider.store.read() as view:
        made = await view.revocations.at(number)
        counters, points = await view.counters(), await view.points.every()
    if made is None or not (viewer.sees_all or made.by == viewer.person.id):
        raise PageProblem(IdpCode.NOT_FOUND, "no such revocation of what you see")
    answered = [_answered(point, made, counters.revocation_line, at_ms) for point in points]
    watched = any(each.word == "waiting" for each in answered) and at_ms - made.at_ms < WATCHED_MS
    values = {"made": made, "answered": answered, "watched": watched, "active": "tree"}
    if "points" in request.query_params:
        return page(request, "points.html", viewer, **values)
    found = await forest_of(request, viewer)
    subject = Subject(RevocationKind(made.kind), made.id, list(forest.hit(found.roots, (made.kind, made.id))))
    return page(request, "revoked.html", viewer, subject=subject, **values)


def _answered(point: FollowedPoint, made: MadeRevocation, line: int, at_ms: int) -> Answered:
    if point.line == line and point.epoch >= made.epoch:
        # Of a later mark nothing says when the point had come so far.
        exact = point.epoch == made.epoch
        return Answered(point.pep, "confirmed", max(0, point.confirmed_ms - made.at_ms) if exact else None)
    gone = at_ms - point.heard_ms > confirmations.CONNECTED_MS
    return Answered(point.pep, "gone" if gone else "waiting", None)


async def _subject(request: Request, viewer: Viewer, kind: str, id_: str) -> Subject:
    """The subject of a question, when the viewer may take it back.

    Raises:
        PageProblem: `QUERY_MALFORMED`, `NOT_PERMITTED` or `NOT_FOUND`.
    """
    if kind not in {each.value for each in KINDS}:
        raise PageProblem(IdpCode.QUERY_MALFORMED, "kind is token, hop, agent or mandate")
    try:
        check_id(kind, id_)
    except StatementError as error:
        raise PageProblem(IdpCode.QUERY_MALFORMED, error.detail) from None
    found = await forest_of(request, viewer)
    if not await _may(request, viewer, found, RevocationKind(kind), id_):
        raise PageProblem(IdpCode.NOT_PERMITTED, "not yours to take back, or not there")
    return Subject(RevocationKind(kind), id_, list(forest.hit(found.roots, (kind, id_))))


async def _may(request: Request, viewer: Viewer, found: Forest, kind: RevocationKind, id_: str) -> bool:
    """True where the question is the viewer's to ask; what counts is decided again with the revocation itself."""
    if PersonRole.ADMIN in viewer.person.roles:
        return True
    if PersonRole.SPONSOR not in viewer.person.roles:
        return False
    async with provider_of(request).store.read() as view:
        match kind:
            case RevocationKind.AGENT:
                party = await view.party(id_)
                return isinstance(party, RegisteredAgent) and party.sponsor == viewer.person.id
            case RevocationKind.MANDATE:
                mandate = await view.lending.mandate(id_)
                return mandate is not None and mandate.sponsor == viewer.person.id
            case _:
                own = [tree.roots for tree in found.trees if tree.sponsor == viewer.person.id]
                return any(True for roots in own for _ in forest.hit(roots, (kind.value, id_)))


def _epoch(text: str) -> int:
    try:
        return since_of(text)
    except Problem:
        raise PageProblem(IdpCode.NOT_FOUND, "no such revocation") from None
