"""A client without a lease: real ur_rtde sees everything, and nothing that it says moves or sets anything."""

import asyncio
import contextlib
import socket
import struct
import subprocess
import sys
import textwrap
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from pep.rtde.line.gateway import GUESTS, LINES, MAX_STOP, STOPS, Gateway, StatePorts
from pep.rtde.line.lease_stop import StopMeans
from pep.rtde.line.relay import AT_ONCE, UNANSWERED, StateRelay
from pep.rtde.robot.connections import DASHBOARD, PRIMARY, REALTIME, RTDE, SECONDARY
from tests.pep.rtde.packages import received
from pep.rtde.wire.codec import Framer, Recipe, decode_answer, encode_answer, encode_request
from pep.rtde.wire.messages import (
    AskControlVersion,
    ControlVersion,
    InputsAnswer,
    OutputsAnswer,
    Pause,
    PauseAnswer,
    ProtocolAnswer,
    RequestProtocol,
    RtdeMessage,
    SetupInputs,
    SetupOutputs,
    Start,
    StartAnswer,
    Values,
    WireError,
)
from pep.rtde.wire.recipes import io_recipes
from pep.rtde.wire.variables import INPUTS, VariableType
from tests.pep.kit import HOST
from tests.pep.rtde.campaign.race import Words
from tests.pep.test_cell import Child
from tests.ursim.plain import Plain

D = VariableType.DOUBLE
HERE = f"{HOST.rsplit('.', 1)[0]}.13"


def read(said, protocol=2):
    return [decode_answer(frame, protocol) for frame in Framer(0xFFFF).feed(said)]


class Talk:
    """A relay with both its neighbours made by hand."""

    def __init__(self):
        self.relay = StateRelay()

    def ask(self, *requests, protocol=2):
        return self.relay.asked(b"".join(encode_request(each, protocol) for each in requests))

    def answer(self, *answers, protocol=2):
        return self.relay.answered(b"".join(encode_answer(each, protocol) for each in answers)).to_client

    def begun(self):
        self.ask(RequestProtocol(2), protocol=1)
        self.answer(ProtocolAnswer(True), protocol=1)
        return self

    def streaming(self):
        self.begun().ask(SetupOutputs(("timestamp",), 500.0))
        self.answer(OutputsAnswer((D,), 1))
        self.ask(Start())
        self.answer(StartAnswer(True))
        return self


def package(value=1.5, number=1):
    return Values(number, struct.pack(">d", value))


def test_inputs_belong_to_somebody_else_and_the_controller_is_not_asked():
    said = Talk().begun().ask(SetupInputs(("input_int_register_0", "input_double_register_0", "nothing")))
    assert said.to_robot == b""
    assert read(said.to_client) == [InputsAnswer((VariableType.IN_USE, VariableType.IN_USE, VariableType.NOT_FOUND), 0)]


def test_answers_keep_the_order_of_their_requests():
    talk = Talk().begun()
    said = talk.ask(AskControlVersion(), SetupInputs(("input_int_register_0",)))
    assert said.to_client == b""
    version = ControlVersion(5, 11, 0, 0)
    assert read(talk.answer(version)) == [version, InputsAnswer((VariableType.IN_USE,), 0)]


def test_packages_go_one_for_one():
    talk = Talk().streaming()
    assert read(talk.answer(package(1.0), package(2.0))) == [package(1.0), package(2.0)]
    text = RtdeMessage("hello", "robot", 3)
    assert read(talk.answer(text)) == [text]
    talk.ask(Pause())
    assert read(talk.answer(package(3.0), PauseAnswer(True), text)) == [package(3.0), PauseAnswer(True)]


def test_a_text_during_set_up_is_kept_from_a_client_that_would_take_it_for_its_answer():
    talk = Talk().begun()
    talk.ask(SetupOutputs(("timestamp",), 500.0))
    assert talk.answer(RtdeMessage("hello", "robot", 3)) == b""


