"""`ztpm doctor`: is this machine able to run a cell, or this directory an identity provider?"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import secrets
import sys
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ztpm.cli.output import FAILURE, console, say_json
from ztpm.cli.provider.person import Json

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

NEEDED: Final = (
    "biscuit-python",
    "cryptography",
    "pyjwt",
    "pydantic",
    "fastapi",
    "mcp",
    "starlette",
    "uvicorn",
    "ur-rtde",
    "pin",
    "coal",
    "sqlalchemy",
)

TETHER_S: Final = 30.0


ConfigFile = Annotated[
    Path | None, typer.Option("--config", help="Also check a gateway's configuration.", exists=True, dir_okay=False)
]


IdpPlace = Annotated[
    Path | None,
    typer.Option("--idp", help="Check an identity provider instead: its directory, or its idp.toml.", exists=True),
]


def doctor(*, config: ConfigFile = None, idp: IdpPlace = None, as_json: Json = False) -> None:
    """Check interpreter, libraries, loopback ports, the physics engines, and the cost of a durable record.

    With the configuration of a gateway also that it would be taken, and how well it knows its arm. Of an identity
    provider: configuration, keys, rights to files, trust bundle, database, certificate, the issuer's answer, webhooks,
    the clock.
    """
    if idp is not None:
        from ztpm.cli.provider.doctor import ProviderDoctor, config_at
        from ztpm.cli.provider.passphrase import ask_passphrase

        looked = ProviderDoctor(config_at(idp), ask_passphrase(new=False).decode())
        checks = [("interpreter", _interpreter), *looked.checks, ("durable record", _durable)]
    else:
        checks = list(CHECKS)
    if config is not None:
        checks.append(("arm", partial(arm_check, config)))
    rows = examined(checks)
    sound = all(row["ok"] for row in rows)
    if as_json:
        say_json({"ok": sound, "checks": rows})
    else:
        for row in rows:
            console.print(f"{'[green]ok  [/]' if row['ok'] else '[bold red]FAIL[/]'} {row['check']}: {row['detail']}")
    raise typer.Exit(0 if sound else FAILURE)


def examined(checks: Iterable[tuple[str, Callable[[], tuple[bool, str]]]]) -> list[dict[str, object]]:
    """Outcome of each check, as it is told."""
    rows: list[dict[str, object]] = []
    for name, probe in checks:
        try:
            ok, detail = probe()
        except Exception as error:  # noqa: BLE001 - a doctor reports every fault
            ok, detail = False, f"{type(error).__name__}: {error}"
        rows.append({"check": name, "ok": ok, "detail": detail})
    return rows


def _interpreter() -> tuple[bool, str]:
    return sys.version_info >= (
        3,
        11,
    ) and sys.platform == "linux", f"Python {platform.python_version()} on {platform.system()}"


def _libraries() -> tuple[bool, str]:
    found = {}
    for name in NEEDED:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "MISSING"
    return "MISSING" not in found.values(), ", ".join(f"{name} {number}" for name, number in found.items())


def _loopback() -> tuple[bool, str]:
    from ztpm.cell.setup import free_addresses

    addresses = free_addresses(secrets.token_bytes(16))
    return True, f"all ports of a cell are free on {addresses.host}"


def _physics() -> tuple[bool, str]:
    from pep.pit import Assessment, CellParameters, MoveJ, Robot, assess
    from ztpm.preparing import prepare_physics
    from ztpm.stage.stage import ACCELERATION_RAD_S2, LEFT, RIGHT, SPEED_RAD_S

    prepare_physics()
    robot, cell = Robot.load("ur3e"), CellParameters()
    started = time.perf_counter()
    motion = MoveJ(LEFT, RIGHT, SPEED_RAD_S, ACCELERATION_RAD_S2)
    result = assess(robot, cell.surveyed, motion, cell, perception_age_s=0.0, touch=frozenset(), seed=b"doctor")
    spent_ms = (time.perf_counter() - started) * 1e3
    if not isinstance(result, Assessment):
        return False, f"{result.reason} {result.detail}"
    return (
        result.tier == 1,
        f"the paper's sweep in an empty cell is tier {int(result.tier)}; engines agree; {spent_ms:.0f} ms",
    )


def arm_check(config: Path) -> tuple[bool, str]:
    """Checks that a gateway takes the configuration, and the arm's calibration where it names one."""
    from pep.base.errors import ConfigError
    from pep.pit.robot.calibration import own_kinematics
    from ztpm.point.cell_config import read_cell, read_robot
    from ztpm.point.gateway_config import read_gateway_config
    from ztpm.status.page import kinematics_said

    try:
        found = read_gateway_config(config)
        robot = read_robot(found, tool=read_cell(found, at=time.time()).tool)
    except ConfigError as error:
        return False, str(error)
    own, known_mm = own_kinematics(robot.model), found.cell.robot_uncertainty_m * 1e3
    said = kinematics_said(own, known_mm)
    return True, said if own is not None else f"{said}; with a `calibration_file` it would be less"


def _durable() -> tuple[bool, str]:
    import tempfile

    with tempfile.TemporaryFile() as file:
        spent = []
        for _ in range(20):
            started = time.perf_counter()
            file.write(b"x" * 512)
            file.flush()
            os.fsync(file.fileno())
            spent.append((time.perf_counter() - started) * 1e3)
    median = sorted(spent)[len(spent) // 2]
    return True, f"a synced record costs {median:.2f} ms (median of {len(spent)})"


def _tether() -> tuple[bool, str]:
    """Checks that children of `ztpm up` end with it, and that its page can tell its visitors' users."""
    import socket
    import subprocess

    from ztpm.base.peer import owner_of

    command = [sys.executable, "-m", "ztpm.base.parent_watch", str(os.getpid()), "ztpm"]
    tried = subprocess.run(command, capture_output=True, text=True, timeout=TETHER_S, check=False)  # noqa: S603 - our own
    tethered = (
        "ztpm.base.parent_watch:" not in tried.stderr
    )  # the package is no program: only the tether itself may not refuse
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as client:
        owned = owner_of(server.getsockname(), client.getsockname()) == os.getuid()
    return tethered and owned, (
        f"children {'end with their parent' if tethered else 'OUTLIVE their parent'}; "
        f"the owner of a loopback connection is {'known' if owned else 'NOT KNOWN'}"
    )


def _lock() -> tuple[bool, str]:
    """Checks that the current directory's file system frees the lock of a holder that is gone."""
    import tempfile
    from pathlib import Path

    from ztpm.base.lock import DirectoryLock, LockedError

    with tempfile.TemporaryDirectory(dir=Path.cwd()) as directory:
        path = Path(directory) / "lock"
        with DirectoryLock.take(path):
            try:
                DirectoryLock.take(path)
            except LockedError:
                return True, "one process at a time can hold a directory here"
    return False, "two processes can hold one directory here"


CHECKS: Final[tuple[tuple[str, Callable[[], tuple[bool, str]]], ...]] = (
    ("interpreter", _interpreter),
    ("libraries", _libraries),
    ("loopback", _loopback),
    ("physics", _physics),
    ("durable record", _durable),
    ("children", _tether),
    ("lock", _lock),
)
