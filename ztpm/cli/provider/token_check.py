"""`ztpm token inspect`, `verify` and `revoke`: a token looked into, verified and ended, by its file."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from ztpm.cli.output import console, fail, fail_at, instant, say_json
from ztpm.cli.provider.person import CellDirectory, Json, Reason, Signer, layout_of, refusals, signed

if TYPE_CHECKING:
    from capabilities.keys.trust import TrustBundle

Source = Annotated[str, typer.Argument(metavar="FILE", help="A file that holds the token's text, or - for input.")]
Trust = Annotated[
    Path | None,
    typer.Option("--trust", help="The trust bundle (default: that of --data).", exists=True, dir_okay=False),
]

LEASE_MS: Final = 30_000
"""Oldest view of revocations that is acted on here: that of a tier without motion (DESIGN.md, freshness lease)."""


def inspect(source: Source, *, trust: Trust = None, directory: CellDirectory = None, as_json: Json = False) -> None:
    """Show sponsor, hops, scope and limits of a token that verifies.

    It comes from a file, since it is a secret.
    """
    seen = seen_in(token_of(source), bundle_of(trust, directory))
    if as_json:
        say_json({"ok": True, **seen})
    else:
        console.print_json(json.dumps(seen))


def verify(
    source: Source,
    *,
    trust: Trust = None,
    audience: Annotated[str, typer.Option(help="Where it is to be shown (default: its only audience).")] = "",
    offline: Annotated[
        bool, typer.Option("--offline", help="Ask nobody: what is revoked meanwhile stays unknown.")
    ] = False,
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Verify a token as an enforcement point does, but for its holder's proof and the tools.

    These are steps 1 to 9 of docs/spec.md. The provider is asked for its revocations. A suspended agent is in the
    registry alone, and not looked for here.
    """
    from capabilities.statements.revocation import RevocationView
    from capabilities.token.verify import verify as check
    from capabilities.values.caps import DEFAULT
    from capabilities.values.errors import Fault
    from ztpm_idp.client.revocation_reader import read_revocations

    bundle, token = bundle_of(trust, directory), token_of(source)
    seen = seen_in(token, bundle)
    if not audience:
        audiences = seen["hops"][-1]["scope"]["audiences"]
        if len(audiences) != 1:
            fail("WHICH_AUDIENCE", f"--audience: one of {', '.join(audiences)}")
        audience = audiences[0]
    if offline:
        view = RevocationView(epoch=0, age_ms=0, revoked=frozenset())
    else:
        with refusals():
            view = read_revocations(bundle)
    chain = check(
        token, at=time.time(), audience=audience, view=view, lease_ms=LEASE_MS, trust=bundle, caps=DEFAULT
    )  # fmt: skip
    if isinstance(chain, Fault):
        fail(str(chain.code), f"{chain.clause} {chain.detail}".strip())
    told = {
        "token_id": chain.token_id,
        "sponsor": chain.sponsor.subject,
        "holder": chain.leaf.agent,
        "audience": audience,
        "ceiling": int(chain.scope.ceiling),
        "not_after": chain.scope.not_after,
        "revocations": None if offline else view.epoch,
    }
    if as_json:
        say_json({"ok": True, **told})
        return
    known = "what is revoked was not asked" if offline else f"nothing of it is revoked at epoch {view.epoch}"
    typer.echo(
        f"It holds: {told['holder']} for {told['sponsor']} at {audience}, up to tier {told['ceiling']}, "
        f"until {instant(chain.scope.not_after)}; {known}."
    )


@signed
def revoke(source: Source, *, trust: Trust = None, reason: Reason, signer: Signer, as_json: Json = False) -> None:
    """Revoke the token in a file, with all that was lent on from it."""
    seen = seen_in(token_of(source), bundle_of(trust, signer.directory))
    person = signer.operator()
    with refusals(), person:
        made = person.revocation("token", seen["token_id"], reason)
    if as_json:
        say_json({"ok": True, "kind": "token", "id": seen["token_id"], "epoch": made.epoch, "known": made.known})
    else:
        typer.echo(f"Revoked, epoch {made.epoch}.")


def bundle_of(trust: Path | None, directory: Path | None) -> TrustBundle:
    """The trust bundle of the file, or else of the directory; or the command ends."""
    from capabilities.keys.trust import TrustBundle
    from capabilities.values.errors import CapabilityError

    file = trust or layout_of(directory).trust
    try:
        return TrustBundle.from_json(file.read_bytes())
    except CapabilityError as error:
        fail("TRUST_MALFORMED", f"{file}: {error}")
    except OSError as error:
        fail_at(file, error, "UNREADABLE")


def token_of(source: str) -> bytes:
    """The token in a file or on standard input, or the command ends."""
    from capabilities.token.token_text import token_from_text
    from capabilities.values.caps import DEFAULT
    from capabilities.values.errors import Fault

    try:
        text = sys.stdin.read().removeprefix("\ufeff") if source == "-" else Path(source).read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        fail_at(source, error, "UNREADABLE")
    token = token_from_text(text.strip(), DEFAULT)
    if isinstance(token, Fault):
        fail(str(token.code), f"{token.clause} {token.detail}".strip())
    return token


def seen_in(token: bytes, bundle: TrustBundle) -> dict[str, Any]:
    """The description of a token that passes steps 1 to 6, or the command ends."""
    from capabilities.token.verify import inspect_token
    from capabilities.values.caps import DEFAULT
    from capabilities.values.errors import TokenError

    try:
        return inspect_token(token, bundle, DEFAULT)
    except TokenError as error:
        fail(str(error.code), error.detail)
