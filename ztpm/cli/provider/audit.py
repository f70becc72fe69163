"""`ztpm audit export`, `verify` and `show`: the ledger, and journals of enforcement points, offline."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.table import Table
from rich.text import Text

from capabilities.keys.trust import TrustBundle
from capabilities.log import tree_head
from capabilities.values.errors import CapabilityError
from capabilities.values.units import INT_LIMIT
from ztpm.cli.output import console, fail, fail_at, instant, plain, say_json
from ztpm.cli.provider.person import Json, Signer, refusals, signed

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import BinaryIO

app = typer.Typer(no_args_is_help=True, help="The ledger and journals: export, verify and show them.")

CELL_CHARACTERS: Final = 40
"""Characters of a value that are shown; `--json` shows it whole."""
MILLI: Final = 1000
LEDGER: Final = (
    "access-ended", "agent-attested", "agent-key-replaced", "agent-registered", "agent-restored", "agent-suspended",
    "agent-vouched", "agents-held", "ask-refused", "ask-taken", "change-confirmed", "change-declined", "change-ended",
    "change-proposed", "clearing-refused", "closing-refused", "delegation-refused", "device-confirmed",
    "device-declined", "envelope-refused", "envelope-revoked", "envelope-revoking-refused", "envelope-signed",
    "latch-clearing", "latch-refused", "latch-taken", "line-begun", "login-added", "login-ended", "mandate-signed",
    "oauth-access-made", "oauth-assent-given", "oauth-client-registered", "oauth-family-ended", "oauth-scope-declared",
    "oauth-scope-ended", "opening-closed", "opening-made", "opening-refused", "pep-key-replaced", "pep-record",
    "pep-registered", "pep-restored", "pep-suspended", "person-key-added", "person-passkey-added", "person-registered",
    "person-roles-changed", "point-heard", "push-failed", "refusals-spent", "revoked", "sensor-key-replaced",
    "sensor-registered", "sensor-restored", "sensor-suspended", "session-begun", "session-ended", "session-key-added",
    "session-key-ended", "store-restored", "store-resumed", "suspension-ended", "token-delegated", "token-drawn",
    "token-issued", "tool-registered", "tool-restored", "tool-retired", "tool-suspended", "trust-stated", "vote-cast",
    "vote-refused",
)  # fmt: skip
"""Kinds of the ledger's entries."""
JOURNAL: Final = (
    "advice", "ask", "ask-answered", "ask-expired", "ask-refused", "decision", "incident", "latch-cleared",
    "latch-retreat", "latched", "lease", "lease-ended", "lease-renewed", "outcome", "picture", "refusal", "stop",
    "stream", "stream-values", "ticket",
)  # fmt: skip
"""Kinds of a journal's records, which the ledger holds as a `pep-record` each."""
KIND_HELP: Final = (
    f"Only what is of this kind. Records of journals: {', '.join(JOURNAL)}. Entries of the ledger: {', '.join(LEDGER)}."
)

RecordFile = Annotated[
    Path, typer.Argument(help="An exported ledger, a journal (JSON lines), or a proof.", exists=True, dir_okay=False)
]
TrustFile = Annotated[
    Path | None, typer.Option("--trust", help="The trust bundle; a ledger needs it.", exists=True, dir_okay=False)
]

HeldFile = Annotated[
    Path | None,
    typer.Option("--held", help="A checkpoint of earlier, as `ztpm audit hold` keeps it.", exists=True, dir_okay=False),
]


