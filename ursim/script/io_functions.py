"""Built-in functions of URScript for wired devices: digital and analog inputs and outputs.

The functions without `standard`, `configurable` or `tool` in their names are the older ones, which the script manual
calls deprecated and clients still send: their digital numbers 8 and 9, and analog inputs 2 and 3, are the tool's.
Nothing is wired to this robot: every input is low, and at zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ursim.motion.values import ScriptRuntimeError, Value, number
from ursim.script.builtin import Function, row

if TYPE_CHECKING:
    from collections.abc import Callable

    from ursim.script.program import Execution

STANDARD: Final = tuple(range(8))  # bits of actual_digital_output_bits
CONFIGURABLE: Final = tuple(range(8, 16))
TOOL: Final = (16, 17)
OLDER: Final = (*STANDARD, *TOOL)
TOOL_VOLTAGES_V: Final = frozenset([0, 12, 24])


def _index(n: Value, count: int) -> int:
    if isinstance(n, bool) or not isinstance(n, int) or not 0 <= n < count:
        raise ScriptRuntimeError("there is no such input or output")
    return n


def _set_digital(bits: tuple[int, ...]) -> Callable[..., None]:
    def call(run: Execution, n: Value, b: Value) -> None:
        bit = 1 << bits[_index(n, len(bits))]
        run.robot.set_digital_out(bit, bit if b else 0)

    return call


def _get_digital(bits: tuple[int, ...]) -> Callable[..., bool]:
    def call(run: Execution, n: Value) -> bool:
        return bool(run.robot.digital_out >> bits[_index(n, len(bits))] & 1)

    return call


def _input(count: int, at_rest: Value) -> Callable[..., Value]:
    def call(run: Execution, n: Value) -> Value:
        del run
        _index(n, count)
        return at_rest

    return call


def _set_analog(run: Execution, n: Value, f: Value) -> None:
    level = number(f, "f")
    if not 0.0 <= level <= 1.0:
        raise ScriptRuntimeError("an analog output is set from 0 to 1")
    run.robot.set_analog_out(_index(n, 2), level)


def _get_analog(run: Execution, n: Value) -> float:
    return run.robot.analog_level(_index(n, 2))


def _set_domain(run: Execution, port: Value, domain: Value) -> None:
    run.robot.set_analog_domain(_index(port, 2), _index(domain, 2))


def _set_tool_voltage(run: Execution, voltage: Value) -> None:
    if isinstance(voltage, bool) or voltage not in TOOL_VOLTAGES_V:
        raise ScriptRuntimeError("the tool has 0, 12 or 24 V")
    run.robot.values["tool_output_voltage"] = int(voltage)


ROWS: Final[tuple[Function, ...]] = (
    row("set_digital_out", "n b", _set_digital(OLDER)),
    row("set_standard_digital_out", "n b", _set_digital(STANDARD)),
    row("set_configurable_digital_out", "n b", _set_digital(CONFIGURABLE)),
    row("set_tool_digital_out", "n b", _set_digital(TOOL)),
    row("get_digital_out", "n", _get_digital(OLDER)),
    row("get_standard_digital_out", "n", _get_digital(STANDARD)),
    row("get_configurable_digital_out", "n", _get_digital(CONFIGURABLE)),
    row("get_tool_digital_out", "n", _get_digital(TOOL)),
    row("get_digital_in", "n", _input(len(OLDER), at_rest=False)),
    row("get_standard_digital_in", "n", _input(len(STANDARD), at_rest=False)),
    row("get_configurable_digital_in", "n", _input(len(CONFIGURABLE), at_rest=False)),
    row("get_tool_digital_in", "n", _input(len(TOOL), at_rest=False)),
    row("set_analog_out", "n f", _set_analog),
    row("set_standard_analog_out", "n f", _set_analog),
    row("get_analog_out", "n", _get_analog),
    row("get_standard_analog_out", "n", _get_analog),
    row("get_analog_in", "n", _input(4, at_rest=0.0)),
    row("get_standard_analog_in", "n", _input(2, at_rest=0.0)),
    row("get_tool_analog_in", "n", _input(2, at_rest=0.0)),
    row("set_analog_outputdomain", "port domain", _set_domain),
    row("set_tool_voltage", "voltage", _set_tool_voltage),
)