@pytest.mark.parametrize(
    "requests",
    [
        [Values(1, b"\0" * 4)],
        [RtdeMessage("go", "me", 3)],
        [AskControlVersion()] * (UNANSWERED + 1),
        [AskControlVersion(), RequestProtocol(1)],
        [SetupInputs(("input_int_register_0",)), RequestProtocol(1)],
    ],
)
def test_what_a_client_may_not_say_ends_the_connection(requests):
    with pytest.raises(WireError):
        Talk().begun().ask(*requests)


@pytest.mark.parametrize(
    "answers",
    [
        [package(number=2)],
        [Values(1, b"\0" * 9)],
        [StartAnswer(True)],
        [ProtocolAnswer(True)],
        [OutputsAnswer((D,), 1)],
    ],
)
def test_what_no_controller_says_ends_it_too(answers):
    with pytest.raises(WireError):
        Talk().streaming().answer(*answers)


@given(st.lists(st.binary(max_size=40), max_size=8), st.booleans())
def test_nothing_but_a_wire_error_comes_of_any_bytes(pieces, robot):
    talk = Talk().streaming()
    for piece in pieces:
        try:
            said = talk.relay.answered(piece) if robot else talk.relay.asked(piece)
        except WireError:
            return
        assert robot or all(frame.kind is not None for frame in Framer().feed(said.to_robot))


# ---- on the wire


@pytest.fixture(scope="module")
def controller():
    child = Child("ursim", "--host", HOST)
    yield child
    child.end()


STOPPINGS = []
"""Stops that the gateway has been told of."""


@pytest.fixture(scope="module")
def gateway(controller):
    """A gateway in a thread of its own, since the clients of this process block."""
    stop, ready = [], threading.Event()

    async def serve():
        loop = asyncio.get_running_loop()
        ports = StatePorts(HOST, stop_deceleration_rad_s2=STOP_DECELERATION_RAD_S2, stopping=STOPPINGS.append)
        gateway, ended = Gateway(ports), asyncio.Event()
        await gateway.listen(HERE)
        stop.append(lambda: loop.call_soon_threadsafe(ended.set))
        ready.set()
        await ended.wait()
        gateway.close()

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    assert ready.wait(10)
    yield HERE
    stop[0]()
    thread.join(10)


def program(text, *arguments):
    """The last line that an unmodified program prints, in a process of its own: ur_rtde's constructors wait for nobody."""
    ran = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(text), *arguments],
        capture_output=True,
        text=True,
        timeout=40,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.splitlines()[-1]


@pytest.mark.e2e
@pytest.mark.timeout(60)
def test_a_receiver_sees_what_it_would_see_at_the_robot(gateway):
    told = program(
        """
        import sys, time
        from rtde_receive import RTDEReceiveInterface
        here, direct = (RTDEReceiveInterface(host) for host in sys.argv[1:])
        first = here.getTimestamp()
        while here.getTimestamp() < first + 2.0:
            time.sleep(0.001)
        print(max(abs(a - b) for a, b in zip(here.getActualQ(), direct.getActualQ())))
        here.disconnect(), direct.disconnect()
        """,
        gateway,
        HOST,
    )
    assert float(told) < 1e-9


@pytest.mark.e2e
@pytest.mark.timeout(60)
def test_who_would_move_or_set_cannot_even_begin(gateway):
    said = program(
        """
        import sys
        from rtde_control import RTDEControlInterface
        try:
            RTDEControlInterface(sys.argv[1], 500.0, RTDEControlInterface.FLAG_NO_WAIT | 0x40 | 0x80)
            print("connected")
        except RuntimeError as error:
            print("refused", error)
        """,
        gateway,
    )
    assert said.startswith("refused")
    assert "already in use" in said
    told = (
        "actual_q", "target_speed_fraction", "actual_digital_output_bits", "tool_output_voltage", "input_int_register_23",
        "standard_analog_output0", "standard_analog_output1", "input_double_register_18", "input_int_register_18",
    )  # fmt: skip
    with Words(HOST, told) as words:
        before = words.until(lambda said: True)[-1]
        tried = program(
            """
            import os, sys
            from rtde_io import RTDEIOInterface
            try:
                io = RTDEIOInterface(sys.argv[1])
            except RuntimeError:
                print("refused", flush=True)
                os._exit(0)
            io.setStandardDigitalOut(2, True)
            io.setSpeedSlider(0.2)
            print("tried", flush=True)
            os._exit(0)
            """,
            gateway,
        )
        assert tried == "refused"
        with Plain(gateway) as raw:  # one that does not take no for an answer
            own = io_recipes(0)[1:4]
            assert [raw.ask(SetupInputs(recipe)).recipe for recipe in own] == [0, 0, 0]
            ones = b"".join(
                encode_request(
                    Values(number, Recipe(names, [INPUTS[name] for name in names]).pack(dict.fromkeys(names, 1))), 2
                )
                for number, names in enumerate(own, 1)
            )
            raw.socket.sendall(ones)
            assert raw.ended()
        assert [said for said in words.for_s(0.2) if said != before] == []


