"""Deciding without enforcing: the simulator alone, every record marked, and callers told the decision."""

import asyncio
import contextlib
import os
import socket
import subprocess
import sys
import threading
from functools import partial
from types import SimpleNamespace

import pytest
from capabilities.values.scope import Tier
from pep.base.errors import PepFault, RobotError
from pep.gate.gate import Gate
from pep.gate.observe_only import HIGHEST_MILLI, OBSERVED, Marked, Simulated, Unwatched
from pep.mcp.guard import DECISION_META
from pep.rtde.command.command_values import MoveJ
from policies.evidence.evidence import ImpactFault
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep import kit
from tests.pep.kit import MOVE, FailingJournal, Rig, full_scope, reading
from tests.pep.mcp.test_mcp import Cell, with_cell
from tests.pep.pit.scenes import HOME
from tests.pep.rtde.leased import leased_scope
from tests.pep.rtde.world import World
from tests.ztpm.point.test_tool_config import toml
from ursim.ports.launch import SimulatedController
from ztpm.point.simulator_check import ANSWER, PORT, QUESTION, recognise

from ztpm.point import gateway_server

pytestmark = pytest.mark.long

SIMULATED = Simulated("127.0.0.1")


@pytest.fixture
def observing(monkeypatch):
    """Every gate that the kit makes from here on observes."""
    monkeypatch.setattr(kit, "Gate", partial(Gate, unsafe_observe=SIMULATED))


@pytest.fixture
def rig(tmp_path, observing):
    rig = Rig(tmp_path)
    yield rig
    rig.gate.close()
    rig.journal.close()


def run(rig, **options):
    return asyncio.run(rig.gate.run(rig.call(rig.agent(), **options), rig.effect))


@pytest.mark.parametrize(
    ("impact", "effect", "reason"),
    [
        (reading(), Effect.PERMIT, Reason.PERMITTED),
        (reading(3, 2_500), Effect.DEFER, Reason.TIER_NEEDS_APPROVAL),
        (reading(4, 3_500), Effect.DENY, Reason.ABOVE_CEILING),
        (reading(1, 900, violations=("person",)), Effect.DENY, Reason.PHYSICS_VIOLATION),
        (ImpactFault("PERCEPTION_INVALID"), Effect.DENY, Reason.PERCEPTION_INVALID),
    ],
)
def test_everything_happens_and_the_record_says_what_was_decided(rig, impact, effect, reason):
    rig.physics.answer = impact
    answer = run(rig)
    assert (answer.decision.effect, answer.decision.reason) == (effect, reason)
    assert answer.observed is (effect is not Effect.PERMIT)
    assert len(rig.sent) == 1
    decision, outcome = rig.records()
    assert (decision["kind"], outcome["kind"], outcome["body"]["outcome"]) == ("decision", "outcome", "done")
    assert decision["body"]["decision"]["reason"] == reason
    assert [record["body"][OBSERVED] for record in rig.records()] == [True, True]
    assert rig.slot.holder is None
    assert answer.ask is None
    assert bool(rig.physics.remembered) is isinstance(impact, ImpactFault), "what was assessed begins where it was"


def test_what_cheap_evidence_denies_happens_without_physics(rig):
    holder = rig.agent(scope=full_scope(rig.clock.wall_s(), speed_high=300_000))
    answer = asyncio.run(rig.gate.run(rig.call(holder), rig.effect))
    assert (answer.decision.reason, answer.observed, len(rig.sent)) == (Reason.LIMIT_EXCEEDED_BY_REQUEST, True, 1)
    assert (rig.physics.asked, rig.physics.remembered) == (0, [rig.sent[0]]), "it begins from where the arm is"
    assert rig.slot.holder is None


def test_the_record_is_durable_before_the_effect_begins(rig):
    rig.physics.answer = reading(4, 3_500)
    seen = []
    rig.before_effect = lambda: seen.extend(r["body"]["decision"]["effect"] for r in rig.records("decision"))
    run(rig)
    assert seen == ["DENY"]


def test_no_record_no_effect(rig):
    rig.build(FailingJournal(rig.journal))
    rig.physics.answer = reading(4, 3_500)
    assert run(rig).decision.reason is Reason.RECORD_FAILED
    assert rig.sent == []


def test_one_motion_at_a_time(rig):
    rig.slot.holder = "another"
    answer = run(rig)
    assert (answer.decision.reason, answer.observed, rig.sent) == (Reason.BUSY, False, [])
    holder = rig.agent(scope=full_scope(rig.clock.wall_s(), speed_high=300_000))
    answer = asyncio.run(rig.gate.run(rig.call(holder), rig.effect))
    assert (answer.decision.reason, answer.observed, rig.sent) == (Reason.BUSY, False, [])
    assert rig.slot.holder == "another"


def test_nothing_ends_an_observed_motion(rig):
    rig.physics.answer = reading(4, 3_500)
    given = []

    async def effect(permit):
        given.append((permit.index_milli, permit.sighted, permit.standing()))
        return await rig.effect(permit)

    asyncio.run(rig.gate.run(rig.call(rig.agent()), effect))
    assert given == [(HIGHEST_MILLI, False, None)]
    assert HIGHEST_MILLI == 1_000 * int(Tier.SAFETY_CRITICAL)
    unwatched = object.__new__(Unwatched)
    assert unwatched.look((0.0,) * 6) is None


def test_what_a_shell_records_is_marked_too(rig):
    asyncio.run(rig.gate.record("incident", {"what": "torn-tail"}))
    assert rig.records("incident")[0]["body"] == {"what": "torn-tail", OBSERVED: True}
    assert Marked(rig.journal).append("incident", {"what": "x"})
    assert rig.records("incident")[1]["body"][OBSERVED] is True


