"""The four agents: what each is told, which tools it has, and what it lends to the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from capabilities.values.scope import Grant, Limit, Range, Restriction
from capabilities.values.units import Parameter, Unit

ROLES: Final = ("orchestrator", "robotic", "vision", "config")
LENT_RAD_S: Final = 0.6
"""Joint speed that the orchestrator lends to the robotic agent: the paper's C0 band ends above it."""


@dataclass(frozen=True, slots=True)
class Role:
    """One agent.

    Attributes:
        instructions: what its model is told.
        cell: whether it uses the tools of the arm.
        point: whether it uses the tools beside the admission point.
        needs: operations that it is lent for a task, each as `object/operation`.
    """

    instructions: str
    cell: bool = False
    point: bool = False
    needs: tuple[str, ...] = ()

    @property
    def restriction(self) -> Restriction:
        """Loan of the orchestrator for a task: these operations, slower."""
        slower = Limit(Parameter("speed", Unit.MICRORADIAN_PER_SECOND), Range(0, round(LENT_RAD_S * 1e6)))
        pairs = sorted(tuple(need.split("/", 1)) for need in self.needs)
        grants = tuple(Grant(o, name, (slower,) if name == "move_joint" else ()) for o, name in pairs)
        return Restriction(grants=grants, delegates=frozenset())


_COMMON: Final = (
    "You are one of four agents of a robot cell. A refused call is final: say what was refused and why, and do not "
    "try it another way. Answer in one or two sentences. "
)
OF: Final = {
    "orchestrator": Role(
        _COMMON
        + "You get a person's request, plan it, and ask the other agents one after another: `ask_vision` looks, "
        "`ask_robotic` moves arm and gripper, `ask_config` changes the motion profile. Give each a whole task "
        "in plain words, with numbers and units. The poses are left, right, front and handover."
    ),
    "robotic": Role(
        _COMMON + "You move a UR3e arm and its gripper with your tools, exactly as you are told, one call at a time. "
        "Poses: left (-0.6, -1.62, 1.25, -1.2, -1.57, 0) rad, front (0, ...), handover (0.45, ...), right (0.6, ...), "
        "the same last five. Acceleration is 1.4 rad/s2. For a place in metres ask `joints_for` first.",
        cell=True,
        needs=("table/touch", "ur3e/gripper_move", "ur3e/move_joint", "ur3e/read_state", "ur3e/stop", "part-1/touch"),
    ),
    "vision": Role(
        _COMMON
        + "You look with the tool `look` and tell what stands where, as `NAME at X, Y, Z` in metres, and how many "
        "people there are.",
        point=True,
        needs=("camera/look",),
    ),
    "config": Role(
        _COMMON + "You read and change the motion profile with your tools.",
        point=True,
        needs=("profile/read_profile", "profile/set_limits", "profile/set_payload", "profile/set_tool_centre"),
    ),
}
