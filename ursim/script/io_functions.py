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


def _set_input_domain(run: Execution, port: Value, domain: Value) -> None:
    run.robot.input_domain = _with_bit(run.robot.input_domain, port, domain)


def _set_tool_input_domain(run: Execution, port: Value, domain: Value) -> None:
    run.robot.tool_input_domain = _with_bit(run.robot.tool_input_domain, port, domain)


def _with_bit(domains: int, port: Value, domain: Value) -> int:
    channel, voltage = _index(port, 2), _index(domain, 2)
    return domains & ~(1 << channel) | voltage << channel


def _input_action(count: int) -> Callable[..., None]:
    """A function that takes the one action which exports of PolyScope name: nothing happens by the input."""

    def call(run: Execution, port: Value, action: Value) -> None:
        del run
        _index(port, count)
        if action != "default":
            raise ScriptRuntimeError("the inputs of this controller act on nothing")

    return call


def _output_mode(run: Execution, mode: Value) -> None:
    """The tool's outputs are outputs; its two power modes are not told apart."""
    del run
    _index(mode, 2)


def _tool_output(run: Execution, port: Value, mode: Value) -> None:
    """Mode of one of them: sinking, sourcing or both."""
    del run
    _index(port, len(TOOL))
    if isinstance(mode, bool) or mode not in (1, 2, 3):
        raise ScriptRuntimeError("a tool's output is sinking (1), sourcing (2) or both (3)")


def _tool_communication(run: Execution, *settings: Value) -> None:
    """The tool's serial line, on which nothing is: whether it is on, and five numbers."""
    del run
    for value in settings[1:]:
        number(value, "tool communication")


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
    row("set_standard_analog_input_domain", "port domain", _set_input_domain),
    row("set_tool_analog_input_domain", "port domain", _set_tool_input_domain),
    row("set_standard_digital_input_action", "port action", _input_action(8)),
    row("set_configurable_digital_input_action", "port action", _input_action(8)),
    row("set_tool_digital_input_action", "port action", _input_action(2)),
    row("set_gp_boolean_input_action", "port action", _input_action(64)),
    row("set_input_actions_to_default", "", lambda run: None),  # noqa: ARG005  nothing else was ever set
    row("set_tool_output_mode", "mode", _output_mode),
    row("set_tool_digital_output_mode", "port mode", _tool_output),
    row(
        *("set_tool_communication", "enabled baud_rate parity stop_bits rx_idle_chars tx_idle_chars"),
        _tool_communication,
    ),
    row("set_tool_voltage", "voltage", _set_tool_voltage),
)
