"""Picture of the network around a gateway: its ways to the controller past the gateway.

What this machine shows is looked at. That nothing else is on the robot's network no machine can tell by itself.
"""

from __future__ import annotations

import ipaddress
import socket
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from pep.point.config_text import is_loopback

if TYPE_CHECKING:
    from collections.abc import Callable

FORWARDING: Final = {
    "IPv4": "/proc/sys/net/ipv4/ip_forward",
    "IPv6": "/proc/sys/net/ipv6/conf/all/forwarding",
}
LISTENERS: Final = ("/proc/net/tcp", "/proc/net/tcp6")
LISTENING: Final = "0A"  # TCP_LISTEN of the kernel's states
SERVICES: Final = {
    22: "SSH",
    502: "Modbus",
    30020: "Interpreter Mode",
    44818: "EtherNet/IP",
    5900: "VNC",
    50002: "External Control",
}
"""Ports of a controller that a gateway does not use, and what answers there."""
PROBE_S: Final = 0.3
"""Longest wait for one of them; a controller at the end of a cable answers within a millisecond."""
ANY: Final = ("0.0.0.0", "::")  # noqa: S104 - compared with, not listened on


@dataclass(frozen=True, slots=True)
class Seen:
    """Sight of the network from this machine.

    Attributes:
        controller: address of the robot.
        face: address at which the gateway stands in its place.
        at_gateway: this machine has that address.
        forwarding: protocols that this machine routes.
        towards: own address towards the controller; None where there is no way.
        elsewhere: own address towards the cell's network; None where there is no way.
        listeners: (address, port) of everybody who listens on this machine.
        open_ports: ports of `SERVICES` at which the controller answers.
    """

    controller: str
    face: str
    at_gateway: bool
    forwarding: tuple[str, ...]
    towards: str | None
    elsewhere: str | None
    listeners: tuple[tuple[str, int], ...]
    open_ports: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Finding:
    """One look: its name, whether nothing is open, and what was found."""

    name: str
    ok: bool
    detail: str


def judge(seen: Seen) -> tuple[Finding, ...]:
    """Findings on what this machine shows.

    Args:
        seen: by `look`.
    """
    if is_loopback(seen.controller):
        return (Finding("network", True, "the controller is on this machine: a simulated one, and no network"),)  # noqa: FBT003 - a field
    return (_forwarding(seen), _interfaces(seen), _listeners(seen), _services(seen))


def _forwarding(seen: Seen) -> Finding:
    if seen.forwarding:
        told = f"this machine routes {' and '.join(seen.forwarding)}: sysctl net.ipv4.ip_forward=0, also for IPv6"
        return Finding("forwarding", False, told)  # noqa: FBT003 - a field
    return Finding("forwarding", True, "off: this machine routes nothing")  # noqa: FBT003 - a field


def _interfaces(seen: Seen) -> Finding:
    if seen.towards is None:
        return Finding("interfaces", False, f"no way from here to {seen.controller}")  # noqa: FBT003 - a field
    if not seen.at_gateway:
        told = (
            f"this machine reaches the controller, and {seen.face} is another's: that is a way past the gateway; take "
            "it off the controller's network now, and run `ztpm doctor --config` at the gateway"
        )
        return Finding("interfaces", False, told)  # noqa: FBT003 - a field
    if seen.elsewhere is not None and seen.elsewhere == seen.towards:
        told = (
            f"the controller and the cell's network are both reached from {seen.towards}: whoever is on that network "
            "reaches the controller past the gateway; give it a cable of its own"
        )
        return Finding("interfaces", False, told)  # noqa: FBT003 - a field
    return Finding("interfaces", True, f"the controller is reached from {seen.towards}, the cell's network is not")  # noqa: FBT003 - a field


def _listeners(seen: Seen) -> Finding:
    open_to = sorted({port for host, port in seen.listeners if host in ANY or host == seen.towards})
    if open_to:
        told = f"towards the controller this machine listens at {', '.join(map(str, open_to))}: close eth1's input"
        return Finding("listeners", False, told)  # noqa: FBT003 - a field
    return Finding("listeners", True, "nobody listens towards the controller")  # noqa: FBT003 - a field


def _services(seen: Seen) -> Finding:
    if seen.open_ports:
        named = ", ".join(f"{SERVICES[port]} ({port})" for port in seen.open_ports)
        told = f"the controller also answers at {named}: switch it off under Security, Services"
        return Finding("controller's services", False, told)  # noqa: FBT003 - a field
    return Finding("controller's services", True, "none that the gateway does not use answers")  # noqa: FBT003 - a field


def look(controller: str, face: str, *, probe: Callable[[str, int], bool] | None = None) -> Seen:
    """Sight of the network from this machine, now.

    Args:
        controller: address of the robot.
        face: address at which the gateway stands in its place.
        probe: whether a port answers; by default it is connected to.
    """
    answers = _answers if probe is None else probe
    loopback = is_loopback(controller)
    return Seen(
        controller=controller,
        face=face,
        at_gateway=_own(face),
        forwarding=tuple(name for name, file in FORWARDING.items() if _on(file)),
        towards=_source(controller),
        elsewhere=None if is_loopback(face) else face,
        listeners=tuple(each for file in LISTENERS for each in _listening(file)),
        open_ports=() if loopback else tuple(port for port in SERVICES if answers(controller, port)),
    )


def _own(host: str) -> bool:
    """True where the address is this machine's."""
    with suppress(OSError):
        family, *_, place = socket.getaddrinfo(host, 0, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.bind(place)
            return True
    return False


def _on(file: str) -> bool:
    with suppress(OSError):
        return Path(file).read_text("ascii").strip() not in {"", "0"}
    return False


def _source(controller: str) -> str | None:
    """Own address from which the controller is reached; no packet is sent."""
    with suppress(OSError):
        family = socket.getaddrinfo(controller, 9, type=socket.SOCK_DGRAM)[0]
        with socket.socket(family[0], socket.SOCK_DGRAM) as probe:
            probe.connect(family[4])
            return str(probe.getsockname()[0])
    return None


def _answers(host: str, port: int) -> bool:
    with suppress(OSError), socket.create_connection((host, port), PROBE_S):
        return True
    return False


def _listening(file: str) -> list[tuple[str, int]]:
    """Listeners by the kernel's table; loopback is left out."""
    found = []
    with suppress(OSError):
        for line in Path(file).read_text("ascii").splitlines()[1:]:
            fields = line.split()
            if fields[3] == LISTENING:
                raw, _, port = fields[1].partition(":")
                host = _address(raw)
                if not is_loopback(host):
                    found.append((host, int(port, 16)))
    return found


def _address(raw: str) -> str:
    """An address as the kernel spells it: words of four bytes, each the other way round."""
    words = [bytes.fromhex(raw[at : at + 8])[::-1] for at in range(0, len(raw), 8)]
    return str(ipaddress.ip_address(b"".join(words)))
