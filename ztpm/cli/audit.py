"""`ztpm audit verify` and `show`: the ledger, offline."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.table import Table
from rich.text import Text

from capabilities.keys.trust import TrustBundle
from capabilities.values.errors import CapabilityError
from ztpm.cli.output import USAGE, console, fail, plain, say_json

app = typer.Typer(no_args_is_help=True, help="The ledger, offline.")

CELL_CHARACTERS: Final = 40
"""Characters of a value that are shown; `--json` shows it whole."""

LedgerFile = Annotated[Path, typer.Argument(help="An exported ledger (NDJSON).", exists=True, dir_okay=False)]
TrustFile = Annotated[Path, typer.Option("--trust", help="The trust bundle.", exists=True, dir_okay=False)]


@app.command("verify")
def verify(file: LedgerFile, trust: TrustFile, *, as_json: Annotated[bool, typer.Option("--json")] = False) -> None:
    """Check every link, every PEP's own chain and the signed checkpoint; name the first entry that is wrong."""
    from ztpm_idp.ledger_file import Defect
    from ztpm_idp.ledger_file import verify as verify_ledger

    try:
        bundle = TrustBundle.from_json(trust.read_bytes())
    except CapabilityError as error:
        fail(str(error.code), f"{trust}: {error.detail}", as_json=as_json, status=USAGE)
    result = verify_ledger(file.read_bytes().splitlines(), bundle)
    if isinstance(result, Defect):
        fail(str(result.code), f"entry {result.seq}", as_json=as_json)
    if as_json:
        say_json({"ok": True, "size": result.size, "head": result.head})
    else:
        typer.echo(f"{result.size} entries, unbroken, head {result.head}, checkpoint signed by the ledger's key.")


@app.command("show")
def show(
    file: LedgerFile,
    *,
    kind: Annotated[str, typer.Option(help="Only entries or records of this kind.")] = "",
    as_json: Annotated[bool, typer.Option("--json")] = False,
) -> None:
    """List entries: when, who, what, and the decision with its reason."""
    from ztpm_idp.ledger_file import LINE_BYTES, LINE_DEPTH
    from ztpm_idp.provider.body_json import BodyError, parse_json

    table = Table(box=None, pad_edge=False)
    for heading in ("seq", "time", "actor", "kind", "decision", "reason", "request"):
        table.add_column(heading)
    for number, line in enumerate(file.read_bytes().splitlines(), start=1):
        try:
            entry = parse_json(line, limit_bytes=LINE_BYTES, limit_depth=LINE_DEPTH)
            row = _row(entry)
        except BodyError as error:
            fail("LINE_MALFORMED", f"line {number}: {error.detail}", as_json=as_json)
        except _MalformedError as error:
            fail("ENTRY_MALFORMED", f"line {number}: {error}", as_json=as_json)
        if row is None or (kind and kind not in row.kinds):
            continue
        if as_json:
            say_json(entry)
        else:  # shown before it is verified
            table.add_row(*(Text(plain(cell)) for cell in row.cells))
    if not as_json:
        console.print(table)


class _MalformedError(Exception):
    """Line that is no entry; the text names its fault."""


@dataclass(frozen=True, slots=True)
class _Row:
    kinds: tuple[str, str]
    cells: tuple[str, ...]


def _row(entry: object) -> _Row | None:
    """Row to show for a line; None for the checkpoint.

    Raises:
        _MalformedError: for a line that is no entry.
    """
    line = _object(entry, "the entry")
    if line.keys() == {"checkpoint"}:
        return None
    if "seq" not in line or "kind" not in line:
        raise _MalformedError("the entry has no number or kind")
    body = _object(line.get("body"), "the body")
    outer = what = str(line["kind"])
    if "record" in body:
        record = _object(body["record"], "the record")
        what, body = str(record.get("kind", "?")), _object(record.get("body"), "the record's body")
    # A decision's record holds it whole; an outcome's names it by its hash, with the outcome.
    decided = body.get("decision")
    answer = decided if isinstance(decided, dict) else body
    asked = body.get("request")
    subject = asked.get("operation", "") if isinstance(asked, dict) else body.get("id", "")
    said = answer.get("effect", answer.get("outcome", ""))
    cells = (
        line["seq"], _time(line.get("at_ms")), line.get("actor", ""), what, said, answer.get("reason", ""), subject
    )  # fmt: skip
    return _Row((outer, what), tuple(str(cell)[:CELL_CHARACTERS] for cell in cells))


def _object(value: object, what: str) -> dict[str, object]:
    if not isinstance(value, dict):
        raise _MalformedError(f"{what} is not an object")
    return value


def _time(at_ms: object) -> str:
    import datetime as dt

    try:
        if type(at_ms) is int:
            return dt.datetime.fromtimestamp(at_ms / 1e3, dt.UTC).strftime("%H:%M:%S.%f")[:-3]
    except (OverflowError, ValueError, OSError):
        pass
    return "?"
