"""`ztpm init --robot`: a cell for a controller that is there."""

from __future__ import annotations

import json
import secrets
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ztpm.cli.output import AS_JSON, console, fail, fail_at, plain, say_json
from ztpm.cli.provider.passphrase import ask_passphrase
from ztpm.cli.provider.person import grouped, known_name, open_key

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.pit import Calibration
    from pep.pit.robot.model import Model
    from pep.rtde.robot.controller_survey import ControllerSurvey
    from ztpm.base.layout import Layout
    from ztpm.cell.network_picture import Finding
    from ztpm.cell.robot_check import FittedRobot
    from ztpm.cell.robot_setup import RobotPlan
    from ztpm.cell.site import SiteAddresses

BOX: Final = 6
"""Numbers of a table or a workspace."""
USUAL_MODEL: Final = "ur3e"
"""Arm for which the stop of the model is known (PHY-2); of any other one it is stated (PHY-55)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotWish:
    """Options of `ztpm init` for a cell with its own controller; empty ones are asked for or left out."""

    robot: str
    model: str
    tool: str
    calibration: Path | None
    provider_host: str
    gateway_host: str
    face: str
    admin: list[str]
    author: str
    surveyor_key: Path | None
    name: str
    sensor: list[str]
    table: str
    workspace: str
    stop_deceleration: float
    tls_certificate: Path | None
    tls_key: Path | None
    bundle: Path | None


def _options(
    *,
    robot: Annotated[str, typer.Option(help="Address of a controller that is there: a cell for it.")] = "",
    model: Annotated[str, typer.Option(help="Its arm: ur3e, ur5e, ur10e, ur16e or a model file.")] = "",
    tool: Annotated[str, typer.Option(help="The mounted tool.")] = "robotiq_2f85",
    calibration: Annotated[
        Path | None, typer.Option(help="The arm's own kinematics, compared with the controller's.", dir_okay=False)
    ] = None,
    provider_host: Annotated[
        str, typer.Option(help="With --robot: host of the identity provider (default: --host).")
    ] = "",
    gateway_host: Annotated[str, typer.Option(help="With --robot: host of the gateway (default: --host).")] = "",
    face: Annotated[
        str, typer.Option(help="With --robot: address at which the gateway is the controller (default: its host).")
    ] = "",
    admin: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME[=PUBLIC]", help="With --robot: a first administrator; again for more."),
    ] = None,
    author: Annotated[str, typer.Option(help="Who signs the cell file (default: the first administrator).")] = "",
    surveyor_key: Annotated[
        Path | None, typer.Option(help="Key that signs it (default: made here).", exists=True, dir_okay=False)
    ] = None,
    name: Annotated[str, typer.Option(help="Name of the cell.")] = "cell",
    sensor: Annotated[
        list[str] | None, typer.Option(help="A sensor that must be heard; again for more (default: camera-1).")
    ] = None,
    table: Annotated[
        str, typer.Option(metavar="X,Y,Z,DX,DY,DZ", help="A table: centre and size, m in the base frame.")
    ] = "",
    workspace: Annotated[
        str, typer.Option(metavar="X,Y,Z,X,Y,Z", help="Lowest and highest corner of where the arm may be, m.")
    ] = "",
    stop_deceleration: Annotated[
        float, typer.Option(min=0.0, help="Joint deceleration of a stop with its load, rad/s2; the UR3e's is known.")
    ] = 0.0,
    tls_certificate: Annotated[
        Path | None, typer.Option(help="Certificate chain, PEM (default: an authority of the cell).", exists=True)
    ] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Its private key, PEM.", exists=True)] = None,
    bundle: Annotated[
        Path | None, typer.Option(help="Directory to create: a part for each machine, with its keys alone.")
    ] = None,
) -> RobotWish:
    return RobotWish(
        robot=robot, model=model, tool=tool, calibration=calibration, provider_host=provider_host,
        gateway_host=gateway_host, face=face, admin=admin or [], author=author, surveyor_key=surveyor_key, name=name,
        sensor=sensor or ["camera-1"], table=table, workspace=workspace, stop_deceleration=stop_deceleration,
        tls_certificate=tls_certificate, tls_key=tls_key, bundle=bundle,
    )  # fmt: skip


def for_robot(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options of a `RobotWish` in place of its parameter `wish`."""
    return grouped(command, "wish", _options)


