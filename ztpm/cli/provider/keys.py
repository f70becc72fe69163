"""`ztpm keys`: the identity provider's own keys over time, on the files of a cell's directory.

Every step writes a new version of the trust bundle. A provider that serves acts on it within a second, and every
enforcement point that hears it a few seconds later. Exit status: 0 done, 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

import time
from contextlib import contextmanager
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ztpm.cli.output import console, fail, fail_at, instant, say_json
from ztpm.cli.provider.person import CellDirectory, Json, layout_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from capabilities.rotation.rotation import KeyRecord, KeyRing, RotationRefused
    from ztpm.base.layout import Layout
    from ztpm.cell.key_ring import RotationStep

app = typer.Typer(no_args_is_help=True, help="The identity provider's keys: list, prepare, activate, taint, revoke.")

FOLLOWED_S: Final = 15
"""Seconds in which every enforcement point that hears the provider has a new bundle: it asks every 10 s, unhinted."""

KeyId = Annotated[str, typer.Argument(metavar="KEY", help="As `ztpm keys list` shows it, e.g. root-2.")]


class KeyRole(StrEnum):
    """The roles, as people say them."""

    ROOT = "root"
    ATTESTER = "attester"
    FEED = "feed"
    REGISTRY = "registry"
    LEDGER = "ledger"


class Curve(StrEnum):
    """Kind of key by its curve."""

    ED25519 = "ed25519"
    P256 = "p256"


@app.command("list")
def list_(*, directory: CellDirectory = None, as_json: Json = False) -> None:
    """Every key that the provider has or had, and the trust bundle that they make."""
    from rich.table import Table

    from ztpm.cell import key_ring

    layout = layout_of(directory)
    with _failures():
        ring = key_ring.read(layout)
    if as_json:
        say_json({"ok": True, **_described(ring), "keys": [_shown(record) for record in ring.records]})
        return
    table = Table(box=None, pad_edge=False)
    for heading in ("key", "state", "signs with", "since", "thumbprint"):
        table.add_column(heading)
    for record in ring.records:
        shown = _shown(record)
        table.add_row(*(str(shown[name]) for name in ("id", "state", "algorithm", "since", "thumbprint")))
    console.print(table)
    described = _described(ring)
    console.print(f"Trust bundle {described['version']}, holds until {described['valid_until']}.")


@app.command("prepare")
def prepare(
    role: Annotated[KeyRole, typer.Argument(help="What the key will sign.")],
    *,
    algorithm: Annotated[
        Curve, typer.Option(help="Root and attester keys are Ed25519 in this version.")
    ] = Curve.ED25519,
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Make a further key of a role, which verifiers trust from now on; it signs nothing yet.

    It is made in the PKCS #11 token, where the provider's configuration says so of the role.
    """
    from capabilities.keys import keys
    from capabilities.keys.windows import Role
    from ztpm.cell import key_ring
    from ztpm.cli.provider.passphrase import ask_passphrase

    layout = layout_of(directory)
    chosen = keys.Algorithm.P256 if algorithm is Curve.P256 else keys.Algorithm.ED25519
    if algorithm is Curve.P256 and role in {KeyRole.ROOT, KeyRole.ATTESTER}:
        fail("ALGORITHM", "what signs tokens is an Ed25519 key in this version")
    passphrase = ask_passphrase(new=False)
    with _failures(), _alone(layout):
        token = key_ring.token_of(layout, role.value)
        at = int(time.time())
        answer = key_ring.prepare(layout, Role[role.name], chosen, passphrase=passphrase, at=at, token=token)
        _tell(answer, None, layout.trust, as_json=as_json)


