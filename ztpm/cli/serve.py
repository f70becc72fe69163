"""`ztpm mcp serve|sign`, `ztpm rtde gateway|sim`: one process of a cell in the foreground."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from ztpm.cli.provider.person import CellDirectory, Json, layout_of

rtde = typer.Typer(no_args_is_help=True, help="The robot: its gateway, a simulated one, and programs under a lease.")


def become(module: str, *arguments: str) -> NoReturn:
    """Turns this process into `python -m module arguments`: one way to start it, with or without the command line."""
    sys.stdout.flush()
    _told_passphrase()
    os.execv(sys.executable, [sys.executable, "-m", module, *arguments])  # noqa: S606 - our own interpreter and our own modules


def _told_passphrase() -> None:
    """Puts the passphrase where every process looks, when the environment names a file that holds it."""
    if "ZTPM_PASSPHRASE_FILE" in os.environ and "ZTPM_PASSPHRASE" not in os.environ:
        from ztpm.cli.provider.passphrase import VARIABLE, ask_passphrase

        os.environ[VARIABLE] = ask_passphrase(new=False).decode()
        del os.environ["ZTPM_PASSPHRASE_FILE"]


def tools(
    *,
    config: Annotated[
        Path | None,
        typer.Option(help="Its configuration (default: of the cell in --data).", exists=True, dir_okay=False),
    ] = None,
    directory: CellDirectory = None,
) -> None:
    """Serve a cell's tools to agents: verify callers, and pass calls on to the robot's gateway.

    The passphrase of its key comes from ZTPM_PASSPHRASE.
    """
    file = config or layout_of(directory).cell_config
    become("ztpm.point.tool_proxy", "--config", str(file))


def sign(
    *,
    point: Annotated[str, typer.Option(help="Origin of the guarded tool server that is asked.", metavar="ORIGIN")],
    key: Annotated[Path, typer.Option(help="Key of the gateway, encrypted.", exists=True, dir_okay=False)],
    listen: Annotated[str, typer.Option(help="Address of this machine alone.", metavar="HOST:PORT")] = "",
) -> None:
    """Sign the evaluations that a gateway on this machine asks for (AuthZEN), and pass them on.

    The passphrase of its key comes from ZTPM_PASSPHRASE.
    """
    options = [f"--listen={listen}"] if listen else []
    become("ztpm.point.evaluation_signer", "--point", point, "--key", str(key), *options)


@rtde.command("gateway")
def gateway(
    *,
    config: Annotated[
        Path | None,
        typer.Option(help="Its configuration (default: of the cell in --data).", exists=True, dir_okay=False),
    ] = None,
    robot: Annotated[str, typer.Option(help="Address of the controller, in place of robot_host.")] = "",
    listen: Annotated[str, typer.Option(help="Address to listen on as the controller.")] = "",
    unsafe_observe: Annotated[
        bool,
        typer.Option("--unsafe-observe", help="Enforce no policy; refused unless the controller is simulated."),
    ] = False,
    directory: CellDirectory = None,
) -> None:
    """Stand before a robot's controller: state and stop for all, motion for the holder of its lease.

    The passphrase of its key comes from ZTPM_PASSPHRASE.
    """
    file = config or layout_of(directory).gateway_config
    options = [f"--{name}={value}" for name, value in (("robot", robot), ("listen", listen)) if value]
    options += ["--unsafe-observe"] if unsafe_observe else []
    become("ztpm.point.gateway_server", "--config", str(file), *options)


@rtde.command("sim")
def sim(
    *,
    host: Annotated[str, typer.Option(help="Loopback address to listen on.")] = "127.0.0.1",
    joints: Annotated[str, typer.Option(help="First configuration: six angles in rad, comma separated.")] = "",
    polyscope: Annotated[str, typer.Option(help="PolyScope version to be, 5.11 to 5.22.")] = "",
    robot: Annotated[str, typer.Option(help="Arm to be: ur3e, ur5e, ur10e or ur16e.")] = "ur3e",
    programs: Annotated[
        str, typer.Option(help="Folder of saved programs for the dashboard's `load`: NAME.urp, NAME.script beside it.")
    ] = "",
    tool: Annotated[str, typer.Option(help="Tool of the installation: its TCP and weight (default: none).")] = "",
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=VALUE][@SECONDS]",
            help="What goes wrong, at the start or so long after it; again for more. "
            "Among others: torn_frames, delay=0.02, slow_frames=16, drop_connections@5, stop@5, protective_stop@5, "
            "in_use=input_int_register_0, reduced_mode, local_control. A name that is none lists them all.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Run a simulated controller of a UR arm that real clients can talk to."""
    settings = (("robot", robot), ("joints", joints), ("polyscope", polyscope), ("programs", programs))
    options = [f"--{name}={value}" for name, value in settings if value]
    options += [f"--fault={each}" for each in fault or ()]
    if tool:
        options += _installed(robot, tool)
    become("ursim", "--host", host, *options, *([] if as_json else ["--words"]))


def _installed(robot: str, tool: str) -> tuple[str, str]:
    """Options of a controller with that tool in its installation, or the end of the command."""
    from pep.pit import ModelError
    from pep.pit.robot.model import Model
    from ztpm.cell.cell import installation
    from ztpm.cli.output import fail

    try:
        return installation(Model.shipped(robot), tool)
    except ModelError as error:
        fail("USAGE", error.detail)
