"""Amounts of each thing that one sponsor may have at the provider, and that it has."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping

HOUR_MS: Final = 3_600_000


@dataclass(frozen=True, slots=True)
class Allowances:
    """Most of each thing that one sponsor may have.

    Attributes:
        live_tokens: tokens that are neither over nor revoked: issued, drawn, or behind a client's access token.
        tokens_an_hour: tokens made within the last hour, revoked or not.
        delegations: hops of one token's tree; of what it has, those of the largest tree are told.
        mandates: mandates in force.
        agents: living agents, clients of OAuth among them.
        asks: asks about its agents that wait for people.
    """

    live_tokens: int = 20_000
    tokens_an_hour: int = 40_000
    delegations: int = 4_096
    mandates: int = 1_024
    agents: int = 256
    asks: int = 24


@dataclass(frozen=True, slots=True)
class AllowanceTable:
    """Allowances of every sponsor.

    Attributes:
        general: of those who are not named.
        named: by id of the sponsor.
    """

    general: Allowances = field(default_factory=Allowances)
    named: Mapping[str, Allowances] = field(default_factory=lambda: MappingProxyType({}))

    def of(self, sponsor: str) -> Allowances:
        """The allowances of a sponsor."""
        return self.named.get(sponsor, self.general)


@dataclass(frozen=True, slots=True)
class Used:
    """Amounts that a sponsor has, of the things that a command needs to be judged; fields as in `Allowances`."""

    live_tokens: int = 0
    tokens_an_hour: int = 0
    delegations: int = 0
    mandates: int = 0
    agents: int = 0
    asks: int = 0
