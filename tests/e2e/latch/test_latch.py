"""Cell whose policies latch: a stop, a restart, refusals, a clearing at the terminal, a motion again."""

import json
import os
import subprocess
import sys

import pytest
from tests.e2e.test_gateway import House, Run
from ztpm.base.stop_call import StopAddress, ask_gateway
from ztpm.cell.cell import PASSPHRASE_VARIABLE
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import until

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(240), pytest.mark.clause("LIV-7", "LSD-21", "LSD-22", "LSD-23")]

POLICY = """
name = "latching"
version = 1
extends = "paper-default"
latch = "person"
latch_on = ["client-lost"]   # and no look at a moving arm that came late, on a machine that does much else
"""


def settled(layout):
    """The gateway's configuration, whose policy set latches after the loss of a program."""
    policy = layout.root.parent / "latching.toml"
    policy.write_text(POLICY)
    text = layout.gateway_config.read_text()
    assert 'policy = "paper-default"' in text
    layout.gateway_config.write_text(text.replace('policy = "paper-default"', f'policy = "{policy}"'))


@pytest.fixture
def house(tmp_path_factory):
    house = House(tmp_path_factory.mktemp("latch"), settled=settled)
    house.agent("mover")
    yield house
    house.stage.close()
    house.cell.stop()


def ztpm(house, *arguments, who="bob"):
    """Exit status and answer of a command that a person gives at a terminal."""
    command = [sys.executable, "-m", "ztpm", *arguments, "--data", str(house.cell.layout.root), "--as", who, "--json"]
    environment = os.environ | {PASSPHRASE_VARIABLE: house.cell.passphrase.decode()}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)
    return done.returncode, json.loads(done.stdout)


SMALL = "[q[0] + 0.02, *q[1:]], 0.4, 1.4)"


def moved(house, motion=f"moves(control.moveJ, {SMALL}"):
    """Lines of a program that makes a small motion, and all that it was told."""
    with Run(house, f"say({motion})") as run:
        _, lines, errors = run.ended()
    return lines, errors


def test_a_lost_program_latches_the_robot_until_a_person_clears_it(house):
    assert moved(house)[0] == ["True"], "an ordinary end of a program latches nothing"
    assert house.journal("latched") == []

    eyes = StateRecorder(house.cell.addresses.host)
    with Run(house, "say('here')\ncontrol.moveJ([q[0] + 1.2, *q[1:]], 0.2, 1.0)") as run:
        assert run.line() == "here"
        until(lambda: not eyes.now().still, "a motion")
        run.process.kill()
    until(lambda: eyes.now().still, "standstill")
    until(lambda: house.journal("latch-retreat"), "a latch on record, with a way out")
    (latched,), (way,) = house.journal("latched"), house.journal("latch-retreat")
    assert (latched["cause"], latched["tier"], latched["approvers"]) == ("client-lost", 1, 1)
    assert way["retreat"][0]["tier"] <= 3
    assert way["retreat"][0]["turns"]

    for again in range(2):
        if again:
            house.cell.gateway.kill()
            house.cell.end("gateway")
            house.cell.start_gateway()
        lines, errors = moved(house, f"control.moveJ({SMALL}")
        assert lines == ["False"], errors
        assert "ROBOT_LATCHED" in errors
        assert latched["latch_id"] in errors
        denied = house.journal("decision")[-1]["decision"]
        assert (denied["effect"], denied["reason"]) == ("DENY", "ROBOT_LATCHED")

    status, listed = ztpm(house, "latch", "list")
    assert (status, [row["latch_id"] for row in listed["latches"]]) == (0, [latched["latch_id"]])
    status, shown = ztpm(house, "latch", "show", latched["latch_id"])
    assert (shown["cause"], shown["retreat"], shown["state"]) == ("client-lost", way["retreat"], "waits")
    here = eyes.now().q_rad
    status, told = ztpm(house, "latch", "clear", latched["latch_id"], "--yes")
    assert (status, told["state"]) == (0, "released")
    until(lambda: house.journal("latch-cleared"), "a clearing on record")
    (cleared,) = house.journal("latch-cleared")
    assert (cleared["latch_id"], cleared["approvers"]) == (latched["latch_id"], ["bob"])
    assert max(abs(a - b) for a, b in zip(eyes.now().q_rad, here, strict=True)) < 1e-3, "clearing moves nothing"

    assert moved(house)[0] == ["True"]
    stopped_by_a_known_person(house, eyes)
    until(
        lambda: {"latched", "latch-retreat", "latch-cleared", "stop"} <= set(kinds(house)),
        "the records in the provider's ledger",
    )
    assert len(house.journal("latched")) == 2
    eyes.close()


def stopped_by_a_known_person(house, eyes):
    """Stop of a moving arm with a known person's word: it stays stopped, though the policies name no such cause."""
    place = StopAddress.of(house.cell.layout.gateway_config)
    said = ask_gateway(place, timeout_s=5)
    assert (said["person"], said["latch"]) == ("", {"latched": False})

    with Run(house, "say('here')\ncontrol.moveJ([q[0] + 1.2, *q[1:]], 0.2, 1.0)") as run:
        assert run.line() == "here"
        until(lambda: not eyes.now().still, "a motion")
        status, told = ztpm(house, "stop", "--reason", "a glove lies in its way")
    assert (status, told["by"], told["person"], told["lease"]) == (0, "gateway", "bob", "mover")
    until(lambda: eyes.now().still, "standstill")
    (word,), latched = house.journal("stop"), house.journal("latched")[-1]
    assert (latched["cause"], latched["person"], latched["tier"]) == ("asked", "bob", 1)
    assert latched["request_id"], "of the motion that the stop before the word has ended"
    assert (word["person"], word["reason"], word["latch_id"]) == ("bob", "a glove lies in its way", latched["latch_id"])
    assert ask_gateway(place, word["word"], timeout_s=5)["fault"] == "STOP_USED"
    assert "ROBOT_LATCHED" in moved(house, f"control.moveJ({SMALL}")[1]

    until(lambda: ztpm(house, "latch", "show", latched["latch_id"])[1].get("person") == "bob", "a latch told to people")
    assert ztpm(house, "latch", "clear", latched["latch_id"], "--yes", who="carol")[1]["state"] == "released"
    until(lambda: len(house.journal("latch-cleared")) == 2, "a clearing on record")
    assert moved(house)[0] == ["True"]


def kinds(house):
    """Kinds of the records that the provider's ledger holds."""
    for line in house.stage.person("carol").export_ledger().splitlines()[:-1]:
        entry = json.loads(line)
        if entry["kind"] == "pep-record":
            yield entry["body"]["record"]["kind"]
