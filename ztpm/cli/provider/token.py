"""`ztpm token issue` and `delegate`, and `ztpm revoke`: authority lent and taken back.

A token is written to a file that only its owner can read; it is never shown. Exit status: 0 done, 1 failure, 2 usage,
3 refused.
"""

from __future__ import annotations

import re
import time
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar

import typer

from capabilities.values import budgets, strict_json
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError
from capabilities.values.scope import Budget
from ztpm.cli.output import fail, fail_at, say_json
from ztpm.cli.provider import confirmed
from ztpm.cli.provider.agent import Software, agent_of
from ztpm.cli.provider.person import As, CellDirectory, Json, Reason, Signer, layout_of, operator, refusals, signed

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from capabilities.values.scope import Grant, Scope
    from ztpm_idp.client import Issued

T = TypeVar("T")
MINUTES: Final = 15
"""Ours: life of a token of the default scope, where none is stated."""
EARLY_S: Final = 5
"""A window from now on begins so long before now, since two machines' clocks differ a little (`Caps.skew_s`)."""

app = typer.Typer(no_args_is_help=True, help="Tokens: lend authority, lend a part of it on, look into one.")

Purpose = Annotated[str, typer.Option(help="What for; in the token and the ledger.")]
Out = Annotated[Path, typer.Option("--out", help="New file for the token.")]
TokenFile = Annotated[Path, typer.Option("--token", help="File of the holder's token.", exists=True, dir_okay=False)]
_BUDGET_HELP: Final = (
    'Budget of a grant, "OBJECT/OPERATION: MOST in SECONDS" for acts, "MOST PARAMETER in SECONDS" for a quantity; '
    '"at URL" behind it where there are several audiences, or none is stated.'
)
Budgeted = Annotated[list[str] | None, typer.Option("--budget", help=_BUDGET_HELP)]
_FORM: Final = re.compile(r"(\S+): ([1-9][0-9]{0,15})(?: (\S+))? in ([1-9][0-9]{0,6})(?: at (\S+))?")