def make(layout: Layout, wish: RobotWish, *, host: str, policy: str, as_json: bool) -> None:
    """Makes the cell, looks at network and machine, and tells what to type next; or ends the command.

    Args:
        layout: an empty or missing directory.
        wish: options.
        host: of the tool server; empty: this machine alone, or asked for.
        policy: shipped policy set, or a file.
        as_json: form of what is told.
    """
    _check(layout, wish)
    told = _survey(wish.robot)
    stated = None if not wish.model else _model(wish.model)
    fitted = _fitted(wish, told, stated)
    host, admins, stop, table, workspace = _asked(wish, host, fitted)
    addresses = _addresses(wish, host)
    plan = _plan(wish, addresses, admins, table, workspace, stop=stop, policy=policy, model=fitted.model.name)
    passphrase = ask_passphrase(new=True)
    parts = _made(layout, plan, fitted, told, passphrase=passphrase, out=wish.bundle)
    _tell(layout, plan, fitted, told, parts, as_json=as_json)


def _check(layout: Layout, wish: RobotWish) -> None:
    """Refuses what cannot be, before a person is asked."""
    if bool(wish.tls_certificate) != bool(wish.tls_key):
        fail("USAGE", "give --tls-certificate and --tls-key together")
    for root in (layout.root, *(() if wish.bundle is None else (wish.bundle,))):
        if root.exists() and any(root.iterdir()):
            fail("EXISTS", f"{root} is not empty")
    for name in (*wish.sensor, *([wish.author] if wish.author else [])):
        known_name(name)


def _survey(robot: str) -> ControllerSurvey:
    from pep.base.errors import RobotError
    from pep.rtde.robot.controller_survey import survey_controller

    try:
        return survey_controller(robot)
    except RobotError as error:
        fail(str(error.code), error.detail)


def _model(stated: str) -> Model:
    from pep.base.errors import ConfigError
    from ztpm.point.cell_config import read_model

    try:
        return read_model(stated)
    except ConfigError as error:
        fail("CONFIG_INVALID", f"--model: {error.detail}")


def _fitted(wish: RobotWish, told: ControllerSurvey, stated: Model | None) -> FittedRobot:
    from ztpm.cell.robot_check import RobotDiffersError, fitted_robot, named_model

    own = None if wish.calibration is None else _calibration(wish.calibration)
    try:
        return fitted_robot(told, named_model(told, stated), tool=wish.tool, own=own)
    except RobotDiffersError as error:
        fail("ROBOT_DIFFERS", f"{wish.robot}: {plain(str(error))}")


def _calibration(path: Path) -> Calibration:
    from pep.pit import Calibration, ModelError

    try:
        return Calibration.from_yaml(path.read_text("utf-8"))
    except ModelError as error:
        fail("UNREADABLE", f"{path}: {error.detail}")
    except (OSError, UnicodeDecodeError) as error:
        fail_at(path, error, "UNREADABLE")


