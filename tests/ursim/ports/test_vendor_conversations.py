"""Conversations of other clients of the vendor's interfaces, byte by byte, with a decoder of their own.

The RTDE part follows UniversalRobots/RTDE_Python_Client_Library: `rtde/rtde.py`, `rtde/serialize.py` and
`examples/example_control_loop.py` with its configuration. The other reads the secondary interface as the vendor's
client interface documentation lays it out. Nothing of `pep.rtde` is used here, so that an error that a codec makes
both ways is found.
"""

import socket
import struct
import time

import pytest
from ursim.ports.launch import SimulatedController

pytestmark = pytest.mark.e2e

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
DASHBOARD, PRIMARY, SECONDARY, REALTIME, RTDE = 29999, 30001, 30002, 30003, 30004
FORMATS = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "ddd",
    "VECTOR6D": "dddddd",
    "VECTOR6INT32": "iiiiii",
}


@pytest.fixture(scope="module")
def cell():
    with SimulatedController.start(joints=HOME) as controller:
        yield controller
    assert controller.process.returncode == 0


class Talk:
    """One RTDE connection: bytes out, frames in."""

    def __init__(self, cell):
        self.socket = socket.create_connection((cell.host, RTDE), timeout=1.0)  # the vendor's client waits as long
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.held = b""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, kind, payload=b""):
        self.socket.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def frame(self):
        """Kind and payload of the next frame."""
        while len(self.held) < 3 or len(self.held) < struct.unpack_from(">H", self.held)[0]:
            received = self.socket.recv(4096)
            assert received, "the controller has closed the connection"
            self.held += received
        size, kind = struct.unpack_from(">HB", self.held)
        payload, self.held = self.held[3:size], self.held[size:]
        return chr(kind), payload

    def says(self, sent, answer):
        """Exactly these bytes are answered by exactly those."""
        self.socket.sendall(sent)
        kind, payload = self.frame()
        assert struct.pack(">HB", 3 + len(payload), ord(kind)) + payload == answer

    def outputs(self, frequency, names):
        """The format of the packages of an accepted output recipe."""
        self.send("O", struct.pack(">d", frequency) + ",".join(names).encode())
        kind, payload = self.frame()
        assert (kind, payload[0]) == ("O", 1)
        types = payload[1:].decode().split(",")
        assert len(types) == len(names)
        return ">B" + "".join(FORMATS[each] for each in types)

    def package(self, form):
        """Content of the next data package; it is exactly as long as its recipe."""
        kind, payload = self.frame()
        assert kind == "U"
        return struct.unpack(form, payload)


def dashboard(cell, line):
    with socket.create_connection((cell.host, DASHBOARD), timeout=5) as client, client.makefile("rwb") as lines:
        lines.readline()
        lines.write(line.encode() + b"\n")
        lines.flush()
        return lines.readline().decode().strip()


def within(seconds, condition):
    due = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < due
        time.sleep(0.005)


# The program of `rtde_control_loop.urp`, as a script: it says 1 when it is ready, 0 once it has taken a set-point.
CONTROL_LOOP = """def rtde_control_loop():
  rtde_set_watchdog("input_int_register_0", 1, "stop")
  write_output_integer_register(0, 0)
  while True:
    write_output_integer_register(0, 1)
    while read_input_integer_register(0) == 0:
      sync()
    end
    a = [read_input_float_register(0), read_input_float_register(1), read_input_float_register(2)]
    b = [read_input_float_register(3), read_input_float_register(4), read_input_float_register(5)]
    write_output_integer_register(0, 0)
    movel(p[a[0], a[1], a[2], b[0], b[1], b[2]], a=1.2, v=0.25)
    while read_input_integer_register(0) == 1:
      sync()
    end
  end
end
"""


