"""`ztpm init` and `ztpm version`."""

from __future__ import annotations

import importlib.metadata
import secrets
from pathlib import Path
from typing import Annotated

import typer

from ztpm.cli.output import fail, fail_at, say_json
from ztpm.cli.provider.passphrase import ask_passphrase
from ztpm.cli.provider.person import PLACE_VARIABLE, Json
from ztpm.cli.robot_setup import RobotWish, for_robot, make


def version(*, as_json: Json = False) -> None:
    """Print the version."""
    number = importlib.metadata.version("ztpm")
    if as_json:
        say_json({"version": number})
    else:
        typer.echo(f"ztpm {number}")


@for_robot
def init(
    *,
    where: Annotated[Path, typer.Option("--data", help="Directory to create.", envvar=PLACE_VARIABLE)] = Path(".ztpm"),
    host: Annotated[str, typer.Option(help="Address the cell listens on; plain HTTP is for loopback only.")] = "",
    policy: Annotated[str, typer.Option(help="Shipped policy set or a file.")] = "paper-default",
    second_sensor: Annotated[
        bool, typer.Option("--second-sensor", help="Two simulated sensors watch the cell, and both must be heard.")
    ] = False,
    wish: RobotWish,
    as_json: Json = False,
) -> None:
    """Make a new cell: keys, operators, trust bundle, configurations. Its passphrase: ZTPM_PASSPHRASE, or asked for.

    With --robot it is a cell for a controller that is there, which is asked for its arm, serial number, kinematics,
    tool, load and limits. Nothing is made when one of them is not as it was said. What is not said is asked for in a
    terminal. Its parts speak TLS unless they are on loopback, and it says what of the network is open.
    """
    from ztpm.base.layout import OPERATORS, Layout, LayoutError
    from ztpm.cell.setup import Addresses, SetupError, free_addresses, initialise

    if wish.robot:
        make(Layout(where.resolve()), wish, host=host, policy=policy, as_json=as_json)
        return
    passphrase = ask_passphrase(new=True)
    addresses = Addresses(host=host) if host else free_addresses(secrets.token_bytes(16))
    layout = Layout(where.resolve())
    try:
        initialise(
            layout,
            addresses,
            passphrase=passphrase,
            policy=policy,
            defer_timeout_s=60,
            second_sensor=second_sensor,
        )
    except LayoutError as error:
        fail("EXISTS", str(error))
    except SetupError as error:
        fail("CONFIG_INVALID", str(error))
    except OSError as error:
        fail_at(layout.root, error, "UNWRITABLE")
    made = {
        "data": str(layout.root),
        "issuer": addresses.issuer,
        "audience": addresses.audience,
        "operators": list(OPERATORS),
    }
    if as_json:
        say_json({"ok": True, **made})
    else:
        typer.echo(
            f"A new cell in {layout.root}: issuer {addresses.issuer}, tools {addresses.audience}, "
            f"operators {', '.join(OPERATORS)}."
        )
