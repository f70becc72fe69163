"""`ztpm audit search`, `prove`, `hold` and `picture`: questions to the identity provider about its ledger."""

from __future__ import annotations

import datetime as dt
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.table import Table
from rich.text import Text

from capabilities.log import tree_head
from capabilities.values.errors import CapabilityError
from capabilities.values.units import INT_LIMIT
from ztpm.cli.output import console, fail, fail_at, plain, say_json
from ztpm.cli.provider.audit import CELL_CHARACTERS, KIND_HELP, MILLI, held_in, trusted
from ztpm.cli.provider.person import Json, Signer, grouped, refusals, signed
from ztpm_idp.domain.audit import object_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from typing import BinaryIO

    from capabilities.keys.trust import TrustBundle
    from ztpm_idp.client import Operator

COLUMNS: Final = ("seq", "time", "kind", "effect", "actor", "agent", "object", "token", "request")
LIMIT: Final = 100
"""Entries that are shown, unless more are asked for."""
TAIL_BYTES: Final = 1_100_000
"""Bytes at the end of an export in which its last line begins: an entry has a megabyte at most."""

TrustFile = Annotated[Path, typer.Option("--trust", help="The trust bundle.", exists=True, dir_okay=False)]


def _question(
    *,
    kind: Annotated[str, typer.Option(metavar="KIND", help=KIND_HELP)] = "",
    actor: Annotated[str, typer.Option(help="Who did it.")] = "",
    agent: Annotated[str, typer.Option(help="An agent: what it did, and what was done to it.")] = "",
    token: Annotated[str, typer.Option(help="A token's id: everything from its issue to its end.")] = "",
    thing: Annotated[str, typer.Option("--object", help="A robot or tool, a party, a mandate, an opening.")] = "",
    request: Annotated[str, typer.Option(help="A request's id, which is also that of its ask.")] = "",
    trace: Annotated[str, typer.Option(help="A trace's id.")] = "",
    since: Annotated[str, typer.Option(metavar="TIME", help="From then on, as 2026-11-25T22:00:00Z.")] = "",
    until: Annotated[str, typer.Option(metavar="TIME", help="Before then.")] = "",
    after: Annotated[int, typer.Option(min=0, max=INT_LIMIT, help="Behind this entry.")] = 0,
) -> dict[str, str | int]:
    words = {"kind": kind, "actor": actor, "agent": agent, "token": token, "object": thing}
    words |= {"request": request, "trace": trace}
    times = {name: _instant_ms(text) for name, text in (("since_ms", since), ("until_ms", until)) if text}
    return {name: word for name, word in words.items() if word} | times | {"after": after}


def _instant_ms(text: str) -> int:
    try:
        moment = dt.datetime.fromisoformat(text)
    except ValueError:
        fail("USAGE", f"{text}: no time such as 2026-11-25T22:00:00Z")
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=dt.UTC)
    at_ms = int(moment.timestamp() * MILLI)
    if not 0 <= at_ms <= INT_LIMIT:
        fail("USAGE", f"{text}: before 1970, or too late")
    return at_ms


