"""Stage on a fresh embedded cell, removed afterwards."""

from __future__ import annotations

import secrets
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ztpm.base.layout import OPERATORS, Layout
from ztpm.base.processes import Child
from ztpm.cell.cell import Cell
from ztpm.cell.setup import free_addresses, initialise
from ztpm.stage.stage import LEFT, Stage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

DEFER_TIMEOUT_S: Final = 4
"""The cell waits this long for an answer to a deferral, so that the story stays short."""

ASKS: Final = 1_000
"""The people of a story answer at once, and more often than people may be asked."""


@contextmanager
def stage(
    *,
    begin: Callable[..., Child] = Child.begin,
    directory: Path | None = None,
    prepare: Callable[[Layout, bytes], None] | None = None,
    second_sensor: bool = False,
    defer_timeout_s: int = DEFER_TIMEOUT_S,
) -> Iterator[Stage]:
    """Stage on a fresh cell, removed afterwards.

    Args:
        begin: begins a process in place of `Child.begin`; the tests of the defences break one here.
        directory: kept afterwards; a temporary one by default.
        prepare: given the cell's files and their passphrase before anything is started, to change one of them.
        second_sensor: a second sensor watches the cell beside the first.
        defer_timeout_s: so long the cell waits for an answer to a deferral.
    """
    with tempfile.TemporaryDirectory(prefix="ztpm-") as temporary:
        layout = Layout(directory or Path(temporary) / "cell")
        addresses = free_addresses(secrets.token_bytes(16))
        passphrase = secrets.token_urlsafe(24).encode()
        initialise(
            layout,
            addresses,
            passphrase=passphrase,
            policy="paper-default",
            defer_timeout_s=defer_timeout_s,
            second_sensor=second_sensor,
        )
        with layout.idp_config.open("a") as settings:
            settings.write(f"asks_a_minute = {ASKS}\nasks_an_hour = {ASKS}\n")
        if prepare is not None:
            prepare(layout, passphrase)
        with Cell.start(layout, addresses, passphrase=passphrase, joints=LEFT, begin=begin) as cell:
            on_stage = Stage(cell=cell, people={})
            on_stage.people = {name: on_stage.operator_from_disk(name) for name in OPERATORS}
            cell.register(on_stage.people["carol"])
            cell.start_enforcement()
            try:
                yield on_stage
            finally:
                on_stage.close()
