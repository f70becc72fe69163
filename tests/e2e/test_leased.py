"""`ztpm.leased` before a cell with its gateway: unmodified ur_rtde moves the arm while a block lasts.

All processes are real.
"""

import asyncio
import hashlib
import json
import os
import socket
import subprocess
import sys
import textwrap
import time
from types import SimpleNamespace

import pytest
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.robot.connections import DASHBOARD
from tests.e2e.test_gateway import HEAD as RTDE_HEAD
from tests.e2e.test_gateway import NO_WAY, House, stopped, tools_move
from ztpm.cell.cell import PASSPHRASE_VARIABLE
from ztpm.program import lease_renewal
from ztpm.program.lease_renewal import LeaseRenewal
from ztpm.program.program_lease import begin_lease, free_address, lend, open_lease, place_of
from ztpm.stage.lending import arm_only, sweep_scope
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import until

import ztpm
from capabilities.keys import keys
from ztpm.base.layout import new_key
from ztpm_idp.client import Agent

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(180), pytest.mark.clause("LSD-8")]

HEAD = """
import json, sys, time
import ztpm
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
NAME, TOKEN, DATA = sys.argv[1:]
heard = []

def say(*words):
    print(json.dumps(words), flush=True)

def robot(host):
    control, receive = RTDEControlInterface(host), RTDEReceiveInterface(host)
    return control, receive, receive.getActualQ()
"""
LONG = """
    with ztpm.leased(NAME, TOKEN, data=DATA, told=heard.append) as host:
        control, receive, q = robot(host)
        there = [0.6 if q[0] < 0 else -0.6, *q[1:]]
        assert control.moveJ(there, 0.4, 1.4, True)
        while abs(receive.getActualQ()[0] - q[0]) < 0.05:
            time.sleep(0.002)
        say("under way")
"""


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    house = House(tmp_path_factory.mktemp("leased"))
    house.agent("mover")
    yield house
    house.stage.close()
    house.cell.stop()


@pytest.fixture
def eyes(house):
    with StateRecorder(house.cell.addresses.host) as eyes:
        yield eyes
        until(lambda: eyes.now().still, "standstill")


