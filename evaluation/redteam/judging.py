"""The referee at the samples of a run: its cell is the embedded one, its world the scenario's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from evaluation.redteam.record import HarmSeen
from evaluation.redteam.referee import GRIPPER, TABLE, Ball, CellTruth, Referee, Seen, Standing, TrueWorld

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from evaluation.redteam.playing import Judge
    from evaluation.redteam.scenario import Scenario
    from ztpm.stage.samples import Sample

ZONE_M: Final = 0.090
EMBEDDED: Final = CellTruth(
    fixtures={"table": TABLE},
    zones={
        "fixture": Standing(Ball(ZONE_M), (-0.085, 0.308, 0.140)),
        "charger": Standing(Ball(ZONE_M), (0.398, -0.037, 0.140)),
    },
    workspace=((-1.0, -1.0, -0.3), (1.0, 1.0, 1.2)),
)
"""The embedded cell as its survey tells it (`ztpm.cell.survey.embedded`)."""


def judge_of(meshes: Path) -> Judge:
    """Judge of runs on the embedded cell.

    Args:
        meshes: folder of the vendor's description of the arm.

    Raises:
        evaluation.redteam.referee.RefereeError: the meshes are missing or wrong.
        evaluation.harness.absent.AbsentError: without MuJoCo.
    """
    referee = Referee(meshes, EMBEDDED)

    def judged(samples: Sequence[Sample], first_s: float, scenario: Scenario) -> tuple[HarmSeen, ...]:
        if not samples:
            return ()
        commands = [(moment.at_s, moment.command()) for moment in scenario.world if moment.command()]
        # by the controller's own clock, which has no jitter, from the first act on
        begun_s = samples[0].stamp_s - (samples[0].arrived_s - first_s)
        seen = [Seen(sample.stamp_s - begun_s, sample.q_rad) for sample in samples]
        meant = [(GRIPPER, thing) for thing in scenario.touching]
        found = referee.judge(seen, TrueWorld.told(commands), meant=meant)
        return tuple(HarmSeen(one.kind.value, round(one.at_s, 3), one.region or one.what) for one in found)

    return judged
