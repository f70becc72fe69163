"""Stop of a cell's arm from its page: by its gateway, else by the controller's dashboard.

gateway ─▶ begins to stop, ends the lease, records it      silent ─▶ dashboard: the running program ends
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from pep.base.errors import RobotError
from pep.rtde.robot.dashboard import stop_program
from ztpm.base.processes import STOP
from ztpm.status.texts import TEXTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from ztpm.cell.cell import Cell

ANSWER_S: Final = 0.4
"""Longest wait for the gateway's word that it stops; it takes some milliseconds."""


@dataclass(frozen=True, slots=True)
class StopAnswer:
    """Outcome of a stop that was asked for on the page.

    Attributes:
        by: "gateway", "dashboard", or "" where nothing took it.
        told: the outcome, for a person.
    """

    by: str
    told: str

    @property
    def stopped(self) -> bool:
        """True where a stop has begun."""
        return self.by != ""

    def as_json(self) -> dict[str, Any]:
        """The same as plain JSON."""
        return {"stopped": self.stopped, **asdict(self)}


class CellStop:
    """Stop of one cell, from any thread; never refused, never counted ([LIV-2]).

    Args:
        cell: running.
        note: puts on record what the gateway does not: event and sentence.
        dashboard: ends the program of the controller at that address; raises `RobotError` where it does not.
    """

    def __init__(
        self,
        cell: Cell,
        *,
        note: Callable[[str, str], object],
        dashboard: Callable[[str], None] = stop_program,
    ) -> None:
        self._cell = cell
        self._note = note
        self._dashboard = dashboard

    def __call__(self) -> StopAnswer:
        """Begins to stop the arm."""
        words: dict[str, str] = TEXTS["stop"]
        gateway = self._cell.children.get("gateway")
        answer = None if gateway is None else gateway.ask({STOP: True}, timeout_s=ANSWER_S, lane=STOP)
        if answer is not None and answer.get("begun") is True:
            lease = answer.get("lease")
            over = words["lease"].format(lease=lease) if lease else ""
            return StopAnswer("gateway", words["begun"] + over)
        try:
            self._dashboard(self._cell.addresses.controller_host)
        except RobotError as error:
            self._note("stop-failed", f"a stop on the page reached nobody: {error.code}")
            return StopAnswer("", words["nobody"])
        self._note("arm-stopped", "stopped on the page through the dashboard: the gateway did not answer")
        return StopAnswer("dashboard", words["dashboard"])
