"""`ztpm idp serve` and `ztpm rtde sim`: one process of a cell in the foreground."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from ztpm.cli.person import Json

idp = typer.Typer(no_args_is_help=True, help="The identity provider.")
rtde = typer.Typer(no_args_is_help=True, help="The robot's interface.")


@idp.callback()
def identity_provider() -> None:
    """The identity provider."""


@rtde.callback()
def robot() -> None:
    """The robot's interface."""


def _become(module: str, *arguments: str) -> NoReturn:
    """This process becomes `python -m module arguments`: one way to start a thing, with or without the command line."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", module, *arguments])  # noqa: S606 - our own interpreter and our own modules


@idp.command("serve")
def serve(config: Annotated[Path, typer.Option("--config", exists=True, dir_okay=False)]) -> None:
    """Serve; the passphrase of its keys comes from ZTPM_PASSPHRASE."""
    _become("ztpm_idp", "--config", str(config))


@rtde.command("sim")
def sim(
    *,
    host: Annotated[str, typer.Option(help="Loopback address to listen on.")] = "127.0.0.1",
    joints: Annotated[str, typer.Option(help="First configuration: six angles in rad, comma separated.")] = "",
    polyscope: Annotated[str, typer.Option(help="PolyScope version to be, 5.11 to 5.22.")] = "",
    as_json: Json = False,
) -> None:
    """Run a simulated UR3e controller that real clients can talk to."""
    options = [f"--{name}={value}" for name, value in (("joints", joints), ("polyscope", polyscope)) if value]
    _become("pep.sim", "--host", host, *options, *([] if as_json else ["--words"]))