def test_the_vendors_control_loop_at_500_hz_with_its_watchdog(cell):
    with Talk(cell) as talk:
        talk.says(b"\x00\x05V\x00\x02", b"\x00\x04V\x01")
        talk.says(b"\x00\x03v", b"\x00\x13v" + struct.pack(">IIII", 5, 11, 6, 1010327))
        form = talk.outputs(500.0, ["actual_TCP_pose"])
        talk.says(b"\x00\x03S", b"\x00\x04S\x01")
        here = talk.package(form)[1:]
    there = (here[0], here[1], here[2] + 0.03, *here[3:])

    with Talk(cell) as talk, socket.create_connection((cell.host, REALTIME), timeout=5) as script:
        talk.says(b"\x00\x05V\x00\x02", b"\x00\x04V\x01")
        names = b"target_q,target_qd,output_int_register_0"
        talk.says(
            b"\x00\x33O" + struct.pack(">d", 500.0) + names,
            b"\x00\x1bO\x01VECTOR6D,VECTOR6D,INT32",
        )
        registers = ",".join(f"input_double_register_{index}" for index in range(6)).encode()
        talk.says(b"\x00\x92I" + registers, b"\x00\x2dI\x01" + b",".join([b"DOUBLE"] * 6))
        talk.says(b"\x00\x17Iinput_int_register_0", b"\x00\x09I\x02INT32")
        talk.says(b"\x00\x03S", b"\x00\x04S\x01")
        script.sendall(CONTROL_LOOP.encode())
        state = ">B6d6di"
        assert struct.calcsize(state) == 101

        def loop(goals):
            """The example's loop, until the last goal is confirmed; where the joints were then."""
            goals, completed, watchdog, confirmed = list(goals), True, 0, []
            for _ in range(5000):  # ten seconds of packages
                recipe, *values = talk.package(state)
                assert recipe == 1
                ready = values[12]
                if completed and ready == 1:
                    if not goals:
                        return confirmed
                    completed, watchdog = False, 1
                    talk.socket.sendall(struct.pack(">HBB6d", 52, ord("U"), 1, *goals.pop(0)))
                elif not completed and ready == 0:
                    completed, watchdog = True, 0
                    confirmed.append(values[:6])
                talk.socket.sendall(struct.pack(">HBBi", 8, ord("U"), 2, watchdog))
            raise AssertionError("the set-points were not taken")

        assert len(loop([there, here])) == 2
        # A message of a client is taken in silence, amid the stream.
        talk.send("M", struct.pack(">B5sB13sB", 5, b"hello", 13, b"Python Client", 3))
        before = talk.package(state)
        assert before[7:13] == (0.0,) * 6
        assert dashboard(cell, "running") == "Program running: true"
        loop([there])
        moved = talk.package(state)[1:7]
        assert max(abs(a - b) for a, b in zip(moved, HOME, strict=True)) > 0.02
        # Nobody kicks the watchdog any more: after one second it stops the program.
        begun = time.monotonic()
        within(3.0, lambda: dashboard(cell, "running") == "Program running: false")
        assert time.monotonic() - begun > 0.9
        talk.send("P")
        for _ in range(5000):
            kind, payload = talk.frame()
            if kind == "P":
                break
        assert payload == b"\x01"
        talk.socket.settimeout(0.05)
        with pytest.raises(TimeoutError):
            talk.frame()


def test_a_client_falls_back_to_the_first_protocol(cell):
    """No recipe id, no frequency, every step; as the guide has it for version 1."""
    with Talk(cell) as talk:
        talk.says(b"\x00\x05V\x00\x03", b"\x00\x04V\x00")
        talk.says(b"\x00\x05V\x00\x01", b"\x00\x04V\x01")
        talk.says(b"\x00\x17Otimestamp,robot_mode", b"\x00\x0fODOUBLE,INT32")
        talk.says(b"\x00\x18Iinput_bit_register_64", b"\x00\x08I\x01BOOL")
        talk.says(b"\x00\x03S", b"\x00\x04S\x01")
        steps = []
        for _ in range(50):
            kind, payload = talk.frame()
            stamp, mode = struct.unpack(">di", payload)
            assert (kind, mode) == ("U", 7)
            steps.append(round(stamp / 0.002))
        assert steps == list(range(steps[0], steps[0] + 50))


