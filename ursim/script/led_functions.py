"""Built-in functions of URScript for an arm that a force or a hand leads: one declared row each."""

# ruff: noqa: PLR0917  the signatures are URScript's

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ursim.motion.arm import AXES
from ursim.motion.led import ForceTool, HandLed
from ursim.motion.spatial import to_frame
from ursim.motion.values import ScriptRuntimeError, Value, number, six
from ursim.script.builtin import Function, row

if TYPE_CHECKING:
    from collections.abc import Callable

    from ursim.script.program import Execution


def _force_mode(
    run: Execution, task_frame: Value, selection_vector: Value, wrench: Value, type_: Value, limits: Value
) -> None:
    for value, name in ((task_frame, "task_frame"), (wrench, "wrench"), (limits, "limits")):
        six(value, name)
    if any(each not in (0, 1) for each in six(selection_vector, "selection_vector")):
        raise ScriptRuntimeError("an axis is compliant (1) or not (0)")
    if type_ not in (1, 2, 3):
        raise ScriptRuntimeError("a force mode type that does not exist")
    robot, drive = run.robot, run.robot.drive
    if drive.motion is not None and not isinstance(drive.motion, ForceTool):
        return  # the move under way goes on as it is planned
    motion = drive.motion if isinstance(drive.motion, ForceTool) else ForceTool(robot.arm, robot.tcp, robot.felt)
    drive.take(run.current, motion)
    motion.frame = to_frame(six(task_frame, "task_frame"))
    motion.compliant = tuple(map(bool, six(selection_vector, "selection_vector")))
    motion.wrench, motion.limits = six(wrench, "wrench"), six(limits, "limits")
    motion.part = robot.force_gain * (1.0 - robot.force_damping)


def _end_force_mode(run: Execution) -> None:
    if isinstance(run.robot.drive.motion, ForceTool):
        run.robot.drive.halt()


def _freedrive(run: Execution, axes: Value = None, feature: Value = None) -> None:
    if axes is not None and any(each not in (0, 1) for each in six(axes, "freeAxes")):
        raise ScriptRuntimeError("an axis is free (1) or not (0)")
    if feature is not None and feature not in ("base", "tool"):
        six(feature, "feature")  # the axes are those of the base here, whatever it says
    free = (True,) * AXES if axes is None else tuple(map(bool, six(axes, "freeAxes")))
    robot = run.robot
    robot.drive.take(run.current, HandLed(robot.arm, robot.tcp, free, lambda: robot.hand))


def _teach(run: Execution) -> None:
    _freedrive(run)


def _end_led(run: Execution) -> None:
    if isinstance(run.robot.drive.motion, HandLed):
        run.robot.drive.halt()


def _scale(setting: str, low: float, high: float) -> Callable[..., None]:
    def call(run: Execution, value: Value) -> None:
        part = number(value, "value")
        if not low <= part <= high:
            raise ScriptRuntimeError(f"a value outside {low} to {high}")
        setattr(run.robot, setting, part)

    return call


ROWS: Final[tuple[Function, ...]] = (
    row("force_mode", "task_frame selection_vector wrench type limits", _force_mode),
    row("force_mode_set_damping", "damping", _scale("force_damping", 0.0, 1.0)),
    row("force_mode_set_gain_scaling", "scaling", _scale("force_gain", 0.0, 2.0)),
    row("end_force_mode", "", _end_force_mode),
    row("teach_mode", "", _teach),
    row("end_teach_mode", "", _end_led),
    row("freedrive_mode", "[freeAxes] [feature]", _freedrive),
    row("end_freedrive_mode", "", _end_led),
    row("get_freedrive_status", "", lambda run: 0),  # noqa: ARG005  normal: no singularity is near
)
