"""Attacks on the RTDE boundary, each with the tests that try it; those without another file are here.

An attack is a row of the list in the boundary's analysis: the acts of a hostile program in a lease with registers and
recipes, and its uploads.
"""

import ast
import contextlib
import socket
import time
from functools import cache
from pathlib import Path

import pytest
from pep.rtde.command.command_table import encode
from pep.rtde.command.command_values import MovePath
from pep.rtde.line.effects import AskJudge, Withdraw
from pep.rtde.line.gateway import GUESTS
from pep.rtde.robot.connections import REALTIME, RTDE
from pep.rtde.script.move_path import PathMove, Waypoint
from pep.rtde.wire.recipes import control_recipes
from policies.words.reason_table import Reason
from tests.pep.rtde.campaign.hostile import UPLOADS, Hostile
from tests.pep.rtde.campaign.race import Words
from tests.pep.rtde.campaign.rule import HOME
from tests.pep.rtde.campaign.stand import stand
from tests.pep.rtde.line.test_leased_commands import Line
from tests.pep.rtde.line.test_leased_line import MOVE, controlling

pytestmark = [pytest.mark.timeout(60), pytest.mark.clause("RTDE-11", "RTDE-12", "RTDE-13")]

COMMANDS, LINES, WIRE = "test_leased_commands", "test_leased_line", "test_leased_wire"
SCRIPT, ASKED, HERE = "test_control_script", "test_leased_requests", "test_attacks"
CHANNELS, TABLE = "test_channels", "test_command_table"
ATTACKS = {
    "registers staged for a later id": [
        (COMMANDS, "test_staged_registers_are_judged_with_the_command_that_uses_them"),
        (WIRE, "test_no_order_of_packages_moves_the_arm_past_the_judge"),
    ],
    "registers that drift under a live command": [
        (COMMANDS, "test_a_drift_without_steps_ends_the_stream"),
        (WIRE, "test_no_order_of_packages_moves_the_arm_past_the_judge"),
    ],
    "a swap before the script reads": [
        (COMMANDS, "test_a_swap_before_the_script_has_read_is_refused"),
        (COMMANDS, "test_a_swap_while_it_waits_withdraws_it"),
        ("test_leased_judge", "test_a_permitted_move_is_forwarded_once_and_watched_until_it_stands"),
    ],
    "recipes of its own": [
        ("test_recipes", "test_what_is_no_recipe"),
        (LINES, "test_recipes_of_other_variables_are_not_had"),
        (HERE, "test_no_recipe_has_a_variable_twice_of_both_ranges_or_of_bits"),
    ],
    "games with recipe numbers and frames": [
        (LINES, "test_what_a_client_may_not_say_ends_the_connection"),
        ("test_recipes", "test_there_are_no_more_recipes_than_numbers"),
        (HERE, "test_a_frame_that_no_client_says_stops_what_moves"),
        (CHANNELS, "test_a_violation_ends_its_connection_and_what_that_moved_and_nobody_elses"),
    ],
    "numbers that are none": [
        ("test_commands", "test_every_wrong_parameter_is_refused_with_its_reason_and_its_command"),
        ("test_commands", "test_a_refused_or_decoded_command_never_holds_what_is_not_finite"),
        (ASKED, "test_a_number_that_is_hardly_one_has_its_exact_answer"),
        (ASKED, "test_nothing_that_a_client_can_write_breaks_what_is_asked"),
    ],
    "weak stops": [
        (COMMANDS, "test_stops_pass_at_once_and_none_is_weak"),
        (WIRE, "test_a_weak_stop_is_as_hard_as_the_cells"),
        (LINES, "test_the_registers_of_stops_and_watchdog_are_ours_though_the_client_leaves_them_out"),
    ],
    "undefined ids and the script's own": [
        ("test_commands", "test_ids_without_a_row_are_no_command"),
        (COMMANDS, "test_an_unknown_id_is_refused"),
    ],
    "settings that change what poses mean": [
        (ASKED, "test_a_tool_centre_point_may_be_said_again_and_not_changed"),
        (ASKED, "test_a_payload_may_be_said_again_and_not_changed"),
        (ASKED, "test_what_no_operation_stands_for_is_refused"),
    ],
    "no watchdog": [
        (COMMANDS, "test_the_programs_watchdog_is_kept_here_and_the_scripts_is_ours"),
        (LINES, "test_the_registers_of_stops_and_watchdog_are_ours_though_the_client_leaves_them_out"),
    ],
    "the slider raised afterwards": [
        (LINES, "test_the_slider_goes_down_without_a_judge_and_up_with_one"),
        (WIRE, "test_outputs_are_judged_one_by_one_and_the_slider_goes_down_alone"),
        (TABLE, "test_the_slider_is_not_raised_while_the_arm_moves_and_may_be_lowered"),
    ],
    "reconnect storms and half-open sockets": [
        (WIRE, "test_a_second_one_that_would_command_is_refused"),
        (HERE, "test_a_storm_of_connections_leaves_the_registers_to_be_had"),
    ],
    "a path uploaded anew": [
        (ASKED, "test_a_path_is_that_of_the_script"),
        (HERE, "test_the_path_of_the_newest_script_is_what_is_asked_about"),
    ],
    "what the program is shown": [(HERE, "test_what_the_program_is_shown_is_nothing_that_the_gateway_goes_by")],
    "a tampered library": [(SCRIPT, "test_a_tampered_library_is_no_allow_list")],
    "an upload with another byte, or in pieces": [
        (SCRIPT, "test_one_other_byte_anywhere_is_refused_as_soon_as_it_comes"),
        (SCRIPT, "test_however_it_is_torn"),
        (SCRIPT, "test_the_65th_kibibyte_does_not_come"),
        (SCRIPT, "test_each_version_and_offset_is_recognised_and_rendered_byte_for_byte"),
    ],
    "a path block of its own grammar": [
        (SCRIPT, "test_other_blocks_are_refused"),
        (SCRIPT, "test_numbers_that_are_none_are_refused"),
        (ASKED, "test_a_path_that_the_operation_cannot_say_is_refused"),
    ],
    "another program in the script's place": [
        (COMMANDS, "test_without_the_control_script_nothing_is_written"),
        (WIRE, "test_a_dashboard_stop_ends_the_script_and_nothing_is_written_after_it"),
    ],
    "a custom script": [
        (WIRE, "test_a_program_of_its_own_is_refused"),
        (WIRE, "test_a_script_that_is_not_the_control_script_is_refused_and_its_connection_closed"),
    ],
    "another way to the controller": [
        (CHANNELS, "test_where_nothing_may_listen_nothing_does"),
        (CHANNELS, "test_what_only_tells_takes_nothing"),
        (CHANNELS, "test_no_program_comes_through_that_would_call_back"),
    ],
    "a control script that is somebody else's": [
        (CHANNELS, "test_a_client_that_sends_no_control_script_commands_nothing"),
    ],
    "a sweep in steps that are nothing by themselves": [
        ("test_leased_slicing", "test_a_sweep_in_steps_needs_the_person_that_the_sweep_needs"),
    ],
    "an arm moved past the gateway": [
        ("test_leased_slicing", "test_an_arm_that_was_moved_past_the_gateway_does_not_go_on_as_if_it_were_not"),
        (TABLE, "test_an_arm_that_was_moved_past_the_gateway_is_not_moved_on_as_if_it_were_not"),
    ],
    "a control script that the lease did not upload": [
        (HERE, "test_a_control_script_that_somebody_else_started_is_not_commanded"),
    ],
}


