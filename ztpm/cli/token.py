"""`ztpm token inspect`: the content of a token, after its signatures were checked."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from capabilities.keys.trust import TrustBundle
from capabilities.values.errors import CapabilityError, Fault, TokenError
from ztpm.cli.output import console, fail, fail_at, say_json
from ztpm.cli.person import Json

app = typer.Typer(no_args_is_help=True, help="Tokens: lend authority, lend a part of it on, look into one.")


@app.command("inspect")
def inspect(
    source: Annotated[str, typer.Argument(help="A file that holds the token's text, or - for standard input.")],
    trust: Annotated[Path, typer.Option("--trust", help="The trust bundle.", exists=True, dir_okay=False)],
    *,
    as_json: Json = False,
) -> None:
    """Show sponsor, hops, scope and limits of a token that verifies.

    It comes from a file, since it is a secret.
    """
    from capabilities.token.token_text import token_from_text
    from capabilities.token.verify import inspect_token
    from capabilities.values.caps import DEFAULT

    try:
        bundle = TrustBundle.from_json(trust.read_bytes())
        text = (
            sys.stdin.read().removeprefix("\ufeff") if source == "-" else Path(source).read_text("utf-8-sig")
        ).strip()
    except CapabilityError as error:
        fail("TRUST_MALFORMED", f"{trust}: {error}")
    except (OSError, UnicodeDecodeError) as error:
        fail_at(source, error, "UNREADABLE")
    token = token_from_text(text, DEFAULT)
    if isinstance(token, Fault):
        fail(str(token.code), f"{token.clause} {token.detail}".strip())
    try:
        seen = inspect_token(token, bundle, DEFAULT)
    except TokenError as error:
        fail(str(error.code), error.detail)
    if as_json:
        say_json({"ok": True, **seen})
    else:
        console.print_json(json.dumps(seen))
