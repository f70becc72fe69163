"""The tools of a cell, composed over whatever commands its robot: devices, speed slider, and the guarded MCP app."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from capabilities.keys import keys
from capabilities.values.caps import DEFAULT as CAPS
from pep.context.flow import Flow
from pep.mcp.arm_server import arm_server
from pep.mcp.guard import guard
from pep.mcp.mapping import ARM_TOOLS
from pep.mcp.provenance import Vouching
from pep.rtde.motion.devices import Devices
from pep.rtde.motion.drive import Drive
from pep.rtde.motion.governed_move import SpeedControl
from pep.rtde.motion.jog import Jog
from pep.rtde.robot.dashboard import stop_program
from pep.rtde.robot.digital_outputs import DigitalOutputs
from pep.rtde.robot.speed_slider import SpeedSlider
from pep.watch.governor import Pacing
from pep.watch.watch import WatchAges
from ztpm.point.robot import committed

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from starlette.types import ASGIApp

    from capabilities.keys.keys import PrivateKey
    from pep.base.ports import Readiness
    from pep.gate.gate import Gate
    from pep.rtde.motion.permitted_control import PermittedControl
    from pep.rtde.robot.gripper import RobotiqGripper
    from pep.rtde.robot.telemetry import Telemetry
    from pep.watch.watch import Watch
    from ztpm.point.robot_point import RobotPoint


@dataclass(frozen=True, slots=True)
class ArmTools:
    """What the tools move.

    Attributes:
        devices: all of it; also the `MotionSlot` port.
        slider: of the controller.
    """

    devices: Devices
    slider: SpeedSlider

    @classmethod
    def of(
        cls,
        point: RobotPoint,
        *,
        control: PermittedControl,
        io: Any,
        gripper: RobotiqGripper,
        telemetry: Telemetry,
        judging: Executor,
        watch: type[Watch],
    ) -> ArmTools:
        """The tools of an enforcement point.

        Args:
            point: which.
            control: guarded.
            io: the raw `RTDEIOInterface`, or what stands for it.
            gripper: of the robot.
            telemetry: of the controller.
            judging: where the watch computes.
            watch: looks at what moves.
        """
        config, physics = point.config, point.physics
        slider = SpeedSlider(io)
        drive = Drive(
            control=control,
            state=point.state,
            gripper=gripper,
            dashboard_stop=lambda: stop_program(config.robot_host),
            start_of=physics.start_of,
            watching=partial(
                watch,
                remaining=physics,
                views=point.frames,
                limits=WatchAges.of(point.cell),
                clock=point.clock,
                submit=judging.submit,
            ),
            hurry=point.follower.hurry,
            audience=config.audience,
            clock=point.clock,
            speed=SpeedControl(slider, Pacing.of(point.cell)),
        )
        devices = Devices(
            drive,
            Jog(drive, control, start_of=physics.start_of, clock=point.clock),
            DigitalOutputs(io, telemetry, audience=config.audience, stopped_ms=lambda: control.stopped_ms),
            partial(committed, physics, control, point.holding),
        )
        return cls(devices, slider)

    def app(self, point: RobotPoint, gate: Gate, key: PrivateKey, *, readiness: Readiness) -> ASGIApp:
        """The guarded MCP server.

        Args:
            point: as before.
            gate: decides.
            key: of the enforcement point.
            readiness: of the robot, for these tools.
        """
        audience = point.config.audience
        return guard(
            arm_server(self.devices, point.physics.summary),
            gate=gate,
            authority=point.authority,
            registry=point.follower,
            tools=ARM_TOOLS,
            asks=point.asks,
            readiness=readiness,
            audience=audience,
            issuer=point.config.issuer,
            clock=point.clock,
            vouching=Vouching(
                key=key,
                audience=audience,
                # Its own receipts alone: of other admission points the registry does not tell.
                admitters={audience: keys.public_raw(key)}.copy,
                flow=Flow(point.clock),
                caps=CAPS,
            ),
        )

    async def close(self) -> None:
        """Everything stands still, and nothing can be sent any more."""
        await self.devices.close()
        self.slider.close()
