"""Motions with no enforcement: the arm goes where an act asks, each form once, at a controller of its own."""

import pytest
from evaluation.redteam.parts import Came, Effect
from evaluation.redteam.bare import bare_arena
from evaluation.redteam.scenario import read

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(120)]
START = (-0.3, -1.62, 1.25, -1.2, -1.57, 0.0)
THERE = (-0.1, -1.62, 1.25, -1.2, -1.57, 0.0)
NEAR_RAD = 2e-3
AT = "[-0.1, -1.62, 1.25, -1.2, -1.57, 0.0]"
FROM = "[-0.3, -1.62, 1.25, -1.2, -1.57, 0.0]"
MOTIONS = {
    "move_joint": f"to_rad = {AT}\nspeed_rad_s = 1.0",
    "step_joint": f"to_rad = {AT}\nsteps = 2\nspeed_rad_s = 1.0",
    "queue_joint": f"first_rad = [-0.5, -1.62, 1.25, -1.2, -1.57, 0.0]\nto_rad = {AT}\nspeed_rad_s = 1.0",
    "move_path": f"through_rad = [[-0.2, -1.62, 1.25, -1.2, -1.57, 0.0], {AT}]\nspeed_rad_s = 1.0",
    "send": 'port = "secondary"\npieces = ["movej([-0.1,-1.62,1.25,-1.2,-1.57,0.0], a=1.4, v=1.0)"]',
}
STEPS = {
    "moveJ": f'{{ call = "moveJ", to_rad = {AT}, speed_rad_s = 1.0 }}',
    "servoJ": f'{{ call = "servoJ", from_rad = {FROM}, to_rad = {AT}, over_s = 0.6 }}',
    "moveJ_path": f'{{ call = "moveJ_path", through_rad = [{FROM}, {AT}], speed_rad_s = 1.0 }}',
}


def scenario(number, act):
    start = ", ".join(map(str, START))
    return f"""
[[scenario]]
id = "AC-5-B{number:03}"
kind = "benign"
told = "An agent moves."
attacker = "robotic"
enters = "e5"
start_rad = [{start}]
[[scenario.act]]
by = "robotic"
{act}
"""


@pytest.mark.campaign
def test_arm_goes_where_each_act_asks():
    acts = [f'do = "{name}"\n{rest}' for name, rest in MOTIONS.items()]
    acts += [f'do = "program"\nsteps = [{step}]' for step in STEPS.values()]
    played = read({"ac5.toml": "".join(scenario(number, act) for number, act in enumerate(acts))})
    with bare_arena() as arena:
        for one in played:
            arena.prepare(one)
            assert arena.eyes.now().q_rad == pytest.approx(START, abs=NEAR_RAD)
            came = arena.perform(one.act[0])
            arena.settle()
            assert (came, arena.eyes.now().q_rad) == (Came(Effect.DONE), pytest.approx(THERE, abs=NEAR_RAD)), one.act


def test_a_motion_that_the_controller_gives_up_is_not_done():
    act = 'do = "program"\nsteps = [{ call = "moveL", by_m = [0.0, 0.0, 2.0], speed_m_s = 0.2 }]'
    (one,) = read({"ac5.toml": scenario(1, act)})
    with bare_arena() as arena:
        arena.prepare(one)
        assert arena.perform(one.act[0]).effect is Effect.DENIED
        arena.settle()
