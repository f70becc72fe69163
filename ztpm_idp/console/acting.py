"""Pages on which people and agents are administered: what would change, the passkey's word, and what became of it.

A session shows a question and does nothing: each act is a person's own word, by a passkey that asserts exactly it, or
by an operator key at a terminal ([CON-11] to [CON-14] in docs/spec.md).
"""

from __future__ import annotations

import json
import secrets
from typing import TYPE_CHECKING, Final
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from fastapi.responses import Response  # noqa: TC002  the framework reads the annotations

from capabilities.keys.keys import thumbprint
from capabilities.statements.people.assertion import relying_party
from capabilities.values.strict_json import canonical
from ztpm_idp.console import acts, words
from ztpm_idp.console.acts import Act
from ztpm_idp.console.pages import page
from ztpm_idp.console.tree import may_cut
from ztpm_idp.console.viewing import Viewer, session_over, to, viewer_of
from ztpm_idp.domain.changes import ChangeState
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent, RegisteredPerson, Standing
from ztpm_idp.domain.signed import AssertedAct
from ztpm_idp.login.forms import fields_of, own_form
from ztpm_idp.login.pages import PageProblem
from ztpm_idp.routes.caller import provider_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ztpm_idp.domain.changes import Change
    from ztpm_idp.provider.done import Done
    from ztpm_idp.store.transaction import Transaction

router = APIRouter()
PURPOSE: Final = "console administration"
"""Purpose under which a question is sealed; it is no cookie's name."""


@router.get("/console/acts/{name}", include_in_schema=False)
async def show_question(request: Request, name: str) -> Response:
    """Asks for the passkey's word on an act, with every member of it; says the command that does the same."""
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        return viewer
    query = request.query_params
    try:
        act = Act(name)
        members = acts.read(act, {field: query.getlist(field) for field in query})
    except acts.UnfitError as error:
        raise PageProblem(IdpCode.QUERY_MALFORMED, str(error)) from None
    except ValueError:
        raise PageProblem(IdpCode.NOT_FOUND, "no such act") from None
    provider = provider_of(request)
    async with provider.store.read() as view:
        act, seen, change = await _seen(view, viewer, act, members, at_ms=provider.now_ms())
    nonce, party = words.fresh(), relying_party(provider.settings.issuer)
    said = {"act": act.value} | members | seen
    said |= {"by": viewer.person.id, "issuer": provider.settings.issuer, "nonce": nonce}
    question = await words.ask(request, viewer, PURPOSE, nonce=nonce, said=said)
    return page(
        request,
        "act.html",
        viewer,
        active="people" if act in acts.PEOPLE else "agents",
        act=act.value,
        said=said,
        # ASCII, so that it is no text to be spelled: the script draws it, and signs what it has drawn.
        exactly=json.dumps(said),
        command=acts.typed(act, said, by=viewer.person.id),
        waits=act in {Act.PROPOSE_END, Act.PROPOSE_ROLES, Act.PROPOSE_PERSON},
        at_terminal=act is Act.CONFIRM and change is not None and change.at_terminal,
        rp="" if party is None or not viewer.person.passkeys else party.rp_id,
        passkeys=party is not None,
        sealed=question.sealed,
    )


@router.post("/console/acts", include_in_schema=False)
async def act_on_word(request: Request) -> Response:
    """Does what a question asked, on the word of a passkey of the person who is logged in."""
    fields = await fields_of(request)
    viewer = await viewer_of(request)
    if not isinstance(viewer, Viewer):
        kept = await words.kept_in(request, PURPOSE, fields.get("sealed", ""))
        raise session_over(request, _question_on(kept["said"]) if kept else "")
    form = own_form(request, fields, "sealed", *words.ASSERTED)
    asserted = words.assertion_in(form)
    provider, by = provider_of(request), viewer.person.id
    # 1. The question was asked in this session, not long ago: what it asked is in its seal alone.
    question = await words.asked(request, viewer, PURPOSE, form["sealed"])
    said: dict[str, str] = dict(question.more["said"])
    # 2. What the page showed is so still.
    act = Act(said["act"])
    members = acts.own(act, said)
    async with provider.store.read() as view:
        now, seen, _ = await _seen(view, viewer, act, members, at_ms=provider.now_ms())
    if now is not act or members | seen != {name: said[name] for name in said.keys() - acts.FRAME}:
        raise PageProblem(IdpCode.CONFLICT, "it changed since the page was shown: look again")
    # 3. The passkey is one of this person's now, and asserts exactly that; its word counts once ([CON-12]).
    once, found = await words.word_on(request, viewer, question, asserted, acts.bound(said))
    signed = AssertedAct(
        said=canonical(said).decode(),
        key=thumbprint(found.key),
        authenticator=asserted.authenticator,
        client=asserted.client,
        signature=asserted.signature,
    )
    change_id = secrets.token_hex(16)
    command = acts.command(said, by=by, signed=signed, change_id=change_id, at_ms=provider.now_ms())
    done = await words.done_once(request, viewer, command, once)
    return await _after(request, act, said, done, change_id=change_id)


