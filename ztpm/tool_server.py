"""The cell's MCP tool server: perception, feeds, gate, guard and robot in one process.

    python -m ztpm.tool_server --config cell.toml

The passphrase of the PEP's key comes from the environment (`ZTPM_PASSPHRASE`). When it listens it prints one JSON line
with `"ready": true`. SIGTERM stops the arm first and everything else after it. With `--reports` it tells whoever
started it how things stand (ztpm/base/report_server.py).
"""

from __future__ import annotations

import argparse
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from pep.gate.observe_only import Unwatched
from pep.rtde.motion.dead_man import DeadMan
from pep.rtde.robot.dashboard import RemoteControl
from pep.rtde.robot.gripper import RobotiqGripper
from pep.rtde.robot.program import ProgramWatch
from pep.rtde.robot.telemetry import Telemetry
from pep.watch.watch import Watch
from ztpm.point.arm_tools import ArmTools
from ztpm.point.cell_config import CellConfig, read_config
from ztpm.point.enforcement_point import main_of
from ztpm.point.robot import (
    PROGRAM_S,
    commanded,
    confirm_kinematics,
    connect,
    connect_outputs,
    found_holding,
    readiness,
)
from ztpm.point.robot_point import RobotPoint, opened_cell
from ztpm.point.simulator_check import recognise

if TYPE_CHECKING:
    import httpx2

    from capabilities.keys.keys import PrivateKey
    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.cell import Cell
    from pep.gate.observe_only import Simulated
    from policies.decide.policy import PolicySet


class ToolServer(RobotPoint):
    """All parts of one cell, composed.

    Args:
        config: of the cell.
        survey: the signed cell file, verified and in force.
        trust: the issuer's public keys.
        key: of this PEP.
        policies: what is decided by.
        http: client of the identity provider.
        unsafe_observe: the simulated controller, where nothing is to be enforced; None enforces.
    """

    def __init__(
        self,
        config: CellConfig,
        *,
        survey: Cell,
        trust: TrustBundle,
        key: PrivateKey,
        policies: PolicySet,
        http: httpx2.AsyncClient,
        unsafe_observe: Simulated | None = None,
    ) -> None:
        super().__init__(config, survey=survey, trust=trust, key=key, http=http, unsafe_observe=unsafe_observe)
        robot, holding = self.robot, self.holding
        gripper = RobotiqGripper(config.robot_host)
        found_holding(holding, gripper)
        # The watch is there before the program that it is to see start.
        program = ProgramWatch(config.robot_host)
        program.listening(within_s=PROGRAM_S)
        control = commanded(
            connect(config.robot_host), program, robot, self.cell, holding, audience=config.audience, clock=self.clock
        )
        self.dead_man = DeadMan(control)
        telemetry = Telemetry(config.robot_host)
        self.readiness = readiness(
            telemetry, RemoteControl(config.robot_host), program, control.isConnected, robot=robot, holding=holding
        )
        if config.calibration_file is not None:
            confirm_kinematics(self.readiness)
        self.judging = ThreadPoolExecutor(1, "rest")
        self.tools = ArmTools.of(
            self,
            control=control,
            io=connect_outputs(config.robot_host),
            gripper=gripper,
            telemetry=telemetry,
            judging=self.judging,
            watch=Watch if unsafe_observe is None else Unwatched,
            # An observed motion begins wherever the arm is: what was denied may never have been assessed.
            start_of=None if unsafe_observe is None else lambda _: self.state.read().q_rad,
        )
        self.gate = self.gated(policies, slot=self.tools.devices, readiness=self.readiness)
        self.app = self.tools.app(self, self.gate, key)

    async def stand(self) -> None:
        """The arm stands still."""
        await self.tools.devices.stop()

    async def close(self) -> None:
        """The connections that move things have ended."""
        self.dead_man.close()
        await self.tools.close()
        self.judging.shutdown(wait=False, cancel_futures=True)
        self.readiness.close()


async def serve(config: CellConfig, *, reports: bool = False, unsafe_observe: bool = False) -> None:
    """The cell's tool server has run and ended, its arm standing still; `reports` as for `ToolServer.run`.

    Args:
        config: of the cell.
        reports: it has told of itself.
        unsafe_observe: nothing was enforced, everything decided and recorded: with a simulated controller alone.

    Raises:
        PepError: when a part cannot be had; nothing was served then.
    """
    # Before anything is opened: a real robot is never observed.
    simulated = recognise(config.robot_host) if unsafe_observe else None
    server = ToolServer(config, **opened_cell(config), unsafe_observe=simulated)
    server.recover()
    await server.run(reports=reports)


def main() -> None:
    """The command line. Exit code 1 for whatever keeps it from serving."""
    parser = argparse.ArgumentParser(prog="python -m ztpm.tool_server", description="The MCP tool server of a cell.")
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--reports", action="store_true", help="answer questions on standard input")
    parser.add_argument(
        "--unsafe-observe", action="store_true", help="enforce nothing; refused unless the controller is simulated"
    )
    options = parser.parse_args()
    main_of(lambda: serve(read_config(options.config), reports=options.reports, unsafe_observe=options.unsafe_observe))


if __name__ == "__main__":
    main()
