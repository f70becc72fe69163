"""The registry as people change it: agents, enforcement points, sensors and tools."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities.keys.keys import b64u
from ztpm_idp.client.envelopes import EnvelopeCaller
from ztpm_idp.client.latches import LatchCaller
from ztpm_idp.client.upkeep import UpkeepCaller

if TYPE_CHECKING:
    from collections.abc import Iterable


class RegistryCaller(UpkeepCaller, EnvelopeCaller, LatchCaller):
    """Requests about what is registered."""

    def register_agent(
        self,
        id: str,  # noqa: A002
        key: bytes,
        *,
        software_digest: str,
        model: str,
        role: str,
        sponsor: str | None = None,
        workload: str = "",
    ) -> None:
        """An agent is registered under a sponsor: this person unless another is named.

        `workload` is the platform's name of it, e.g. "spiffe://cell.example/mover"; without one the agent
        has evidence of kind `key` alone.
        """
        body = {"id": id, "key": b64u(key), "software_digest": software_digest, "model": model, "role": role}
        named = {"workload": workload} if workload else {}
        self._post("/agents", body | {"sponsor": sponsor or self.id} | named)

    def retire_agent(self, id: str, reason: str) -> int:  # noqa: A002
        """The agent and all that is below it are dead, for ever; the epoch."""
        return int(self._post(f"/agents/{id}/retire", {"reason": reason})["epoch"])

    def suspend_agent(self, id: str, reason: str) -> None:  # noqa: A002
        """The agent and all that is below it may do nothing until a person restores it."""
        self._post(f"/agents/{id}/suspend", {"reason": reason})

    def restore_agent(self, id: str, reason: str, *, relearn: bool = False) -> None:  # noqa: A002
        """The agent's suspension is ended, and its deviations are taken off it: it may act again as before.

        Args:
            id: of the agent.
            reason: for the ledger.
            relearn: its work has changed: its baseline is learned anew.

        Raises:
            ClientError: `NOTHING_TO_RESTORE` when it is not suspended and nothing was reported of it, and other codes.
        """
        self._post(f"/agents/{id}/restore", {"reason": reason, "relearn": relearn})

    def vouch(self, id: str, reason: str) -> None:  # noqa: A002
        """The agent, held since a restore, may receive and lend authority again.

        Raises:
            ClientError: `NOT_PERMITTED`, `AGENT_INACTIVE` and other codes.
        """
        self._post(f"/agents/{id}/vouch", {"reason": reason})

    def resume(self, unheard: Iterable[str]) -> None:
        """The restored identity provider serves again.

        Args:
            unheard: exactly the enforcement points that were not heard; every agent is held unless there is none.

        Raises:
            ClientError: `POINTS_UNHEARD`, whose detail names them; `NOT_RESTORING`, `NOT_PERMITTED`.
        """
        self._post("/restoring/resume", {"unheard": sorted(unheard)})

    def set_trust(self, id: str, permille: int) -> None:  # noqa: A002
        """The agent's static trust is this."""
        self._post(f"/agents/{id}/trust", {"permille": permille})

    def register_pep(self, id: str, key: bytes, audiences: Iterable[str]) -> None:  # noqa: A002
        """An enforcement point is registered."""
        self._post("/peps", {"id": id, "key": b64u(key), "audiences": list(audiences)})

    def register_sensor(self, id: str, key: bytes, *, calibration: str, transit_ms: int, audience: str) -> None:  # noqa: A002
        """A sensor is registered for the cell of an audience."""
        body = {"id": id, "key": b64u(key), "calibration": calibration, "transit_ms": transit_ms, "audience": audience}
        self._post("/sensors", body)

    def register_tool(
        self, *, audience: str, name: str, definition_digest: str, operation: str, base_tier: int
    ) -> None:
        """A tool's reviewed definition is registered, or replaced."""
        body = {"audience": audience, "name": name, "definition_digest": definition_digest, "operation": operation}
        self._post("/tools", body | {"base_tier": base_tier})
