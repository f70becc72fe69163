"""`ztpm explain`: a code of any answer, with its cause and the next step."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Annotated

import typer
from rich.table import Table

from ztpm.cli.output import console, fail, say_json
from ztpm.cli.provider.person import Json


def explain(
    code: Annotated[
        str, typer.Argument(help="A code as a command, a server or a record tells it; all without it.")
    ] = "",
    *,
    as_json: Json = False,
) -> None:
    """Explain a code: its cause, the next step, the primitives that find it, and the exit status."""
    from policies.words.reason_table import REASONS, Reason
    from ztpm.codes.code_table import code_table

    table = code_table()
    wanted = code.strip().rstrip(":").upper()
    if not wanted:
        _list(as_json=as_json)
        return
    if wanted not in table:
        near = ", ".join(get_close_matches(wanted, table, n=3))
        fail("CODE_UNKNOWN", f"{code}; near to it: {near}" if near else code)
    row, owners = table[wanted], REASONS[Reason(wanted)].owners if wanted in REASONS else ()
    if as_json:
        told = {"code": wanted, "cause": row.cause, "next": row.step, "primitives": list(owners), "status": row.status}
        say_json({"ok": True, **told})
        return
    console.print(wanted, style="bold")
    lines = [
        ("cause", row.cause),
        ("next step", row.step),
        ("found by", ", ".join(owners)),
        ("exit status", row.status),
    ]
    shown = Table(box=None, pad_edge=False, show_header=False)
    for name, value in lines:
        if value:
            shown.add_row(name, str(value))
    console.print(shown)


def _list(*, as_json: bool) -> None:
    from ztpm.codes.code_table import code_table

    if as_json:
        say_json({"ok": True, "codes": {code: row.cause for code, row in code_table().items()}})
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("code", no_wrap=True)
    table.add_column("cause")
    for code, row in code_table().items():
        table.add_row(code, row.cause)
    console.print(table)