FAR, NEAR = (0.0, -1.57, 1.2, -1.2, -1.57, 0.0), (2.5, -1.57, 1.2, -1.2, -1.57, 0.0)


def program_text(*lines):
    return ("def p():\n" + "".join(f"  {line}\n" for line in lines) + "end\n").encode()


@contextlib.contextmanager
def eyes():
    state = received(HOST)
    try:
        yield state.read
    finally:
        state.close()


def until(what):
    end = time.monotonic() + 15
    while not what():
        assert time.monotonic() < end
        time.sleep(0.002)


@pytest.mark.e2e
@pytest.mark.timeout(60)
@pytest.mark.parametrize("port", [PRIMARY, SECONDARY, REALTIME])
@pytest.mark.parametrize(
    "said",
    [
        program_text(f"movej({list(FAR)}, a=3, v=3)"),
        program_text("stopj(2)", f"movej({list(FAR)}, a=3, v=3)"),
        f"movej({list(FAR)}, a=3, v=3)\n".encode(),
        program_text("while True:", "sync()", "end"),
        program_text("set_standard_digital_out(1, True)"),
    ],
)
def test_no_program_that_does_more_than_stop_comes_through(gateway, port, said):
    with eyes() as now, socket.create_connection((gateway, port), timeout=5) as link:
        before = now()
        link.sendall(said)
        with contextlib.suppress(ConnectionResetError):
            while link.recv(65_536):
                pass
        assert now().q_rad == before.q_rad


@pytest.mark.e2e
@pytest.mark.timeout(60)
@pytest.mark.parametrize("said", [program_text("stopj(0.01)"), b"stopl(0.01)\n", b"stop program\n"])
def test_anybody_stops_and_as_hard_as_the_cell_says(gateway, said):
    with eyes() as now:
        target = FAR if abs(now().q_rad[0] - NEAR[0]) < 0.1 else NEAR
        with socket.create_connection((HOST, SECONDARY), timeout=5) as robot:
            robot.sendall(program_text(f"movej({list(target)}, a=1.4, v=1.0)"))
            until(lambda: max(map(abs, now().qd_rad_s)) > 0.9)
            with socket.create_connection((gateway, SECONDARY), timeout=5) as link:
                STOPPINGS.clear()
                link.sendall(said)
                asked = time.monotonic()
                until(lambda: max(map(abs, now().qd_rad_s)) < 1e-3)
            # 1 rad/s at 8 rad/s2 is 0.125 s; at 0.01 it would be 100 s
            assert time.monotonic() - asked < 2.0
            assert STOPPINGS == [StopMeans.PROGRAM]
            assert abs(now().q_rad[0] - target[0]) > 0.1


@pytest.mark.e2e
@pytest.mark.timeout(60)
def test_what_is_no_text_ends_the_connection(gateway):
    with socket.create_connection((gateway, REALTIME), timeout=5) as link:
        link.sendall(b"\xff\xfe\n")
        with contextlib.suppress(ConnectionResetError):
            while link.recv(65_536):
                pass


