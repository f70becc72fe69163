"""A tool server without a gateway that is gone leaves an arm that stands: ur_rtde's motion outlives its client, so the controller ends it."""

import time

import pytest
from pep.base.stop_model import KICK_S, STOP_DECELERATION_RAD_S2, dead_man_s
from ztpm.base.layout import write_private
from ztpm.demo.motion import Motion
from ztpm.demo.run import play
from ztpm.demo.story import STORY
from ztpm.demo.story.moving import SLOW_RAD_S, UNDER_WAY_RAD, at_left
from ztpm.stage.live import stage
from ztpm.stage.stage import RIGHT
from ztpm.stage.stopping import SAMPLE_S

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(120)]

GATEWAYS = ("url = ", "calls_url = ", "listen_host = ", "carriage_port = ", "host = ", "port = ")
"""Settings of a gateway that a tool server without one has not, or has differently."""


def alone(cell):
    """The cell's tool server is what commands its robot, and no gateway is there."""
    addresses, layout = cell.addresses, cell.layout
    for name in ("tools", "gateway"):
        cell.end(name)
    lines = [line for line in layout.gateway_config.read_text().splitlines() if not line.startswith(GATEWAYS)]
    own = [f'host = "{addresses.host}"', f"port = {addresses.tools_port}", *lines]
    config = layout.root / "alone.toml"
    write_private(config, "\n".join(own).encode())
    cell.start_sensor("--to", f"{addresses.host}:{addresses.perception_port}")
    cell.tools = cell.start_child("tool server", "ztpm.tool_server", "--config", str(config), environment=cell._secret)


def test_a_killed_tool_server_leaves_a_standing_arm():
    with stage() as on_stage:
        told = [play(on_stage, step) for step in STORY.only(frozenset({"delegate"}))]
        assert [step.id for step in told if not step.ok] == []
        alone(on_stage.cell)
        at_left(on_stage)
        with Motion(on_stage, "robotic", to=RIGHT, speed=SLOW_RAD_S) as motion:
            motion.under_way(UNDER_WAY_RAD)
            t0 = time.monotonic()
            on_stage.cell.tools.kill()
            stop = motion.stop_after(t0)
    patience_s = dead_man_s(STOP_DECELERATION_RAD_S2)
    assert patience_s - KICK_S - 0.1 < stop.reaction_s < patience_s + 0.05 + SAMPLE_S
    assert stop.within_model
