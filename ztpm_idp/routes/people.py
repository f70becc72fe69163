"""People: who they are, and the changes of them that take two; recovery by the root key."""

from __future__ import annotations

import secrets
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request

from capabilities.keys.keys import thumbprint, unb64u
from ztpm_idp.domain import commands
from ztpm_idp.domain.asking.asks import AskState
from ztpm_idp.domain.changes import ROOT, Change, ChangeKind, ChangeState, Word
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.events import ChangeEnded, RevocationKind
from ztpm_idp.domain.lending import allowances
from ztpm_idp.domain.login.commands import EndLogin
from ztpm_idp.domain.parties import PersonRole, RegisteredPerson
from ztpm_idp.provider import wire
from ztpm_idp.provider.problems import Problem
from ztpm_idp.routes.caller import Call, RootCall, authenticated, body_of, by_root, in_session, provider_of
from ztpm_idp.routes.registry import end

router = APIRouter()
Caller = Annotated[Call, Depends(authenticated)]
Bound = Annotated[Call, Depends(in_session())]
Root = Annotated[RootCall, Depends(by_root)]


@router.post("/people", status_code=201, openapi_extra=body_of(wire.PersonBody))
async def register_person(request: Request, call: Caller) -> dict[str, str]:
    """An administrator registers a person who only lends or reads; any other is proposed at `/changes/person`."""
    body = call.body(wire.PersonBody)
    command = commands.RegisterPerson(call.party.id, body.id, body.name, unb64u(body.key), frozenset(body.roles))
    await provider_of(request).run(command, actor=call.party.id)
    return {"id": body.id}


@router.get("/people")
async def list_people(request: Request, call: Bound) -> list[dict[str, Any]]:
    """Every person, for people, with all keys that sign for it now, and its logins at other providers."""
    of_people(call)
    async with provider_of(request).store.read() as view:
        found, logins = await view.all_parties("person"), await view.sessions.logins()
    return [
        {
            "id": person.id,
            "name": person.name,
            "roles": sorted(role.value for role in person.roles),
            "status": person.standing.value,
            "keys": sorted(map(thumbprint, person.keys)),
            "logins": logins.get(person.id, []),
            "passkeys": sorted(map(thumbprint, person.passkey_keys)),
        }
        for person in found
        if isinstance(person, RegisteredPerson)
    ]


