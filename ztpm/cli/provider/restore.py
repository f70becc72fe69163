"""`ztpm idp migrate`, `backup`, `restore`, `mark` and `resume`, `ztpm agent vouch`: the store, copied and put back.

Exit status: 0 done, 1 failure, 2 usage, 3 refused.
"""

from __future__ import annotations

import time
import tomllib
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ztpm.cli.output import fail, fail_at, plain, say_json
from ztpm.cli.provider.agent import AgentName
from ztpm.cli.provider.passphrase import ask_passphrase
from ztpm.cli.provider.person import (
    CellDirectory,
    Json,
    Reason,
    Signer,
    known_name,
    layout_of,
    open_key,
    refusals,
    signed,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ztpm_idp.settings import FileSettings

CONFIG_KEYS: Final = ("issuer", "pep_key_file", "state_dir")
"""Settings of any enforcement point that its mark needs."""
Config = Annotated[
    Path | None,
    typer.Option("--config", help="Its configuration (default: of the cell in --data).", exists=True, dir_okay=False),
]


def backup(
    destination: Annotated[Path, typer.Argument(metavar="DEST", help="New file, which only you may read.")],
    *,
    config: Config = None,
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Copy the identity provider's store, whole and consistent, while it serves."""
    from ztpm_idp.restore import backup as copy

    settings, _ = _settings(config, directory)
    with _failures():
        size = copy(settings.database_url, destination)
    if as_json:
        say_json({"ok": True, "file": str(destination), "bytes": size})
    else:
        typer.echo(f"{destination}: {size} bytes. It holds all but the keys.")


def migrate(*, config: Config = None, directory: CellDirectory = None, as_json: Json = False) -> None:
    """Bring the identity provider's database to this release's schema, before any process of it serves.

    Every process does so when it starts, and of several at once one does; this does it alone, and makes a new one.
    """
    import asyncio

    from ztpm_idp.store import Store
    from ztpm_idp.store.database.migrate import NEWEST

    settings, _ = _settings(config, directory)

    async def migrated() -> str | None:
        store = await Store.open(settings.database_url)
        await store.close()
        return store.before

    with _failures():
        before = asyncio.run(migrated())
    if as_json:
        say_json({"ok": True, "schema": NEWEST, "before": before})
    elif before == NEWEST:
        typer.echo(f"The schema is {NEWEST} already.")
    else:
        typer.echo(f"The schema is {NEWEST}{', in a new database' if before is None else f'; it was {before}'}.")


def restore(
    *,
    copy: Annotated[
        Path | None,
        typer.Option(
            "--from", help="The copy (default: the store in its place is one already).", exists=True, dir_okay=False
        ),
    ] = None,
    ledger: Annotated[
        list[Path] | None, typer.Option(help="An exported ledger; again for more.", exists=True, dir_okay=False)
    ] = None,
    mark: Annotated[
        list[Path] | None,
        typer.Option(help="The newest mark of a point that cannot reach the provider.", exists=True, dir_okay=False),
    ] = None,
    config: Config = None,
    directory: CellDirectory = None,
    as_json: Json = False,
) -> None:
    """Put a copy in the place of the identity provider's store, which must not be running.

    What ledgers and marks hold revoked is revoked in it; the ledger of the store that was there is read by itself. The
    provider then lends nothing and tells nothing until every enforcement point was heard, and `ztpm idp resume`.
    """
    from ztpm_idp.keys.key_files import SettingsError
    from ztpm_idp.restore import StoppedProvider
    from ztpm_idp.restore import restore as put_back
    from ztpm_idp.settings import load_keys, load_policies

    settings, folder = _settings(config, directory)
    try:
        keys = load_keys(settings, folder, ask_passphrase(new=False).decode())
        deployment = StoppedProvider(settings.settings(keys), keys, load_policies(settings, folder), time.time)
    except SettingsError as error:
        fail("CONFIG_INVALID", f"{error.setting}: {error.why}")
    with _failures():
        done = put_back(deployment, copy, ledgers=ledger or (), marks=mark or ())
    if as_json:
        told = {"line": done.line, "taken_back": done.taken_back, "waits_for": done.waits_for, "held": done.held}
        say_json({"ok": True, **told, "before": done.before, "kept": None if done.kept is None else str(done.kept)})
        return
    typer.echo(
        f"Line {done.line} is begun; {done.taken_back} revocations were taken back, {done.held} agents are held. "
        f"Of the ledger before, {done.before} was read{'' if done.kept is None else f'; it is kept as {done.kept}'}.\n"
        f"Start the service. It waits for {', '.join((*done.waits_for, 'an administrator'))}: ztpm idp resume"
    )


@signed
def resume(
    *,
    unheard: Annotated[
        list[str] | None,
        typer.Option(help="A point that was not heard and will not be, as the refusal names it; again for more."),
    ] = None,
    signer: Signer,
    as_json: Json = False,
) -> None:
    """End the restore, as an administrator: the provider serves again.

    Every point that was not heard must be named. It may know of revocations that are lost, so all agents are held then.
    """
    person = signer.operator()
    with refusals(), person:
        person.resume(unheard or ())
    if as_json:
        say_json({"ok": True, "unheard": sorted(unheard or ())})
        return
    held = " Every agent is held: ztpm agent vouch AGENT, for each of which you know that it is not revoked."
    typer.echo(f"It serves again.{held if unheard else ''}")


@signed
def vouch(agent: AgentName, *, reason: Reason, signer: Signer, as_json: Json = False) -> None:
    """Vouch, as an administrator, for an agent that is held since a restore: it may act on new authority again."""
    known_name(agent)
    person = signer.operator()
    with refusals(), person:
        person.vouch(agent, reason)
    if as_json:
        say_json({"ok": True, "id": agent, "held": False})
    else:
        typer.echo("It may receive and lend authority again.")


def mark(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="New file for the mark.")],
    *,
    config: Annotated[
        Path, typer.Option("--config", help="Configuration of the enforcement point.", exists=True, dir_okay=False)
    ],
    as_json: Json = False,
) -> None:
    """Sign what an enforcement point knows to be revoked, for `ztpm idp restore --mark`.

    Only a point that cannot reach the provider needs it: the others tell theirs. The passphrase is that of its key.
    """
    from pep.base.errors import FeedError
    from pep.provider.feed_mark import FeedMarkFile, kept_names, signed_marks
    from ztpm.base.layout import LayoutError, write_private

    issuer, key_file, state = _point(config)
    file = state / "feed.json"
    try:
        known, revoked = FeedMarkFile(file).read(issuer), kept_names(file.with_suffix(".kept"), issuer)
    except FeedError as error:
        fail(str(error.code), error.detail)
    parts = signed_marks(known, revoked, key=open_key(key_file), at=int(time.time()))
    try:
        write_private(out, "".join(f"{part}\n" for part in parts).encode())
    except LayoutError as error:
        fail("EXISTS", str(error))
    except OSError as error:
        fail_at(out, error, "UNWRITABLE")
    if as_json:
        say_json({"ok": True, "file": str(out), "line": known.line, "epoch": known.epoch, "revoked": len(revoked)})
    else:
        typer.echo(f"{out}: line {known.line}, epoch {known.epoch}, {len(revoked)} revocations.")