def test_the_caller_is_told_its_result_and_what_would_have_been_decided(tmp_path, observing):
    from pep.base.clock import SystemClock

    cell = Cell(tmp_path, clock=SystemClock()).start()
    try:
        cell.physics.answer = reading(3, 2_500)
        result = with_cell(cell, lambda: cell.use(cell.agent(), "move_joint", MOVE))
        assert not result.is_error
        assert result.structured_content["outcome"] == "reached"
        told = result.meta[DECISION_META]
        assert (told["decision"], told["reason"], told[OBSERVED]) == ("DEFER", "TIER_NEEDS_APPROVAL", True)
        assert len(cell.arm.moves) == 1
        assert cell.issuer.asks == {}
    finally:
        cell.gate.close()
        cell.journal.close()


@pytest.mark.real_time
def test_a_leased_programs_command_that_was_denied_is_forwarded(tmp_path, observing):
    """Before physics, so that nothing but the command itself says from where and to where."""
    world = World(tmp_path)
    try:
        world.holder = world.agent(scope=leased_scope(world.clock.wall_s(), speed_high=300_000))
        world.at()
        held = world.decided(MoveJ((HOME[0] + 0.1, *HOME[1:]), 0.5, 1.4, asynchronous=False))
        assert held.answers[0] == "forward"
        (decision,) = world.records("decision")
        assert decision["body"]["decision"]["reason"] == Reason.LIMIT_EXCEEDED_BY_REQUEST
        assert decision["body"][OBSERVED] is True
    finally:
        world.gate.close()
        world.journal.close()


def test_a_gate_enforces_unless_it_is_told_otherwise(tmp_path):
    rig = Rig(tmp_path)
    try:
        rig.physics.answer = reading(4, 3_500)
        answer = run(rig)
        assert (answer.decision.effect, answer.observed, rig.sent) == (Effect.DENY, False, [])
        assert OBSERVED not in rig.records("decision")[0]["body"]
    finally:
        rig.gate.close()
        rig.journal.close()


# --- who is simulated


def test_the_simulated_controller_is_recognised():
    with SimulatedController.start(joints=(0.0, -1.57, 1.57, -1.57, -1.57, 0.0)) as controller:
        assert recognise(controller.host) == Simulated(controller.host)


@contextlib.contextmanager
def dashboard(answer):
    """A dashboard on an address of its own; `answer` makes the reply of a line, None hangs up."""
    host = f"127.{200 + os.getpid() % 50}.{os.getpid() // 50 % 250}.7"
    with socket.create_server((host, PORT)) as server:

        def serve():
            with contextlib.suppress(OSError):
                while True:
                    link, _ = server.accept()
                    with link, link.makefile("rwb") as lines:
                        lines.write(b"Connected: Universal Robots Dashboard Server\n")
                        lines.flush()
                        said = answer(lines.readline())
                        if said is not None:
                            lines.write(said)
                            lines.flush()

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield host
        server.shutdown(socket.SHUT_RDWR)
    thread.join(5)


NO_SIMULATOR = {
    "a robot": lambda line: b"could not understand: '" + line.strip() + b"'\n",
    "an echo": lambda line: line,
    "an old answer": lambda _: f"{ANSWER}{'0' * 32}\n".encode(),
    "one without end": lambda line: line.strip(),
    "one that hangs up": lambda _: None,
}


@pytest.mark.parametrize("name", NO_SIMULATOR)
def test_whoever_answers_otherwise_is_not_simulated(name):
    with dashboard(NO_SIMULATOR[name]) as host, pytest.raises(RobotError) as error:
        recognise(host)
    assert error.value.code is PepFault.NOT_SIMULATED


@pytest.mark.parametrize(
    "host", ["192.0.2.1", "localhost", "robot.example", "", "0.0.0.0", "127.1", "::ffff:192.0.2.1"]
)
def test_an_address_that_is_not_loopback_is_not_even_asked(host, monkeypatch):
    monkeypatch.setattr(socket, "create_connection", lambda *_, **__: pytest.fail("asked"))
    with pytest.raises(RobotError) as error:
        recognise(host)
    assert error.value.code is PepFault.NOT_SIMULATED


def test_the_question_is_no_command_of_a_robot():
    assert QUESTION.split()[0] not in {"stop", "play", "load", "popup", "power", "get", "set", "is", "safetystatus"}


def test_where_nobody_answers_nothing_is_simulated():
    with pytest.raises(RobotError) as error:
        recognise("127.99.99.99")
    assert error.value.code is PepFault.NOT_SIMULATED


def test_a_gateway_refuses_to_start_observing_what_is_not_simulated(tmp_path):
    journal, config = tmp_path / "journal.ndjson", tmp_path / "gateway.toml"
    with dashboard(NO_SIMULATOR["a robot"]) as host:
        config.write_text(toml(robot_host=f'"{host}"', journal_file=f'"{journal}"', state_dir=f'"{tmp_path}"'))
        ended = subprocess.run(
            [sys.executable, "-m", "ztpm.point.gateway_server", "--config", config, "--unsafe-observe"],
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert ended.returncode == 1
    assert ended.stderr.startswith("NOT_SIMULATED")
    assert ended.stdout == ""
    assert not journal.exists()


def test_a_gateway_that_observes_says_so_before_anything_else(monkeypatch, capsys):
    monkeypatch.setattr(gateway_server, "recognise", Simulated)
    monkeypatch.setattr(gateway_server, "opened_cell", lambda config: pytest.fail(capsys.readouterr().err))
    config = SimpleNamespace(robot_host="127.0.0.1")
    with pytest.raises(pytest.fail.Exception) as raised:
        asyncio.run(gateway_server.serve(config, unsafe_observe=True))
    assert str(raised.value).startswith("UNSAFE")
