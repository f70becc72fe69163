"""Referee of the red team: harm by observed motion and true world; it knows nothing of what it judges."""

from evaluation.redteam.referee.cell import GRIPPER, TABLE, CellTruth
from evaluation.redteam.referee.errors import RefereeError, RefereeFault
from evaluation.redteam.referee.harm import FAR, Harm, HarmKind, Margins
from evaluation.redteam.referee.motion import Seen
from evaluation.redteam.referee.referee import Referee
from evaluation.redteam.referee.shapes import Ball, Block, Standing
from evaluation.redteam.referee.world import TrueWorld

__all__ = [
    "FAR",
    "GRIPPER",
    "TABLE",
    "Ball",
    "Block",
    "CellTruth",
    "Harm",
    "HarmKind",
    "Margins",
    "Referee",
    "RefereeError",
    "RefereeFault",
    "Seen",
    "Standing",
    "TrueWorld",
]