def _point(config: Path) -> tuple[str, Path, Path]:
    """Issuer, key file and state directory in the configuration of any enforcement point."""
    try:
        table = tomllib.loads(config.read_text("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        fail_at(config, error, "UNREADABLE")
    except tomllib.TOMLDecodeError:
        fail("CONFIG_INVALID", f"{config}: not TOML")
    for name in CONFIG_KEYS:
        if not isinstance(table.get(name), str):
            fail("CONFIG_INVALID", f"{config}: {name}")
    issuer, key_file, state = (table[name] for name in CONFIG_KEYS)
    return issuer, Path(key_file), Path(state)


def _settings(config: Path | None, directory: Path | None) -> tuple[FileSettings, Path]:
    """Settings of the identity provider, and the folder where their relative names start."""
    from ztpm_idp.keys.key_files import SettingsError
    from ztpm_idp.settings import load_settings

    file = config or layout_of(directory).idp_config
    try:
        return load_settings(file), file.parent
    except SettingsError as error:
        fail("CONFIG_INVALID", f"{file}: {error.setting}: {error.why}")


@contextmanager
def _failures() -> Iterator[None]:
    """Ends the command at a copy that cannot be made or put back."""
    from ztpm_idp.store import RestoreError, StoreNotOpenedError

    try:
        yield
    except (RestoreError, StoreNotOpenedError) as error:
        fail(error.code, plain(error.sentence))
    except OSError as error:
        fail_at("", error, "UNWRITABLE")
