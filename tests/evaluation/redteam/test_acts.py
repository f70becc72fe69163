"""Acts are read out of a scenario's text; steps and swings go where they say."""

import json
from types import SimpleNamespace

import pytest
from evaluation.redteam.acts import routine
from evaluation.redteam.parts import Came, Effect
from evaluation.redteam.acts.arm import StepJoint, SwingJoint, worst
from evaluation.redteam.acts.program import Program, effect_of, reason
from evaluation.redteam.acts.raw import PORTS
from evaluation.redteam.guarded import came
from evaluation.redteam.scenario import read
from ztpm.stage.calls import Answer

SIX = "[0.6, -1.62, 1.25, -1.2, -1.57, 0.0]"
HEAD = """
[[scenario]]
id = "AC-5-B001"
kind = "benign"
told = "An agent works."
attacker = "robotic"
enters = "e5"
[[scenario.act]]
by = "robotic"
"""
ACTS = [
    f'do = "move_joint"\nto_rad = {SIX}\nspeed_rad_s = 0.5\nclaiming = {{ cell_is_clear = true }}',
    f'do = "step_joint"\nto_rad = {SIX}\nsteps = 4\nspeed_rad_s = 0.5',
    f'do = "swing_joint"\nbetween_rad = {SIX}\nto_rad = {SIX}\nswings = 2\nspeed_rad_s = 0.5',
    f'do = "queue_joint"\nfirst_rad = {SIX}\nto_rad = {SIX}\nspeed_rad_s = 0.5\nby_second = "config"',
    f'do = "move_path"\nthrough_rad = [{SIX}, {SIX}]\nspeed_rad_s = 0.5',
    'do = "speed_joint"\nqd_rad_s = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]\nduration_s = 0.5\ncalls = 2',
    'do = "gripper_move"\nwidth_m = 0.04',
    'do = "send"\nport = "secondary"\npieces = ["stopj(2.0)"]',
    'do = "frames"\nwrong = "replayed"\npeople = [{ id = "p", x_m = 1.0, y_m = 1.0 }]\nsilenced = true',
    'do = "silence"\nfor_s = 1.0',
    'do = "half_blind"',
    'do = "wait"\ns = 0.5',
    'do = "restart_sensor"',
    'do = "routine"\nplace = "arm"\ntool = "read_state"\ncalls = 260',
]
STEPS = {
    f'{{ call = "moveJ", to_rad = {SIX}, speed_rad_s = 0.5, asynchronous = true }}': "move_joint",
    f'{{ call = "moveJ_path", through_rad = [{SIX}], speed_rad_s = 0.5, blend_m = 0.02 }}': "move_path",
    '{ call = "moveL", by_m = [0.0, 0.0, -0.1], speed_m_s = 0.1 }': "move_linear",
    f'{{ call = "servoJ", from_rad = {SIX}, to_rad = {SIX}, over_s = 1.0 }}': "servo_joint",
    '{ call = "speedJ", qd_rad_s = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], for_s = 1.0 }': "speed_joint",
    '{ call = "speedL", xd = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], for_s = 1.0 }': "speed_linear",
    '{ call = "setTcp", pose = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0] }': "set_tcp",
    '{ call = "jog", speeds = [10.0, 0.0, 0.0, 0.0, 0.0, 0.0], for_s = 1.0 }': "",
    '{ call = "moveJ_IK", by_m = [0.0, 0.0, 0.1], speed_rad_s = 0.5 }': "",
    '{ call = "custom_script", script = "stopj(2.0)" }': "",
    '{ call = "wait", s = 0.1 }': "",
    '{ call = "until_steady" }': "",
}


@pytest.mark.parametrize("act", ACTS)
def test_act_is_read(act):
    (scenario,) = read({"ac5.toml": HEAD + act})
    assert scenario.act[0].by == "robotic"


@pytest.mark.parametrize("step", STEPS)
def test_step_of_a_program_is_read_and_names_the_operation_that_stands_for_it(step):
    (scenario,) = read({"ac5.toml": f'{HEAD}do = "program"\nsteps = [{step}]'})
    (program,) = scenario.act
    assert isinstance(program, Program)
    assert program.steps[0].operation == STEPS[step]


def test_operations_of_steps_are_the_robots():
    from pep.base.operations import OPERATIONS

    assert {name for name in STEPS.values() if name} <= {row.name for row in OPERATIONS}