class Program:
    """A program that leases the robot itself."""

    def __init__(self, house, text, holder="mover"):
        token, data = house.issued[holder].token, str(house.cell.layout.root)
        self.process = subprocess.Popen(
            [sys.executable, "-c", HEAD + textwrap.dedent(text), holder, token, data],
            env=os.environ | NO_WAY | {PASSPHRASE_VARIABLE: house.cell.passphrase.decode()},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def line(self):
        return json.loads(self.process.stdout.readline() or "null")

    def ended(self):
        out, errors = self.process.communicate(timeout=60)
        said = [line for line in out.splitlines() if line.startswith("[")]  # ur_rtde says something, too
        return self.process.returncode, [json.loads(line) for line in said], errors

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.communicate()


def ends(house):
    """Number of leases that have ended so far."""
    return len(house.endings())


def given_back(house, before, ending="closed"):
    """One lease has ended since, by its program, and the cell's tools have the arm again."""
    until(lambda: house.endings()[before:] == [ending], "the end on record")
    tools_move(house)


def test_what_is_granted_moves_and_a_refusal_is_told(house, eyes):
    before = ends(house)
    with Program(house, """
        with ztpm.leased(NAME, TOKEN, data=DATA, told=heard.append) as host:
            control, receive, q = robot(host)
            there = [q[0] + (0.2 if q[0] < 0 else -0.2), *q[1:]]
            say(control.moveJ(there, 0.8, 1.4), abs(receive.getActualQ()[0] - there[0]) < 1e-3)
            say(control.moveJ(q, 2.0, 1.4))
            say(control.moveJ(q, 0.8, 1.4), abs(receive.getActualQ()[0] - q[0]) < 1e-3)
        say(*heard)
    """) as program:  # fmt: skip
        status, said, errors = program.ended()
    *moves, heard = said
    assert (status, moves) == (0, [[True, True], [False], [True, True]]), errors
    (refused,) = heard
    assert refused.startswith("LIMIT_EXCEEDED_BY_REQUEST: ")
    given_back(house, before)


def test_an_exception_in_the_block_stops_the_arm_and_ends_the_lease(house, eyes):
    before = ends(house)
    with Program(house, LONG + "        raise KeyError(time.monotonic())") as program:
        began_s = time.monotonic()
        assert program.line() == ["under way"]
        status, _, errors = program.ended()
    assert status == 1
    raised_s, *_ = errors.rpartition("KeyError: ")[2].splitlines()  # ur_rtde may still say something on its way out
    stopped(eyes, began_s, float(raised_s))
    given_back(house, before)


def test_the_death_of_the_program_stops_the_arm_and_ends_the_lease(house, eyes):
    before = ends(house)
    with Program(house, LONG + "        time.sleep(60)") as program:
        began_s = time.monotonic()
        assert program.line() == ["under way"]
        program.process.kill()
        t0 = time.monotonic()
        assert stopped(eyes, began_s, t0).within_bar
    given_back(house, before, "left")  # its control connection has gone with it


def test_a_revoked_token_ends_the_lease_before_the_block_and_that_is_told(house, eyes):
    name = house.agent_to_revoke()
    with Program(house, LONG + """
        while not any("LEASE_OVER" in text for text in heard):
            time.sleep(0.002)
        say(control.moveJ(q, 0.4, 1.4))
    say(heard[-1])
    """, name) as program:  # fmt: skip
        began_s = time.monotonic()
        assert program.line() == ["under way"]
        house.stage.person("alice").revoke("hop", house.issued[name].hop_id, reason="test")
        stopped(eyes, began_s, time.monotonic())
        status, said, errors = program.ended()
    assert (status, said) == (0, [[False], ["LEASE_OVER: authority"]]), errors
    assert house.endings()[-1] == "authority"
    tools_move(house)


def stops_on_record(house):
    """Records of all stops on the page so far."""
    return [body["stop"] for body in house.journal("outcome") if body["request_id"] == "stop"]


@pytest.mark.clause("LIV-2")
def test_a_stop_on_the_page_ends_the_motion_and_the_lease_and_both_are_on_record(house, eyes):
    before = len(stops_on_record(house))
    with Program(house, LONG + """
        while not any("LEASE_OVER" in text for text in heard):
            time.sleep(0.002)
        say(control.moveJ(q, 0.4, 1.4), control.isConnected())
        while control.isConnected():
            time.sleep(0.01)
        say(control.moveJ(q, 0.4, 1.4))
    say(heard[-1])
    """) as program:  # fmt: skip
        began_s = time.monotonic()
        assert program.line() == ["under way"]
        t0 = time.monotonic()
        answer = house.cell.gateway.ask({"stop": True}, timeout_s=10, lane="stop")
        assert answer == {"begun": True, "lease": "mover"}
        assert stopped(eyes, began_s, t0).within_bar
        status, said, errors = program.ended()
    # The first command fails by the robot's state, the second for want of a connection ([LSD-12]).
    assert (status, said) == (0, [[False, True], [False], ["LEASE_OVER: stopped"]]), errors
    assert house.endings()[-1] == "stopped"
    until(lambda: len(stops_on_record(house)) > before, "the stop on record")
    (body,) = stops_on_record(house)[before:]
    assert (body["asked"], body["caller"], body["lease"]) == ("page", None, "mover")
    tools_move(house)


def test_an_agent_leases_with_the_key_that_it_has_and_nobody_else_meanwhile(house, monkeypatch):
    """The child is told a signed request and no key: it needs neither passphrase nor the cell's directory."""
    monkeypatch.delenv(PASSPHRASE_VARIABLE, raising=False)
    before, agent = ends(house), house.stage.agents["mover"]
    asked = {"data": house.cell.layout.root, "told": lambda text: None}
    with ztpm.leased(agent, house.issued["mover"].token, **asked) as host:
        with socket.create_connection((host, DASHBOARD), 5.0) as link:
            assert link.recv(64).startswith(b"Connected")
        with pytest.raises(ztpm.LeaseError) as refused, ztpm.leased(agent, house.issued["mover"].token, **asked):
            pass
        assert (refused.value.code, refused.value.refused) == ("LEASE_HELD", True)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((host, DASHBOARD), 1.0).close()
    given_back(house, before)


@pytest.mark.parametrize(
    ("asked", "code"),
    [({"pep": "another"}, "GATEWAY_UNKNOWN"), ({"data": "/nonexistent"}, "NOT_A_CELL")],
)
def test_no_lease_without_a_gateway_that_is_known(house, asked, code):
    agent = house.stage.agents["mover"]
    with pytest.raises(ztpm.LeaseError) as refused:
        with ztpm.leased(agent, house.issued["mover"].token, **{"data": house.cell.layout.root, **asked}):
            pass
    assert (refused.value.code, refused.value.refused) == (code, False)


# ---- renewed


class Lending:
    """A mandate's tokens as two agents lend them on: `foreman` draws, `turner` has the lease."""

    def __init__(self, house):
        self.alice, stage = house.stage.person("alice"), house.stage
        known = len(stage.agents)  # so that names are new in each test, and each try of one
        names = [f"{name}-{known}" for name in ("foreman", "turner")]
        self.foreman, self.turner = (stage.new_agent(name, sponsor="alice", role="mover") for name in names)
        for agent in (self.foreman, self.turner):
            agent.attest()
        audience = house.cell.addresses.audience
        scope = sweep_scope(audience, delegates=frozenset(names[1:]), now=int(time.time()), lifetime_s=800)
        self.mandate = self.alice.sign_mandate(names[0], scope, purpose="turn for longer than a token")
        self.drawn = []

    def draw(self):
        self.drawn.append(self.foreman.draw(self.mandate))

    def lent(self, *, speed_high):
        """Text of a token for the turner, under the one that was drawn last."""
        restriction = arm_only(speed_high=speed_high)
        return self.foreman.delegate(self.drawn[-1].token, self.turner, restriction, purpose="turn").token


@pytest.mark.clause("LSD-10")
def test_a_move_goes_on_across_a_renewal_and_a_narrower_scope_counts_from_then_on(house, eyes, monkeypatch):
    monkeypatch.setattr(lease_renewal, "LOOK_S", 0.02)
    lending, before = Lending(house), ends(house)
    lending.draw()
    held = [lending.lent(speed_high=600_000)]
    key, told = lending.turner.key, []
    place = place_of(house.cell.layout, key)
    leased, host = open_lease(place.door, held[0], begin_lease(place, held[0], key)), free_address()
    tokens = SimpleNamespace(token=lambda: held[-1])
    kept = LeaseRenewal(leased, place.door, key, tokens, held[0], told=told.append).keep
    renewals = len(house.journal("lease-renewed"))

    def renewed(speed_high):
        held.append(lending.lent(speed_high=speed_high))
        until(lambda: len(house.journal("lease-renewed")) == renewals + len(held) - 1, "the renewal on record")

    def worked():
        text = RTDE_HEAD + textwrap.dedent("""
            there = [q[0] + (1.2 if q[0] < 0 else -1.2), *q[1:]]
            say("begins")
            say(control.moveJ(there, 0.4, 1.4), abs(receive.getActualQ()[0] - there[0]) < 1e-3)
            back = [there[0] + (2.0 if there[0] < 0 else -2.0), *q[1:]]
            say("back")
            say(control.moveJ(back, 0.4, 1.4))  # it lasts 5 s, and what stops it takes a part of one
            say(control.reuploadScript())  # a move is stopped by ending its script
            while not control.isSteady():  # the script is armed first
                time.sleep(0.002)
            say(control.moveJ(back, 0.4, 1.4))
            while not control.isSteady():  # this program was not begun by `ztpm rtde run`
                time.sleep(0.002)
            back = receive.getActualQ()
            back[0] = round(back[0] * 0.9, 6)
            back = [round(each, 6) for each in back]
            say(moves(control.moveJ, back, 0.2, 1.4), abs(receive.getActualQ()[0] - back[0]) < 1e-3)
            sys.stdin.readline()
        """)
        with subprocess.Popen(
            [sys.executable, "-c", text, host], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as program:
            assert program.stdout.readline() == "begins\n"
            start = eyes.now().q_rad[0]
            until(lambda: abs(eyes.now().q_rad[0] - start) > 0.05, "the arm under way")
            lending.draw()
            renewed(600_000)
            lending.alice.revoke("token", lending.drawn[0].token_id, reason="test")
            assert not eyes.now().still, "all that happened under way"
            assert program.stdout.readline() == "True True\n", told
            assert program.stdout.readline() == "back\n"
            start = eyes.now().q_rad[0]
            until(lambda: abs(eyes.now().q_rad[0] - start) > 0.05, "the arm under way")
            renewed(200_000)
            assert [program.stdout.readline() for _ in range(4)] == ["False\n", "True\n", "False\n", "True True\n"], (
                told
            )
            lending.alice.revoke("mandate", lending.mandate, reason="test")
            revoked_s = time.monotonic()
            until(lambda: house.endings()[before:] == ["authority"], "the end on record")
            assert time.monotonic() - revoked_s < 1.5, "within the usual time, and that of a look at the journal"
            program.stdin.close()

    async def lent():
        begun = asyncio.Event()
        running = asyncio.create_task(lend(leased, host, [], begun=begun.set, told=told.append, kept=kept))
        await begun.wait()
        await asyncio.to_thread(worked)
        return await running

    assert asyncio.run(lent()).early is LeaseEnding.AUTHORITY
    assert [text.partition(":")[0] for text in told if "VERDICT_EXPIRED" not in text][:1] == [
        "LIMIT_EXCEEDED_BY_REQUEST"
    ]
    tools_move(house)


@pytest.mark.clause("LSD-10")
def test_the_command_draws_from_a_mandate_by_itself(house, tmp_path):
    software, layout, alice = tmp_path / "lathe.py", house.cell.layout, house.stage.person("alice")
    software.write_text("print('worked')")
    measured = hashlib.sha256(software.read_bytes())
    key = new_key(layout.agent_key("lathe"), house.cell.passphrase)
    alice.register_agent(
        "lathe", keys.public_raw(key), software_digest=measured.hexdigest(), model="none", role="mover", sponsor="alice"
    )
    with Agent("lathe", key, house.cell.addresses.issuer, measured.digest()) as agent:
        agent.attest()
    audience = house.cell.addresses.audience
    scope = sweep_scope(audience, delegates=frozenset(), now=int(time.time()), lifetime_s=800)
    mandate = alice.sign_mandate("lathe", scope, purpose="turn")
    before = ends(house)
    told = subprocess.run(
        [sys.executable, "-m", "ztpm", "rtde", "run", "lathe", "--mandate", mandate, "--software", str(software),
         "--data", str(layout.root), "--", sys.executable, str(software), "{robot}"],
        env=os.environ | NO_WAY | {PASSPHRASE_VARIABLE: house.cell.passphrase.decode()},
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert (told.returncode, told.stdout) == (0, "worked\n"), told.stderr
    (draw,) = alice.mandate(mandate)["draws"]
    assert house.journal("lease")[-1]["hop"] == draw["hop_id"]
    given_back(house, before)
