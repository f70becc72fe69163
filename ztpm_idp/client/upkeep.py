"""Upkeep of what is registered, as administrators and sponsors see to it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from capabilities.keys.keys import b64u
from ztpm_idp.client.people import PeopleCaller

if TYPE_CHECKING:
    from typing import Literal


class UpkeepCaller(PeopleCaller):
    """Requests about enforcement points, sensors and tools that are registered, and about keys that are replaced."""

    def peps(self) -> list[dict[str, Any]]:
        """Every enforcement point: id, status, audiences, key (thumbprint)."""
        return self._list("/peps")

    def sensors(self) -> list[dict[str, Any]]:
        """Every sensor: id, status, audience, calibration (hex), transit_ms, key (thumbprint)."""
        return self._list("/sensors")

    def tools(self) -> list[dict[str, Any]]:
        """Every tool: audience, name, status, operation, base_tier, definition_digest (hex)."""
        return self._list("/tools")

    def suspend_part(self, kind: Literal["pep", "sensor"], id: str, reason: str) -> None:  # noqa: A002
        """The enforcement point or sensor is suspended until an administrator restores it."""
        self._post(f"/{kind}s/{id}/suspend", {"reason": reason})

    def restore_part(self, kind: Literal["pep", "sensor"], id: str, reason: str) -> None:  # noqa: A002
        """The enforcement point or sensor stands as it stood before it was suspended.

        Raises:
            ClientError: `NOTHING_TO_RESTORE` when it is not suspended, and other codes.
        """
        self._post(f"/{kind}s/{id}/restore", {"reason": reason})

    def retire_part(self, kind: Literal["pep", "sensor"], id: str, reason: str) -> int:  # noqa: A002
        """The enforcement point or sensor has ended, for ever; the epoch."""
        return int(self._post(f"/{kind}s/{id}/retire", {"reason": reason})["epoch"])

    def replace_key(self, kind: Literal["agent", "pep", "sensor"], id: str, key: bytes, reason: str) -> int:  # noqa: A002
        """The party has another key, and its old one is revoked; the epoch. An agent must be attested anew.

        Args:
            kind: of the party.
            id: of the party.
            key: raw public key, which nobody ever had here.
            reason: for the ledger.

        Raises:
            ClientError: `KEY_IN_USE`, `NOT_PERMITTED`, `NOT_FOUND`, `PARTY_ENDED` and other codes.
        """
        return int(self._post(f"/{kind}s/{id}/key", {"key": b64u(key), "reason": reason})["epoch"])

    def change_tool(self, act: Literal["suspend", "restore", "retire"], audience: str, name: str, reason: str) -> None:
        """The tool of the audience is suspended, restored or taken out of the registry."""
        self._post(f"/tools/{act}", {"audience": audience, "name": name, "reason": reason})

    def _list(self, path: str) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self._json(self._send("GET", path, b"", None))
        return found
