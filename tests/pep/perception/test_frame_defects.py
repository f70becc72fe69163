"""Defective frames, singly, over TCP: each is refused with its fault, recorded, and keeps the arm still.

It stays still until a good frame comes.

Real are the receiver, the judge of frames, physics, the policies, the gate and the journal; only the arm's own state is made by hand.
"""

import asyncio
import base64
import contextlib
import json

import pytest
from capabilities.values.caps import DEFAULT as CAPS
from msgspec.structs import replace
from pep.perception.receiver import CONNECTIONS, FrameReceiver
from pep.perception.sensor_frames import FRAME_BYTES, Frames, Seen, SensorFrame
from pep.rtde.robot.state_receiver import JointState
from pep.world.held_object import CommittedGrip
from pep.world.world import CellPhysics
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.unread import unread
from tests.pep.kit import CALIBRATION, Rig, survey

from capabilities.keys import jws, keys
from capabilities.statements import checkpoint, observation, statement_form
from pep.pit import CellParameters, Robot, observed, standing_adult, surveyed

POSE = (0.0, -1.62, 1.25, -1.2, -1.57, 0.0)
SWEEP = {"q_rad": [0.4, *POSE[1:]], "speed_rad_s": 0.5, "acceleration_rad_s2": 1.4}
ARM = Robot.load("ur3e")
OLD, BOOT, NEXT = "0" * 32, "1" * 32, "2" * 32


class Arm:
    """It stands still at the middle of the sweep."""

    def read(self):
        return JointState(POSE, (0.0,) * 6, 7, 1)


class Cell:
    """Two cameras that the cell names, and one that it does not, at an enforcement point that listens on TCP."""

    def __init__(self, tmp_path):
        self.rig = Rig(tmp_path)
        self.clock, self.registry = self.rig.clock, self.rig.registry
        self.keys = {f"camera-{n}": self.registry.add_sensor(f"camera-{n}") for n in (1, 2, 3)}
        named = frozenset({"camera-1", "camera-2"})
        self.frames = Frames(sensors=self.registry, named=named, clock=self.clock, caps=CAPS)
        stated = survey(self.clock.wall_s(), sensors=tuple(sorted(named)))
        cell = surveyed(stated, CellParameters(objects=()))
        self.rig.physics = CellPhysics(
            holding=CommittedGrip(ARM, cell),
            cell=cell,
            valid_until_s=stated.not_after,
            frames=self.frames,
            state=Arm(),
            clock=self.clock,
        )
        self.rig.build()
        self.holder = self.rig.agent()
        self.sequence, self.writers = 100, []
        self.receiver = FrameReceiver(self.frames, clock=self.clock, incident=self.incident)

    def incident(self, sensor, fault, detail, count):
        body = {"what": "perception", "sensor": sensor, "fault": fault, "detail": detail, "count": count}
        self.rig.journal.append("incident", body)

    def incidents(self):
        return [(r["body"]["sensor"], r["body"]["fault"]) for r in self.rig.records() if r["kind"] == "incident"]

    def observation(self, **changes):
        self.sequence += 1
        seen = observation.Observation(
            sensor="camera-1",
            boot_id=BOOT,
            sequence=self.sequence,
            captured_ms=int(self.clock.wall_s() * 1000),
            calibration=CALIBRATION,
            complete=True,
            people=(),
            objects=(),
        )
        return replace(seen, **changes)

    def frame(self, *, key=None, **changes):
        seen = self.observation(**changes)
        return unread(observation, seen, key or self.keys[seen.sensor]).encode()

    def spoilt(self, old, new):
        """A frame by the right key over claims in which some bytes were replaced before it signed."""
        raw = claims_of(self.frame())
        assert old in raw
        header = {"typ": "ztpm-observation+jwt", "kid": keys.thumbprint(self.registry.known["camera-1"].key)}
        return jws.sign(header, raw.replace(old, new, 1), self.keys["camera-1"]).encode()

    async def push(self, *chunks, half=False):
        """A connection of its own sends these bytes and, for half a line, goes away."""
        _, writer = await asyncio.open_connection("127.0.0.1", self.port)
        for chunk in chunks:
            writer.write(chunk)
        await writer.drain()
        self.writers.append(writer)
        if half:
            writer.close()

    async def until(self, what):
        async with asyncio.timeout(20):
            while not what():
                await asyncio.sleep(0.002)

    async def move(self):
        answer = await self.rig.gate.run(self.rig.call(self.holder, arguments=SWEEP), self.rig.effect)
        return answer.decision

    async def start(self):
        self.port = await self.receiver.listen("127.0.0.1", 0)
        # An earlier boot, and then the present one: the frames of both are kept for those who replay them.
        self.oldest = self.frame(boot_id=OLD)
        self.clock.advance(10)
        self.previous = self.frame()
        self.latest = self.frame()
        await self.push(*(text + b"\n" for text in (self.oldest, self.previous, self.latest)))
        await self.push(self.frame(sensor="camera-2") + b"\n")
        await self.until(lambda: isinstance(self.frames.view(), Seen) and self.frames.view().complete)
        self.clock.advance(10)

    async def close(self):
        for writer in self.writers:
            writer.close()
        await self.receiver.close()
        self.rig.gate.close()
        self.rig.journal.close()


