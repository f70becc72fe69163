"""Making of a cell for a controller that is there: body of `ztpm init --robot`.

Every path in its configurations is relative, so that the directory, or a machine's part of it, may lie anywhere.
"""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.statements import cell as cell_statement
from pep.base.errors import ConfigError
from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from pep.pit.robot.controller_kinematics import calibration_text
from ztpm.base.layout import Layout, new_key, read_key, write_private
from ztpm.cell import survey
from ztpm.cell.authority import machine_certificate, new_authority
from ztpm.cell.first_draft import cell_draft, first_scope
from ztpm.cell.provider_setup import ProviderPlan, fill_provider, toml, whole_or_nothing
from ztpm.cell.service_files import Placed, own_program, service_files
from ztpm.cell.setup import GATEWAY_ID, PEP_ID, SetupError
from ztpm.cell.site import MACHINES, SiteAddresses
from ztpm.point.cell_config import ROBOT_MODEL, read_cell
from ztpm.point.gateway_config import read_gateway_config
from ztpm.point.tool_proxy_config import read_door_config

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.keys.keys import PrivateKey
    from pep.rtde.robot.controller_survey import ControllerSurvey
    from ztpm.cell.first_draft import CellWish
    from ztpm.cell.robot_check import FittedRobot

PARTS: Final = {GATEWAY_ID: "gateway", PEP_ID: "tools"}
"""Enforcement points of a new cell, and the machine of each."""
DEFER_S: Final = 60
"""Time for which a question waits for a person; ours, as in the embedded cell."""
WHOLE: Final = {
    "provider": ("idp",),
    "gateway": ("gateway", "cell/cell.jws"),
    "tools": ("cell/cell.toml", "cell/pep.key", "cell/state"),
}
"""Parts of the directory by machine, besides what all have and its certificate."""
STAYS: Final = ("gateway/gateway.toml", "gateway/calibration.yaml", "cell/cell.jws", "cell/cell.toml")
"""Parts that stay with the administrators, too: no key is in them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotPlan:
    """Cell that is to be made.

    Attributes:
        addresses: of its parts and of the controller.
        wish: what is put into the draft of its cell file.
        people: first administrators by id, each with a raw public key of its own, or None: its key is made here.
        surveyor_key: signs the cell file; None: the author's key, which is made here.
        stop_deceleration_rad_s2: how hard every joint stops with its load.
        robot: as the gateway's configuration names it: a shipped model, or the path of a model file.
        certificate, certificate_key: PEM files for all machines; None: the cell has an authority of its own.
        policy: name of a shipped policy set, or a path.
    """

    addresses: SiteAddresses
    wish: CellWish
    people: Mapping[str, bytes | None] = field(repr=False)
    surveyor_key: PrivateKey | None = field(default=None, repr=False)
    stop_deceleration_rad_s2: float = STOP_DECELERATION_RAD_S2
    robot: str = ROBOT_MODEL
    certificate: Path | None = None
    certificate_key: Path | None = None
    policy: str = "paper-default"

    @property
    def own_authority(self) -> bool:
        """True where certificates are made here."""
        return self.addresses.tls and self.certificate is None


class _RelativePlan(ProviderPlan):
    """Provider of the cell, whose files lie beside its configuration or one folder above."""

    def settings(self, layout: Layout) -> dict[str, str | int | list[str]]:
        """See `ProviderPlan.settings`."""
        stated = ProviderPlan.settings(self, layout)
        own: dict[str, str | int | list[str]] = {
            "key_ring_file": layout.key_ring.name,
            "database_url": f"sqlite+aiosqlite:///{layout.database.name}",
        }
        keys_of_oauth = [Path(each).name for each in stated["oauth_key_files"]]  # type: ignore[union-attr]
        tls: dict[str, str | int | list[str]] = {
            name: f"../tls/{Path(str(stated[name])).name}" for name in _TLS if name in stated
        }
        return {**stated, **own, **tls, "oauth_key_files": keys_of_oauth}


_TLS: Final = ("tls_certificate_file", "tls_key_file")


def initialise_robot(
    layout: Layout,
    plan: RobotPlan,
    fitted: FittedRobot,
    told: ControllerSurvey,
    *,
    passphrase: bytes,
    at: float,
    out: Path | None = None,
) -> dict[str, Path]:
    """Makes every file of a new cell with a controller, or no file.

    Args:
        layout: an empty or missing directory.
        plan: of the cell.
        fitted: arm of the controller.
        told: the controller's word on itself, which is kept.
        passphrase: encrypts every private key but those of certificates.
        at: seconds since the epoch.
        out: an empty or missing directory for the parts of separate machines; None: one machine is all.

    Returns:
        The directory of each machine, where they are separate.

    Raises:
        ztpm.base.layout.LayoutError: when a directory has anything in it.
        SetupError: naming a setting with which a process would not start.
        pep.pit.files.plain_file.FileError: a table or workspace that cannot be.
        ztpm_idp.keys.key_files.SettingsError: a setting of the provider.
        ztpm_idp.provider.problems.Problem: people that are refused.
        OSError: when the directory cannot be written.
    """
    with whole_or_nothing(layout):
        _certificates(layout, plan, passphrase, at=at)
        provider = _RelativePlan(
            issuer=plan.addresses.issuer,
            people=plan.people,
            host=plan.addresses.provider,
            port=plan.addresses.idp_port,
            certificate=layout.certificate("provider") if plan.addresses.tls else None,
            key=layout.certificate_key("provider") if plan.addresses.tls else None,
            policy=plan.policy,
        )
        fill_provider(layout, provider, passphrase=passphrase, at=int(at))
        parts = {
            GATEWAY_ID: new_key(layout.gateway_key, passphrase),
            PEP_ID: new_key(layout.pep_key, passphrase),
        }
        for state in (layout.state, layout.gateway_state):
            state.mkdir(mode=0o700, parents=True, exist_ok=True)
        signer = _cell_file(layout, plan, fitted, passphrase, at=at)
        _configurations(layout, plan, fitted, signer)
        public = {name: keys.b64u(keys.public_raw(key)) for name, key in parts.items()}
        write_private(layout.controller, _record(plan, fitted, told, public))
        write_private(layout.first_scope, first_scope(plan.addresses.audience))
        _services(layout, MACHINES, Placed(str(layout.root), own_program(sys.executable), plan.own_authority))
        _check(layout, at=at)
        return {} if out is None else _bundle(layout, out)


def _certificates(layout: Layout, plan: RobotPlan, passphrase: bytes, *, at: float) -> None:
    """Certificate and key of each machine, where the cell is reached from others."""
    if not plan.addresses.tls:
        return
    if plan.certificate is not None and plan.certificate_key is not None:
        for machine in MACHINES:
            write_private(layout.certificate(machine), plan.certificate.read_bytes())
            write_private(layout.certificate_key(machine), plan.certificate_key.read_bytes())
        return
    authority = new_authority(plan.wish.name, passphrase, at=at)
    write_private(layout.authority, authority.certificate)
    write_private(layout.authority_key, authority.key)
    for machine, host in plan.addresses.hosts.items():
        issued = machine_certificate(authority, passphrase, [host], at=at)
        write_private(layout.certificate(machine), issued.certificate)
        write_private(layout.certificate_key(machine), issued.key)


def _cell_file(layout: Layout, plan: RobotPlan, fitted: FittedRobot, passphrase: bytes, *, at: float) -> bytes:
    """Draft and signed cell file; the signer's raw public key."""
    text = cell_draft(plan.wish, audience=plan.addresses.audience)
    stated = survey.draft(text, at=int(at), days=survey.DAYS)
    signer = plan.surveyor_key
    if signer is None:
        signer = read_key(layout.operator_key(plan.wish.author), passphrase)
    write_private(layout.cell_draft, text.encode())
    write_private(layout.cell_file, cell_statement.sign(stated, signer).encode() + b"\n")
    if fitted.calibration is not None:
        write_private(layout.calibration, calibration_text(fitted.calibration).encode())
    return keys.public_raw(signer)