@app.command("activate")
def activate(
    key: KeyId,
    *,
    at_once: Annotated[bool, typer.Option(help="Also where verifiers may not have its bundle yet.")] = False,
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Let the prepared key sign from now on, 15 s after it was prepared or later.

    The key that signed is trusted until the last of its signatures is over.
    """
    from capabilities.rotation import rotation
    from ztpm.cell import key_ring

    if not at_once:
        with _failures():
            found = key_ring.read(layout_of(directory)).find(key)
        left_s = 0 if found is None else found.prepared_at + FOLLOWED_S - int(time.time())
        if found is not None and found.activated_at is None and left_s > 0:
            fail("TOO_SOON", f"{key}: {left_s} s more")
    _step(rotation.activate, key, layout_of(directory), as_json=as_json)


@app.command("taint")
def taint(key: KeyId, *, directory: CellDirectory = None, as_json: Json = False) -> None:
    """Refuse all that the retired key signs from now on.

    If the key may be in other hands, revoke it instead.
    """
    from capabilities.rotation import rotation

    _step(rotation.taint, key, layout_of(directory), as_json=as_json)


@app.command("revoke")
def revoke(key: KeyId, *, directory: CellDirectory = None, as_json: Json = False) -> None:
    """Nothing under the key is accepted any more, for ever."""
    from capabilities.rotation import rotation

    _step(rotation.revoke, key, layout_of(directory), as_json=as_json)


@app.command("renew")
def renew(*, directory: CellDirectory = None, as_json: Json = False) -> None:
    """The same keys in a new trust bundle, which holds for a year."""
    from ztpm.cell import key_ring

    layout = layout_of(directory)
    with _failures(), _alone(layout):
        _tell(key_ring.renew(layout, at=int(time.time())), "", layout.trust, as_json=as_json)


def _step(verb: RotationStep, id_: str, layout: Layout, *, as_json: bool) -> None:
    from ztpm.cell import key_ring

    with _failures(), _alone(layout):
        _tell(key_ring.step(layout, verb, id_, at=int(time.time())), id_, layout.trust, as_json=as_json)


def _tell(answer: KeyRing | RotationRefused, id_: str | None, trust: Path, *, as_json: bool) -> None:
    """Tells the step on the key of this name; None means the last one, "" none."""
    from capabilities.rotation.rotation import RotationRefused

    if isinstance(answer, RotationRefused):
        fail(str(answer.why), answer.detail)
    record = answer.records[-1] if id_ is None else answer.find(id_)
    described = {**_described(answer), "trust_file": str(trust)}
    if as_json:
        say_json({"ok": True, **described, **({} if record is None else {"key": _shown(record)})})
        return
    done = "" if record is None else f"{record.id} is {record.state}. "
    typer.echo(
        f"{done}Trust bundle {described['version']} in {trust}, until {described['valid_until']}. A provider that "
        "serves and the enforcement points that hear it follow by themselves; bring it to every other verifier."
    )


def _described(ring: KeyRing) -> dict[str, object]:
    from capabilities.values.caps import DEFAULT

    bundle = ring.bundle(DEFAULT)
    return {"issuer": ring.issuer, "version": ring.version, "valid_until": instant(bundle.valid_until)}


def _shown(record: KeyRecord) -> dict[str, object]:
    from capabilities.keys import keys

    steps = (record.prepared_at, record.activated_at, record.retired_at, record.tainted_at, record.revoked_at)
    return {
        "id": record.id,
        "state": str(record.state),
        "algorithm": str(keys.algorithm_of(record.key)),
        "since": instant(max(at for at in steps if at is not None)),
        "thumbprint": keys.thumbprint(record.key),
    }


@contextmanager
def _alone(layout: Layout) -> Iterator[None]:
    """Holds the ring: no other step is taken meanwhile."""
    from ztpm.base.layout import LayoutError
    from ztpm.base.lock import DirectoryLock, LockedError

    try:
        if not layout.key_lock.parent.is_dir():
            raise LayoutError(f"{layout.key_ring} is missing")
        with DirectoryLock.take(layout.key_lock):
            yield
    except LockedError as error:
        fail("STEP_UNDER_WAY", f"{layout.key_ring}: process {error.pid or '?'}")


@contextmanager
def _failures() -> Iterator[None]:
    """Ends the command at a file that cannot be read, opened or written."""
    from capabilities.values.errors import BadKeyError
    from ztpm.base.layout import LayoutError
    from ztpm_idp.keys.key_files import SettingsError

    try:
        yield
    except BadKeyError as error:
        fail("KEYS_UNREADABLE", str(error))
    except LayoutError as error:
        fail("KEYS_UNREADABLE", str(error))
    except SettingsError as error:
        fail("CONFIG_INVALID", f"{error.setting}: {error.why}")
    except OSError as error:
        fail_at("", error, "UNWRITABLE")
