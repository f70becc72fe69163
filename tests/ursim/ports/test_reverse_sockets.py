"""Programs that talk back: sockets to a client, as the vendor's client library uses them, and programs loaded from disk.

The library itself is C++ and comes in no wheel, so its conversation is held here by a program of our own: integers in
millionths over three sockets, a thread that follows them, a time-out that ends it.
"""

import socket
import struct
import threading
import time
from contextlib import contextmanager

import pytest
from tests.ursim.cell import HOME, until
from ursim.ports.launch import SimulatedController

pytestmark = pytest.mark.e2e

MILLION = 1_000_000
FOLLOWER = """def external():
  global target = get_joint_positions()
  global mode = 0
  global left = 0
  thread follow():
    while mode == 1:
      enter_critical
      servoj(target, t=get_steptime(), lookahead_time=0.03, gain=300)
      exit_critical
    end
    stopj(4.0)
  end
  thread points():
    while left > 0:
      read = socket_read_binary_integer(8, "points", 0.5)
      if read[0] > 0:
        left = left - 1
        movej([read[1], read[2], read[3], read[4], read[5], read[6]] / 1000000, t=read[7] / 1000000)
      else:
        left = -1
      end
    end
    socket_send_int(left, "points")
  end
  thread orders():
    while True:
      read = socket_read_binary_integer(5, "orders", 0)
      if read[0] > 0:
        set_payload(read[2] / 1000000, [read[3], read[4], read[5]] / 1000000)
      end
    end
  end
  if not (socket_open("{host}", {points}, "points") and socket_open("{host}", {orders}, "orders")):
    halt
  end
  if not socket_open("{host}", {reverse}, "reverse"):
    halt
  end
  follower = 0
  obeying = run orders()
  read_timeout = 0.0
  while mode > -2:
    enter_critical
    read = socket_read_binary_integer(8, "reverse", read_timeout)
    if read[0] > 0:
      read_timeout = read[1] / 1000.0
      if read[8] != mode:
        mode = read[8]
        join follower
        if mode == 1:
          target = get_joint_positions()
          follower = run follow()
        elif mode == 3:
          left = read[2]
          follower = run points()
        end
      end
      if mode == 1:
        target = [read[2], read[3], read[4], read[5], read[6], read[7]] / 1000000
      end
    else:
      mode = -2
    end
    exit_critical
  end
  kill obeying
  stopj(4.0)
  socket_close("reverse")
end
"""


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    programs = tmp_path_factory.mktemp("programs")
    with SimulatedController.start(joints=HOME, programs=programs) as controller:
        controller.programs = programs
        yield controller


@pytest.fixture
def receive(cell):
    receive = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed").RTDEReceiveInterface(cell.host)
    yield receive
    receive.disconnect()


@contextmanager
def three_sockets(cell):
    """The program runs; its sockets: points, orders, reverse."""
    listening = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
    for each in listening:
        each.settimeout(5.0)
    points, orders, reverse = (each.getsockname()[1] for each in listening)
    text = FOLLOWER.format(host="127.0.0.1", points=points, orders=orders, reverse=reverse)
    with socket.create_connection((cell.host, 30002), 5.0) as port:
        port.sendall(text.encode())
        taken = [each.accept()[0] for each in listening]
        yield taken
    for each in (*listening, *taken):
        each.close()


def words(*numbers):
    return struct.pack(f">{len(numbers)}i", *numbers)


def servo(q, read_timeout_ms=200):
    return words(read_timeout_ms, *(round(each * MILLION) for each in q), 1)


def standing(receive):
    return max(map(abs, receive.getActualQd())) == 0.0


def test_a_client_that_is_called_back_streams_targets_and_its_silence_ends_the_program(cell, receive):
    with three_sockets(cell) as (_, orders, reverse):
        orders.sendall(words(0, 500_000, 1_000, 2_000, 30_000))
        begun, goal = receive.getActualQ(), list(receive.getActualQ())
        for step in range(150):
            goal[0] = begun[0] + 0.1 * (step + 1) / 150
            reverse.sendall(servo(goal))
            threading.Event().wait(0.002)
        until(lambda: abs(receive.getActualQ()[0] - goal[0]) < 1e-3 or reverse.sendall(servo(goal)))
        assert receive.getPayload() == pytest.approx(0.5)
        assert receive.getRobotStatus() & 2  # its program runs
        silent_s = time.monotonic()
        until(lambda: not receive.getRobotStatus() & 2 and standing(receive))
        assert time.monotonic() - silent_s < 1.0  # 0.2 s of silence, and a stop
        assert reverse.recv(1) == b""