def _configurations(layout: Layout, plan: RobotPlan, fitted: FittedRobot, signer: bytes) -> None:
    """Configurations of tool server and gateway."""
    at = plan.addresses
    common: dict[str, str | int | list[str]] = {
        "audience": at.audience, "issuer": at.issuer, "trust_file": "../trust.json", "journal_file": "journal.ndjson",
        "state_dir": "state", "policy": plan.policy,
    }  # fmt: skip
    own_tls: dict[str, dict[str, str | int | list[str]]] = {
        machine: {"tls_certificate_file": f"../tls/{machine}.pem", "tls_key_file": f"../tls/{machine}.key"}
        for machine in (MACHINES if at.tls else ())
    }
    tools: dict[str, str | int | list[str]] = {
        "host": at.host, "port": at.tools_port, "pep_id": PEP_ID, "pep_key_file": "pep.key", "gateway_url": at.calls,
    }  # fmt: skip
    gateway: dict[str, str | int | list[str]] = {
        "host": at.gateway, "port": at.door_port, "pep_id": GATEWAY_ID, "pep_key_file": "gateway.key",
        "robot_host": at.controller, "perception_port": at.perception_port, "defer_timeout_s": DEFER_S,
        "cell_file": "../cell/cell.jws", "cell_signer_key": keys.b64u(signer), "url": at.door, "calls_url": at.calls,
        "listen_host": at.face, "carriage_port": at.carriage_port, "robot": plan.robot,
        **({} if fitted.calibration is None else {"calibration_file": "calibration.yaml"}),
    }  # fmt: skip
    stop = f"\n[cell]\nstop_deceleration_rad_s2 = {plan.stop_deceleration_rad_s2!r}\n".encode()
    write_private(layout.cell_config, toml({**common, **tools, **own_tls.get("tools", {})}))
    write_private(layout.gateway_config, toml({**common, **gateway, **own_tls.get("gateway", {})}) + stop)


