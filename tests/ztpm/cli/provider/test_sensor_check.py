"""`ztpm sensor check` on live frames over a real socket: a good stream, and each fault by its code."""

import contextlib
import itertools
import socket
import threading
import time

import pytest
from capabilities.statements.observation import Capsule, Observation, ObservedPerson
from tests.unread import unread
from tests.ztpm.cli.conftest import PASSPHRASE
from ztpm.cli.output import console
from ztpm.codes.code_table import code_table

from capabilities.keys import keys
from capabilities.statements import observation
from pep.sensor import Sensor, person_at

KEY = keys.generate()
HZ = 30
pytestmark = pytest.mark.e2e


@pytest.fixture
def document(tmp_path):
    path = tmp_path / "camera-1.pdf"
    path.write_bytes(b"measured on Monday")
    return path


@pytest.fixture
def port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@contextlib.contextmanager
def streaming(port, document, show, gaps):
    """A sensor's program at work: `show(sensor, n)` for the n-th frame, after each of `gaps` (s)."""
    ended = threading.Event()

    def work():
        with Sensor(KEY, f"127.0.0.1:{port}", calibration=document, name="camera-1") as sensor:
            due = time.monotonic()
            for number, gap in enumerate(gaps):
                show(sensor, number)
                due += gap
                if ended.wait(max(0, due - time.monotonic())):
                    return

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def steady(hz):
    return itertools.repeat(1 / hz)


def stands(sensor, _):
    sensor.see([person_at(0.9, 0.1, floor_z_m=-0.8)])


def checked(run, port, document, *options, seconds=1.5):
    return run(
        "sensor", "check", "camera-1", "--at", f"127.0.0.1:{port}", "--public", keys.b64u(keys.public_raw(KEY)),
        "--calibration", document, "--transit-ms", 60, "--seconds", seconds, *options,
    )  # fmt: skip


def until_good(look):
    """The first look with no fault, of eight: a busy machine makes gaps of its own."""
    for _ in range(8):
        told = look()
        if not told.status:
            return told
    raise AssertionError(told.out)


def codes(told):
    assert told.status == (1 if told.json["findings"] else 0)
    for finding in told.json["findings"]:
        assert finding["next"] == code_table()[finding["code"]].step
    return [finding["code"] for finding in told.json["findings"]]


def test_a_good_stream_is_told_in_eighty_columns_and_as_json(run, port, document):
    with streaming(port, document, stands, steady(HZ)):
        told = until_good(lambda: checked(run, port, document, "--json", seconds=1))
        words = until_good(lambda: checked(run, port, document, seconds=1))
    assert codes(told) == [] and told.json["ok"]
    assert told.json["people"] == told.json["ids"] == 1 and 25 < told.json["rate_hz"] < 35
    assert words.out.splitlines()[-1] == "Nothing is wrong with camera-1."
    assert max(map(len, words.out.splitlines())) <= 80


def test_half_the_rate_is_slow_and_says_the_step(run, port, document, monkeypatch):
    monkeypatch.setattr(console, "width", 80)
    with streaming(port, document, stands, steady(HZ / 2)):
        told = checked(run, port, document)
    assert told.status == 1
    assert "FRAMES_SLOW: 1" in told.out and code_table()["FRAMES_SLOW"].step in " ".join(told.out.split())
    assert max(map(len, told.out.splitlines())) <= 80


def test_uneven_frames_are_jitter_and_long_gaps_stop_an_arm(run, port, document):
    with streaming(port, document, stands, itertools.cycle([0.02, 0.02, 0.06, 0.02, 0.04])):
        assert "FRAMES_JITTER" in codes(checked(run, port, document, "--json"))
    with streaming(port, document, stands, itertools.cycle([*[1 / HZ] * 19, 0.2])):
        assert "FRAMES_GAPS" in codes(checked(run, port, document, "--json"))


