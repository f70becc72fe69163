"""`ztpm idp`: the identity provider as its operators run it, with or without a cell.

The commands on a running one's store (backup, restore, resume, mark, recover) join the group in `ztpm/cli/__init__.py`.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ztpm.cli.output import AS_JSON, fail, fail_at, say_json
from ztpm.cli.provider.party_keys import raw_of
from ztpm.cli.provider.passphrase import ask_passphrase
from ztpm.cli.provider.person import PLACE_VARIABLE, CellDirectory, Json, known_name, layout_of
from ztpm.cli.serve import become

if TYPE_CHECKING:
    from ztpm.base.layout import Layout
    from ztpm.cell.provider_setup import ProviderPlan

app = typer.Typer(
    no_args_is_help=True, help="The identity provider: make it, serve it, restore its store, recover an administrator."
)

TWO: Final = 2
"""Administrators from whom on approvers and administrators can be changed."""


@app.command("init")
def init(
    *,
    where: Annotated[Path, typer.Option("--data", help="Directory to create.", envvar=PLACE_VARIABLE)] = Path(".ztpm"),
    issuer: Annotated[
        str, typer.Option(help="Its base URL as every machine reaches it, with a path: https://idp.example/ztpm.")
    ] = "",
    admin: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=PUBLIC]",
            help="A first administrator; again for more. With a public key of `ztpm person new-key`, else one is made.",
        ),
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on (default: all with TLS, else loopback).")] = "",
    port: Annotated[int, typer.Option(min=0, max=65_535, help="Port to listen on (default: the issuer's).")] = 0,
    tls_certificate: Annotated[
        Path | None, typer.Option(help="Certificate chain, PEM.", exists=True, dir_okay=False)
    ] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Its private key, PEM.", exists=True, dir_okay=False)] = None,
    database: Annotated[str | None, typer.Option(help="Database URL (default: SQLite in the directory).")] = None,
    policy: Annotated[str, typer.Option(help="Shipped policy set or a file.")] = "paper-default",
    as_json: Json = False,
) -> None:
    """Make an identity provider of its own, without a cell: keys, trust bundle, configuration, administrators.

    Its passphrase: ZTPM_PASSPHRASE, or asked for. What is not said is asked for in a terminal.
    """
    from ztpm.base.layout import Layout, LayoutError
    from ztpm.cell.provider_setup import ProviderPlan, initialise_provider
    from ztpm_idp.keys.key_files import SettingsError
    from ztpm_idp.provider.problems import Problem
    from ztpm_idp.store import StoreNotOpenedError, StoreUnavailableError

    if database == "":  # a variable of a script that has no value is no wish for SQLite
        fail("CONFIG_INVALID", "database_url: empty; leave --database out for SQLite in the directory")
    if bool(tls_certificate) != bool(tls_key):
        fail("USAGE", "give --tls-certificate and --tls-key together")
    issuer = issuer or _asked("Base URL of the provider, with a path (https://idp.example/ztpm)", "--issuer")
    people = people_of(admin or _asked("First administrators, at least two", "--admin").replace(",", " ").split())
    passphrase = ask_passphrase(new=True)
    layout = Layout(where.resolve())
    plan = ProviderPlan(
        issuer=issuer, people=people, host=host, port=port, certificate=tls_certificate, key=tls_key,
        database_url=database or "", policy=str(Path(policy).resolve()) if Path(policy).is_file() else policy,
    )  # fmt: skip
    try:
        initialise_provider(layout, plan, passphrase=passphrase, at=int(time.time()))
    except LayoutError as error:
        fail("EXISTS", str(error))
    except SettingsError as error:
        fail("CONFIG_INVALID", f"{error.setting}: {error.why}")
    except Problem as error:
        fail(error.code.value, error.detail)
    except StoreNotOpenedError as error:
        fail(error.code, error.sentence)
    except StoreUnavailableError:
        fail("CONFIG_INVALID", "database_url: the store cannot be made")
    except OSError as error:
        fail_at(layout.root, error, "UNWRITABLE")
    _tell(layout, plan, as_json=as_json)


def _asked(question: str, option: str) -> str:
    """The answer to a question in a terminal, or the end of the command."""
    if AS_JSON.get() or not sys.stdin.isatty():
        fail("NO_PEOPLE" if option == "--admin" else "USAGE", f"give {option}")
    return str(typer.prompt(question, err=True))


def people_of(stated: list[str]) -> dict[str, bytes | None]:
    """First administrators by id, with the keys that were told."""
    people: dict[str, bytes | None] = {}
    for each in stated:
        name, _, public = each.partition("=")
        known_name(name)
        if name in people:
            fail("USAGE", f"--admin: {name} twice")
        people[name] = raw_of(public) if public else None
    if not people:
        fail("NO_PEOPLE", "--admin")
    return people


def _tell(layout: Layout, plan: ProviderPlan, *, as_json: bool) -> None:
    host, port = plan.listener
    made = {name: layout.operator_key(name) for name, public in plan.people.items() if public is None}
    if as_json:
        told = {"data": str(layout.root), "issuer": plan.issuer, "host": host, "port": port, "trust": str(layout.trust)}
        keys = {name: str(path) for name, path in made.items()}
        say_json({"ok": True, **told, "administrators": sorted(plan.people), "keys": keys})
        return
    typer.echo(f"A new identity provider in {layout.root}: issuer {plan.issuer}, listening on {host}, port {port}.")
    for name, path in made.items():
        typer.echo(f"{path}: hand it to {name}, and leave no copy.")
    typer.echo(f"{layout.trust}: bring it to every machine that is to believe this provider.")
    if plan.issuer.startswith("https:") and plan.certificate is None:
        typer.echo(
            "No TLS files: put a TLS proxy before it on this machine, or make it anew with --tls-certificate and "
            "--tls-key."
        )
    if len(plan.people) < TWO:
        typer.echo(
            "One administrator changes no approver and no administrator: a second one comes by `ztpm idp recover`."
        )
    typer.echo("Next: ztpm idp serve")


@app.command("serve")
def serve(
    *,
    config: Annotated[
        Path | None,
        typer.Option(help="Its configuration (default: that of --data).", exists=True, dir_okay=False),
    ] = None,
    directory: CellDirectory = None,
) -> None:
    """Serve the identity provider; the passphrase of its keys comes from ZTPM_PASSPHRASE."""
    become("ztpm.point.provider_server", "--config", str(config or layout_of(directory).idp_config))