def _record(plan: RobotPlan, fitted: FittedRobot, told: ControllerSurvey, parts: Mapping[str, str]) -> bytes:
    """The controller's word on itself, and the enforcement points of the cell."""
    return (
        json.dumps(
            {
                "host": plan.addresses.controller,
                "model": told.model,
                "robot": fitted.model.name,
                "serial": told.serial,
                "polyscope": told.polyscope,
                "calibration": None if fitted.calibration is None else fitted.calibration.signature,
                "told": list(fitted.told),
                "parts": {name: {"machine": PARTS[name], "public": public} for name, public in parts.items()},
            },
            indent=2,
        ).encode()
        + b"\n"
    )


def _services(layout: Layout, machines: tuple[str, ...], placed: Placed) -> None:
    for name, text in service_files(machines, placed).items():
        write_private(layout.services / name, text.encode())


def _check(layout: Layout, *, at: float) -> None:
    """Reads each configuration by the reader that its process starts with.

    Raises:
        SetupError: naming what is refused.
    """
    from ztpm.point.cell_config import read_policies, read_trust

    try:
        door, gateway = read_door_config(layout.cell_config), read_gateway_config(layout.gateway_config)
        read_policies(door)
        read_trust(gateway)
        read_cell(gateway, at=at)
    except ConfigError as error:
        raise SetupError(error.detail) from error


def _bundle(layout: Layout, out: Path) -> dict[str, Path]:
    """Parts of a new cell's directory, each for one machine with only the keys that belong there.

    What stays has the people's keys, that of the authority, and copies of configurations; nothing that serves.

    Args:
        layout: just made.
        out: an empty or missing directory.

    Returns:
        The directory of each machine.

    Raises:
        ztpm.base.layout.LayoutError: when `out` has anything in it.
        OSError: when it cannot be written.
    """
    with whole_or_nothing(Layout(out)):
        for machine in MACHINES:
            part = Layout(out / machine)
            part.root.mkdir(mode=0o700)
            certificates = (layout.certificate(machine), layout.certificate_key(machine))
            for path in (
                layout.trust,
                layout.authority,
                *certificates,
                *(layout.root / name for name in WHOLE[machine]),
            ):
                if path.exists():
                    _copied(path, part.root / path.relative_to(layout.root))
            placed = Placed(f"/var/lib/ztpm/{machine}", authority=layout.authority.exists())
            _services(part, (machine,), placed)
    kept = {layout.root / name for name in STAYS}
    for machine in MACHINES:
        for each in (layout.certificate(machine), layout.certificate_key(machine)):
            each.unlink(missing_ok=True)
        for path in (layout.root / name for name in WHOLE[machine]):
            _removed(path, kept)
    shutil.rmtree(layout.services)
    return {machine: out / machine for machine in MACHINES}


def _copied(path: Path, target: Path) -> None:
    target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    if path.is_dir():
        shutil.copytree(path, target)
    else:
        shutil.copy2(path, target)


def _removed(path: Path, kept: set[Path]) -> None:
    """Removes a file, or a folder but for what is kept in it."""
    if path.is_dir() and any(each.is_relative_to(path) for each in kept):
        for each in list(path.iterdir()):
            _removed(each, kept)
    elif path.is_dir():
        shutil.rmtree(path)
    elif path not in kept:
        path.unlink(missing_ok=True)
