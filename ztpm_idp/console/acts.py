"""Acts of administration on the console, closed: what is asked for, what a passkey says to it, and the command.

Pure. The members of an act are texts, since a person reads them and a browser signs them: [CON-11] to [CON-14].
"""

from __future__ import annotations

import shlex
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, assert_never

from pydantic import StringConstraints, ValidationError

from capabilities.keys.keys import thumbprint, unb64u
from capabilities.statements.people.assertion import Word, challenge
from ztpm_idp.domain import commands
from ztpm_idp.domain.changes import Change, ChangeKind
from ztpm_idp.domain.changes import Word as Answer
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.parties import PersonRole
from ztpm_idp.provider import wire
from ztpm_idp.provider.wire import Body, Name, Text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ztpm_idp.domain.signed import AssertedAct


class Act(StrEnum):
    """Act of administration that a person asks for on the console."""

    SUSPEND = "suspend-agent"
    RESTORE = "restore-agent"
    REGISTER_AGENT = "register-agent"
    END = "end-person"
    """The end of oneself, or of a person who is neither approver nor administrator, at once."""
    PROPOSE_END = "propose-end"
    PROPOSE_ROLES = "propose-roles"
    PROPOSE_PERSON = "propose-person"
    CONFIRM = "confirm-change"
    DECLINE = "decline-change"


PEOPLE: Final = frozenset(Act) - {Act.SUSPEND, Act.RESTORE, Act.REGISTER_AGENT}
"""Acts on people; the others are on agents."""
ChangeId = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{32}$")]


class UnfitError(ValueError):
    """A member that the act does not take, or not so."""


class _Suspended(Body):
    agent: Name
    reason: Text


class _Restored(Body):
    agent: Name
    reason: Text
    relearn: Literal["yes", "no"] = "no"


class _Confirmed(Body):
    change_id: ChangeId


class _Declined(Body):
    change_id: ChangeId
    reason: Text


_BODIES: Final[Mapping[Act, type[Body]]] = {
    Act.SUSPEND: _Suspended,
    Act.RESTORE: _Restored,
    Act.REGISTER_AGENT: wire.AgentBody,
    Act.END: wire.EndBody,
    Act.PROPOSE_END: wire.EndBody,
    Act.PROPOSE_ROLES: wire.RolesBody,
    Act.PROPOSE_PERSON: wire.PersonBody,
    Act.CONFIRM: _Confirmed,
    Act.DECLINE: _Declined,
}
FRAME: Final = frozenset({"act", "by", "issuer", "nonce"})
"""Members that every passkey's word on an act has."""
_ROLES: Final = "roles"
_ROLE: Final = "role"
"""Field of a form for one role; as often as there are roles."""


