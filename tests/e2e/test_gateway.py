"""Cell with its gateway, real processes all: the rights of an unmodified ur_rtde program, and its ends."""

import contextlib
import json
import os
import re
import secrets
import signal
import socket
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from functools import partial

import pytest
from opentelemetry import trace
from opentelemetry.trace import NonRecordingSpan, SpanContext, TraceFlags
from pep.base.operations import MOVE_LINEAR, SERVO_JOINT, SPEED_JOINT
from pep.rtde.command.limits import widest
from pep.rtde.robot.connections import DASHBOARD, PRIMARY
from evaluation.harness import copies
from tests.e2e import sabotage
from tests.e2e.collector import collecting
from tests.e2e.tls import TlsAddresses, reached_by_tls
from ztpm.base.layout import OPERATORS, Layout, write_private
from ztpm.cell.cell import PASSPHRASE_VARIABLE, Cell
from ztpm.cell.setup import free_addresses, initialise
from ztpm.demo.motion import Motion
from ztpm.stage.lending import sweep_scope
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import LEFT, Stage, until
from ztpm.stage.stopping import read_stop
from ztpm_idp.client import direct_http

# As long as all other tests with whole cells together.
pytestmark = [pytest.mark.e2e, pytest.mark.timeout(180)]

NO_WAY = dict.fromkeys(("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"), "http://127.0.0.1:9")
"""Proxies that no part of a cell may use."""
HEAD = """
import sys, time
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
control, receive = RTDEControlInterface(sys.argv[1]), RTDEReceiveInterface(sys.argv[1])
q = receive.getActualQ()

def say(*words):
    print(*words, flush=True)

def moves(command, *arguments):
    for _ in range(5):  # a machine that does much else holds a verdict up for longer than it lives
        if command(*arguments):
            return True
"""

MOVES = "say(control.moveJ([q[0] + 0.01, *q[1:]], 0.4, 1.4))"
HERE_THEN_MOVES = f"say('here')\nsys.stdin.readline()\n{MOVES}"


