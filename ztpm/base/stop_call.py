"""Stop of a cell's arm from another process: at the gateway's own address, else by the controller's dashboard.

    gateway ─▶ begins to stop, ends the lease, records it ([LIV-7])      silent ─▶ dashboard: the running program ends

Nothing else of the cell is asked, so it works while the page or the identity provider is gone.
"""

from __future__ import annotations

import json
import tomllib
from contextlib import closing
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from typing import TYPE_CHECKING, Any, Final, Self
from urllib.parse import urljoin, urlsplit

if TYPE_CHECKING:
    from pathlib import Path

ANSWER_S: Final = 0.5
"""Longest wait for the gateway's word that it stops; it takes some milliseconds."""
WORD_S: Final = 3.0
"""Longest wait for its answer to a signed word: it is on record before it is answered."""
ANSWER_BYTES: Final = 65_536
"""Longest answer that is read."""
GATEWAY: Final = "gateway"
DASHBOARD: Final = "dashboard"
"""Takers of a stop."""


def stop_url(door: str) -> str:
    """Canonical URL of a gateway's stop: beside its door for leases."""
    return urljoin(door, "stop")


@dataclass(frozen=True, slots=True)
class StopAddress:
    """Whom to tell that an arm is to stop, and what a word on it has to name.

    Attributes:
        url: where the gateway takes stops.
        robot_host: address of the controller.
        issuer, audience: canonical URLs of the identity provider and the cell.
    """

    url: str
    robot_host: str
    issuer: str
    audience: str

    @classmethod
    def of(cls, config: Path) -> Self:
        """The address in a gateway's configuration, of which nothing else is read: a stop waits for no check of it.

        Raises:
            OSError: it cannot be read.
            ValueError: it does not say.
        """
        stated = tomllib.loads(config.read_text(encoding="utf-8"))
        members = [stated.get(name) for name in ("url", "robot_host", "issuer", "audience")]
        if not all(isinstance(member, str) for member in members):
            raise ValueError("no url, robot_host, issuer or audience")
        door, host, issuer, audience = map(str, members)
        return cls(stop_url(door), host, issuer, audience)


def ask_gateway(address: StopAddress, word: str = "", *, timeout_s: float) -> dict[str, Any] | None:
    """The gateway's answer to a stop, with a person's word where there is one; None where none comes in time.

    It goes straight to the gateway, past any proxy of the environment. Certificates are loaded for TLS alone: a stop
    does not wait for them elsewhere.
    """
    parts = urlsplit(address.url)
    body = json.dumps({"stop": True} | ({"word": word} if word else {}))
    try:
        kind = HTTPSConnection if parts.scheme == "https" else HTTPConnection
        with closing(kind(parts.hostname or "", parts.port, timeout=timeout_s)) as link:
            link.request("POST", parts.path, body, {"Content-Type": "application/json"})
            said = json.loads(link.getresponse().read(ANSWER_BYTES))
    except (OSError, HTTPException, ValueError, RecursionError):
        return None
    return said if isinstance(said, dict) and said.get("stopped") is True else None


def stop_arm(address: StopAddress) -> dict[str, Any] | None:
    """Begins to stop the arm: the answer, with `by` of who took it; None where nobody did."""
    said = ask_gateway(address, timeout_s=ANSWER_S)
    if said is not None:
        return said
    from pep.base.errors import RobotError
    from pep.rtde.robot.dashboard import stop_program

    try:
        stop_program(address.robot_host)
    except RobotError:
        return None
    return {"stopped": True, "by": DASHBOARD, "lease": "", "person": "", "fault": "", "latch": None}