@pytest.mark.e2e
@pytest.mark.timeout(60)
def test_the_dashboard_answers_questions_stops_and_nothing_else(gateway):
    with socket.create_connection((gateway, DASHBOARD), timeout=5) as link, link.makefile("rwb") as lines:
        assert lines.readline() == b"Connected: Universal Robots Dashboard Server\n"

        def said(line):
            lines.write(line + b"\n")
            lines.flush()
            return lines.readline().decode().strip()

        STOPPINGS.clear()
        assert said(b"robotmode") == "Robotmode: RUNNING"
        assert STOPPINGS == []
        assert said(b"stop") in {"Stopped", "Failed to execute: stop"}
        assert said(b"pause") in {"Pausing program", "Failed to execute: pause"}
        assert STOPPINGS == [StopMeans.DASHBOARD, StopMeans.REGISTERS]
        assert said(b"play") == "Failed to execute: play"
        assert said(b"power on") == "Failed to execute: power on"
        assert said(b"unlock protective stop") == "Failed to execute: unlock protective stop"
        assert said(b"load x.urp; reboot") == "could not understand"
        assert said(b"robotmode") == "Robotmode: RUNNING"
        assert said(b"quit") == "Disconnected"
        assert lines.readline() == b""


@pytest.mark.e2e
@pytest.mark.timeout(60)
def test_a_dashboard_line_without_end_ends_the_connection(gateway):
    with socket.create_connection((gateway, DASHBOARD), timeout=5) as link, link.makefile("rwb") as lines:
        lines.readline()
        link.sendall(b"robotmode " * 100)
        with contextlib.suppress(ConnectionResetError):
            assert lines.readline() == b""


@pytest.mark.clause("RTDE-16")
@pytest.mark.e2e
@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("port", "said"),
    [
        (PRIMARY, b"stopj(2)\n" * (STOPS + 1)),
        (PRIMARY, b"def f(" + b",".join(b"a%d" % n for n in range(MAX_STOP)) + b"):end\n"),
        (DASHBOARD, b"robotmode\n" * (LINES + 1)),
        (RTDE, encode_request(SetupInputs(("speed_slider_mask",)), 1) * (AT_ONCE + 1)),
    ],
)
def test_more_at_once_than_anybody_says_ends_the_connection_and_holds_up_nobody(gateway, port, said):
    with socket.create_connection((gateway, port), timeout=5) as link:
        link.sendall(said)
        with contextlib.suppress(ConnectionResetError):
            while link.recv(65_536):
                pass


@contextlib.contextmanager
def guests(host, port, sources):
    """Connections that say nothing, from these addresses."""
    with contextlib.ExitStack() as ends:
        yield [ends.enter_context(socket.create_connection((host, port), 5, (source, 0))) for source in sources]


def ended(link):
    """True where the link has ended: nothing is read from it but its end."""
    link.settimeout(5)
    try:
        while link.recv(65_536):
            pass
    except ConnectionResetError:
        pass
    except TimeoutError:
        return False
    return True


def answers(link):
    return link.makefile("rb").readline().startswith(b"Connected")


ONE, ANOTHER = "127.9.9.1", "127.9.9.2"


@pytest.mark.clause("RTDE-16")
@pytest.mark.e2e
@pytest.mark.timeout(60)
def test_who_takes_all_places_of_a_port_keeps_nobody_else_from_it(gateway):
    with guests(gateway, DASHBOARD, [ONE] * GUESTS) as idle:
        assert all(map(answers, idle))
        with guests(gateway, DASHBOARD, [ONE]) as (more,):
            assert ended(more)
        with guests(gateway, DASHBOARD, [ANOTHER]) as (other,), guests(gateway, PRIMARY, [ONE]) as (reader,):
            assert answers(other)
            assert ended(idle[0])
            assert reader.recv(4)
            other.sendall(b"stop\n")
            assert other.recv(64)


@pytest.mark.clause("RTDE-16")
@pytest.mark.e2e
@pytest.mark.timeout(60)
def test_places_are_shared_evenly_and_then_kept(gateway):
    half = GUESTS // 2
    with guests(gateway, DASHBOARD, [ONE] * half + [ANOTHER] * half) as idle:
        assert all(map(answers, idle))
        with guests(gateway, DASHBOARD, [ONE]) as (more,):
            assert ended(more)
        with guests(gateway, DASHBOARD, ["127.9.9.3"]) as (third,):
            assert answers(third)
            assert ended(idle[0])
