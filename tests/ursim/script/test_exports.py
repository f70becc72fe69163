"""Programs as PolyScope writes them to a file: preamble, label lines, text."""

import pytest
from pep.rtde.script.urscript import ProgramStream, ScriptError, ScriptFault, parse
from tests.ursim.cell import Bench

EXPORT = """def pick():
  set_standard_analog_input_domain(0, 1)
  set_standard_analog_input_domain(1, 1)
  set_tool_analog_input_domain(1, 1)
  set_analog_outputdomain(0, 0)
  set_analog_outputdomain(1, 0)
  set_input_actions_to_default()
  set_standard_digital_input_action(3, "default")
  set_tool_communication(False, 115200, 0, 1, 1.5, 3.5)
  set_tool_output_mode(0)
  set_tool_digital_output_mode(0, 1)
  set_tool_voltage(0)
  set_safety_mode_transition_hardness(1)
  set_gravity([0.0, 0.0, 9.82])
  $ 1 "Robot Program"
  $ 2 "If end while" "noBreak"
  if True:
    $ 3 "Set DO[2]=On"
    set_standard_digital_out(2, True)
  end
end
"""


def told(text, **options):
    """Register 0 after one program of these lines."""
    bench = Bench(**options)
    bench.load("def t():\n" + text + "\nend\n")
    bench.tick(3)
    assert bench.exceptions == []
    return bench.out(0)


def test_an_export_runs_and_its_domains_are_read_back():
    bench = Bench()
    assert bench.load(EXPORT) is None
    bench.tick(3)
    assert bench.exceptions == []
    assert bench.robot.read("actual_digital_output_bits") == 4
    assert bench.robot.read("analog_io_types") == 0b0011  # both inputs in volts, both outputs in amperes
    assert bench.robot.read("tool_analog_input_types") == 0b10


def test_labels_are_layout_alone():
    plain = "\n".join(line for line in EXPORT.splitlines() if "$" not in line) + "\n"
    assert parse(EXPORT) == parse(plain)
    assert ProgramStream(10**6).feed('$ 1 "def"\n' + EXPORT) != []


@pytest.mark.parametrize(
    "text", ["x = 1 $ 2\n", '$ "no number"\n', "$ 1\n", '$ 1 "open\n', '$ 1 "a" x = 2\n', 'x = 1 $ 2 "a"\n']
)
def test_a_label_has_one_form_and_a_line_of_its_own(text):
    with pytest.raises(ScriptError) as wrong:
        parse(text)
    assert wrong.value.code is ScriptFault.CHARACTER


@pytest.mark.parametrize("action", ["start", "freedrive"])
def test_inputs_act_on_nothing(action):
    bench = Bench()
    bench.load(f'set_standard_digital_input_action(0, "{action}")\n')
    bench.tick(3)
    assert len(bench.exceptions) == 1


@pytest.mark.parametrize(
    ("expression", "value"),
    [
        ('str_len("abc")', 3),
        ("get_list_length([1, 2])", 2),
        ('to_num("-17")', -17),
        ('str_find("abcabc", "b", 2)', 4),
        ('str_find("abc", "x")', -1),
        ('to_num(str_sub("ab12cd", 2, 2))', 12),
        ('to_num(str_sub("ab34", 2))', 34),
        ('to_num(str_at("a7", 1))', 7),
        ("binary_list_to_integer(integer_to_binary_list(-5))", -5),
        ("binary_list_to_integer([True, False, True])", 5),
        ("length(integer_to_binary_list(1))", 32),
    ],
)
def test_text_and_lists(expression, value):
    assert told(f"write_output_integer_register(0, {expression})") == value


@pytest.mark.parametrize(
    "expression", ['str_at("a", 1)', 'to_num("nan")', 'to_num("x")', "str_len(1)", 'str_sub("a", -1)']
)
def test_what_text_does_not_hold_ends_the_program(expression):
    bench = Bench()
    bench.load(f"def t():\nx = {expression}\nend\n")
    bench.tick(3)
    assert len(bench.exceptions) == 1