def _asked(wish: RobotWish, host: str, fitted: FittedRobot) -> tuple[str, list[str], float, str, str]:
    """Answers to what no option says: in a terminal a question each, elsewhere one refusal that names them all."""
    from pep.base.stop_model import STOP_DECELERATION_RAD_S2

    usual = fitted.model.name == USUAL_MODEL
    admins, stop = wish.admin, wish.stop_deceleration or (STOP_DECELERATION_RAD_S2 if usual else 0.0)
    if AS_JSON.get() or not sys.stdin.isatty():
        missing = [name for name, given in (("--admin", admins), ("--stop-deceleration", stop)) if not given]
        if missing:
            fail("USAGE", f"give {' and '.join(missing)}")
        return host, admins, stop, wish.table, wish.workspace
    ask = partial(typer.prompt, err=True, default="", show_default=False)
    host = host or ask("Address of this machine on the cell's network (empty: this machine alone)")
    admins = (
        admins
        or str(ask("First administrators, at least two")).replace(",", " ").split()
        or fail("NO_PEOPLE", "--admin")
    )
    stop = stop or float(typer.prompt("Joint deceleration of a stop with its load, rad/s2", type=float, err=True))
    table = wish.table or ask("Table: centre and size, m in the base frame: x,y,z,dx,dy,dz (empty: none)")
    workspace = wish.workspace or ask("Workspace: lowest and highest corner, m: x,y,z,x,y,z (empty: none)")
    return str(host), admins, stop, str(table), str(workspace)


def _addresses(wish: RobotWish, host: str) -> SiteAddresses:
    from pep.point.config_text import is_loopback
    from ztpm.cell.site import SiteAddresses, free_loopback

    if not host:
        if wish.bundle is not None or wish.gateway_host or wish.provider_host:
            fail("USAGE", "give --host: the address of the tool server as other machines reach it")
        return free_loopback(wish.robot, secrets.token_bytes(16))
    gateway = wish.gateway_host or host
    hosts = (wish.provider_host or host, gateway, host, wish.face or gateway)
    if wish.robot in hosts:
        fail("USAGE", f"{wish.robot} is the controller's own address")
    return SiteAddresses(
        host=host, controller=wish.robot, provider=hosts[0], gateway=gateway, face=hosts[3],
        tls=not all(map(is_loopback, hosts[:3])),
    )  # fmt: skip


def _plan(
    wish: RobotWish, addresses: SiteAddresses, admins: list[str], table: str, workspace: str, *, stop: float,
    policy: str, model: str,
) -> RobotPlan:  # fmt: skip
    from ztpm.cell.first_draft import CellWish
    from ztpm.cell.robot_setup import RobotPlan
    from ztpm.cli.provider.idp import people_of

    people = people_of(admins)
    author = wish.author or next(iter(people))
    key = None if wish.surveyor_key is None else open_key(wish.surveyor_key)
    if key is None and people.get(author, b"") is not None:
        fail("USAGE", f"give --surveyor-key: the key of {author}, who signs the cell file, is not made here")
    cell = CellWish(
        name=wish.name, author=author, tool=wish.tool, sensors=tuple(wish.sensor), table=_box("--table", table),
        workspace=_box("--workspace", workspace),
    )  # fmt: skip
    return RobotPlan(
        addresses=addresses, wish=cell, people=people, surveyor_key=key, stop_deceleration_rad_s2=stop,
        robot=str(Path(wish.model).resolve()) if wish.model.endswith(".toml") else model,
        certificate=wish.tls_certificate, certificate_key=wish.tls_key,
        policy=str(Path(policy).resolve()) if Path(policy).is_file() else policy,
    )  # fmt: skip


def _box(option: str, text: str) -> tuple[float, ...] | None:
    if not text:
        return None
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != BOX or not all(abs(each) <= 100 for each in numbers):
        fail("USAGE", f"{option}: six numbers in metres, separated by commas")
    return numbers


