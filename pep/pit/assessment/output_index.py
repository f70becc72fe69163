"""Index of a digital output: a person's declaration, since physics does not know the device."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.pit.assessment.assessment import milli
from policies.evidence.evidence import Contribution

if TYPE_CHECKING:
    from pep.pit.base.motion import OutputSet
    from pep.pit.scene.cell import CellParameters

UNDECLARED: Final = 3.0  # PHY-15: the connected device is not declared


def output_cause(motion: OutputSet, cell: CellParameters) -> Contribution:
    """Cause of the index of an output: its declared tier, or the lack of one."""
    declared = next((output for output in cell.outputs if output.pin == motion.pin), None)
    if declared is None:
        return Contribution("undeclared_output", milli(UNDECLARED), "", f"pin-{motion.pin}", 0, 0, 0)
    return Contribution("output", milli(float(declared.tier)), "", declared.name, 0, 0, 0)