def claims_of(text):
    payload = text.split(b".")[1]
    return base64.urlsafe_b64decode(payload + b"=" * (-len(payload) % 4))


def flip(text, part):
    parts = text.split(b".")
    first = parts[part][8:9]
    parts[part] = parts[part][:8] + (b"A" if first != b"A" else b"B") + parts[part][9:]
    return b".".join(parts)


def wall_ms(cell, seconds):
    return int((cell.clock.wall_s() + seconds) * 1000)


def strangers_key(cell):
    return keys.generate()


def crowd():
    return tuple(observed(standing_adult(5.0, n * 0.5, name=f"p{n}")) for n in range(33))


def nested(depth):
    return b'"people":' + b"[" * depth + b"]" * depth


# what is sent; the fault; whose newest frame it then is ("" for a stranger)
DEFECTS = {
    "replayed": (lambda c: c.latest, "NOT_NEWER", "camera-1"),
    "reordered": (lambda c: c.previous, "NOT_NEWER", "camera-1"),
    "an earlier boot's recording": (lambda c: c.oldest, "NOT_NEWER", "camera-1"),
    "an earlier boot's id again": (lambda c: c.frame(boot_id=OLD, sequence=9_999), "NOT_NEWER", "camera-1"),
    "a sequence number again": (lambda c: c.frame(sequence=103), "NOT_NEWER", "camera-1"),
    "a sequence number from before": (lambda c: c.frame(sequence=1), "NOT_NEWER", "camera-1"),
    "a higher number captured earlier": (lambda c: c.frame(captured_ms=wall_ms(c, -0.2)), "NOT_NEWER", "camera-1"),
    "a new boot captured earlier": (lambda c: c.frame(boot_id=NEXT, captured_ms=wall_ms(c, -0.2)), "NOT_NEWER", "camera-1"),
    "from the future": (lambda c: c.frame(captured_ms=wall_ms(c, 1.1)), "OUT_OF_TIME", "camera-1"),
    "from the far future": (lambda c: c.frame(captured_ms=2**53 - 1), "OUT_OF_TIME", "camera-1"),
    "older than a second": (lambda c: aged(c, 1.03), "OUT_OF_TIME", "camera-1"),
    "an unknown calibration": (lambda c: c.frame(calibration="cd" * 32), "WRONG_CALIBRATION", "camera-1"),
    "no calibration": (lambda c: c.spoilt(b'"calibration":"' + CALIBRATION.encode() + b'",', b""), "UNTRUSTED", "camera-1"),
    "signed by nobody known": (lambda c: c.frame(key=keys.generate()), "UNTRUSTED", "camera-1"),
    "signed by another sensor of the cell": (lambda c: c.frame(key=c.keys["camera-2"]), "UNTRUSTED", "camera-1"),
    "signed by a sensor that the cell does not name": (lambda c: c.frame(key=c.keys["camera-3"]), "UNTRUSTED", "camera-1"),
    "signed by an agent": (lambda c: c.frame(key=c.holder.key), "UNTRUSTED", "camera-1"),
    "signed by the identity provider": (lambda c: c.frame(key=c.rig.made["registry"]), "UNTRUSTED", "camera-1"),
    "one bit of the claims flipped": (lambda c: flip(c.frame(), 1), None, None),
    "one bit of the signature flipped": (lambda c: flip(c.frame(), 2), "UNTRUSTED", "camera-1"),
    "without its signature": (lambda c: c.frame().rpartition(b".")[0] + b".", "UNTRUSTED", "camera-1"),
    "algorithm none": (lambda c: unsigned(c.frame()), "UNTRUSTED", "camera-1"),
    "a registered sensor that the cell does not name": (lambda c: c.frame(sensor="camera-3"), "UNKNOWN_SENSOR", ""),
    "a sensor that nobody registered": (lambda c: c.frame(sensor="camera-9", key=keys.generate()), "UNKNOWN_SENSOR", ""),
    "another statement by the sensor's key": (
        lambda c: checkpoint.sign(checkpoint.Checkpoint("https://idp.example/ztpm", 1, "0" * 64, 1), c.keys["camera-1"]).encode(),
        "MALFORMED",
        "",
    ),
    "a frame of another kind by the sensor's key": (lambda c: other_kind(c), "UNTRUSTED", "camera-1"),
    "not a number": (lambda c: c.spoilt(b'"sequence":', b'"sequence":NaN,"x":'), "UNTRUSTED", "camera-1"),
    "infinite": (lambda c: c.spoilt(b'"complete":true', b'"complete":Infinity'), "UNTRUSTED", "camera-1"),
    "a number beyond every double": (lambda c: c.spoilt(b'"complete":true', b'"complete":1e999'), "UNTRUSTED", "camera-1"),
    "a fraction": (lambda c: c.spoilt(b'"captured_ms":', b'"captured_ms":1.5,"x":'), "UNTRUSTED", "camera-1"),
    "a duplicate key": (lambda c: c.spoilt(b'"complete":true', b'"complete":false,"complete":true'), "UNTRUSTED", "camera-1"),
    "a member more": (lambda c: c.spoilt(b'"complete":true', b'"colour":1,"complete":true'), "UNTRUSTED", "camera-1"),
    "nested deeply": (lambda c: c.spoilt(b'"people":[]', nested(100)), "UNTRUSTED", "camera-1"),
    "nested beyond every stack": (lambda c: c.spoilt(b'"people":[]', nested(12_000)), "MALFORMED", ""),
    "a coordinate beyond every cell": (
        lambda c: c.frame(objects=(observation.ObservedObject("o", "rigid", observation.Sphere((10**9, 0, 0), 5)),)),
        "UNTRUSTED",
        "camera-1",
    ),
    "a body without extent": (
        lambda c: c.frame(objects=(observation.ObservedObject("o", "rigid", observation.Sphere((0, 0, 0), 0)),)),
        "UNTRUSTED",
        "camera-1",
    ),
    "a person without a body": (lambda c: c.frame(people=(observation.ObservedPerson("p", ()),)), "UNTRUSTED", "camera-1"),
    "33 people": (lambda c: c.frame(people=crowd()), "UNTRUSTED", "camera-1"),
    "the same person twice": (lambda c: c.frame(people=crowd()[:1] * 2), "UNTRUSTED", "camera-1"),
    "larger than any frame": (lambda c: c.frame() + b"A" * FRAME_BYTES, "TOO_LARGE", ""),
    "an empty line": (lambda c: b"", "MALFORMED", ""),
    "a line of spaces": (lambda c: b"   ", "MALFORMED", ""),
    "a word": (lambda c: b"hello", "MALFORMED", ""),
    "plain JSON": (lambda c: claims_of(c.frame()), "MALFORMED", ""),
    "binary noise": (lambda c: bytes(n for n in range(256) if n != 10), "MALFORMED", ""),
    "a frame in UTF-16": (lambda c: c.frame().decode().encode("utf-16").replace(b"\n", b""), "MALFORMED", "camera-1"),
    "a carriage return at the end": (lambda c: c.frame() + b"\r", "UNTRUSTED", "camera-1"),
    "a frame and a half on one line": (lambda c: c.frame() + c.frame()[:40], "UNTRUSTED", "camera-1"),
}  # fmt: skip