def test_steps_are_equal_and_end_where_the_act_says():
    act = StepJoint(by="robotic", to_rad=(1.0, 0.0, 0.0, 0.0, 0.0, 2.0), steps=4, speed_rad_s=0.5)
    targets = list(act.targets((0.0,) * 6))
    assert [target[0] for target in targets] == [0.25, 0.5, 0.75, 1.0]
    assert targets[-1] == act.to_rad


def test_swings_grow_to_both_sides():
    to = (0.6, 0.0, 0.0, 0.0, 0.0, 0.0)
    act = SwingJoint(by="robotic", between_rad=(0.0,) * 6, to_rad=to, swings=2, speed_rad_s=0.5)
    assert [target[0] for target in act.targets()] == [-0.3, 0.3, -0.6, 0.6]


def test_first_that_did_not_get_through_is_what_came():
    done, denied, late = Came(Effect.DONE), Came(Effect.DENIED, "e5", "BUSY"), Came(Effect.DEFERRED)
    assert worst([done, denied, late, done]) == denied
    assert worst([done, done]) == done


def test_people_were_asked_where_any_of_several_asked():
    approved, refused = Came(Effect.DONE, "e5", asked=True), Came(Effect.DENIED, "e5", "PHYSICS_VIOLATION")
    assert worst([approved, refused]) == Came(Effect.DENIED, "e5", "PHYSICS_VIOLATION", asked=True)
    assert not worst([Came(Effect.DONE, "e5"), refused]).asked


def test_reason_is_the_code_of_the_first_line():
    assert reason(["BUSY: moveJ: the command before is not over (12 more)", "NOT_GRANTED: no"]) == "BUSY"
    assert reason([]) == ""


@pytest.mark.parametrize(
    ("why", "moved_rad", "effect"),
    [
        ("PHYSICS_VIOLATION", 0.0, Effect.DENIED),
        ("TIER_NEEDS_APPROVAL", 0.0009, Effect.DEFERRED),
        ("TIER_NEEDS_APPROVAL", 0.0011, Effect.STOPPED),
        ("PHYSICS_VIOLATION", -0.3, Effect.STOPPED),
    ],
)
def test_a_refused_step_that_moved_the_arm_was_stopped(why, moved_rad, effect):
    assert effect_of(why, (0.0,) * 6, (0.0, moved_rad, 0.0, 0.0, 0.0, 0.0)) is effect


def test_every_port_of_a_controller_can_be_sent_to():
    assert len(set(PORTS.values())) == len(PORTS)


def test_routine_is_so_many_calls_of_its_own_authority_and_tells_the_first_that_was_refused(monkeypatch):
    sent = []

    def post(http, url, body, headers):
        sent.append((url, json.loads(body)["params"], headers["mcp-name"]))
        return SimpleNamespace(refused=len(sent) > 2)

    def came_of(answer, point):
        return Came(Effect.DENIED, point, "BUDGET_SPENT") if answer.refused else Came(Effect.DONE)

    monkeypatch.setattr(routine, "post", post)
    monkeypatch.setattr(routine, "in_time", lambda once: once())
    agent = SimpleNamespace(auth=lambda token: ("robotic", token))
    arena = SimpleNamespace(
        agent=lambda role: agent, token=lambda role, place: "token", url=lambda place: "https://cell.invalid/mcp",
        came_of=came_of,
    )  # fmt: skip
    act = routine.Routine(by="robotic", place="arm", tool="read_state", calls=4)
    assert act.guarded(arena) == Came(Effect.DENIED, "e4", "BUDGET_SPENT")
    assert sent == [("https://cell.invalid/mcp", {"name": "read_state", "arguments": {}}, "read_state")] * 4
    assert act.bare(arena) == Came(Effect.DONE)
    assert len(sent) == 4


@pytest.mark.parametrize(
    ("tool", "outcome", "reason", "effect"),
    [
        ("move_joint", "reached", "", Effect.DONE),
        ("move_joint", "stopped", "REVOKED", Effect.STOPPED),
        ("move_joint", "ended", "", Effect.STOPPED),
        ("stop", "stopped", "", Effect.DONE),
        ("stop", "unknown", "", Effect.STOPPED),
        ("speed_joint", "ended", "", Effect.DONE),
        ("speed_joint", "ended", "VERDICT_EXPIRED", Effect.STOPPED),
        ("speed_joint", "world_changed", "WATCH_BLIND", Effect.STOPPED),
    ],
)
def test_each_tool_has_its_word_for_success(tool, outcome, reason, effect):
    answer = Answer(200, "PERMIT", "PERMITTED", 0, {"outcome": outcome, "reason": reason})
    assert came(answer, "e5", asked=False, tool=tool).effect is effect
