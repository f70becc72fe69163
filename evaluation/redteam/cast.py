"""Cast of a scenario: agents that nothing is known of yet, with fresh authority."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from ztpm.stage.lending import arm_only, lent

if TYPE_CHECKING:
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