def test_points_are_read_one_by_one_and_the_end_is_told(cell, receive):
    with three_sockets(cell) as (points, _, reverse):
        q = receive.getActualQ()
        ways = [[q[0] + part, *q[1:]] for part in (0.05, 0.1, 0.02)]
        for way in ways:
            points.sendall(words(*(round(each * MILLION) for each in way), 200_000, 0))
        reverse.sendall(words(5_000, 3, 0, 0, 0, 0, 0, 3))
        points.settimeout(5.0)
        assert points.recv(4) == words(0)
        until(lambda: receive.getActualQ() == pytest.approx(ways[-1], abs=1e-5))  # its state comes a little later


def test_nobody_there_is_false_and_a_line_is_read(cell, receive):
    with socket.create_server(("127.0.0.1", 0)) as gone:
        port = gone.getsockname()[1]
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection((cell.host, 30002), 5.0) as sent:
        server.settimeout(5.0)
        here = server.getsockname()[1]
        sent.sendall(
            f"""def t():
  if socket_open("127.0.0.1", {port}):
    halt
  end
  socket_open("127.0.0.1", {here})
  socket_send_line("ready")
  name = socket_read_line()
  socket_send_string(str_cat("hello ", name))
  numbers = socket_read_ascii_float(2)
  socket_send_int(floor(numbers[1] + numbers[2]))
  word = socket_read_string(suffix=";")
  socket_send_byte(str_len(word))
  rest = socket_read_byte_list(2, timeout=0.05)
  socket_send_int(rest[0])
  socket_send_int(socket_get_var("speed"))
end
""".encode()
        )
        peer, _ = server.accept()
        peer.settimeout(5.0)
        assert peer.recv(64) == b"ready\n"
        peer.sendall(b"bob\r\n")
        assert peer.recv(64) == b"hello bob"
        peer.sendall(b"(1.5, 2.75)")
        assert peer.recv(64) == words(4)
        peer.sendall(b"word;")
        assert peer.recv(64) == b"\x04"
        assert peer.recv(4) == words(0)
        assert peer.recv(64) == b"GET speed\n"
        peer.sendall(b"speed 42\n")
        assert peer.recv(64) == words(42)
        assert peer.recv(64) == b""  # the program is over, and its sockets with it
        peer.close()


def test_programs_are_loaded_from_disk_and_played(cell, receive):
    (cell.programs / "turn.urp").write_bytes(b"\x1f\x8b")
    (cell.programs / "turn.script").write_text(
        'def turn():\n  $ 1 "MoveJ"\n  q = get_actual_joint_positions()\n  q[0] = q[0] + 0.05\n  movej(q)\nend\n'
    )
    (cell.programs / "broken.urp").write_bytes(b"")
    (cell.programs / "broken.script").write_text("def t(:\n")
    with socket.create_connection((cell.host, 29999), 5.0) as board:
        lines = board.makefile("rw", newline="\n")

        def says(line):
            lines.write(line + "\n")
            lines.flush()
            return lines.readline().strip()

        lines.readline()
        assert says("get loaded program") == "No program loaded"
        assert says("play") == "Failed to execute: play"
        assert says("load nothing.urp") == "File not found: nothing.urp"
        assert says("load ../programs/turn.urp").startswith("File not found")
        assert says("load broken.urp") == "Error while loading program: broken.urp"
        assert says("load turn.urp") == "Loading program: /programs/turn.urp"
        assert says("get loaded program") == "Loaded program: /programs/turn.urp"
        for _ in range(2):  # again and again
            until(lambda: says("programState") == "STOPPED turn.urp")
            begun = receive.getActualQ()[0]
            assert says("play") == "Starting program"
            until(lambda: abs(receive.getActualQ()[0] - begun - 0.05) < 1e-5)  # noqa: B023
