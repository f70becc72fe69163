"""`ztpm revoke`: authority ends, for ever. Exit status: 0 revoked, 1 failure, 2 usage, 3 refused."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from ztpm.cli.output import say_json
from ztpm.cli.person import Json, Reason, Signer, refusals, signed


class Revocable(StrEnum):
    """Kinds of things that can be revoked."""

    TOKEN = "token"  # noqa: S105 - a word, not a secret
    HOP = "hop"
    AGENT = "agent"
    KEY = "key"
    SPONSOR = "sponsor"
    AUDIENCE = "audience"
    MANDATE = "mandate"


@signed
def revoke(
    kind: Annotated[Revocable, typer.Argument(help="A hop takes all that is below it along.")],
    id_: Annotated[str, typer.Argument(metavar="ID", help="As `ztpm token inspect` and `ztpm agent list` show it.")],
    *,
    reason: Reason,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Revoke a token, hop, agent, key, sponsor, audience or mandate; enforcement points know within a feed's period."""
    person = signer.operator()
    with refusals(), person:
        made = person.revocation(kind.value, id_, reason)
    if as_json:
        say_json({"ok": True, "kind": kind.value, "id": id_, "epoch": made.epoch, "known": made.known})
    else:
        typer.echo(f"Revoked, epoch {made.epoch}.")
        if not made.known:
            typer.echo(f"The identity provider never knew such a {kind.value}: check the id, this may protect nobody.")
