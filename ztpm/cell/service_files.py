"""Files that keep a cell's processes running: a unit of systemd for each, and a compose file for all.

`deploy/systemd` and `deploy/compose/cell.yaml` are made of the same (`python -m docs.generate`).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

from ztpm.cell.site import MACHINES

if TYPE_CHECKING:
    from collections.abc import Iterable

PROGRAM: Final = "/opt/ztpm/bin/ztpm"
STATE: Final = PurePosixPath("/var/lib/ztpm")
HOMES: Final = ("/home", "/root", "/run/user")
"""Places that `ProtectHome` hides."""
IMAGE: Final = "ztpm-cell"
USER: Final = 10_001
"""User and group inside the image, as the Containerfile makes them."""


@dataclass(frozen=True, slots=True)
class Service:
    """One process of a cell, as a machine keeps it running.

    Attributes:
        unit: name of its unit.
        title: for people.
        words: the command, without the program and the configuration.
        config: its configuration, in the directory of the cell.
        after: units that are started before it, where they are on the same machine.
        stops_s: longest time for its end; the gateway waits for an arm that stands still.
        moves: it carries commands to an arm: real-time scheduling, and compiled physics.
        lines: further lines of `[Service]`.
        begun: command that makes it alone; empty: it comes of a cell's setup.
    """

    unit: str
    title: str
    words: str
    config: str
    after: tuple[str, ...]
    stops_s: int
    moves: bool = False
    lines: tuple[str, ...] = ()
    begun: str = ""


SERVICES: Final = dict(
    zip(
        MACHINES,
        (
            Service(
                "ztpm-idp",
                "ZTPM identity provider",
                "idp serve",
                "idp/idp.toml",
                (),
                15,
                lines=(
                    "# Figures for a Prometheus elsewhere (docs/operation.md), by a token of at least 32 characters:",
                    "#LoadCredential=metrics-token:/etc/ztpm/metrics-token",
                    "#Environment=ZTPM_METRICS_TOKEN_FILE=%d/metrics-token",
                ),
                begun="idp init --data {} --issuer ... --admin ...",
            ),
            Service(
                "ztpm-gateway",
                "ZTPM gateway of a robot",
                "rtde gateway",
                "gateway/gateway.toml",
                ("ztpm-idp.service",),
                60,
                moves=True,
            ),
            Service(
                "ztpm-tools",
                "ZTPM tool server of a cell",
                "mcp serve",
                "cell/cell.toml",
                ("ztpm-idp.service", "ztpm-gateway.service"),
                15,
            ),
        ),
        strict=True,
    )
)
"""Services by machine."""


@dataclass(frozen=True, slots=True)
class Placed:
    """Place of a cell's files on one machine.

    Attributes:
        directory: of the cell, or of the machine's bundle.
        program: the `ztpm` that is run.
        authority: the cell has an authority of its own, whose certificate lies in the directory.
    """

    directory: str
    program: str = PROGRAM
    authority: bool = True


def unit(service: Service, placed: Placed) -> str:
    """Text of the unit.

    Args:
        service: that is run.
        placed: on the machine.
    """
    here = PurePosixPath(placed.directory)
    own = here.is_relative_to(STATE)
    hidden = any(PurePosixPath(each).is_relative_to(home) for each in (here, placed.program) for home in HOMES)
    config = _word(str(here / service.config))
    return "\n".join(
        [
            f"# The {service.title}. Before the first start, as root (docs/deployment.md):",
            f"#   useradd --system --home-dir {STATE} --shell /usr/sbin/nologin ztpm",
            *(
                [
                    f"#   install -d -m 0700 -o ztpm -g ztpm {STATE}",
                    f"#   what `ztpm init --robot` made for this machine as {here}, owned by ztpm",
                ]
                if own
                else [f"#   chown -R ztpm: {here}"]
            ),
            "#   install -d -m 0700 /etc/ztpm, and the passphrase alone in /etc/ztpm/passphrase, mode 0600",
            *(
                [
                    "#   or, of a company (docs/provider.md): runuser -u ztpm -- env ZTPM_PASSPHRASE=... \\",
                    f"#     {placed.program} {service.begun.format(here)}",
                ]
                if own and service.begun
                else []
            ),
            "",
            "[Unit]",
            f"Description={service.title}",
            "Wants=network-online.target",
            f"After={' '.join(('network-online.target', 'time-sync.target', *service.after))}",
            "",
            "[Service]",
            "Type=exec",
            "User=ztpm",
            "Group=ztpm",
            *(["StateDirectory=ztpm", "StateDirectoryMode=0700"] if own else [f"ReadWritePaths={_word(str(here))}"]),
            "UMask=0077",
            "LoadCredential=passphrase:/etc/ztpm/passphrase",
            "Environment=ZTPM_PASSPHRASE_FILE=%d/passphrase",
            *(
                [f"Environment={_word(f'SSL_CERT_FILE={here}/tls/ca.pem')}"]
                if placed.authority and service.after
                else []
            ),
            *service.lines,
            *(
                ["CacheDirectory=ztpm", "CacheDirectoryMode=0700", "Environment=NUMBA_CACHE_DIR=/var/cache/ztpm"]
                if service.moves
                else []
            ),
            f"ExecStart={_word(placed.program)} {service.words} --config {config}",
            "# Status 2 is a setting that is refused: another start would be refused as well.",
            "Restart=on-failure",
            f"RestartSec={5 if service.moves else 2}",
            "RestartPreventExitStatus=2",
            f"TimeoutStopSec={service.stops_s}",
            *(["LimitRTPRIO=1"] if service.moves else []),
            "LimitNOFILE=16384",
            "",
            "# Ports below 1024 without root; nothing else that root may.",
            "AmbientCapabilities=CAP_NET_BIND_SERVICE",
            "CapabilityBoundingSet=CAP_NET_BIND_SERVICE",
            "NoNewPrivileges=yes",
            "LockPersonality=yes",
            "PrivateDevices=yes",
            "PrivateTmp=yes",
            "ProtectClock=yes",
            "ProtectControlGroups=yes",
            f"ProtectHome={'read-only' if hidden else 'yes'}",
            "ProtectHostname=yes",
            "ProtectKernelLogs=yes",
            "ProtectKernelModules=yes",
            "ProtectKernelTunables=yes",
            "ProtectProc=invisible",
            "ProcSubset=pid",
            "ProtectSystem=strict",
            "RemoveIPC=yes",
            "RestrictAddressFamilies=AF_INET AF_INET6 AF_UNIX",
            "RestrictNamespaces=yes",
            *([] if service.moves else ["RestrictRealtime=yes"]),
            "RestrictSUIDSGID=yes",
            "SystemCallArchitectures=native",
            "SystemCallFilter=@system-service",
            "SystemCallFilter=~@privileged",
            "SystemCallErrorNumber=EPERM",
            "",
            "[Install]",
            "WantedBy=multi-user.target",
            "",
        ]
    )


def compose(machines: Iterable[str], placed: Placed) -> str:
    """Text of a compose file: these machines' services on one host, each on the host's own addresses.

    Args:
        machines: of `MACHINES`.
        placed: on the machine; a relative directory begins at the file.
    """
    inside = f"{STATE}/cell"
    lines = [
        "# The processes of a cell by compose, on this machine's addresses (docs/deployment.md). Beside this file,",
        "# once: secrets/passphrase (mode 0600), and files of the cell that the image's user may read and write:",
        f"#   chown -R {USER}:{USER} secrets {placed.directory}",
        "# The image, at the source tree:",
        f"#   docker build -f deploy/container/Containerfile --build-arg EXTRAS=idp,pep,cli -t {IMAGE} .",
        "services:",
    ]
    for machine in machines:
        service = SERVICES[machine]
        known = [each for each in machines if f"{SERVICES[each].unit}.service" in service.after]
        lines += [
            f"  {machine}:",
            f"    image: {IMAGE}",
            f"    command: {json.dumps([*service.words.split(), '--config', f'{inside}/{service.config}'])}",
            f'    user: "{USER}:{USER}"',
            "    network_mode: host",
            "    restart: on-failure",
            "    read_only: true",
            "    cap_drop: [ALL]",
            '    security_opt: ["no-new-privileges:true"]',
            f'    tmpfs: ["/tmp:mode=0700,uid={USER},gid={USER}"]',
            "    environment:",
            "      ZTPM_PASSPHRASE_FILE: /run/secrets/passphrase",
            *([f"      SSL_CERT_FILE: {inside}/tls/ca.pem"] if placed.authority and service.after else []),
            *(["      NUMBA_CACHE_DIR: /var/cache/ztpm"] if service.moves else []),
            "    secrets: [passphrase]",
            *(["    ulimits: {rtprio: 1}"] if service.moves else []),
            *([f"    depends_on: [{', '.join(known)}]"] if known else []),
            "    volumes:",
            f"      - {json.dumps(f'{placed.directory}:{inside}')}",
            *(["      - compiled:/var/cache/ztpm"] if service.moves else []),
            f"    stop_grace_period: {service.stops_s}s",
            '    logging: {driver: json-file, options: {max-size: 10m, max-file: "5"}}',
        ]
    lines += ["", "secrets:", "  passphrase: {file: ./secrets/passphrase}"]
    if any(SERVICES[machine].moves for machine in machines):
        lines += ["", "volumes:", "  compiled: {}"]
    return "\n".join([*lines, ""])


def shipped() -> dict[str, str]:
    """Files of `deploy/` by their path there: the units of separate machines, and the compose file of one."""
    units = {
        f"systemd/{service.unit}.service": unit(service, Placed(str(STATE / machine)))
        for machine, service in SERVICES.items()
    }
    return {**units, "compose/cell.yaml": compose(MACHINES, Placed("./cell"))}


def service_files(machines: Iterable[str], placed: Placed) -> dict[str, str]:
    """Files for one machine, by name.

    Args:
        machines: those of `MACHINES` that it is.
        placed: on it.
    """
    machines = tuple(machines)
    units = {f"{SERVICES[each].unit}.service": unit(SERVICES[each], placed) for each in machines}
    return {**units, "compose.yaml": compose(machines, Placed("..", placed.program, placed.authority))}


def _word(text: str) -> str:
    """The text as one word of a unit: `%` and `$` mean nothing, and a blank ends no word."""
    kept = text.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%")
    return f'"{kept}"' if any(each in text for each in " \t\"'\\;") else kept


def own_program(interpreter: str) -> str:
    """The `ztpm` beside this interpreter, else the usual one."""
    beside = Path(interpreter).with_name("ztpm")
    return str(beside) if beside.exists() else PROGRAM
