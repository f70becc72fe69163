"""`ztpm up`: the cell, kept running."""

from __future__ import annotations

import os
import secrets
import signal
import sys
import threading
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ztpm.cli.output import console, fail, fail_at, say_json
from ztpm.cli.provider.passphrase import ask_passphrase
from ztpm.cli.provider.person import PLACE_VARIABLE, believe

if TYPE_CHECKING:
    from ztpm.base.layout import Layout
    from ztpm.up import Up

SOMEBODY: Final = (
    '{"form": "ztpm-world/1", "frame": "base", '
    '"view": {"people": [{"id": "p1", "standing_adult": {"x_m": 0.69, "y_m": 0.0}}]}}'
)
"""World file with a person near the arm, to be tried."""


def up(
    *,
    where: Annotated[
        Path, typer.Option("--data", help="Directory of the cell; made when missing.", envvar=PLACE_VARIABLE)
    ] = Path(".ztpm"),
    policy: Annotated[str, typer.Option(help="Of a new cell: shipped policy set or a file.")] = "paper-default",
    named: Annotated[
        bool,
        typer.Option("--localhost", help="Of a new cell: its provider is at localhost, so that passkeys work."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON line when the cell is ready.")] = False,
) -> None:
    """Run a cell until SIGINT or SIGTERM: identity provider, simulated UR3e and sensor, gateway, tools, status page.

    A cell of `ztpm init --robot` has a controller and sensors of its own: the others are run.
    """
    from ztpm.base.event_log import EventLog
    from ztpm.base.layout import Layout
    from ztpm.base.lock import DirectoryLock, LockedError
    from ztpm.cell.setup import free_addresses, is_empty
    from ztpm.preparing import waiting

    with waiting("starting the cell", at_once=True):  # a busy machine takes seconds to load what a cell is made of
        from ztpm.up import UpError, prepare, run
        from ztpm.up import as_json as told_to_machines

    layout = Layout(where.resolve())
    believe(layout)
    try:
        made = not layout.root.exists()
        layout.root.mkdir(mode=0o700, parents=True, exist_ok=True)
        lock = DirectoryLock.take(layout.lock)
    except LockedError as error:
        fail("RUNNING_ALREADY", f"{layout.root}: process {error.pid or '?'}")
    except OSError as error:
        fail_at(layout.root, error, "UNWRITABLE")
    with lock:
        try:
            new = is_empty(layout)
            passphrase = ask_passphrase(new=new)  # until it is given, Ctrl-C ends the command at once
            ended = threading.Event()
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, lambda *_: ended.set())
            if not as_json:
                console.print(f"{'Making' if new else 'Starting'} the cell in {layout.root} ...")
            with waiting("starting the cell", at_once=True) as over:
                fresh = partial(free_addresses, secrets.token_bytes(16), named=named)
                addresses = prepare(layout, passphrase=passphrase, policy=policy, fresh=fresh)
                log = EventLog(layout.log, wall_s=time.time, say=_mute if as_json else _say)
                if lock.stale_pid is not None:
                    log.note(
                        "stale-lock",
                        f"an earlier run, process {lock.stale_pid}, ended without an end",
                        pid=lock.stale_pid,
                    )

                def ready(cell: Up) -> None:
                    over()
                    if as_json:
                        say_json(told_to_machines(cell, layout, pid=os.getpid()))
                        sys.stdout.flush()
                    else:
                        _overview(cell, layout)

                from ztpm.stage.stage import LEFT

                run(layout, addresses, passphrase=passphrase, joints=LEFT, log=log, ended=ended, ready=ready)
        except UpError as error:
            _undo(layout, made=made)
            fail(error.code, str(error))
        except BaseException:
            _undo(layout, made=made)
            raise


def _mute(told: str) -> None:
    """Says nothing."""


def _say(told: str) -> None:
    from ztpm.preparing import SHOWN

    SHOWN.over()  # a line of its own
    typer.echo(told, err=True)


def _undo(layout: Layout, *, made: bool) -> None:
    """Removes a directory that was made for a cell that could not be made."""
    if made and layout.root.exists() and list(layout.root.iterdir()) == [layout.lock]:
        layout.lock.unlink()
        layout.root.rmdir()


def _overview(cell: Up, layout: Layout) -> None:
    directory, issuer, audience = layout.root, cell.addresses.issuer, cell.addresses.audience
    from ztpm.up import operators_of

    operators = ", ".join(operators_of(layout))
    real = layout.controller.exists()
    rows = [
        ("status page", cell.status),
        ("tool server", f"{audience}   (MCP; a token and a proof with each request)"),
        ("identity provider", issuer),
        ("robot", f"{cell.addresses.face_host}   (its gateway: state and stop for everybody, motion in a lease)"),
        ("controller" if real else "simulated UR3e", f"{cell.addresses.controller_host}   (behind the gateway)"),
        ("operators", f"{operators}; their keys, encrypted: {directory}/operators"),
        ("log", str(layout.log)),
    ]
    console.print("\nThe cell is up. Ctrl-C ends it, the arm first.\n")
    for name, value in rows:
        console.print(f"  {name:18} {value}", markup=False)
    console.print("\nTry in another terminal (ZTPM_PASSPHRASE set, or it is asked for):\n")
    person, other = (*operators_of(layout), "alice", "bob")[:2]
    signs = f"--data {directory} --as {person}"
    scope = f" --scope {layout.first_scope} --minutes 15" if real else ""
    for command in (
        f"ztpm approvals list --data {directory} --as {other}",
        f"ztpm agent list --data {directory} --as {person}",
        f"ztpm agent register mover --role mover --software FILE --data {directory} --as {person}",
        f"ztpm agent attest mover --software FILE --data {directory}",
        f"ztpm token issue mover --software FILE --purpose 'try it'{scope} --out mover.token {signs}",
        f"ztpm rtde run mover --token mover.token --data {directory} -- python PROGRAM {{robot}}",
        f"ztpm revoke agent mover --reason 'no longer needed' --data {directory} --as {person}",
        f"ztpm enrol sensor camera-1 --calibration FILE --data {directory} --as {person}"
        if real
        else f"echo '{SOMEBODY}' > {layout.scene}",
    ):
        console.print(f"  {command}", markup=False)
    for differing in cell.differing:
        console.print(
            f"\n[bold yellow]{differing}.[/] Nothing registers it again by itself; when you have looked at it:"
        )
        console.print(f"  ztpm mcp pin --data {directory} --as {operators_of(layout)[-1]}", markup=False)