def _question_on(said: Mapping[str, str]) -> str:
    """Path and query of the question on the act that was shown."""
    act = Act(said["act"])
    return f"/acts/{act.value}?{urlencode(acts.fields(act, said))}"


async def _after(request: Request, act: Act, said: Mapping[str, str], done: Done, *, change_id: str) -> Response:
    """The way to the page on which the result is seen."""
    match act:
        case Act.SUSPEND | Act.RESTORE:
            return to(request, f"/agents/{said['agent']}")
        case Act.REGISTER_AGENT:
            return to(request, f"/agents/{said['id']}")
        case Act.END:
            name = "sponsor", said["person"]
            async with provider_of(request).store.read() as view:
                made = await view.revocations.among({name})
            return to(request, f"/revocations/{made.get(name, done.epoch)}")
        case Act.CONFIRM | Act.DECLINE:
            return to(request, f"/people?after={said['change_id']}")
        case _:
            return to(request, f"/people?after={change_id}")


async def _seen(
    view: Transaction, viewer: Viewer, act: Act, members: Mapping[str, str], *, at_ms: int
) -> tuple[Act, dict[str, str], Change | None]:
    """Act that this amounts to now; what is so beforehand and bound with it; the change that is answered.

    Raises:
        PageProblem: `NOT_PERMITTED`, `NOT_FOUND`, `PARTY_ENDED`, `CHANGE_UNKNOWN` or `CHANGE_OVER`.
    """
    admin = PersonRole.ADMIN in viewer.person.roles
    if act in {Act.SUSPEND, Act.RESTORE}:
        agent = await view.party(members["agent"])
        if not isinstance(agent, RegisteredAgent) or not may_cut(viewer, agent.sponsor):
            raise PageProblem(IdpCode.NOT_PERMITTED, "no agent that is yours to suspend or restore")
        return act, {"standing": agent.standing.value, "sponsor": agent.sponsor}, None
    if act is Act.REGISTER_AGENT:
        if not may_cut(viewer, members["sponsor"]):
            raise PageProblem(IdpCode.NOT_PERMITTED, "a sponsor, or an administrator for one, registers agents")
        return act, {}, None
    if not admin and not (act is Act.END and members["person"] == viewer.person.id):
        raise PageProblem(IdpCode.NOT_PERMITTED, "administrators change people")
    if act is Act.PROPOSE_PERSON:
        return act, {}, None
    if act in {Act.CONFIRM, Act.DECLINE}:
        change = await view.people.change(members["change_id"])
        if change is None:
            raise PageProblem(IdpCode.CHANGE_UNKNOWN)
        if (state := change.state(at_ms)) is not ChangeState.OPEN:
            raise PageProblem(IdpCode.CHANGE_OVER, f"it is {state.value}")
        whom = await view.party(change.person)
        had = {"had": _roles(whom)} if isinstance(whom, RegisteredPerson) else {}
        return act, acts.told(change) | had, change
    person = await view.party(members["person"])
    if not isinstance(person, RegisteredPerson):
        raise PageProblem(IdpCode.NOT_FOUND, "no such person")
    if person.standing is Standing.REVOKED:
        raise PageProblem(IdpCode.PARTY_ENDED)
    if act is not Act.PROPOSE_ROLES:
        alone = person.id == viewer.person.id or not person.privileged
        act = Act.END if alone else Act.PROPOSE_END
    return act, {"name": person.name, "had": _roles(person)}, None


def _roles(person: RegisteredPerson) -> str:
    return " ".join(sorted(person.roles))