def test_the_frequency_asked_for_is_the_one_that_comes(cell):
    with Talk(cell) as talk:
        talk.says(b"\x00\x05V\x00\x02", b"\x00\x04V\x01")
        form = talk.outputs(125.0, ["timestamp"])
        talk.says(b"\x00\x03S", b"\x00\x04S\x01")
        stamps = [talk.package(form)[1] for _ in range(30)]
        assert [round((b - a) / 0.002) for a, b in zip(stamps, stamps[1:], strict=False)] == [4] * 29


def test_every_type_of_the_wire_is_read_by_a_decoder_of_its_own(cell):
    """Values are written by a script or known beforehand, and none of them reads the same the other way round."""
    names = [
        "output_bit_register_64", "output_bit_register_65", "output_bit_registers0_to_31", "output_int_register_30",
        "output_double_register_30", "actual_digital_output_bits", "joint_mode", "actual_q", "payload_cog",
        "robot_mode", "tool_output_mode",
    ]  # fmt: skip
    with Talk(cell) as talk, socket.create_connection((cell.host, REALTIME), timeout=5) as script:
        talk.says(b"\x00\x05V\x00\x02", b"\x00\x04V\x01")
        form = talk.outputs(500.0, names)
        assert form == ">B??IidQ" + "i" * 6 + "d" * 9 + "iB"
        talk.says(b"\x00\x03S", b"\x00\x04S\x01")
        script.sendall(
            b"def marks():\n write_output_boolean_register(64, True)\n write_output_boolean_register(8, True)\n"
            b" write_output_integer_register(30, -2)\n write_output_float_register(30, 0.1)\n"
            b" set_tool_digital_out(1, True)\n set_payload(1.5, [0.01, -0.02, 0.03])\nend\n"
        )
        wanted = (1, True, False, 1 << 8, -2, 0.1, 1 << 17, *[253] * 6)
        q = talk.package(form)[13:19]
        assert max(abs(a - b) for a, b in zip(q, HOME, strict=True)) < 0.5
        for _ in range(1000):
            values = talk.package(form)
            if values == (*wanted, *q, 0.01, -0.02, 0.03, 7, 0):
                return
        raise AssertionError(values)


@pytest.mark.parametrize("protocol", [1, 2])
def test_the_controllers_own_text_is_read(cell, protocol):
    """A fault of the protocol is told before the connection ends, in the form of the agreed version."""
    with Talk(cell) as talk:
        talk.says(struct.pack(">HBH", 5, ord("V"), protocol), b"\x00\x04V\x01")
        talk.socket.sendall(b"\x00\x03Z")
        kind, payload = talk.frame()
        assert kind == "M"
        if protocol == 1:
            assert payload[0] == 1  # an error
            assert payload[1:].decode().isprintable()
        else:
            length = payload[0]
            source = payload[length + 1]
            assert payload[1 : 1 + length].decode().isprintable()
            assert payload[2 + length : 2 + length + source] == b"RTDE"
            assert payload[2 + length + source :] == b"\x01"
        assert talk.socket.recv(1) == b""


# ------------------------------------------------------------------------------------------------ secondary interface

# Sizes of the parts of a robot state of PolyScope 5.9 and later without Euromap, header included.
SIZES = {0: 47, 1: 251, 2: 37, 3: 75, 4: 101, 5: 225, 6: 445, 7: 61, 8: 8}


