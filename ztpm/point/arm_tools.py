"""The tools of a cell, composed over its line to the controller: motions, switches, and the guarded MCP app."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from capabilities.keys import keys
from capabilities.values.caps import DEFAULT as CAPS
from pep.context.flow import Flow
from pep.mcp.arm_server import arm_server
from pep.mcp.guard import guard
from pep.mcp.mapping import ARM_TOOLS
from pep.mcp.provenance import Vouching
from pep.rtde.motion.governed_move import SpeedControl
from pep.rtde.own.tool_motions import ToolMotions
from pep.rtde.robot.digital_outputs import DigitalOutputs
from pep.rtde.robot.speed_slider import SpeedSlider
from pep.watch.governor import Pacing
from ztpm.point.robot import committed

if TYPE_CHECKING:
    from collections.abc import Callable

    from starlette.types import ASGIApp

    from capabilities.keys.keys import PrivateKey
    from pep.base.ports import Readiness
    from pep.gate.gate import Gate
    from pep.rtde.motion.motions import Motions
    from pep.rtde.own.tool_lease import OwnLines
    from pep.rtde.robot.gripper import RobotiqGripper
    from pep.watch.watch import Watch
    from ztpm.point.robot_point import RobotPoint


def tool_motions(
    point: RobotPoint,
    *,
    lines: OwnLines,
    motions: Motions,
    gripper: RobotiqGripper,
    watching: Callable[..., Watch],
) -> ToolMotions:
    """All that the tools of an enforcement point move and switch.

    Args:
        point: which.
        lines: to the controller.
        motions: of the arm.
        gripper: of the robot.
        watching: begins a watch, given what judges the rest of a motion.
    """
    audience, physics, stopper = point.config.audience, point.physics, motions.stopper
    return ToolMotions(
        lines,
        motions,
        gripper=gripper,
        outputs=DigitalOutputs(lines.switch, point.state, audience=audience, stopped_ms=lambda: stopper.stopped_ms),
        watching=partial(watching, remaining=physics),
        speed=SpeedControl(SpeedSlider(lines.switch), Pacing.of(point.cell)),
        gripped=partial(committed, physics, lines, point.holding),
        audience=audience,
        clock=point.clock,
    )


def tools_app_of(
    point: RobotPoint, tools: ToolMotions, gate: Gate, key: PrivateKey, *, readiness: Readiness
) -> ASGIApp:
    """The guarded MCP server.

    Args:
        point: as before.
        tools: what they move.
        gate: decides.
        key: of the enforcement point.
        readiness: of the robot, for these tools.
    """
    audience = point.config.audience
    return guard(
        arm_server(tools, point.physics.summary),
        gate=gate,
        authority=point.authority,
        registry=point.follower,
        tools=ARM_TOOLS,
        asks=point.asks,
        readiness=readiness,
        audience=audience,
        issuer=point.config.issuer,
        clock=point.clock,
        kept=point.kept,
        vouching=Vouching(
            key=key,
            audience=audience,
            # Its own receipts alone: of other admission points the registry does not tell.
            admitters={audience: keys.public_raw(key)}.copy,
            flow=Flow(point.clock),
            caps=CAPS,
        ),
    )