def _made(
    layout: Layout,
    plan: RobotPlan,
    fitted: FittedRobot,
    told: ControllerSurvey,
    *,
    passphrase: bytes,
    out: Path | None,
) -> dict[str, Path]:
    """Makes every file; the machines' parts where they were asked for."""
    from pep.pit.files.plain_file import FileError
    from ztpm.base.layout import LayoutError
    from ztpm.cell.robot_setup import initialise_robot
    from ztpm.cell.setup import SetupError
    from ztpm_idp.keys.key_files import SettingsError
    from ztpm_idp.provider.problems import Problem
    from ztpm_idp.store import StoreUnavailableError

    try:
        parts = None if out is None else out.resolve()
        return initialise_robot(layout, plan, fitted, told, passphrase=passphrase, at=time.time(), out=parts)
    except LayoutError as error:
        fail("EXISTS", str(error))
    except SetupError as error:
        fail("CONFIG_INVALID", str(error))
    except SettingsError as error:
        fail("CONFIG_INVALID", f"{error.setting}: {error.why}")
    except FileError as error:
        fail(error.reason, error.detail)
    except Problem as error:
        fail(error.code.value, error.detail)
    except StoreUnavailableError:
        fail("CONFIG_INVALID", "database_url: the store cannot be made")
    except OSError as error:
        fail_at(layout.root, error, "UNWRITABLE")


def _tell(
    layout: Layout,
    plan: RobotPlan,
    fitted: FittedRobot,
    told: ControllerSurvey,
    parts: dict[str, Path],
    *,
    as_json: bool,
) -> None:
    from ztpm.cell.network_picture import judge, look
    from ztpm.cli.doctor import CHECKS, arm_check, examined

    config = Path(parts["gateway"]) / "gateway/gateway.toml" if parts else layout.gateway_config
    findings = judge(look(plan.addresses.controller, plan.addresses.face))
    checks = examined([*CHECKS, ("arm", partial(arm_check, config))])
    then = _next(layout, plan, parts)
    if as_json:
        robot = {"host": plan.addresses.controller, **json.loads(layout.controller.read_bytes())}
        say_json({
            "ok": True, "data": str(layout.root), "issuer": plan.addresses.issuer, "audience": plan.addresses.audience,
            "robot": robot, "network": [{"check": f.name, "ok": f.ok, "detail": f.detail} for f in findings],
            "checks": checks, "bundles": {name: str(path) for name, path in parts.items()}, "next": then,
        })  # fmt: skip
        return
    typer.echo(
        f"A {fitted.model.name} at {plan.addresses.controller}: serial number {plain(told.serial)}, "
        f"{plain(told.polyscope)}, {'its own' if fitted.calibration else 'nominal'} kinematics, tool {plan.wish.tool}."
    )
    for sentence in fitted.told:
        typer.echo(f"  {plain(sentence)}")
    typer.echo(f"Its cell in {layout.root}: issuer {plan.addresses.issuer}, tools {plan.addresses.audience}, "
               f"the gateway as a controller at {plan.addresses.face}.")  # fmt: skip
    _show(findings, checks)
    typer.echo("Next:")
    for command in then:
        typer.echo(f"  {command}")


def _show(findings: tuple[Finding, ...], checks: list[dict[str, object]]) -> None:
    rows = [(f.name, f.ok, f.detail) for f in findings] + [(c["check"], c["ok"], c["detail"]) for c in checks]
    for name, ok, detail in rows:
        console.print(f"{'[green]ok  [/]' if ok else '[bold red]OPEN[/]'} {name}: {detail}")


def _next(layout: Layout, plan: RobotPlan, parts: dict[str, Path]) -> list[str]:
    """Commands that a person types next."""
    who = f"--data {layout.root} --as {next(iter(plan.people))}"
    sensors = [f"ztpm enrol sensor {name} --calibration FILE {who}" for name in plan.wish.sensors]
    if not parts:
        return [f"ztpm up --data {layout.root}", *sensors]
    units = {"provider": "ztpm-idp", "gateway": "ztpm-gateway", "tools": "ztpm-tools"}
    brought = [
        f"bring {path} to {plan.addresses.hosts[machine]} as /var/lib/ztpm/{machine}, with its unit {units[machine]}"
        for machine, path in parts.items()
    ]
    return [
        *brought,
        "systemctl enable --now ztpm-idp",
        f"ztpm enrol gateway gateway-1 {who}",
        f"ztpm enrol tools cell-1 {who}",
        *sensors,
        "systemctl enable --now ztpm-gateway",
        "systemctl enable --now ztpm-tools",
    ]
