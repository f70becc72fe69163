"""Authority on the stage: an operator's scope, the restriction of a delegation, and a token's content."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from capabilities.token.token_text import token_from_text
from capabilities.token.verify import inspect_token
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Grant, Limit, Range, Restriction, Scope, Tier
from capabilities.values.units import Parameter, Unit
from ztpm.stage.stage import StageError

if TYPE_CHECKING:
    from ztpm.stage.stage import Stage

LIFETIME_S: Final = 900
SLOWER: Final = 600_000
"""Joint speed that the orchestrator lends to the robotic agent, urad/s."""


def lent(stage: Stage, *delegates: str, ceiling: Tier = Tier.HIGH_CONSEQUENCE) -> Scope:
    """Scope that an operator lends now, for these delegates."""
    scope = sweep_scope(
        stage.cell.addresses.audience, delegates=frozenset(delegates), now=int(time.time()), lifetime_s=LIFETIME_S
    )
    return replace(scope, ceiling=ceiling)


def hand_down(stage: Stage, to: str, restriction: Restriction, *, keep_as: str | None = None) -> str:
    """Delegates from the orchestrator to an agent; the token is kept under `keep_as` or the agent's name."""
    token = (
        stage.agents["orchestrator"]
        .delegate(stage.tokens["orchestrator"], stage.agents[to], restriction, purpose="move the arm along the sweep")
        .token
    )
    stage.tokens[keep_as or to] = token
    return token


def raw(text: str) -> bytes:
    """Bytes of a token text that is known to be well formed."""
    token = token_from_text(text, DEFAULT)
    if not isinstance(token, bytes):
        raise StageError("a token that was just issued does not parse")
    return token


def hop_id(stage: Stage, token: str) -> str:
    """Id of a token's last hop, as `ztpm token inspect` shows it."""
    described: Any = inspect_token(raw(token), stage.trust, DEFAULT)
    return str(described["hops"][-1]["hop_id"])


def sweep_scope(audience: str, *, delegates: frozenset[str], now: int, lifetime_s: int) -> Scope:
    """Scope of a planner: arm, gripper, the table's touch and the state of one cell, up to tier 3.

    Args:
        audience: canonical URL of the cell's tool server.
        delegates: agents that the planner may lend to.
        now: seconds since the epoch.
        lifetime_s: lifetime of the scope.
    """
    angle, speed, acceleration = Unit.MICRORADIAN, Unit.MICRORADIAN_PER_SECOND, Unit.MICRORADIAN_PER_SECOND2
    joints = tuple(Limit(Parameter(f"q{i}", angle), Range(-3_000_000, 3_000_000)) for i in range(6))
    move = Grant(
        "ur3e",
        "move_joint",
        (
            *joints,
            Limit(Parameter("speed", speed), Range(0, 1_050_000)),
            Limit(Parameter("acceleration", acceleration), Range(0, 2_000_000)),
        ),
    )
    gripper = Grant(
        "ur3e",
        "gripper_move",
        (
            Limit(Parameter("width", Unit.MICROMETRE), Range(0, 85_000)),
            Limit(Parameter("speed", Unit.MICROMETRE_PER_SECOND), Range(20_000, 150_000)),
            Limit(Parameter("force", Unit.MILLINEWTON), Range(20_000, 100_000)),
        ),
    )
    return Scope(
        grants=(Grant("table", "touch"), gripper, move, Grant("ur3e", "read_state"), Grant("ur3e", "stop")),
        ceiling=Tier.HIGH_CONSEQUENCE,
        audiences=frozenset({audience}),
        delegates=delegates,
        depth=3,
        not_before=now - 1,
        not_after=now + lifetime_s,
    )


def arm_only(*, speed_high: int, ceiling: Tier | None = None, delegates: frozenset[str] = frozenset()) -> Restriction:
    """Restriction to arm, state and stop, slower; no gripper.

    Args:
        speed_high: highest joint speed in urad/s.
        ceiling: a lower tier ceiling, or None to keep the parent's.
        delegates: agents of the next hop; none by default.
    """
    speed = Limit(Parameter("speed", Unit.MICRORADIAN_PER_SECOND), Range(0, speed_high))
    return Restriction(
        grants=(Grant("ur3e", "move_joint", (speed,)), Grant("ur3e", "read_state"), Grant("ur3e", "stop")),
        ceiling=ceiling,
        delegates=delegates,
    )