def asking(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of a question in place of its parameter `asked`."""
    return grouped(command, "asked", _question)


@signed
@asking
def search(
    *,
    asked: dict[str, Any],
    form: Annotated[str, typer.Option(metavar="FORM", help="rows; or whole entries as `lines` or as `cef`.")] = "rows",
    limit: Annotated[int, typer.Option(min=1, help="Most rows that are shown.")] = LIMIT,
    out: Annotated[Path | None, typer.Option(help="New file for lines or cef, which only you may read.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on behind the last entry in the file.")] = False,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Find entries of the provider's ledger: by kind, actor, agent, token, object, request and time.

    As `lines` or `cef` all of them are written, page by page, for a SIEM. For those who read the ledger.
    """
    if form not in ("rows", "lines", "cef"):
        fail("USAGE", f"--form {form}: rows, lines or cef")
    if form == "rows" and (out is not None or resume):
        fail("USAGE", "a file takes --form lines or cef")
    if resume and out is None:
        fail("USAGE", "--resume needs --out")
    after = int(asked.pop("after"))
    person = signer.operator()
    with refusals(), person:
        if form == "rows":
            _show(person, asked, after, limit, as_json=as_json)
        else:
            _write(person, asked, form, after, out, resume=resume, as_json=as_json)


def _show(person: Operator, asked: Mapping[str, str | int], after: int, limit: int, *, as_json: bool) -> None:
    table, last, more = Table(box=None, pad_edge=False), 0, False
    for heading in COLUMNS:
        table.add_column(heading)
    for number, row in enumerate(person.search_rows(asked, after=after)):
        if number == limit:
            more = True
            break
        last = row["seq"]
        if as_json:
            say_json(row)
        else:
            table.add_row(*(Text(plain(cell)[:CELL_CHARACTERS]) for cell in _cells(row)))
    if as_json:
        return
    console.print(table)
    if more:
        typer.echo(f"There are more: --after {last}")


def _cells(row: Mapping[str, Any]) -> Iterator[str]:
    moment = dt.datetime.fromtimestamp(row["at_ms"] / MILLI, dt.UTC).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"
    for name in COLUMNS:
        yield moment if name == "time" else str(row.get(name, ""))


def _write(
    person: Operator,
    asked: Mapping[str, str | int],
    form: str,
    after: int,
    out: Path | None,
    *,
    resume: bool,
    as_json: bool,
) -> None:
    if out is None:
        for page in person.search_pages(asked, form=form, after=after):
            typer.echo(page.decode(), nl=False)
        return
    written = 0
    try:
        with _file(out, resume=resume) as file:
            after = max(after, _last(file, form)) if resume else after
            for page in person.search_pages(asked, form=form, after=after):
                file.write(page)
                file.flush()
                written += page.count(b"\n")
    except FileExistsError:
        fail("EXISTS", str(out))
    except OSError as error:
        fail_at(out, error, "UNWRITABLE")
    if as_json:
        say_json({"ok": True, "out": str(out), "entries": written})
        return
    typer.echo(f"{written} entries. To go on later: the same with --resume")


def _file(out: Path, *, resume: bool) -> BinaryIO:
    flags = os.O_RDWR | os.O_CREAT | (0 if resume else os.O_EXCL)
    return os.fdopen(os.open(out, flags, 0o600), "r+b")


def _last(file: BinaryIO, form: str) -> int:
    """Number of the last whole entry in the file, which then stands at its end.

    Half a line behind that entry is cut off.
    """
    end = file.seek(0, os.SEEK_END)
    begin = max(0, end - TAIL_BYTES)
    file.seek(begin)
    tail = file.read()
    whole = tail.rfind(b"\n") + 1
    file.seek(begin + whole)
    file.truncate()
    lines = tail[:whole].splitlines()
    if not lines:
        if end > whole:
            fail("LINE_MALFORMED", "the file has no line that ends")
        return 0
    try:
        if form == "lines":
            return int(json.loads(lines[-1])["seq"])
        return int(lines[-1].decode().rpartition(" externalId=")[2].split(" ")[0])
    except (ValueError, KeyError, TypeError):
        fail("LINE_MALFORMED", f"the last line is no entry as --form {form} writes it")


@signed
def prove(
    entry: Annotated[str, typer.Argument(help="Number or hash of the entry.")],
    *,
    trust: TrustFile,
    out: Annotated[Path, typer.Option("--out", help="New file, which only you may read.")],
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Write one entry with the proof that it stands in the ledger.

    The file is verified with the trust bundle alone: `ztpm audit verify`. For those who read the ledger.
    """
    bundle, person = trusted(trust), signer.operator()
    asked: int | str = int(entry) if entry.isdecimal() and len(entry) < len(str(INT_LIMIT)) else entry
    with refusals(), person:
        line, proof, head = _proven(person, asked, bundle)
    whole = tree_head.EntryProof(proof.index, proof.path, proof.checkpoint, line)
    _put(out, whole.text, os.O_EXCL)
    if as_json:
        say_json({"ok": True, "out": str(out), "entry": proof.index + 1, "size": head.size, "root": head.root.hex()})
        return
    typer.echo(f"Entry {proof.index + 1} of {head.size}. To check it: ztpm audit verify {out} --trust TRUST")


@signed
def hold(
    file: Annotated[
        Path, typer.Argument(help="The checkpoint that you hold; made where there is none.", dir_okay=False)
    ],
    *,
    trust: TrustFile,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Take the ledger's newest checkpoint, once it is proven to go on from the one that you hold.

    For every registered party. Kept away from the provider, it shows each later change of what it covers.
    """
    from ztpm_idp.client.auditing import LedgerKeys

    bundle, person = trusted(trust), signer.operator()
    ledger = LedgerKeys(bundle.issuer, bundle.ledger)
    before = held_in(file, bundle) if file.exists() else None
    with refusals(), person:
        try:
            text = person.checkpoint() if before is None else person.goes_on(before, ledger)
            head = ledger.open(text)
        except CapabilityError as error:
            fail("LEDGER_FORKED" if before is not None else "CHECKPOINT_UNTRUSTED", str(error))
    _put(file, text, os.O_TRUNC)
    since = 0 if before is None else before.size
    if as_json:
        say_json({"ok": True, "size": head.size, "root": head.root.hex(), "held": since})
        return
    gone_on = f", {head.size - since} of them since the one that you held" if before is not None else ""
    typer.echo(f"{file}: {head.size} entries{gone_on}, root {head.root.hex()}.")


@signed
def picture(
    request: Annotated[str, typer.Argument(help="Id of the request, as the trail and `ztpm audit search` have it.")],
    *,
    trust: TrustFile,
    out: Annotated[Path, typer.Option("--out", help="New HTML file, which only you may read.")],
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Draw the motion of a request from its record: the arm and what was around it when it was decided.

    The file has the newest picture that a record about the request names, once the record is proven to stand in the
    ledger, or is not written. For those who read the ledger.
    """
    bundle, person = trusted(trust), signer.operator()
    with refusals(), person:
        named = [row["seq"] for row in person.search_rows({"request": request, "kind": "picture"})]
        if not named:
            fail("NO_PICTURE", f"no record names one of request {request}")
        line, proof, head = _proven(person, named[-1], bundle)
        digest = _digest_in(line, request)
        text = person.motion_picture(digest)
    from ztpm.picture.ask_picture import record_picture

    number = proof.index + 1
    told = f"Request {request}, entry {number}"
    _put(out, record_picture(text, sentence=told, digest=digest), os.O_EXCL)
    if as_json:
        say_json({"ok": True, "out": str(out), "entry": number, "size": head.size, "digest": digest})
        return
    typer.echo(f"{out}: the picture that entry {number} of {head.size} names, SHA-256 {digest}.")


def _proven(
    person: Operator, entry: int | str, bundle: TrustBundle
) -> tuple[bytes, tree_head.EntryProof, tree_head.TreeHead]:
    """An entry by its number or hash, its proof and the head of the ledger; without one the command ends."""
    proof = person.entry_proof(entry)
    line = person.entry(proof.index + 1)
    try:
        head = tree_head.check_entry(line, proof, tree_head.origin_of(bundle.issuer), bundle.ledger)
    except CapabilityError as error:
        fail("PROOF_WRONG", f"entry {entry}: {error}")
    return line, proof, head


def _digest_in(line: bytes, request: str) -> str:
    """Digest that a record about this request names in its entry, or the command ends."""
    said = object_of(object_of(object_of(json.loads(line)).get("body")).get("record"))
    about = object_of(said.get("body"))
    if (said.get("kind"), about.get("request_id")) != ("picture", request):
        fail("NO_PICTURE", "the record is about another request")
    if "digest" not in about:
        fail("NO_PICTURE", f"none was made: {about.get('reason')}")
    return str(about["digest"])


def _put(path: Path, text: str, how: int) -> None:
    try:
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | how, 0o600), "w") as file:
            file.write(text)
    except FileExistsError:
        fail("EXISTS", str(path))
    except OSError as error:
        fail_at(path, error, "UNWRITABLE")
