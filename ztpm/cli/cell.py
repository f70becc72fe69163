"""`ztpm cell`: the signed cell file, made and inspected."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer

from ztpm.cli.output import USAGE, console, fail, fail_at, say_json
from ztpm.cli.provider.person import Json, open_key

app = typer.Typer(no_args_is_help=True, help="Cell files: what stands in a cell, signed by a person.")


@app.command("sign")
def sign(
    draft: Annotated[Path, typer.Argument(help="The draft, TOML; its members stand in docs/spec.md.")],
    key: Annotated[Path, typer.Option("--key", help="The operator's private key. Its passphrase: ZTPM_PASSPHRASE.")],
    out: Annotated[Path, typer.Option("--out", help="The cell file to make; one that exists is left as it is.")],
    days: Annotated[int, typer.Option(help="How long it is in force.", min=1, max=366)] = 365,
    *,
    as_json: Json = False,
) -> None:
    """Sign the survey of a cell.

    The robot's gateway takes it when `cell_signer_key` names the signing key.
    """
    from capabilities.keys import keys
    from capabilities.statements import cell
    from ztpm.base.layout import LayoutError, write_private
    from ztpm.cell import survey

    try:
        stated = survey.draft(draft.read_text("utf-8-sig"), at=int(time.time()), days=days)
    except survey.DraftError as error:
        fail(error.code, f"{draft}: {error.detail}", status=USAGE)
    except (OSError, UnicodeDecodeError) as error:
        fail_at(draft, error, "UNREADABLE")
    signer = open_key(key)
    try:
        write_private(out, cell.sign(stated, signer).encode() + b"\n")
    except LayoutError as error:
        fail("EXISTS", str(error))
    except OSError as error:
        fail_at(out, error, "UNWRITABLE")
    made = {"file": str(out), "signer_key": keys.b64u(keys.public_raw(signer)), "not_after": stated.not_after}
    if as_json:
        say_json({"ok": True, **made})
    else:
        typer.echo(f'{out}: signed. In the gateway\'s configuration: cell_signer_key = "{made["signer_key"]}"')


@app.command("show")
def show(
    source: Annotated[Path, typer.Argument(help="A cell file.")],
    signer: Annotated[str, typer.Option("--signer", help="The signer's public key, base64url, as `cell_signer_key`.")],
    *,
    as_json: Json = False,
) -> None:
    """Show the content of a cell file, once its signature is checked. Exit 3 for one that a gateway refuses."""
    from capabilities.keys import keys
    from capabilities.statements import cell
    from capabilities.values.caps import DEFAULT
    from capabilities.values.errors import BadKeyError, StatementError
    from pep.pit import CellParameters, SurveyError, surveyed

    try:
        trusted = keys.check_raw(keys.unb64u(signer))
        text = source.read_text("utf-8-sig").strip()
    except BadKeyError as error:
        fail(str(error.code), "--signer is no public key")
    except (OSError, UnicodeDecodeError) as error:
        fail_at(source, error, "UNREADABLE")
    try:
        stated = cell.open(text, frozenset({trusted}), DEFAULT)
        surveyed(stated, CellParameters())
    except (StatementError, SurveyError) as error:
        fail(str(error.code), error.detail)
    if not stated.not_before <= time.time() < stated.not_after:
        fail("EXPIRED", f"in force from {stated.not_before} until {stated.not_after}")
    if as_json:
        say_json({"ok": True, "cell": cell.to_claims(stated)})
    else:
        console.print_json(json.dumps(cell.to_claims(stated)))