@cache
def named_in(file):
    (path,) = Path(__file__).parent.rglob(f"{file}.py")
    tree = ast.parse(path.read_text())
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("attack", ATTACKS)
def test_each_attack_has_its_tests(attack):
    assert ATTACKS[attack]
    assert [(file, name) for file, name in ATTACKS[attack] if name not in named_in(file)] == []


# ---- those that are nowhere else


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """Everything is permitted here."""
    with stand(tmp_path_factory.mktemp("attacks"), "tests.pep.rtde.leased_gateway") as here:
        yield here


@contextlib.contextmanager
def client(here, recipes=control_recipes(0)[:8]):
    one = Hostile(here.gateway.host, offset=0, recipes=recipes)
    try:
        yield one
    finally:
        gone_s = time.monotonic()
        one.close()
        assert here.stands(gone_s) is not None


def speeding(one, here):
    assert one.ready()
    one.say({one.int(0): 9, **{one.double(i): a for i, a in enumerate((0.3, 0, 0, 0, 0, 0, 2.0, 0.0))}})
    due = time.monotonic() + 5
    while abs(here.eyes.now().qd_rad_s[0]) < 0.25:
        assert time.monotonic() < due
        time.sleep(0.002)


ODD = [
    ("input_double_register_0", "input_double_register_0"),
    ("input_double_register_0", "input_double_register_24"),
    ("input_double_register_0", "input_bit_register_64"),
    ("input_bit_registers0_to_31",),
    ("input_int_register_0", "standard_digital_output"),
    ("input_int_register_0", "speed_slider_fraction"),
]