@app.command("export")
@signed
def export(
    *,
    first: Annotated[int, typer.Option("--from", min=1, max=INT_LIMIT, help="First entry.")] = 1,
    last: Annotated[
        int, typer.Option("--to", min=1, max=INT_LIMIT, help="Last entry (default: the newest).", show_default=False)
    ] = INT_LIMIT,
    out: Annotated[
        Path | None, typer.Option("--out", help="New file, which only you may read (default: standard output).")
    ] = None,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Write the ledger's entries as JSON lines, and the signed checkpoint that they end in.

    For administrators and approvers.
    """
    if first > last:
        fail("USAGE", "--from is behind --to")
    if as_json and out is None:
        fail("USAGE", "--json tells of a file, so give --out")
    person = signer.operator()
    count = -1  # the checkpoint is no entry
    with refusals(), person, _new(out) as file:
        for page in person.ledger_pages(first=first, last=last):
            file.write(page)
            count += page.count(b"\n")
    if out is None:
        return
    if as_json:
        say_json({"ok": True, "out": str(out), "first": first, "entries": count})
        return
    asked = f" --from {first}" if first > 1 else ""
    typer.echo(f"{count} entries. To check them: ztpm audit verify {out} --trust TRUST{asked}")


@contextmanager
def _new(out: Path | None) -> Iterator[BinaryIO]:
    """The new file, which is gone again where it did not become whole; or standard output."""
    if out is None:
        yield sys.stdout.buffer
        return
    try:
        file = os.fdopen(os.open(out, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb")
    except FileExistsError:
        fail("EXISTS", str(out))
    except OSError as error:
        fail_at(out, error, "UNWRITABLE")
    try:
        with file:
            yield file
    except BaseException as error:
        out.unlink()
        if isinstance(error, OSError):
            fail_at(out, error, "UNWRITABLE")
        raise


@app.command("verify")
def verify(
    file: RecordFile,
    *,
    trust: TrustFile = None,
    first: Annotated[
        int, typer.Option("--from", min=1, max=INT_LIMIT, help="First entry of a ledger that was exported in part.")
    ] = 1,
    held: HeldFile = None,
    as_json: Json = False,
) -> None:
    """Check every link of a ledger or journal, and a ledger's signed checkpoint; name the first entry that is wrong.

    Of a proof that `ztpm audit prove` wrote, check that its entry stands in the ledger.
    """
    from ztpm_idp.ledger_file import is_journal

    with file.open("rb") as lines:
        begin = lines.readline().removesuffix(b"\n")
        if begin.decode(errors="replace") == tree_head.PROOF_FORM:
            _proof(file, trust, as_json=as_json)
            return
        journal = is_journal(begin)
        lines.seek(0)
        if journal and first > 1:
            fail("USAGE", "a journal is read from its first record on")
        if journal:
            _journal(lines, as_json=as_json)
        elif trust is None:
            fail("USAGE", "a ledger needs --trust")
        elif held is not None and first > 1:
            fail("USAGE", "--held is compared with a whole ledger")
        else:
            _ledger(lines, trust, first, held, as_json=as_json)


def _journal(lines: BinaryIO, *, as_json: bool) -> None:
    from ztpm_idp.ledger_file import Defect, verify_journal

    found = verify_journal(lines)
    if isinstance(found, Defect):
        fail(str(found.code), f"a journal: record {found.seq}", more={"read": "journal"})
    if as_json:
        say_json({"ok": True, "read": "journal", **asdict(found)})
        return
    torn = f" {found.unfinished_bytes} bytes of a record were never finished." if found.unfinished_bytes else ""
    typer.echo(
        f"A journal of {plain(found.pep)}: {found.size} records, unbroken, head {found.head}. Nobody signed its end: "
        f"the ledger holds that.{torn}"
    )


def trusted(trust: Path) -> TrustBundle:
    """The trust bundle in a file, or the command ends."""
    try:
        return TrustBundle.from_json(trust.read_bytes())
    except CapabilityError as error:
        fail("TRUST_MALFORMED", f"{trust}: {error}")
    except OSError as error:
        fail_at(trust, error, "UNREADABLE")


def held_in(path: Path, bundle: TrustBundle) -> tree_head.TreeHead:
    """The tree head of the checkpoint in a file, or the command ends."""
    try:
        return tree_head.open(path.read_text(), tree_head.origin_of(bundle.issuer), bundle.ledger)
    except (CapabilityError, UnicodeDecodeError) as error:
        fail("CHECKPOINT_UNTRUSTED", f"{path}: {error}")
    except OSError as error:
        fail_at(path, error, "UNREADABLE")


def _proof(file: Path, trust: Path | None, *, as_json: bool) -> None:
    if trust is None:
        fail("USAGE", "a proof needs --trust")
    bundle = trusted(trust)
    try:
        proof = tree_head.read_proof(file.read_text())
        if proof.entry is None:
            fail("PROOF_WRONG", f"{file} does not hold the entry that it is about")
        head = tree_head.check_entry(proof.entry, proof, tree_head.origin_of(bundle.issuer), bundle.ledger)
    except (CapabilityError, UnicodeDecodeError) as error:
        fail("PROOF_WRONG", f"{file}: {error}")
    number = proof.index + 1
    if as_json:
        say_json({"ok": True, "read": "proof", "entry": number, "size": head.size, "root": head.root.hex()})
        return
    typer.echo(
        f"Entry {number} stands in the ledger of {head.size} entries, root {head.root.hex()}, signed by its key."
    )


def _ledger(lines: BinaryIO, trust: Path, first: int, held: Path | None, *, as_json: bool) -> None:
    from ztpm_idp.ledger_file import Defect
    from ztpm_idp.ledger_file import verify as verify_ledger

    bundle = trusted(trust)
    before = None if held is None else held_in(held, bundle)
    found = verify_ledger((line.rstrip(b"\r\n") for line in lines), bundle, first=first, held=before)
    if isinstance(found, Defect):
        fail(str(found.code), f"a ledger: entry {found.seq}", more={"read": "ledger"})
    if as_json:
        more = {} if before is None else {"held": before.size}
        say_json({"ok": True, "read": "ledger", "first": first, **asdict(found), **more})
        return
    which = f"{found.size} entries" if first == 1 else f"entries {first} to {found.size}, a part"
    typer.echo(
        f"A ledger: {which}, unbroken, head {found.head}, checkpoint signed by the ledger's key as of "
        f"{instant(found.as_of_ms // MILLI)}."
        + ("" if before is None else f" It begins with the {before.size} entries of the checkpoint that you hold.")
    )


@app.command("show")
def show(
    file: RecordFile,
    *,
    kind: Annotated[str, typer.Option(metavar="KIND", help=KIND_HELP)] = "",
    as_json: Json = False,
) -> None:
    """List entries: when, who, what, and the decision with its reason."""
    from ztpm_idp.ledger_file import LINE_BYTES, LINE_DEPTH
    from ztpm_idp.provider.body_json import BodyError, parse_json

    if kind:
        _check_kind(kind)
    table = Table(box=None, pad_edge=False)
    for heading in ("seq", "time", "actor", "kind", "decision", "reason", "request"):
        table.add_column(heading)
    for number, line in enumerate(file.read_bytes().splitlines(), start=1):
        try:
            entry = parse_json(line, limit_bytes=LINE_BYTES, limit_depth=LINE_DEPTH)
            row = _row(entry)
        except BodyError as error:
            fail("LINE_MALFORMED", f"line {number}: {error.detail}")
        except _MalformedError as error:
            fail("ENTRY_MALFORMED", f"line {number}: {error}")
        if row is None or (kind and kind not in row.kinds):
            continue
        if as_json:
            say_json(entry)
        else:  # shown before it is verified
            table.add_row(*(Text(plain(cell)) for cell in row.cells))
    if not as_json:
        console.print(table)


def _check_kind(word: str) -> None:
    """Ends the command for a word that is no kind, and names the near ones."""
    every = sorted({*LEDGER, *JOURNAL})
    if word not in every:
        near = get_close_matches(word, every, n=3) or every
        fail("USAGE", f"--kind {word}: no such kind; there is {', '.join(near)}")


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