class Command:
    """A command of `ztpm rtde` by a holder."""

    def __init__(self, house, verb, holder, *more):
        addresses = house.cell.addresses
        command = [sys.executable, "-m", "ztpm", "rtde", verb, holder, "--token", str(house.tokens[holder])]
        places = ["--gateway", addresses.door, "--audience", addresses.audience]
        self.process = subprocess.Popen(
            [*command, *places, "--data", str(house.cell.layout.root), *more],
            env=os.environ | NO_WAY | {PASSPHRASE_VARIABLE: house.cell.passphrase.decode()},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def line(self):
        return self.process.stdout.readline().strip()

    def ended(self):
        out, errors = self.process.communicate(timeout=60)
        return self.process.returncode, out.splitlines(), errors

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.communicate()


class Run(Command):
    """A program under `ztpm rtde run`."""

    def __init__(self, house, text, holder="mover"):
        super().__init__(house, "run", holder, "--", sys.executable, "-c", HEAD + textwrap.dedent(text), "{robot}")


class House:
    """The cell, and its agents with their tokens in files; `settled` is told once its configuration is written."""

    def __init__(self, root, addresses=None, *, settled=lambda layout: None):
        layout, addresses = Layout(root / "cell"), addresses or free_addresses(secrets.token_bytes(16))
        passphrase = secrets.token_urlsafe(16).encode()
        initialise(layout, addresses, passphrase=passphrase, policy="paper-default", defer_timeout_s=20)
        settled(layout)

        self.broken = {}  # defects by name of the process that starts with one

        def begin(child, *command, environment):
            one = partial(sabotage.begin, copies.begin, self.broken[child]) if child in self.broken else copies.begin
            return one(child, *command, environment=environment | NO_WAY)

        self.cell = Cell.start(layout, addresses, passphrase=passphrase, joints=LEFT, begin=begin)
        self.stage = Stage(cell=self.cell, people={})
        self.stage.people = {name: self.stage.operator_from_disk(name) for name in OPERATORS}
        self.cell.register(self.stage.person("carol"))
        self.cell.start_enforcement()
        self.tokens, self.issued, self.folder = {}, {}, root

    def agent(self, name, *more):
        agent = self.stage.new_agent(name, sponsor="alice", role="mover")
        agent.attest()
        scope = sweep_scope(self.cell.addresses.audience, delegates=frozenset(), now=int(time.time()), lifetime_s=800)
        scope = replace(
            scope, grants=tuple(sorted((*scope.grants, *map(widest, more)), key=lambda g: (g.object, g.operation)))
        )
        self.issued[name] = self.stage.person("alice").issue(agent, scope, purpose="test")
        self.stage.tokens[name], self.tokens[name] = self.issued[name].token, self.folder / name
        write_private(self.tokens[name], self.issued[name].token.encode())

    def agent_to_revoke(self):
        """The name of one that nobody else uses."""
        name = f"brief-{secrets.token_hex(4)}"
        self.agent(name)
        return name

    def endings(self):
        return [body["ending"] for body in self.journal("lease-ended")]

    def journal(self, kind):
        return [row["body"] for row in self.stage.journal(since=0) if row["kind"] == kind]


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """One that is reached as from other machines, by TLS."""
    folder = tmp_path_factory.mktemp("gateway")
    addresses = TlsAddresses(free_addresses(secrets.token_bytes(16)).host)
    with contextlib.ExitStack() as ends:
        believed = ends.enter_context(pytest.MonkeyPatch.context())

        def settled(layout):
            believed.setenv("SSL_CERT_FILE", str(reached_by_tls(folder, addresses, layout.idp_config, ends)))

        spans = ends.enter_context(collecting())
        believed.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", spans.url)
        believed.setenv("OTEL_BSP_SCHEDULE_DELAY", "200")
        house = House(folder, addresses, settled=settled)
        house.spans = spans
        ends.callback(house.cell.stop)
        ends.callback(house.stage.close)
        house.agent("mover", SPEED_JOINT, SERVO_JOINT, MOVE_LINEAR)
        yield house


@pytest.fixture
def eyes(house):
    eyes = StateRecorder(house.cell.addresses.host)
    yield eyes
    until(lambda: eyes.now().still, "standstill")
    eyes.close()


def test_what_is_granted_moves_and_what_is_not_does_not(house, eyes):
    decided, refused = (len(house.journal(kind)) for kind in ("decision", "refusal"))
    with Run(house, """
        there = list(q)
        there[0] += 0.3
        say(moves(control.moveJ, there, 0.8, 1.4), abs(receive.getActualQ()[0] - there[0]) < 1e-3)
        say(control.moveJ(q, 2.0, 1.4))   # faster than the token says
        say(control.moveJ([2.9, *q[1:]], 0.8, 1.4))   # into the zone of tier 4, and out of every ceiling
        say(control.moveJ([float("nan"), *q[1:]], 0.8, 1.4))
        pose = receive.getActualTCPPose()
        pose[2] += 0.03
        say(moves(control.moveL, pose, 0.05, 0.3), abs(receive.getActualTCPPose()[2] - pose[2]) < 1e-3)
        say(control.jogStart([0, 0, 0.02, 0, 0, 0]))
        say(control.setPayload(5.0, [0, 0, 0]))
        say(moves(control.moveJ, q, 0.8, 1.4), abs(receive.getActualQ()[0] - q[0]) < 1e-3)
    """) as run:  # fmt: skip
        status, said, errors = run.ended()
    assert said == ["True True", "False", "False", "False", "True True", "False", "False", "True True"], errors
    assert status == 0
    # ur_rtde writes there too, at the same time.
    told = [reason for reason in re.findall(r"ztpm: ([A-Z_]+):", errors) if reason != "VERDICT_EXPIRED"]
    assert {"NOT_GRANTED", "PAYLOAD_MISMATCH", "LIMIT_EXCEEDED_BY_REQUEST", "NOT_FINITE"} <= set(told), errors
    assert len(told) == 5, "each refusal once, and nothing else"
    reasons = [body["decision"]["reason"] for body in house.journal("decision")[decided:]]
    assert reasons.count("PERMITTED") == 3
    assert "LIMIT_EXCEEDED_BY_REQUEST" in reasons
    refusals = {body["reason"] for body in house.journal("refusal")[refused:]}
    assert {"NOT_GRANTED", "PAYLOAD_MISMATCH", "NOT_FINITE"} <= refusals, (
        "whoever refused: the judge, or the line before"
    )


def test_a_program_that_runs_already_is_lent_a_lease(house, eyes):
    with Command(house, "connect", "mover", "--json") as lent:
        told = json.loads(lent.line())
        assert told["ready"]
        text = HEAD + MOVES
        program = subprocess.run(
            [sys.executable, "-c", text, told["robot"]], capture_output=True, text=True, timeout=60, check=True
        )
        assert program.stdout.split() == ["True"]
        assert lent.ended()[0] == 0  # with the program


def test_a_lease_is_given_back_at_will(house):
    with Command(house, "connect", "mover", "--json") as lent:
        assert json.loads(lent.line())["ready"]
        lent.process.send_signal(signal.SIGINT)
        assert lent.ended()[0] == 0


def test_a_gateway_whose_certificate_is_not_believed_is_told_nothing(house, monkeypatch):
    monkeypatch.delenv("SSL_CERT_FILE")
    with Command(house, "connect", "mover", "--json") as lent:
        status, said, _ = lent.ended()
    assert (status, json.loads(said[-1])["code"]) == (1, "REGISTRY_UNAVAILABLE")


def test_a_gateway_that_is_not_registered_for_the_robot_is_told_nothing(house):
    with Command(house, "connect", "mover", "--json", "--pep", "another") as lent:
        status, said, _ = lent.ended()
    assert (status, json.loads(said[-1])["code"]) == (2, "GATEWAY_UNKNOWN")


OTHERS_TOO = """
from rtde_io import RTDEIOInterface
outputs = RTDEIOInterface(sys.argv[1])
"""


@pytest.mark.clause("LSD-12")
@pytest.mark.parametrize(
    ("ends", "status"),
    [
        (OTHERS_TOO + "del control\ntime.sleep(0.5)\nsay(receive.getRuntimeState())\nsys.exit(3)", 3),
        ("control.disconnect()\nsay(receive.getRuntimeState())\nraise ValueError", 1),
    ],
)
def test_a_program_ends_as_it_wants_to(house, ends, status):
    with Run(house, ends) as run:
        found, said, errors = run.ended()
    assert (found, said) == (status, ["1"]), errors
    assert not re.search(r"terminate called|RTDE\w+ (boost|Exception)|connection", errors), errors


def test_streams_flow(house, eyes):
    with Run(house, """
        for _ in range(250):
            start = control.initPeriod()
            q[0] += 0.0006
            assert control.servoJ(q, 0.0, 0.0, 0.002, 0.1, 300), "servoJ"
            control.waitPeriod(start)
        control.servoStop()
        say(receive.getActualQ()[0] - q[0] > -0.05)
        begun = receive.getActualQ()[0]
        for _ in range(2500):
            start = control.initPeriod()
            assert control.speedJ([-0.2, 0, 0, 0, 0, 0], 0.5, 0.05), "speedJ"
            control.waitPeriod(start)
            if receive.getActualQ()[0] < begun - 0.03:
                break  # how long the first step is judged is the machine's affair
        control.speedStop(10.0)
        say(receive.getActualQ()[0] < begun - 0.03)
    """) as run:  # fmt: skip
        status, said, errors = run.ended()
    assert (status, said) == (0, ["True", "True"]), errors


def stopped(eyes, began_s, t0):
    until(lambda: eyes.now().still, "standstill")
    stop = read_stop(eyes.since(began_s), at_s=t0, acceleration_rad_s2=1.4)
    assert stop is not None
    assert stop.within_model
    return stop


LONG = """
    there = list(q)
    there[0] = 0.6 if q[0] < 0 else -0.6
    say("begins")
    say(control.moveJ(there, 0.4, 1.4))
"""


def under_way(eyes, run):
    began_s, start = time.monotonic(), eyes.now().q_rad
    assert run.line() == "begins"
    until(lambda: abs(eyes.now().q_rad[0] - start[0]) > 0.05, "the arm under way")
    return began_s


def test_a_program_that_is_killed_leaves_a_standing_arm(house, eyes):
    with Run(house, "import os\nsay('pid', os.getpid())\n" + textwrap.dedent(LONG)) as run:
        pid = int(run.line().split()[1])
        began_s = under_way(eyes, run)
        os.kill(pid, signal.SIGKILL)
        t0 = time.monotonic()
        assert stopped(eyes, began_s, t0).within_bar
        assert run.ended()[0] == 128 + signal.SIGKILL


def test_the_death_of_ztpm_run_stops_the_arm(house, eyes):
    with Run(house, LONG) as run:
        began_s = under_way(eyes, run)
        run.process.kill()
        t0 = time.monotonic()
        assert stopped(eyes, began_s, t0).within_bar


def test_a_revoked_token_stops_the_arm_and_ends_the_lease(house, eyes):
    name = house.agent_to_revoke()
    with Run(house, LONG + "    time.sleep(60)", name) as run:
        began_s = under_way(eyes, run)
        house.stage.person("alice").revoke("hop", house.issued[name].hop_id, reason="test")
        t0 = time.monotonic()
        stopped(eyes, began_s, t0)
        assert run.line() == "False"
        until(lambda: house.endings()[-1:] == ["authority"], "the end on record")
        run.process.send_signal(signal.SIGTERM)
        status, _, errors = run.ended()
    assert status == 128 + signal.SIGTERM
    assert "\nLEASE_OVER: authority" in errors
    assert "ztpm: REVOKED" in errors or "ztpm: LEASE_OVER: authority" in errors, "why the move had failed"


def test_a_look_that_breaks_keeps_no_lease_open(house):
    """The task that looks after the leases goes on."""
    name = house.agent_to_revoke()
    house.broken["gateway"] = "gateway_look_breaks"
    house.cell.start_gateway()
    try:
        with Run(house, "say('here')\nwhile control.isConnected():\n    time.sleep(0.05)", name) as run:
            assert run.line() == "here"
            house.stage.person("alice").revoke("hop", house.issued[name].hop_id, reason="test")
            until(lambda: house.endings()[-1:] == ["authority"], "the end on record")
            assert "LEASE_OVER: authority" in run.ended()[2]
        said = [json.loads(line) for line in house.cell.gateway.output if line.startswith("{")]
        broke = [line for line in said if str(line.get("event")).startswith("leases: ")]
        assert len(broke) == 1, ("once in a minute", said)
        assert broke[0]["error"] == "RuntimeError", broke
        assert any("gateway_server.py" in place for place in broke[0]["at"]), broke
    finally:
        house.broken.clear()
        house.cell.start_gateway()


# ---- the cell's tools, before the same arm


def aside(house, by_rad=0.02):
    """Place of the arm, and a little farther."""
    base, *others = house.stage.rounded_joints
    return (round(base + (by_rad if base < 0 else -by_rad), 6), *others)


def across(house):
    """The other end of the sweep."""
    base, *others = house.stage.rounded_joints
    return (0.6 if base < 0 else -0.6, *others)


def tools_move(house):
    """A tool has moved the arm, as soon as tools have it again."""
    until(lambda: house.stage.move("mover", to=aside(house), speed=0.4).decision == "PERMIT", "the tools' arm")


def test_tools_and_programs_have_the_arm_in_turns(house, eyes):
    tools_move(house)
    with Run(house, HERE_THEN_MOVES) as run:
        assert run.line() == "here"
        before = eyes.now().q_rad
        answer = house.stage.move("mover", to=aside(house), speed=0.4)
        assert (answer.decision, answer.reason) == ("DENY", "ROBOT_NOT_EXCLUSIVE")
        assert eyes.now().q_rad == pytest.approx(before, abs=1e-4)
        assert house.stage.ask("mover", "read_state", {}).decision == "PERMIT", "and nobody is kept from looking"
        run.process.stdin.write("\n")
        run.process.stdin.flush()
        status, said, errors = run.ended()
    assert (status, said) == (0, ["True"]), errors
    tools_move(house)


def test_one_trace_goes_from_a_token_to_its_effect(house):
    """The caller's own: at the provider, tool server and gateway, in both journals, and in the ledger's index."""
    trace_id = secrets.token_hex(16)
    ids = SpanContext(
        int(trace_id, 16), 0xB7AD6B7169203331, is_remote=False, trace_flags=TraceFlags(TraceFlags.SAMPLED)
    )
    name = f"traced-{trace_id[:6]}"
    with trace.use_span(NonRecordingSpan(ids)):
        house.agent(name)
        answer = house.stage.ask(name, "read_state", {})
    assert answer.decision == "PERMIT"
    services = {"ztpm-idp", "ztpm-tools", "ztpm-gateway"}
    until(lambda: {span["service"] for span in house.spans.of(trace_id)} == services, "spans of all three")

    def calls():
        """Number of calls at the gateway: one whose verdict came too late was made again."""
        return [span["name"] for span in house.spans.of(trace_id)].count("tools/call read_state")

    def decided():
        """Service, decision and reason of each decision's span."""
        several = [span for span in house.spans.of(trace_id) if span["name"] == "ztpm.decide"]
        return [(s["service"], s["said"]["ztpm.decision"], s["said"]["ztpm.reason"]) for s in several]

    # Spans come in batches: that of a call may come after that of its decision.
    until(lambda: calls() and len(decided()) == calls(), "a decision's span of each call")
    assert decided()[-1] == ("ztpm-gateway", "PERMIT", "PERMITTED")
    traced = {("ztpm-idp", "Issue"), ("ztpm-gateway", "read_state")}

    def operations():
        return {(span["service"], span["said"].get("ztpm.operation")) for span in house.spans.of(trace_id)}

    until(lambda: operations() >= traced, "the spans of the token and of the effect")

    def outcomes():
        own = [
            body for body in house.journal("decision") + house.journal("outcome") if body.get("trace_id") == trace_id
        ]
        return [bool(body.get("outcome")) for body in own]

    each = [False] * calls() + [True] * calls()
    until(lambda: outcomes() == each, "the outcome of each call, which is on record after its answer")
    carol = house.stage.person("carol")
    wanted = {"token-issued", "ticket", "decision", "outcome"}
    until(lambda: {row["kind"] for row in carol.search_rows({"trace": trace_id})} >= wanted, "the ledger's index")
    told = json.dumps(house.spans.of(trace_id))
    assert house.issued[name].token not in told and house.issued[name].token_id not in told


def test_tool_server_and_gateway_tell_their_health(house):
    addresses = house.cell.addresses
    with direct_http.client(5.0) as http:
        for door in (addresses.audience, addresses.door):
            origin = "/".join(door.split("/")[:3])
            assert http.get(f"{origin}/livez").json() == {"alive": True}
            until(lambda: http.get(f"{origin}/readyz").json() == {"ready": True}, "a view that is young")  # noqa: B023
            assert http.post(f"{origin}/readyz").status_code == 405


def test_a_tool_that_moves_keeps_the_arm(house, eyes):
    tools_move(house)
    with Motion(
        house.stage, "mover", to=aside(house, 0.6), speed=0.06
    ) as motion:  # longer than a program takes to come
        motion.under_way(0.05)
        with Run(house, "say('here')") as run:
            status, said, errors = run.ended()
        answer = motion.answer()
    assert (answer.decision, answer.content["outcome"]) == ("PERMIT", "reached"), answer.content
    assert (status, said) == (3, []), errors
    assert "LEASE_HELD" in errors


def test_a_tools_stop_ends_a_programs_motion(house, eyes):
    with Run(house, LONG) as run:
        began_s = under_way(eyes, run)
        t0 = time.monotonic()
        assert house.stage.ask("mover", "stop", {}).decision == "PERMIT"
        stopped(eyes, began_s, t0)  # a client's whole conversation later
        assert run.line() == "False"


@pytest.mark.parametrize(("port", "words"), [(DASHBOARD, b"stop\n"), (PRIMARY, b"stopj(0.1)\n")])
def test_anybodys_stop_ends_a_tools_motion(house, eyes, port, words):
    """The tool sees that it was a stop: its other work is dropped, and its next motion is done."""
    tools_move(house)
    with Motion(house.stage, "mover", to=across(house), speed=0.4) as motion:
        motion.under_way(0.05)
        with socket.create_connection((house.cell.addresses.gateway_host, port), 5.0) as stranger:
            t0 = time.monotonic()
            stranger.sendall(words)
            stop = motion.stop_after(t0)
        answer = motion.answer()
    assert stop.within_model
    assert stop.within_bar
    assert answer.content["outcome"] == "stopped", answer.content
    tools_move(house)


@pytest.mark.parametrize("who", ["gateway", "tools"])
def test_a_tools_motion_does_not_outlive_who_carries_it_out(house, eyes, who):
    """The controller's watchdog ends what a dead gateway began; the gateway ends what nobody waits for any more."""
    tools_move(house)
    with Motion(house.stage, "mover", to=across(house), speed=0.4) as motion:
        motion.under_way(0.05)
        t0 = time.monotonic()
        house.cell.children[who].kill()
        stop = motion.stop_after(t0)
    assert stop.within_model
    assert stop.within_bar
    {"gateway": house.cell.start_gateway, "tools": house.cell.start_tools}[who]()
    tools_move(house)


def test_the_gateways_death_stops_the_arm_and_its_next_life_serves(house, eyes):
    with Run(house, LONG) as run:
        began_s = under_way(eyes, run)
        t0 = time.monotonic()
        house.cell.gateway.kill()
        assert stopped(eyes, began_s, t0).within_bar
    house.cell.start_gateway()
    with Run(house, MOVES) as run:
        status, said, errors = run.ended()
    assert (status, said) == (0, ["True"]), errors


def without_robot(house, there):
    """No tool moves an arm that says nothing."""
    until(lambda: house.stage.move("mover", to=there, speed=0.4).reason == "ROBOT_NOT_RUNNING", "no robot")


@pytest.mark.clause("RTDE-18", "LSD-2")
def test_a_controller_that_was_switched_off_is_served_when_it_is_back(house):
    """Nobody begins the gateway or the tool server anew for it."""
    tools_move(house)
    assert house.stage.move("mover", to=aside(house, 0.1), speed=0.4).decision == "PERMIT"
    there = aside(house)
    house.cell.robot.kill()
    without_robot(house, there)
    house.cell.start_robot()
    house.stage.eyes = None
    until(lambda: house.stage.move("mover", to=there, speed=0.4).reason == "SEQUENCE_DRIFT", "an arm that is elsewhere")
    with Run(house, MOVES) as run:  # which sees where it is
        status, said, errors = run.ended()
    assert (status, said) == (0, ["True"]), errors
    tools_move(house)


@pytest.mark.clause("RTDE-18")
def test_a_controller_that_fell_silent_is_served_when_it_is_back(house):
    """No connection is closed, as when its power is cut."""
    tools_move(house)
    there = aside(house)
    with Run(house, HERE_THEN_MOVES) as run:
        assert run.line() == "here"
        house.cell.robot.popen.send_signal(signal.SIGSTOP)
        until(lambda: house.endings()[-1:] == ["robot"], "the end on record")
        run.process.stdin.write("\n")
        run.process.stdin.flush()
        time.sleep(3.0)  # meanwhile each connection is given up, and had again from a port that says nothing
        house.cell.robot.kill()
        _, said, errors = run.ended()
    assert "True" not in said
    assert "LEASE_OVER: robot" in errors
    without_robot(house, there)
    house.cell.start_robot()
    house.stage.eyes = None
    tools_move(house)