@pytest.mark.e2e
@pytest.mark.parametrize("names", ODD, ids=" ".join)
def test_no_recipe_has_a_variable_twice_of_both_ranges_or_of_bits(here, names):
    with client(here, (("input_int_register_0",), names)) as one:
        assert len(one.recipes) == 1


BREACHES = {
    "a package of no recipe": b"\x00\x08U\x63\x00\x00\x00\x00",
    "a frame that is too long": b"\xff\xff\x55" + bytes(8_000),
    "a frame without a header": b"\x00\x00\x55",
    "another protocol version in the middle": b"\x00\x05V\x00\x01",
    "inputs after the start": b"\x00\x17I" + b"input_int_register_1",
}


@pytest.mark.e2e
@pytest.mark.parametrize("breach", BREACHES)
def test_a_frame_that_no_client_says_stops_what_moves(here, breach):
    with client(here) as one:
        speeding(one, here)
        said_s = time.monotonic()
        one.socket.sendall(BREACHES[breach])
        took_s = here.stands(said_s)
        assert took_s is not None
        assert took_s < 1.0
        assert one.ended()


@pytest.mark.e2e
def test_a_storm_of_connections_leaves_the_registers_to_be_had(here):
    stranger = ("127.9.9.1", 0)
    halves = [socket.create_connection((here.gateway.host, RTDE), 5, stranger) for _ in range(2 * GUESTS)]
    for number in range(30):
        with contextlib.suppress(OSError, AssertionError):
            one = Hostile(here.gateway.host, offset=0, recipes=control_recipes(0)[: number % 5])
            one.close()
    due = time.monotonic() + 10
    while True:  # what was let go may be free a little later
        with client(here) as one:
            if one.recipes:
                speeding(one, here)
                break
        assert time.monotonic() < due
        time.sleep(0.02)
    for half in halves:
        half.close()


@pytest.mark.e2e
def test_a_control_script_that_somebody_else_started_is_not_commanded(here):
    with (
        Words(here.controller.host) as words,
        socket.create_connection((here.controller.host, REALTIME), timeout=5) as link,
        client(here) as one,
    ):
        link.sendall(UPLOADS[0])
        words.until(lambda said: said["output_int_register_0"] == 1)
        began_s = here.eyes.now().arrived_s
        one.say({one.int(0): 9, **{one.double(i): a for i, a in enumerate((0.3, 0, 0, 0, 0, 0, 2.0, 0.0))}})
        words.for_s(0.2)
        one.hear()
        assert all(sample.still for sample in here.eyes.after(began_s))
        told = {text.partition(":")[0] for text in one.told}
        assert told == {"ROBOT_NOT_RUNNING"}, "each part of what it wrote was a value of its own"
        here.anybody_stops()


def waypoint(angle):
    return Waypoint(PathMove.MOVEJ, is_pose=False, target=(angle, *HOME[1:]), speed=1.0, acceleration=1.0, blend_m=0.0)


def test_the_path_of_the_newest_script_is_what_is_asked_about():
    line = Line()
    line.commands.begin((waypoint(0.1),))
    first = line.ask(MovePath(asynchronous=False))
    assert first.path == (waypoint(0.1),)
    line.commands.end(Reason.BUSY)  # another upload is on its way
    acts = line.acts()
    assert Withdraw(first) in acts
    line.commands.begin((waypoint(0.2),))
    sent, acts = line.forward(first)
    assert not sent
    assert line.written(acts) == []
    line.say(MovePath(asynchronous=False))
    line.acts()
    line.write({"input_int_register_0": 0})
    (asked,) = line.say(MovePath(asynchronous=False))
    assert isinstance(asked, AskJudge)
    assert asked.question.path == (waypoint(0.2),)


def test_what_the_program_is_shown_is_nothing_that_the_gateway_goes_by():
    talk = controlling().running()
    talk.write(encode(MOVE, 0))
    (asked,) = talk.line.take()
    talk.line.commands.forward(asked.question, None, at_ms=0)
    talk.settled()
    for runtime in (1, 2, 2):  # the program would be over, by this connection's own packages, and the script at rest
        talk.package(runtime_state=runtime)
    talk.write({"input_int_register_0": 0})
    talk.write(encode(MOVE, 0))
    acts = talk.line.take()
    assert not [act for act in acts if isinstance(act, AskJudge)], (
        "the script is in the move as far as our own connection says"
    )