def aged(cell, seconds):
    """A frame of a sensor that was heard long ago, held up for longer than clocks may differ."""
    text = cell.frame(boot_id=NEXT)
    cell.clock.wall += seconds
    return text


def unsigned(text):
    payload = text.split(b".")[1]
    header = keys.b64u(json.dumps({"alg": "none", "typ": "ztpm-observation+jwt"}, separators=(",", ":")).encode())
    return header.encode() + b"." + payload + b"."


def other_kind(cell):
    return statement_form.sign("perception", json.loads(claims_of(cell.frame())), cell.keys["camera-1"]).encode()


def played(tmp_path, scenario):
    async def inside():
        cell = Cell(tmp_path)
        try:
            await cell.start()
            return await scenario(cell)
        finally:
            await cell.close()

    return asyncio.run(inside())


async def refused_until_the_next_good_frame(cell, fault, sensor):
    assert (sensor, fault) in cell.incidents()
    decision = await cell.move()
    assert (decision.effect, decision.reason, decision.tier) == (Effect.DENY, Reason.PERCEPTION_INVALID, None)
    assert {"CII-4"} <= {f.primitive for f in decision.findings}
    assert cell.rig.sent == []
    recorded = [r["body"] for r in cell.rig.records() if r["kind"] == "decision"][-1]["evidence"]["perception"]
    assert [(s["sensor"], s["fault"]) for s in recorded["sensors"] if s["state"] == "invalid"] == [(sensor, fault)]
    # Another sensor's good frame excuses nothing that names this one.
    await cell.push(cell.frame(sensor="camera-2") + b"\n")
    await cell.until(lambda: cell.frames._newest["camera-2"].observation.sequence == cell.sequence)
    if sensor:
        assert (await cell.move()).reason is Reason.PERCEPTION_INVALID
    cell.clock.advance(10)
    await cell.push(cell.frame() + b"\n")
    await cell.until(lambda: isinstance(cell.frames.view(), Seen))
    assert (await cell.move()).effect is Effect.PERMIT
    assert len(cell.rig.sent) == 1