class Secondary:
    """A client of 30002 that takes states apart itself."""

    def __init__(self, cell):
        self.socket = socket.create_connection((cell.host, SECONDARY), timeout=2.0)
        self.held = b""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def packet(self):
        while len(self.held) < 5 or len(self.held) < struct.unpack_from(">i", self.held)[0]:
            received = self.socket.recv(4096)
            assert received
            self.held += received
        size, kind = struct.unpack_from(">iB", self.held)
        packet, self.held = self.held[5:size], self.held[size:]
        return kind, packet

    def state(self):
        """The next robot state: the bodies of its parts."""
        kind, packet = self.packet()
        assert kind == 16  # on this port nothing follows the greeting but states
        parts = {}
        while packet:
            size, part = struct.unpack_from(">iB", packet)
            assert size == SIZES[part]
            parts[part], packet = packet[5:size], packet[size:]
        assert set(parts) == set(SIZES)
        return parts

    def until(self, wanted):
        """The first state that is `wanted`, within ten seconds of states."""
        for _ in range(100):
            parts = self.state()
            if wanted(parts):
                return parts
        raise AssertionError("not in a hundred states")


def joints(parts):
    """Six times actual and target position, speed, current, voltage, two temperatures, mode."""
    return [struct.unpack_from(">dddffffB", parts[1], 41 * index) for index in range(6)]


def running(parts):
    stamp, connected, enabled, on, emergency, protective, running, paused, mode, *_ = struct.unpack(
        ">Q7?BBdddB", parts[0]
    )
    assert stamp > 0
    assert (connected, enabled, on, emergency, protective, paused, mode) == (True, True, True, False, False, False, 7)
    return running


def test_a_client_of_the_secondary_interface_sees_its_program_run_and_stops_it(cell):
    with Secondary(cell) as client:
        kind, greeting = client.packet()
        stamp, source, said, length = struct.unpack_from(">QbBb", greeting)
        assert (kind, source, said) == (20, -2, 3)
        assert stamp > 1_600_000_000_000_000  # microseconds of this century
        assert greeting[11 : 11 + length] == b"URControl"
        assert struct.unpack_from(">BBii", greeting, 11 + length) == (5, 11, 6, 1010327)

        client.socket.sendall(b"movej([0, -1.5708, 1.5708, -1.5708, -1.5708, 0], a=8, v=2)\n")
        parts = client.until(
            lambda p: not running(p) and max(abs(j[0] - h) for j, h in zip(joints(p), HOME, strict=True)) < 1e-9
        )
        assert all(joint[7] == 253 for joint in joints(parts))
        begun = struct.unpack_from(">dddddd", parts[4])
        axes = struct.unpack_from(">6d6d6d6d", parts[5], 24)  # theta, a, d, alpha
        assert axes[6:12] == pytest.approx((0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0), abs=1e-9)
        assert axes[12:18] == pytest.approx((0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921), abs=1e-9)
        limits = struct.unpack_from(">12d12d", parts[6])
        assert limits[:2] == pytest.approx((-6.2832, 6.2832), abs=1e-4)
        assert limits[12] == pytest.approx(3.1416, abs=1e-4)

        client.socket.sendall(
            b"def swing():\n  set_standard_digital_out(3, True)\n"
            b"  movej([2, -1.5708, 1.5708, -1.5708, -1.5708, 0], a=4, v=0.5)\nend\n"
        )
        parts = client.until(lambda p: running(p) and abs(joints(p)[0][2] - 0.5) < 1e-9)
        assert struct.unpack_from(">ii", parts[3])[1] & 1 << 3
        on_its_way = joints(parts)[0][0]
        assert 0.0 < on_its_way < 2.0
        assert joints(parts)[0][1] == on_its_way  # target and actual are one here

        client.socket.sendall(b"stopj(4)\n")
        parts = client.until(lambda p: not running(p) and joints(p)[0][2] == 0.0)
        stopped = joints(parts)[0][0]
        assert on_its_way < stopped < 2.0
        x, y, z, *_ = struct.unpack_from(">dddddd", parts[4])
        assert z == pytest.approx(begun[2], abs=1e-9)  # the base alone has turned
        assert x * x + y * y == pytest.approx(begun[0] ** 2 + begun[1] ** 2, abs=1e-9)
        mode, reduced = struct.unpack_from(">BB", parts[3], 60)
        assert (mode, reduced) == (1, 0)
        assert joints(client.state())[0][0] == stopped
