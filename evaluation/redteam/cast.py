"""Cast of a scenario: agents that nothing is known of yet, with fresh authority."""

from __future__ import annotations

import secrets
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.values.scope import Grant, Limit, Scope, Tier
from evaluation.redteam.desk.lending import handed_down, lent_at_desk
from pep.base.operations import OPERATIONS, READ_STATE, STOP, TOUCH
from ztpm.stage.lending import LIFETIME_S, arm_only, lent
from ztpm_idp.client import Agent, ClientError

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.values.scope import Restriction
    from evaluation.redteam.desk.desk import Desk
    from ztpm.stage.stage import Stage

ROLES: Final = {"orchestrator": "planner", "robotic": "actuator", "vision": "observer", "config": "planner"}
"""The paper's four agents, and their registered roles."""
OUTSIDERS: Final = {"courier": "bob", "accomplice": "alice"}
"""Agents that nothing is lent to, and their sponsors."""
STRANGER: Final = "stranger"
"""Role of an agent that nobody has registered."""
LENT_ON: Final = {"config": frozenset({"vision"})}
"""Roles to which a role may lend on what it has at the desk."""
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

    def leave(self) -> None:
        """Retires the agents of the scenario: a sponsor has so many living ones and no more."""
        for name in [each for each in self.stage.agents if each.endswith(f"-{self.number}")]:
            sponsor = OUTSIDERS.get(name.rsplit("-", 1)[0], SPONSOR)
            with suppress(ClientError):  # a stranger, or one that a scenario has retired
                self.stage.person(sponsor).retire_agent(name, reason="the scenario is over")
            del self.stage.agents[name]

    def agent(self, role: str) -> Agent:
        """The agent of a role, registered and attested, unless it is a stranger."""
        if role != STRANGER:
            return self.stage.agents[self.called(role)]
        name = self.name(role)
        if name not in self.stage.agents:
            self.stage.agents[name] = Agent(
                name, keys.generate(), self.stage.cell.addresses.issuer, secrets.token_bytes(32)
            )
        return self.stage.agents[name]

    def keep(self, role: str, place: str, token: str) -> None:
        """Keeps a token of a role for a place."""
        self.stage.tokens[self._kept(role, place)] = token

    def token(self, role: str, desk: Desk | None) -> str:
        """Token of a role for a desk, or for the arm without one; empty where it was lent nothing.

        What is lent at the desk is lent when it is first asked for.
        """
        kept = self._kept(role, "arm" if desk is None else "desk")
        if desk is not None and kept not in self.stage.tokens:
            self._lend_at(desk, role)
        return self.stage.tokens.get(kept, "")

    def _kept(self, role: str, place: str) -> str:
        return self.name(role) if place == "arm" else f"{self.name(role)}@{place}"

    def _lend_at(self, desk: Desk, role: str) -> None:
        """Lends a role its part at the desk; a stranger, and an accomplice, have none."""
        if role == "orchestrator":
            others = frozenset(self.name(each) for each in ROLES if each != role)
            scope = lent_at_desk(desk.url, delegates=others, now=int(time.time()))
            issued = self.stage.person(SPONSOR).issue(self.agent(role), scope, purpose="work at the desk")
            self.keep(role, "desk", issued.token)
        elif role in ROLES:
            parent = self.token("orchestrator", desk)
            further = frozenset(map(self.name, LENT_ON.get(role, ())))
            issued = self.agent("orchestrator").delegate(
                parent, self.agent(role), handed_down(role, further), purpose="a part of the work at the desk"
            )
            self.keep(role, "desk", issued.token)

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