@pytest.mark.parametrize("name", DEFECTS)
def test_a_defective_frame(tmp_path, name):
    build, fault, sensor = DEFECTS[name]

    async def scenario(cell):
        assert cell.incidents() == []
        await cell.push(build(cell) + b"\n")
        await cell.until(cell.incidents)
        ((said_sensor, said_fault),) = cell.incidents()
        if fault is None:  # which claim the flipped bit is in decides whose frame it passes for
            assert (said_sensor, said_fault) in {("camera-1", "UNTRUSTED"), ("", "MALFORMED"), ("", "UNKNOWN_SENSOR")}
        else:
            assert (said_sensor, said_fault) == (sensor, fault)
        await refused_until_the_next_good_frame(cell, said_fault, said_sensor)

    played(tmp_path, scenario)


def test_half_a_line(tmp_path):
    async def scenario(cell):
        await cell.push(cell.frame()[:200], half=True)
        await cell.until(cell.incidents)
        await refused_until_the_next_good_frame(cell, "MALFORMED", "")

    played(tmp_path, scenario)


def test_a_line_that_never_ends(tmp_path):
    async def scenario(cell):
        await cell.push(b"A" * (2 * FRAME_BYTES))
        await cell.until(cell.incidents)
        await refused_until_the_next_good_frame(cell, "TOO_LARGE", "")

    played(tmp_path, scenario)


def test_a_flood_is_one_record(tmp_path):
    async def scenario(cell):
        forged = [cell.frame(key=strangers_key(cell)) + b"\n" for _ in range(40)]
        for text in forged:
            await cell.push(text)
        await cell.until(lambda: cell.receiver._told[("camera-1", "UNTRUSTED")][1] == 39)
        assert cell.incidents() == [("camera-1", "UNTRUSTED")]
        cell.clock.advance(1_001)
        await cell.push(cell.frame(key=strangers_key(cell)) + b"\n")
        await cell.until(lambda: len(cell.incidents()) == 2)
        counts = [r["body"]["count"] for r in cell.rig.records() if r["kind"] == "incident"]
        assert counts == [1, 40]

    played(tmp_path, scenario)


def test_the_connection_after_the_last_is_hung_up_on_and_the_view_stands(tmp_path):
    async def scenario(cell):
        while (held := len(cell.receiver._writers)) < CONNECTIONS:
            await cell.push(cell.frame() + b"\n")
            await cell.until(lambda: sum(cell.receiver._writers.values()) > held)
        reader, writer = await asyncio.open_connection("127.0.0.1", cell.port)
        with contextlib.suppress(ConnectionResetError):  # what it sent was not even read
            writer.write(cell.frame(key=keys.generate()) + b"\n")
            assert await reader.read() == b""
        await cell.until(cell.incidents)
        assert cell.incidents() == [("", "TOO_MANY_SENDERS")]
        assert (await cell.move()).effect is Effect.PERMIT
        assert isinstance(cell.frames.admit(cell.frame()), SensorFrame)

    played(tmp_path, scenario)


def test_silent_strangers_do_not_keep_a_sensor_out(tmp_path):
    async def scenario(cell):
        believed = sum(cell.receiver._writers.values())
        assert believed >= 1, "the sensor's own"
        free = CONNECTIONS - len(cell.receiver._writers)
        crowd = [await asyncio.open_connection("127.0.0.1", cell.port) for _ in range(free)]
        await cell.until(lambda: len(cell.receiver._writers) == CONNECTIONS)
        await cell.push(cell.frame() + b"\n")
        await cell.until(lambda: sum(cell.receiver._writers.values()) == believed + 1)
        assert await crowd[0][0].read() == b"", "the oldest stranger"
        assert cell.incidents() == [("", "TOO_MANY_SENDERS")]
        for _, writer in crowd:
            writer.close()

    played(tmp_path, scenario)


def test_two_sensors_that_contradict_each_other_are_on_record_and_nobody_is_lost(tmp_path):
    async def scenario(cell):
        person = observed(standing_adult(-0.62, -0.3, name="person-1"))
        await cell.push(cell.frame(people=(person,)) + b"\n")
        await cell.until(cell.incidents)
        assert cell.incidents() == [("camera-1", "CONTRADICTED")]
        decision = await cell.move()
        assert (decision.effect, decision.tier) == (Effect.DEFER, 3)
        assert cell.rig.sent == []

    played(tmp_path, scenario)


def test_there_are_enough_defects():
    assert len(DEFECTS) >= 45
