"""The index of a digital output: what a person declared it to be, since no physics knows what is connected."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.pit.assessment.assessment import milli
from policies.evidence.evidence import Contribution

if TYPE_CHECKING:
    from pep.pit.base.motion import OutputSet
    from pep.pit.scene.cell import CellParameters

UNDECLARED: Final = 3.0  # PHY-15: nobody said what is connected there


def output_cause(motion: OutputSet, cell: CellParameters) -> Contribution:
    """The one thing that the index of an output comes from: its declared tier, or that it has none."""
    declared = next((output for output in cell.outputs if output.pin == motion.pin), None)
    if declared is None:
        return Contribution("undeclared_output", milli(UNDECLARED), "", f"pin-{motion.pin}", 0, 0, 0)
    return Contribution("output", milli(float(declared.tier)), "", declared.name, 0, 0, 0)