@router.get("/people/{id_}/allowances")
async def read_allowances(request: Request, id_: str, call: Bound) -> dict[str, Any]:
    """Allowances of a sponsor, and what is used of each, for that person and for administrators."""
    of_people(call)
    roles = call.party.roles if isinstance(call.party, RegisteredPerson) else frozenset()
    if call.party.id != id_ and PersonRole.ADMIN not in roles:
        raise Problem(IdpCode.NOT_PERMITTED, "the sponsor and administrators see them")
    provider = provider_of(request)
    at_ms = provider.now_ms()
    async with provider.store.read() as view:
        if not isinstance(await view.party(id_), RegisteredPerson):
            raise Problem(IdpCode.NOT_FOUND)
        asked = await view.approvals.standing("", since_s=at_ms // 1_000)
        waiting = sum(1 for one in asked if one.ask.sponsor == id_ and one.state(at_ms) is AskState.OPEN)
        used = await view.using.shown(id_, at_ms=at_ms, asks=waiting)
    most = provider.rules.allowances.of(id_)
    return {
        "sponsor": id_,
        "allowances": [
            {"name": name, "used": getattr(used, name), "most": getattr(most, name)} for name in allowances.names()
        ],
    }


@router.post("/people/{id_}/disable", openapi_extra=body_of(wire.ReasonBody))
async def disable_person(request: Request, id_: str, call: Caller) -> dict[str, int]:
    """The person and every tree of authority under it are dead, for ever.

    The end of another approver or administrator is proposed at `/changes/end`.
    """
    return await end(request, call, RevocationKind.SPONSOR, id_)


@router.post("/changes/person", status_code=201, openapi_extra=body_of(wire.PersonBody))
async def propose_person(request: Request, call: Caller) -> dict[str, str]:
    """An administrator proposes a person to register."""
    body = call.body(wire.PersonBody)
    change = change_of(
        request, ChangeKind.PERSON, body.id, by=call.party.id, name=body.name, roles=frozenset(body.roles),
        key=unb64u(body.key),
    )  # fmt: skip
    return await propose(request, call, change)


@router.post("/changes/key", status_code=201, openapi_extra=body_of(wire.KeyBody))
async def propose_key(request: Request, call: Caller) -> dict[str, str]:
    """A person proposes a further key of its own."""
    key = unb64u(call.body(wire.KeyBody).key)
    return await propose(
        request, call, change_of(request, ChangeKind.KEY, call.party.id, by=call.party.id, key=key)
    )  # fmt: skip


@router.post("/changes/login", status_code=201, openapi_extra=body_of(wire.LoginBody))
async def propose_login(request: Request, call: Caller) -> dict[str, str]:
    """An administrator, or the person itself, proposes that a person may log in with a login at another provider."""
    body = call.body(wire.LoginBody)
    change = change_of(request, ChangeKind.LOGIN, body.person, by=call.party.id, login=f"{body.issuer} {body.subject}")
    return await propose(request, call, change)


@router.post("/logins/end", openapi_extra=body_of(wire.EndLoginBody))
async def end_login(request: Request, call: Caller) -> dict[str, str]:
    """A login at another provider ends at once, with the sessions that it began: for its person or an administrator."""
    body = call.body(wire.EndLoginBody)
    command = EndLogin(call.party.id, f"{body.issuer} {body.subject}")
    await provider_of(request).run(command, actor=call.party.id)
    return {"issuer": body.issuer, "subject": body.subject}


@router.post("/changes/roles", status_code=201, openapi_extra=body_of(wire.RolesBody))
async def propose_roles(request: Request, call: Caller) -> dict[str, str]:
    """An administrator proposes all the roles that a person has from then on."""
    body = call.body(wire.RolesBody)
    change = change_of(request, ChangeKind.ROLES, body.person, by=call.party.id, roles=frozenset(body.roles))
    return await propose(request, call, change)


@router.post("/changes/end", status_code=201, openapi_extra=body_of(wire.EndBody))
async def propose_end(request: Request, call: Caller) -> dict[str, str]:
    """An administrator proposes that a person ends."""
    body = call.body(wire.EndBody)
    change = change_of(request, ChangeKind.END, body.person, by=call.party.id, reason=body.reason)
    return await propose(request, call, change)


@router.post("/recoveries", status_code=201, openapi_extra=body_of(wire.RecoveryBody))
async def recover(request: Request, call: Root) -> dict[str, str]:
    """The root key proposes an administrator, who is one after a day, or once two administrators confirm it."""
    body = call.body(wire.RecoveryBody)
    change = change_of(
        request, ChangeKind.RECOVERY, body.person, by=ROOT, name=body.name, key=unb64u(body.key)
    )  # fmt: skip
    await provider_of(request).run(commands.Recover(call.key, change, call.signed), actor=ROOT)
    return {"change_id": change.change_id}


@router.get("/changes")
async def list_changes(request: Request, call: Bound) -> list[dict[str, Any]]:
    """The changes of people that wait, for people, oldest first."""
    of_people(call)
    at_ms = provider_of(request).now_ms()
    async with provider_of(request).store.read() as view:
        found = await view.people.open_changes(at_ms=at_ms)
    return [_shown(change) for change in found if change.state(at_ms) is ChangeState.OPEN]


@router.post("/changes/{change_id}/confirm", openapi_extra=body_of(wire.NothingBody))
async def confirm_change(request: Request, change_id: str, call: Caller) -> dict[str, str]:
    """Another administrator than its proposer confirms a change; its state afterwards."""
    call.body(wire.NothingBody)
    return await _answer(request, call, change_id, Word.CONFIRM, "")


@router.post("/changes/{change_id}/decline", openapi_extra=body_of(wire.ReasonBody))
async def decline_change(request: Request, change_id: str, call: Caller) -> dict[str, str]:
    """An administrator declines a change, or its proposer takes it back; its state afterwards."""
    return await _answer(request, call, change_id, Word.DECLINE, call.body(wire.ReasonBody).reason)


def of_people(call: Call) -> None:
    """Checks that a person calls.

    Raises:
        Problem: `NOT_PERMITTED`.
    """
    if not isinstance(call.party, RegisteredPerson):
        raise Problem(IdpCode.NOT_PERMITTED, "people read this")


def change_of(request: Request, kind: ChangeKind, person: str, **members: Any) -> Change:
    """A change of this person that is proposed now; `members` are those of `Change`."""
    return Change(
        change_id=secrets.token_hex(16),
        kind=kind,
        person=person,
        proposed_ms=provider_of(request).now_ms(),
        **members,
    )


async def propose(request: Request, call: Call, change: Change) -> dict[str, str]:
    """The caller proposes the change; its id."""
    await provider_of(request).run(commands.ProposeChange(change, call.signed), actor=call.party.id)
    return {"change_id": change.change_id}


async def _answer(request: Request, call: Call, change_id: str, word: Word, reason: str) -> dict[str, str]:
    command = commands.AnswerChange(call.party.id, change_id, word, reason, call.signed)
    done = await provider_of(request).run(command, actor=call.party.id)
    state = next((event.state for event in done.events if isinstance(event, ChangeEnded)), ChangeState.OPEN)
    return {"change_id": change_id, "state": state.value}


def _shown(change: Change) -> dict[str, Any]:
    return {
        "change_id": change.change_id,
        "kind": change.kind.value,
        "person": change.person,
        "name": change.name,
        "roles": sorted(role.value for role in change.roles),
        "login": change.login,
        "key": "" if change.key is None else thumbprint(change.key),
        "passkey": change.credential != "",
        "reason": change.reason,
        "by": change.by,
        "state": ChangeState.OPEN.value,
        "until": change.until_ms // 1_000,
        "confirmed": sorted(change.confirmed),
        "declined": sorted(change.declined),
    }