def test_somebody_who_jumps_and_ids_that_change(run, port, document):
    def jumps(sensor, number):
        sensor.see([person_at(0.9 if number % 10 else 3.0, 0.1, floor_z_m=-0.8, name="bob")])

    def changes(sensor, number):
        sensor.see([person_at(0.9, 0.1, floor_z_m=-0.8, name=f"p{number}")])

    with streaming(port, document, jumps, steady(HZ)):
        assert "PEOPLE_JUMP" in codes(checked(run, port, document, "--json"))
    with streaming(port, document, changes, steady(HZ)):
        assert "IDS_CHANGE" in codes(checked(run, port, document, "--json"))


def test_an_old_capture_is_late(run, port, document):
    def late(sensor, _):
        sensor.see(captured_s=time.time() - 0.3)

    with streaming(port, document, late, steady(HZ)):
        assert "FRAMES_LATE" in codes(checked(run, port, document, "--json"))


@contextlib.contextmanager
def written_by_others(port, document, people, *, key=KEY, sequence=1):
    """Frames of a program that is not ours, at 30 Hz."""
    import hashlib

    ended, digest = threading.Event(), hashlib.sha256(document.read_bytes()).hexdigest()

    def work():
        wire = None
        for number in itertools.count(sequence):
            if ended.wait(1 / HZ):
                return
            frame = Observation("camera-1", "0" * 32, number, int(time.time() * 1000), digest, True, people, ())
            try:
                wire = wire or socket.create_connection(("127.0.0.1", port))
                wire.sendall(unread(observation, frame, key).encode() + b"\n")
            except OSError:
                wire = None

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def one(a, b, radius):
    return (ObservedPerson("bob", (("head", Capsule(a, b, radius)),)),)


@pytest.mark.parametrize(
    ("people", "also"),
    [
        # 0.9 m as 900 m: no frame reaches so far, so each is refused besides
        (
            one((900_000_000, 0, -800_000_000), (900_000_000, 0, 1_000_000_000), 300_000_000),
            ["UNTRUSTED", "FRAMES_NONE"],
        ),
        # a body of 2 m as one of 2 mm
        (one((900, 0, -800), (900, 0, 1000), 300), []),
        # near enough to be a frame: 20 mm as 20 m
        (one((20_000_000, 0, -20_000_000), (20_000_000, 0, 20_000_000), 3_000_000), []),
    ],
)
def test_millimetres_for_metres_are_named(run, port, document, people, also):
    with written_by_others(port, document, people):
        found = codes(checked(run, port, document, "--json"))
    assert found[0] == "NOT_METRES" and set(also) <= set(found)


def test_a_strangers_frames_another_calibration_and_silence(run, port, document, tmp_path):
    with written_by_others(port, document, (), key=keys.generate()):
        assert codes(checked(run, port, document, "--json")) == ["UNTRUSTED", "FRAMES_NONE"]
    other = tmp_path / "other.pdf"
    other.write_bytes(b"another")
    with streaming(port, document, stands, steady(HZ)):
        assert codes(checked(run, port, other, "--json")) == ["WRONG_CALIBRATION", "FRAMES_NONE"]
    assert codes(checked(run, port, document, "--json", seconds=1)) == ["FRAMES_NONE"]


def test_the_key_of_the_directory_is_the_sensors(run, cell, port, document):
    path = cell.party_key("sensor", "camera-1")
    path.parent.mkdir(mode=0o700, exist_ok=True)
    path.write_bytes(keys.to_pem(KEY, PASSPHRASE.encode()))
    path.chmod(0o600)
    with streaming(port, document, stands, steady(HZ)):
        told = run(
            "sensor", "check", "camera-1", "--at", f"127.0.0.1:{port}", "--calibration", document, "--seconds", 1,
            "--data", cell.root, "--json",
        )  # fmt: skip
    assert told.json["frames"] > 5 and told.json["rejected"] == 0
    missing = run("sensor", "check", "camera-9", "--at", "127.0.0.1:1", "--calibration", document, "--data", cell.root)
    assert missing.status == 2 and missing.err.startswith("KEYS_UNREADABLE")


def test_a_place_that_another_program_has_is_named(run, document):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        told = checked(run, taken.getsockname()[1], document, "--json")
    assert (told.status, told.json["code"]) == (1, "PORT_UNUSABLE")
    assert checked(run, "x", document, "--json").json["code"] == "USAGE"
