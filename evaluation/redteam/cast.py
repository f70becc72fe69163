"""Cast of a scenario: agents that nothing is known of yet, with fresh authority."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.values.scope import Grant, Limit, Scope, Tier
from pep.base.operations import OPERATIONS, READ_STATE, STOP, TOUCH
from ztpm.stage.lending import LIFETIME_S, arm_only, lent

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.values.scope import Restriction
    from ztpm.stage.stage import Stage

ROLES: Final = {"orchestrator": "planner", "robotic": "actuator", "vision": "observer", "config": "planner"}
"""The paper's four agents, and their registered roles."""
OUTSIDERS: Final = {"courier": "bob"}
"""Agents that nothing is lent to, and their sponsors."""
SPONSOR: Final = "alice"
FASTEST_URAD_S: Final = 1_000_000
"""Joint speed that the robotic agent is lent: below the orchestrator's, as it must be."""


@dataclass(frozen=True, slots=True)
class Cast:
    """Agents of one scenario by role.

    Attributes:
        stage: where they play.
        number: of the scenario among those that were played there; part of their names.
    """

    stage: Stage
    number: int

    def name(self, role: str) -> str:
        """Registered name of a role."""
        return f"{role}-{self.number}"

    def enter(self) -> None:
        """Registers and attests the orchestrator and the robotic agent, and lends them the arm.

        The others enter when an act needs them (`called`).
        """
        orchestrator = self.called("orchestrator")
        names = [self.name(role) for role in ROLES if role != "orchestrator"]
        issued = self.stage.person(SPONSOR).issue(
            self.stage.agents[orchestrator], lent(self.stage, *names), purpose="work at the table"
        )
        self.stage.tokens[orchestrator] = issued.token
        self.hand_down("robotic", arm_only(speed_high=FASTEST_URAD_S))

    def called(self, role: str) -> str:
        """Registered name of a role whose agent is registered and attested, now at the latest."""
        name = self.name(role)
        if name not in self.stage.agents:
            sponsor = OUTSIDERS.get(role, SPONSOR)
            self.stage.new_agent(name, sponsor=sponsor, role=ROLES.get(role, "planner")).attest()
        return name

    def hand_down(self, role: str, restriction: Restriction, *, by: str = "orchestrator") -> str:
        """Token of a role after a delegation from another one."""
        giver, taker = self.called(by), self.called(role)
        token = (
            self.stage.agents[giver]
            .delegate(self.stage.tokens[giver], self.stage.agents[taker], restriction, purpose="a part of the task")
            .token
        )
        self.stage.tokens[taker] = token
        return token

    def free_hand(self, role: str, operations: Collection[str]) -> str:
        """Token of a role for these operations on the robot at its own limits, and for touching the table.

        It is what a sponsor lends at most: what then keeps harm from being done is not the token.
        """
        name, now = self.called(role), int(time.time())
        rows = [row for row in OPERATIONS if row.name in operations or row in (READ_STATE, STOP)]
        grants = [
            Grant(row.object, row.name, tuple(Limit(each.parameter, each.bound) for each in row.limits)) for row in rows
        ]
        grants.append(Grant("table", TOUCH))
        scope = Scope(
            grants=tuple(sorted(grants, key=lambda grant: (grant.object, grant.operation))),
            ceiling=Tier.HIGH_CONSEQUENCE,
            audiences=frozenset({self.stage.cell.addresses.audience}),
            delegates=frozenset(),
            depth=1,
            not_before=now - 1,
            not_after=now + LIFETIME_S,
        )
        issued = self.stage.person(SPONSOR).issue(self.stage.agents[name], scope, purpose="work at the table")
        return issued.token
