"""The first people of an identity provider, put beside the store before it is ever served."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pydantic import ValidationError

from capabilities.keys.keys import b64u, thumbprint
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.commands import Initialise
from ztpm_idp.domain.parties import RegisteredPerson, Standing
from ztpm_idp.domain.registry import initialise as first_people
from ztpm_idp.domain.wanted import wanted
from ztpm_idp.provider.problems import Problem
from ztpm_idp.provider.wire import PersonBody
from ztpm_idp.store import Store

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

ACTOR = "bootstrap"
"""Actor in the ledger for acts that nobody did over the wire."""


@dataclass(frozen=True, slots=True)
class FirstPerson:
    """A person of the first hour.

    Attributes:
        id: lower-case ASCII.
        name: as shown to people.
        key: raw public key.
        roles: of "sponsor", "approver", "admin", "auditor".
    """

    id: str
    name: str
    key: bytes
    roles: tuple[str, ...]


async def initialise(database_url: str, *, people: Iterable[FirstPerson], now: Callable[[], float] = time.time) -> None:
    """The store exists, has the newest schema, and knows these people. Works on an empty store only.

    Args:
        database_url: as in the settings.
        people: at least one of them an administrator.
        now: wall clock.

    Raises:
        Problem: `STORE_NOT_EMPTY`, `NO_ADMINISTRATOR`, `ALREADY_REGISTERED`, `KEY_IN_USE`, `BODY_MALFORMED`.
        StoreUnavailableError: the store cannot be opened.
    """
    command = Initialise(tuple(_person(person) for person in people))
    at_ms = int(now() * 1_000)
    store = await Store.open(database_url)
    try:
        async with store.write() as transaction:
            outcome = first_people(await transaction.load(wanted(command), young_ms=at_ms), command)
            if isinstance(outcome, Refusal):
                raise Problem(outcome.code, outcome.detail)
            await transaction.append(outcome, actor=ACTOR, at_ms=at_ms)
    finally:
        await store.close()


def _person(first: FirstPerson) -> RegisteredPerson:
    """The person, by the very rules that hold on the wire."""
    try:
        body = PersonBody.model_validate(
            {"id": first.id, "name": first.name, "key": b64u(first.key), "roles": list(first.roles)}
        )  # fmt: skip
    except ValidationError as error:
        field = str(error.errors(include_input=False)[0]["loc"][0])
        raise Problem(IdpCode.BODY_MALFORMED, f"people: {field}") from None
    return RegisteredPerson(
        body.id, first.key, thumbprint(first.key), Standing.ACTIVE, body.name, frozenset(body.roles)
    )
