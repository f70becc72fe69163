"""`ztpm pep` and `ztpm sensor`: enforcement points and sensors, as administrators keep them.

Exit status: 0 done, 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ztpm.cli.output import fail_at, say_json
from ztpm.cli.provider.party_keys import PartyName, PartyPublic, key_for, rotation_of
from ztpm.cli.provider.person import Json, Reason, Signer, known_name, refusals, signed
from ztpm.cli.tables import show_table

if TYPE_CHECKING:
    from typing import Literal

    from ztpm_idp.client import Operator

pep = typer.Typer(no_args_is_help=True, help="Enforcement points: who stands before which tools.")
sensor = typer.Typer(no_args_is_help=True, help="Sensors: whose frames are believed, and how good they are.")

TRANSIT_MS: Final = 20
"""Ours: declared longest transit of a frame where none is stated, as the simulated sensor's."""

CalibrationFile = Annotated[
    Path, typer.Option(help="Its calibration document; the SHA-256 is what is registered.", exists=True, dir_okay=False)
]
TransitMs = Annotated[int, typer.Option(min=1, max=1_000, help="Longest time from exposure to arrival, ms.")]


@pep.command("register")
@signed
def register_pep(
    part: PartyName,
    *,
    audience: Annotated[list[str], typer.Option(help="Canonical URL that it serves; again for more.")],
    public: PartyPublic = "",
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Register an enforcement point; its key is made in the directory, encrypted, unless its public half is told."""
    known_name(part)
    person = signer.operator()
    raw, where = key_for(signer, "pep", part, public)
    with refusals(), person:
        person.register_pep(part, raw, audience)
    _registered(part, where, as_json=as_json)


@sensor.command("register")
@signed
def register_sensor(
    part: PartyName,
    *,
    audience: Annotated[str, typer.Option(help="Canonical URL of the cell that it watches.")],
    calibration: CalibrationFile,
    transit_ms: TransitMs = TRANSIT_MS,
    public: PartyPublic = "",
    signer: Signer,
    as_json: Json = False,
) -> None:
    """Register a sensor; its key is made in the directory, encrypted, unless its public half is told."""
    where = put_sensor(part, signer, audience=audience, calibration=calibration, transit_ms=transit_ms, public=public)
    _registered(part, where, as_json=as_json)


def put_sensor(part: str, signer: Signer, *, audience: str, calibration: Path, transit_ms: int, public: str) -> str:
    """Registers a sensor; gives the file of a key made for it, or "" where its public half was told."""
    import hashlib

    known_name(part)
    person = signer.operator()
    try:
        digest = hashlib.sha256(calibration.read_bytes()).hexdigest()
    except OSError as error:
        fail_at(calibration, error, "UNREADABLE")
    raw, where = key_for(signer, "sensor", part, public)
    with refusals(), person:
        person.register_sensor(part, raw, calibration=digest, transit_ms=transit_ms, audience=audience)
    return where


@pep.command("list")
@signed
def list_peps(*, signer: Signer, as_json: Json = False) -> None:
    """List every enforcement point with its standing, its audiences and its key."""
    person = signer.operator()
    with refusals(), person:
        rows = person.peps()
    if as_json:
        say_json({"ok": True, "peps": rows})
        return
    show_table(("pep", "status", "audiences", "key"), [
        (row.get("id"), row.get("status"), "\n".join(map(str, row.get("audiences") or ())), row.get("key"))
        for row in rows
    ])  # fmt: skip


@sensor.command("list")
@signed
def list_sensors(*, signer: Signer, as_json: Json = False) -> None:
    """List every sensor with its standing, its audience and its key."""
    person = signer.operator()
    with refusals(), person:
        rows = person.sensors()
    if as_json:
        say_json({"ok": True, "sensors": rows})
        return
    show_table(("sensor", "status", "audience", "transit", "key"), [
        (row.get("id"), row.get("status"), row.get("audience"), f"{row.get('transit_ms')} ms", row.get("key"))
        for row in rows
    ])  # fmt: skip


def _add(group: typer.Typer, kind: Literal["pep", "sensor"], called: str, then: str) -> None:
    """Adds the commands that both kinds have."""

    @signed
    def suspend(part: PartyName, *, reason: Reason, signer: Signer, as_json: Json = False) -> None:
        person = _person(part, signer)
        with refusals(), person:
            person.suspend_part(kind, part, reason)
        _say(part, "suspended", as_json=as_json)

    @signed
    def restore(part: PartyName, *, reason: Reason, signer: Signer, as_json: Json = False) -> None:
        person = _person(part, signer)
        with refusals(), person:
            person.restore_part(kind, part, reason)
        _say(part, "restored", as_json=as_json)

    @signed
    def retire(part: PartyName, *, reason: Reason, signer: Signer, as_json: Json = False) -> None:
        person = _person(part, signer)
        with refusals(), person:
            epoch = person.retire_part(kind, part, reason)
        if as_json:
            say_json({"ok": True, "id": part, "epoch": epoch})
        else:
            typer.echo(f"Retired, epoch {epoch}.")

    suspend.__doc__ = f"Suspend {called} until it is restored: {then}."
    restore.__doc__ = f"Restore {called} that was suspended."
    retire.__doc__ = f"Retire {called}, for ever. Nothing takes it back: register a new one instead."
    for command in (suspend, restore, retire):
        group.command(command.__name__)(command)
    group.command("rotate")(rotation_of(kind))


_add(pep, "pep", "an enforcement point", "it hears nothing, so it permits nothing once its view is too old")
_add(sensor, "sensor", "a sensor", "no frame of it is believed")


def _person(name: str, signer: Signer) -> Operator:
    known_name(name)
    return signer.operator()


def _say(name: str, status: str, *, as_json: bool) -> None:
    if as_json:
        say_json({"ok": True, "id": name, "status": status})
    else:
        typer.echo(f"{status.capitalize()}.")


def _registered(name: str, where: str, *, as_json: bool) -> None:
    if as_json:
        say_json({"ok": True, "id": name, "status": "registered", **({"key": where} if where else {})})
    else:
        typer.echo(f"Registered; its key is {where}." if where else "Registered.")
