"""Numbers of a request to be led by a force or a hand, or its refusal.

Pure: one command, one answer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.base.operations import FORCE_MODE, FREEDRIVE
from pep.rtde.command import command_values as v
from pep.rtde.command.led_limits import HELD, NO_AXES, ends_of
from pep.rtde.wire.refusal import InputRefusal
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from capabilities.values.scope import Grant

_FIXED: Final = 2
"""Type of force mode whose task frame is as it is given; the others turn it with the arm."""


def forced(command: v.ForceMode, grant: Grant | None) -> tuple[float, ...] | InputRefusal:
    """Parameters of `force_mode` in SI units, as the command is written; refused as `PARAMETERS_WRONG`.

    Args:
        command: with limits that are lowered already (`pep.rtde.command.led_limits.lowered`).
        grant: of the chain for it; None where there is none, which the gate says then.
    """
    chosen = list(zip(command.selection, command.limits, command.wrench_n_nm, HELD, strict=True))
    if command.type != _FIXED:
        return _wrong("forceMode: type 2 alone, a task frame that stays as it is given")
    if not any(command.selection):
        return _wrong("forceMode: no axis is compliant")
    if not all(limit > 0 for compliant, limit, _, _ in chosen if compliant):
        return _wrong("forceMode: a compliant axis has a speed of more than 0 as its limit")
    if not all(force == 0 and limit <= most for compliant, limit, force, most in chosen if not compliant):
        return _wrong("forceMode: a held axis has no force, and deviates by 1 cm or 0.1 rad")
    speeds = (limit if compliant else 0.0 for compliant, limit, _, _ in chosen)
    return (*command.task_frame_m_rad, *command.wrench_n_nm, *speeds, *ends_of(FORCE_MODE, grant, count=2))


def handed(command: v.FreedriveMode | v.TeachMode, grant: Grant | None) -> tuple[float, ...] | InputRefusal:
    """Parameters of `freedrive` in SI units; refused as `PARAMETERS_WRONG`. Teach mode frees all axes."""
    free = (True,) * len(NO_AXES) if isinstance(command, v.TeachMode) else command.free_axes
    if not any(free):
        return _wrong("freedriveMode: no axis is free")
    if isinstance(command, v.FreedriveMode) and not all(free) and command.feature_m_rad != NO_AXES:
        return _wrong("freedriveMode: some axes of the base alone, or all; no feature")
    return (*map(float, free), *ends_of(FREEDRIVE, grant, count=4))


def _wrong(what: str) -> InputRefusal:
    return InputRefusal(Reason.PARAMETERS_WRONG, what)