@app.command("issue")
def issue(
    agent: Annotated[str, typer.Argument(metavar="AGENT", help="Who receives it.")],
    *,
    software: Software,
    purpose: Purpose,
    out: Out,
    scope: Annotated[
        Path | None, typer.Option(help="JSON of the whole scope (default: the arm, up to tier 3).")
    ] = None,
    budget: Budgeted = None,
    delegate: Annotated[list[str] | None, typer.Option(help="Whom it may lend to, with the default scope.")] = None,
    minutes: Annotated[
        int | None,
        typer.Option(min=1, max=60, help="How long from now (default: the scope's own window, else 15)."),
    ] = None,
    name: As,
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Lend an agent authority, as its sponsor."""
    from capabilities.values.scope_json import scope_from_json

    check_new(out)
    if scope is None:
        lent = arm_scope(directory, frozenset(delegate or ()), 60 * (minutes or MINUTES))
    else:
        lent = read_as(scope, scope_from_json)
        if minutes is not None:
            now = int(time.time())
            lent = replace(lent, not_before=now - EARLY_S, not_after=now + 60 * minutes)
    grants = with_budgets(lent.grants, budget or (), audiences=lent.audiences)
    lent = replace(lent, grants=grants or lent.grants)
    person = operator(directory=directory, name=name, issuer="", key=None)
    receiver = agent_of(agent, software, directory=directory)
    with refusals(), person, receiver:
        issued = person.issue(receiver, lent, purpose=purpose)
    keep(issued, out, as_json=as_json)


@app.command("delegate")
def delegate(
    lender: Annotated[str, typer.Argument(metavar="FROM", help="The holder of --token.")],
    receiver: Annotated[str, typer.Argument(metavar="TO", help="Who receives it.")],
    *,
    token: TokenFile,
    restriction: Annotated[
        Path, typer.Option(help="JSON of what is taken away; it must take something.", exists=True, dir_okay=False)
    ],
    software: Software,
    purpose: Purpose,
    out: Out,
    budget: Budgeted = None,
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Lend a narrower part of a token on; --software is the receiver's software."""
    from capabilities.values.scope_json import restriction_from_json

    check_new(out)
    less = read_as(restriction, restriction_from_json)
    less = replace(less, grants=with_budgets(less.grants, budget or (), audiences=less.audiences))
    text = read_token(token)
    # The lender signs with its key; only the receiver's measurement is attested.
    holder = agent_of(lender, software, directory=directory)
    other = agent_of(receiver, software, directory=directory)
    with refusals(), holder, other:
        issued = holder.delegate(text, other, less, purpose=purpose)
    keep(issued, out, as_json=as_json)


def read_token(file: Path) -> str:
    """The text of a token in a file, or the command ends."""
    try:
        return file.read_text("utf-8-sig").strip()
    except (OSError, UnicodeDecodeError) as error:
        fail_at(file, error, "UNREADABLE")


def with_budgets(
    grants: tuple[Grant, ...] | None, stated: Iterable[str], *, audiences: frozenset[str] | None
) -> tuple[Grant, ...] | None:
    """Grants with these budgets beside those that they have; the command ends where one is refused.

    Args:
        grants: of a scope or restriction.
        stated: each budget as the command line has it.
        audiences: likewise; the only one is that of a budget that names none.
    """
    from capabilities.values.well_formed import well_formed_grants

    kept = {f"{grant.object}/{grant.operation}": grant for grant in grants or ()}
    for text in stated:
        read = _FORM.fullmatch(text)
        if read is None:
            fail("UNREADABLE", f"--budget {text!r}: not OBJECT/OPERATION: MOST [PARAMETER] in SECONDS [at URL]")
        pair, most, parameter, window_s, audience = read.groups()
        if pair not in kept:
            fail("UNREADABLE", f"--budget {text!r}: the grants are {', '.join(kept) or 'not stated'}")
        if audience is None and len(audiences or ()) != 1:
            fail("UNREADABLE", f"--budget {text!r}: say at which audience; each has a share of its own")
        where = audience or min(audiences or ())
        own = kept[pair].budgets
        made = budgets.least((*own, Budget(parameter or "", where, int(window_s), int(most))))
        if len(made) <= len(own):
            fail("UNREADABLE", f"--budget {text!r}: another budget of {pair} implies it, or it another")
        kept[pair] = replace(kept[pair], budgets=made)
    made_grants = tuple(kept.values())
    try:
        if made_grants:
            well_formed_grants(made_grants, DEFAULT)
    except CapabilityError as error:
        fail("UNREADABLE", f"--budget: {error.code} {error.detail}")
    return made_grants or None


def arm_scope(directory: Path | None, delegates: frozenset[str], lifetime_s: int) -> Scope:
    """The whole arm of a cell up to tier 3, for so long, or the end of the command."""
    if not layout_of(directory).cell_config.exists():
        fail("SCOPE_MISSING", "give --scope: the usual one is that of a cell's arm")
    from ztpm.cell.setup import SetupError, read_addresses
    from ztpm.stage.lending import sweep_scope

    try:
        audience = read_addresses(layout_of(directory)).audience
    except SetupError as error:
        fail("CONFIG_INVALID", str(error))
    return sweep_scope(audience, delegates=delegates, now=int(time.time()), lifetime_s=lifetime_s)


def read_as(path: Path, parse: Callable[[object], T]) -> T:
    """The JSON of a file, parsed strictly, or the command ends."""
    try:
        return parse(strict_json.parse_object(strict_json.without_mark(path.read_bytes())))
    except CapabilityError as error:
        fail("UNREADABLE", f"{path}: {error.code} {error.detail}")
    except OSError as error:
        fail_at(path, error, "UNREADABLE")


def check_new(out: Path) -> None:
    """Checks before the delegation that the token's file can be made: an unkept token would be lost authority."""
    if out.exists() or not out.absolute().parent.is_dir():
        fail("EXISTS" if out.exists() else "UNWRITABLE", str(out))


def keep(issued: Issued, out: Path, *, as_json: bool) -> None:
    """Writes the token to a new file that only its owner can read, and tells its ids."""
    from ztpm.base.layout import LayoutError, write_private

    try:
        write_private(out, issued.token.encode() + b"\n")
    except LayoutError as error:
        fail("EXISTS", str(error))
    except OSError as error:
        fail_at(out, error, "UNWRITABLE")
    told: dict[str, Any] = {"token_id": issued.token_id, "hop_id": issued.hop_id, "expires_at": issued.expires_at}
    if as_json:
        say_json({"ok": True, "file": str(out), **told})
    else:
        typer.echo(f"{out}: token {issued.token_id}, hop {issued.hop_id}.")


# --- taking back ------------------------------------------------------------------------------------------------------


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
    wait_s: Annotated[
        float,
        typer.Option("--wait", min=0, max=confirmed.LONGEST_WAIT_S, help="Seconds to wait for enforcement points."),
    ] = confirmed.WAIT_S,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Revoke a token, hop, agent, key, sponsor, audience or mandate, and show which enforcement points confirm it."""
    from ztpm_idp.client import ClientError

    person = signer.operator()
    with person:
        with refusals():
            made = person.revocation(kind.value, id_, reason)
        if not as_json:
            typer.echo(f"Revoked, epoch {made.epoch}.")
            if not made.known:
                typer.echo(
                    f"The identity provider never knew such a {kind.value}: check the id, this may protect nobody."
                )
        points, fault = None, ""
        if wait_s > 0:
            try:
                points = confirmed.wait(person, made, wait_s=wait_s, said=_unsaid if as_json else confirmed.say)
            except ClientError as error:  # it is revoked all the same
                fault = error.code
    if as_json:
        told: dict[str, object] = {} if points is None else {"points": points.told}
        told |= {"points_unknown": fault} if fault else {}
        say_json({"ok": True, "kind": kind.value, "id": id_, "epoch": made.epoch, "known": made.known, **told})
    elif points is not None:
        confirmed.say_rest(points)
    elif fault:
        typer.echo(f"Which enforcement points have it in force is not known: {fault}.")


def _unsaid(name: str, after_ms: int) -> None:
    """Says nothing: JSON tells all at the end."""