def read(act: Act, given: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Members of an act as the fields of a form state them: exactly its own, as the command takes them.

    Args:
        act: which.
        given: texts by field; one of roles occurs once for each.

    Raises:
        UnfitError: naming the field.
    """
    model = _BODIES[act]
    fields = {_ROLE if name == _ROLES else name: name for name in model.model_fields}
    if unknown := given.keys() - fields.keys():
        raise UnfitError(min(unknown)[:64])
    values: dict[str, Any] = {}
    for field, name in fields.items():
        texts = [text.strip() for text in given.get(field, ())]
        if name == _ROLES:
            values[name] = texts
        elif len(texts) > 1:
            raise UnfitError(name)
        elif texts:
            values[name] = texts[0]
    try:
        body = model.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        raise UnfitError(f"{first['loc'][0]}: {first['type']}") from None
    return {name: _text(value) for name, value in body.model_dump().items()}


def own(act: Act, said: Mapping[str, str]) -> dict[str, str]:
    """Members of what was said that the form of the act has."""
    return {name: said[name] for name in _BODIES[act].model_fields}


def fields(act: Act, said: Mapping[str, str]) -> list[tuple[str, str]]:
    """Fields of a form, of which `read` makes the act's own members of what was said."""
    found: list[tuple[str, str]] = []
    for name, text in own(act, said).items():
        found += [(_ROLE, role) for role in text.split()] if name == _ROLES else [(name, text)]
    return found


def _text(value: Any) -> str:
    return " ".join(sorted(set(value))) if isinstance(value, list) else str(value)


def told(change: Change) -> dict[str, str]:
    """Members that a waiting change has, of which an answer states every one."""
    every = {
        "kind": change.kind.value,
        "person": change.person,
        "name": change.name,
        "roles": " ".join(sorted(change.roles)),
        "key": "" if change.key is None else thumbprint(change.key),
        "key_kind": "passkey" if change.credential else "",
        "login": change.login,
        "why": change.reason,
        "proposed_by": change.by,
    }
    return {name: text for name, text in every.items() if text}


def bound(said: Mapping[str, str]) -> bytes:
    """The challenge, 32 bytes, of a passkey that says this ([CON-12]).

    Args:
        said: the act's members, with `act`, `by`, `issuer`, and the question's `nonce`.
    """
    return challenge(Word.ADMINISTRATION, said)


def command(said: Mapping[str, str], *, by: str, signed: AssertedAct, change_id: str, at_ms: int) -> commands.Command:
    """The command that an act amounts to: the very one of a signed request.

    Args:
        said: as in `bound`.
        by: id of the person.
        signed: the passkey's word.
        change_id: 32 fresh hex digits, of a change that is proposed.
        at_ms: wall clock.
    """

    def proposed(kind: ChangeKind, person: str, **members: Any) -> commands.ProposeChange:
        change = Change(
            change_id=change_id, kind=kind, person=person, by=by, proposed_ms=at_ms, by_passkey=True, **members
        )
        return commands.ProposeChange(change, signed)

    match act := Act(said["act"]):
        case Act.SUSPEND:
            return commands.SuspendAgent(by, said["agent"], said["reason"])
        case Act.RESTORE:
            return commands.RestoreAgent(by, said["agent"], said["reason"], said["relearn"] == "yes")
        case Act.REGISTER_AGENT:
            return commands.RegisterAgent(
                by=by,
                id=said["id"],
                key=unb64u(said["key"]),
                software_digest=bytes.fromhex(said["software_digest"]),
                model=said["model"],
                role=said["role"],
                sponsor=said["sponsor"],
                workload=said["workload"],
            )
        case Act.END:
            return commands.Revoke(by, RevocationKind.SPONSOR, said["person"], said["reason"])
        case Act.PROPOSE_END:
            return proposed(ChangeKind.END, said["person"], reason=said["reason"])
        case Act.PROPOSE_ROLES:
            return proposed(ChangeKind.ROLES, said["person"], roles=_roles(said))
        case Act.PROPOSE_PERSON:
            members = {"name": said["name"], "key": unb64u(said["key"]), "roles": _roles(said)}
            return proposed(ChangeKind.PERSON, said["id"], **members)
        case Act.CONFIRM:
            return commands.AnswerChange(by, said["change_id"], Answer.CONFIRM, "", signed)
        case Act.DECLINE:
            return commands.AnswerChange(by, said["change_id"], Answer.DECLINE, said["reason"], signed)
        case _:
            assert_never(act)


def _roles(said: Mapping[str, str]) -> frozenset[PersonRole]:
    return frozenset(map(PersonRole, said[_ROLES].split()))


def typed(act: Act, said: Mapping[str, str], *, by: str) -> str:
    """The line that does the same with an operator key, at a terminal that holds it."""
    roles = [part for role in said.get(_ROLES, "").split() for part in ("--role", role)]
    reason = ["--reason", said.get("reason", "")]
    match act:
        case Act.SUSPEND:
            parts = ["agent", "suspend", said["agent"], *reason]
        case Act.RESTORE:
            parts = ["agent", "restore", said["agent"], *reason, *(["--relearn"] if said["relearn"] == "yes" else [])]
        case Act.REGISTER_AGENT:
            workload = ["--workload", said["workload"]] if said["workload"] else []
            parts = ["agent", "register", said["id"], "--software", "FILE", "--model", said["model"], "--role",
                     said["role"], "--sponsor", said["sponsor"], *workload, f"--public={said['key']}"]  # fmt: skip
        case Act.END | Act.PROPOSE_END:
            parts = ["person", "retire", said["person"], *reason]
        case Act.PROPOSE_ROLES:
            parts = ["person", "roles", said["person"], *roles]
        case Act.PROPOSE_PERSON:
            parts = ["person", "register", said["id"], "--name", said["name"], f"--public={said['key']}", *roles]
        case Act.CONFIRM:
            parts = ["person", "confirm", said["change_id"]]
        case Act.DECLINE:
            parts = ["person", "decline", said["change_id"], *reason]
        case _:
            assert_never(act)
    return shlex.join(["ztpm", *parts, "--as", by])
