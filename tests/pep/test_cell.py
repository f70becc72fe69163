"""Whole cell without the identity provider's process: real controller, physics, ur_rtde client and sensor."""

import asyncio
import contextlib
import dataclasses
import hashlib
import json
import os
import subprocess
import sys
import threading

import httpx2
import numpy as np
import pytest
from capabilities.statements.registry import PartyEntry, SensorEntry, ToolEntry
from mcp import Client
from mcp.client.streamable_http import streamable_http_client
from pep.base.clock import SystemClock
from pep.base.thread_priority import goes_first
from pep.gate.observe_only import OBSERVED
from pep.mcp.arm_server import tool_definitions
from pep.mcp.guard import DECISION_META
from pep.rtde.robot.dashboard import stop_program
from tests.pep.rtde.packages import received
from policies.decision.load import load_shipped
from policies.evidence.tiers import FRESH
from tests.pep.kit import AUDIENCE, CALIBRATION, HOST, ISSUER, PEP, PORT, FakeIssuer, agent, issuer_keys, survey
from tests.pep.mcp.test_mcp import Signed
from tests.pep.sensor.test_keypoints import COCO_17, points
from tests.pep.sensor.test_sensors_page import FIVE_LINES
from pep.world.timed_request import arguments_of
from ztpm.point.gateway_config import GatewayConfig
from ztpm.point.gateway_server import GatewayServer
from ztpm.point.simulator_check import recognise
from ztpm.point.tool_proxy import ToolProxy
from ztpm.point.tool_proxy_config import ToolProxyConfig
from ztpm.stage.samples import StateRecorder

from capabilities.keys import keys
from pep.pit import CellParameters, JointTrajectory, Output

GATEWAY_HOST = HOST.rpartition(".")[0] + ".10"
"""Address at which the gateway has the controller's ports."""
CALLS = f"http://{HOST}:{PORT + 2}/calls"
DOOR = "door-1"
SEND_TRIES = 5

LEFT = (-0.6, -1.62, 1.25, -1.2, -1.57, 0.0)
RIGHT = (0.6, -1.62, 1.25, -1.2, -1.57, 0.0)
PASSPHRASE = "correct horse battery staple"
PATIENT = CellParameters(watch_age_limit_s=1.0, watch_time_limit_s=1.0, reaction_s=0.5, perception_age_limit_s=1.2)
"""Cell whose watch waits longer, since this machine is also busy with other tests.

A motion is to end for the reason that a test gives it.
"""
SLOW_RAD_S = 0.08
"""sqrt(2 x 1.4 rad/s2 x 2 mrad): how fast a joint is so far from where it stops."""
pytestmark = pytest.mark.e2e


class Child:
    """A process that says when it is ready."""

    def __init__(self, module, *arguments):
        self.popen = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "ZTPM_PASSPHRASE": PASSPHRASE},
        )
        timer = threading.Timer(60, self.popen.kill)
        timer.start()
        line = self.popen.stdout.readline()
        timer.cancel()
        assert json.loads(line)["ready"] is True

    def tell(self, **command):
        self.popen.stdin.write(json.dumps(command).encode() + b"\n")
        self.popen.stdin.flush()

    def end(self):
        self.popen.terminate()
        try:
            self.popen.wait(10)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait(10)
        self.popen.stdin.close()
        self.popen.stdout.close()


@pytest.fixture(scope="module")
def controller():
    child = Child("ursim", "--host", HOST, "--joints=" + ",".join(map(str, LEFT)))
    yield child
    child.end()


class Elsewhere(httpx2.MockTransport):
    """Provider as the tool server finds it: the ledger has a journal of each point.

    A test looks at the gateway's.
    """

    def __init__(self, issuer):
        def handle(request):
            if not request.url.path.endswith("/ledger/records"):
                return issuer.handle(request)
            return httpx2.Response(200, json={"accepted_through": json.loads(request.content)["records"][-1]["seq"]})

        super().__init__(handle)


async def listens(port, task):
    """Waits until the server of that task listens."""
    async with asyncio.timeout(60):
        while True:
            with contextlib.suppress(OSError):
                _, writer = await asyncio.open_connection(HOST, port)
                writer.close()
                return
            assert not task.done(), task.exception()
            await asyncio.sleep(0.05)


class Cell:
    """A running gateway, and a tool server before it, with everything around them. To be made on their event loop."""

    def __init__(self, tmp, sensor, parameters, *, calibration=CALIBRATION, **gateway):
        self.made, trust = issuer_keys()
        sensor_key, pep_key, door_key = keys.generate(), keys.generate(), keys.generate()
        (tmp / "sensor.key").write_bytes(keys.to_pem(sensor_key, PASSPHRASE.encode()))
        (tmp / "sensor.key").chmod(0o600)
        point = dict(audience=AUDIENCE, host=HOST, issuer=ISSUER, trust_file=tmp / "trust.json", policy="paper-default")
        (tmp / "door").mkdir()
        config = GatewayConfig(
            **point,
            port=PORT + 2,
            pep_id=PEP,
            pep_key_file=tmp / "pep.key",
            journal_file=tmp / "journal.ndjson",
            state_dir=tmp,
            robot_host=HOST,
            perception_port=PORT + 1,
            defer_timeout_s=1,
            cell_file=tmp / "cell.jws",
            cell_signer_key=keys.b64u(keys.public_raw(keys.generate())),
            cell=dataclasses.replace(parameters, objects=()),
            url=f"http://{HOST}:{PORT + 2}/leases",
            calls_url=CALLS,
            listen_host=GATEWAY_HOST,
            carriage_port=PORT + 3,
        )
        door = ToolProxyConfig(
            **point,
            port=PORT,
            pep_id=DOOR,
            pep_key_file=tmp / "door.key",
            journal_file=tmp / "door.ndjson",
            state_dir=tmp / "door",
            gateway_url=CALLS,
        )
        tools = [ToolEntry(t.name, t.definition_digest, t.operation, t.base_tier) for t in tool_definitions_cached()]
        sensors = [SensorEntry("camera-1", keys.public_raw(sensor_key), calibration, 20)]
        self.clock = SystemClock()
        self.issuer = FakeIssuer(self.made, self.clock, tools=tools, sensors=sensors)
        self.issuer.peps = (PartyEntry(DOOR, keys.public_raw(door_key)),)
        made = dict(trust=trust, policies=load_shipped("paper-default"))
        self.server = GatewayServer(
            config, survey=survey(self.clock.wall_s()), key=pep_key, http=self.issuer.client(), **made, **gateway
        )
        self.door = ToolProxy(door, key=door_key, http=httpx2.AsyncClient(transport=Elsewhere(self.issuer)), **made)
        for each in (self.server, self.door):
            each.recover()
        self.sensor = sensor(str(tmp / "sensor.key"))

    @contextlib.asynccontextmanager
    async def running(self):
        tasks = []
        try:
            for each in (self.server, self.door):
                tasks.append(task := asyncio.create_task(each.run()))
                await listens(each.config.port, task)
            yield self
        finally:
            for each, task in zip((self.door, self.server), reversed(tasks), strict=True):
                each.ended.set()
                await task
            self.sensor.end()

    def holder(self, name="robotic", **options):
        return agent(self.made, self.clock.wall_s(), name=name, **options)

    async def use(self, holder, tool, arguments):
        """The tool's answer; a verdict that came too late is asked for again, as its reason says."""
        for _ in range(SEND_TRIES):
            result = await self._used(holder, tool, arguments)
            if (result.meta or {}).get(DECISION_META, {}).get("reason") != "VERDICT_EXPIRED":
                break
        return result

    async def _used(self, holder, tool, arguments):
        async with httpx2.AsyncClient(auth=Signed(holder, self.clock), timeout=60) as http:
            async with Client(streamable_http_client(AUDIENCE, http_client=http)) as client:
                return await client.call_tool(tool, arguments)

    async def move(self, holder, q, speed=0.5):
        arguments = {"q_rad": list(q), "speed_rad_s": speed, "acceleration_rad_s2": 1.4}
        return await self.use(holder, "move_joint", arguments)

    async def see(self, holder, people=(), objects=()):
        self.sensor.tell(people=list(people), objects=list(objects))
        async with asyncio.timeout(20):
            while True:
                world = (await self.use(holder, "read_state", {})).structured_content["world"]
                seen = (world["people"], world["objects"], world["perception"]) == (len(people), len(objects), FRESH)
                # What a process does first holds its loop up, and the controller ends a program that is not heard of.
                if seen and self.server.own.up:
                    return

    def records(self, kind):
        return [r["body"] for r in self.server.journal.records() if r["kind"] == kind]


_DEFINITIONS = []


def tool_definitions_cached():
    if not _DEFINITIONS:
        _DEFINITIONS.extend(tool_definitions())
    return _DEFINITIONS


tool_definitions_cached()


def sensor(key_file):
    return Child(
        "ursim.sensor.sensor", "--key-file", key_file, "--sensor", "camera-1", "--calibration", CALIBRATION,
        "--to", f"{HOST}:{PORT + 1}",
    )  # fmt: skip


def in_cell(tmp_path, scenario, parameters=PATIENT, sensor=sensor, **gateway):
    async def inside():
        goes_first()  # as the real gateway
        cell = Cell(tmp_path, sensor, parameters, **gateway)
        async with cell.running():
            return await scenario(cell)

    return asyncio.run(inside())


def decided(result):
    told = result.meta[DECISION_META]
    return told["decision"], told["reason"], told["tier"]


def test_the_arm_moves_stops_and_loses_authority(controller, tmp_path):
    eyes = received(HOST)

    async def scenario(cell):
        holder = cell.holder()
        await cell.see(holder)

        # an empty cell: permitted, and the arm arrives
        result = await cell.move(holder, RIGHT)
        assert decided(result) == ("PERMIT", "PERMITTED", 1)
        assert result.structured_content["outcome"] == "reached", result.structured_content
        assert eyes.read().q_rad == pytest.approx(RIGHT, abs=2e-3)

        # a stop while it moves
        moving = asyncio.create_task(cell.move(holder, LEFT, speed=0.3))
        await moved(eyes, RIGHT, moving)
        stopped = await cell.use(holder, "stop", {})
        assert stopped.structured_content["outcome"] == "stopped"
        assert (await moving).structured_content["outcome"] == "stopped"
        assert eyes.read().still

        # busy while it moves
        here = eyes.read().q_rad
        moving = asyncio.create_task(cell.move(holder, LEFT, speed=0.3))
        await moved(eyes, here, moving)
        second = await cell.move(holder, RIGHT)
        assert decided(second)[:2] == ("DENY", "BUSY")

        # authority lost while it moves
        cell.issuer.revoke("hop", holder.hop_id)
        with contextlib.suppress(Exception):
            # The SDK lists the tools to check the result, and is refused by then.
            await moving
        ends = [body.get("result", {}).get("outcome") for body in cell.records("outcome")]
        assert "authority_lost" in ends
        assert eyes.read().still
        holder = cell.holder()

        # a caller who goes away
        here = eyes.read().q_rad
        moving = asyncio.create_task(cell.move(holder, RIGHT, speed=0.2))
        await moved(eyes, here, moving)
        moving.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await moving
        async with asyncio.timeout(10):
            while "cancelled" not in [body["outcome"] for body in cell.records("outcome")]:
                await asyncio.sleep(0.02)
        assert eyes.read().still

        # a person in the way: deferred, nothing moves, and silence denies
        await cell.see(holder, people=[{"id": "bob", "x_m": 0.66, "y_m": 0.0}])
        before = eyes.read().q_rad
        deferred = await cell.move(holder, RIGHT)
        assert decided(deferred)[0] == "DEFER"
        async with asyncio.timeout(10):
            while not cell.records("ask-expired"):
                await asyncio.sleep(0.05)
        assert decided(await cell.move(holder, RIGHT))[:2] == ("DENY", "APPROVAL_TIMEOUT")
        assert eyes.read().q_rad == pytest.approx(before, abs=2e-3)

        # a sensor that falls silent over an empty cell: nobody knows whether it still is
        await cell.see(holder)
        cell.sensor.tell(pause=True)
        async with asyncio.timeout(10):
            while (await cell.use(holder, "read_state", {})).structured_content["world"]["perception"] != "stale":
                await asyncio.sleep(0.05)
        assert decided(await cell.move(holder, RIGHT)) == ("DEFER", "TIER_NEEDS_APPROVAL", 3)
        cell.sensor.tell(pause=False)
        await cell.see(holder)

        # the gripper: not before it has been activated, which is consequential
        inactive = await cell.use(holder, "gripper_move", {"width_m": 0.04, "speed_m_s": 0.1, "force_n": 40.0})
        assert inactive.is_error
        activated = await cell.use(holder, "gripper_activate", {})
        assert decided(activated) == ("PERMIT", "PERMITTED", 2)
        assert activated.structured_content == {"ready": True, "width_m": pytest.approx(0.085)}
        grip = await cell.use(holder, "gripper_move", {"width_m": 0.04, "speed_m_s": 0.1, "force_n": 40.0})
        assert decided(grip)[0] == "PERMIT"
        assert grip.structured_content["width_m"] == pytest.approx(0.04, abs=2e-3)

        # an arm that is moving when the server ends
        here = eyes.read().q_rad
        target = RIGHT if abs(here[0] - RIGHT[0]) > 0.3 else LEFT
        moving = asyncio.create_task(cell.move(holder, target, speed=0.2))
        await moved(eyes, here, moving)

    in_cell(tmp_path, scenario)
    assert eyes.read().still
    eyes.close()


SPEEDS = {"qd_rad_s": [0.2, 0.0, 0.0, 0.0, 0.0, 0.0], "acceleration_rad_s2": 2.0, "duration_s": 1.0}


def test_a_stream_of_speeds_through_the_tools(controller, tmp_path):
    eyes = received(HOST)

    async def scenario(cell):
        holder = cell.holder()
        await cell.see(holder)
        assert decided(await cell.move(holder, LEFT))[:2] == ("PERMIT", "PERMITTED")

        # it moves, and stops by itself
        here = eyes.read().q_rad[0]
        result = await cell.use(holder, "speed_joint", {**SPEEDS, "duration_s": 0.5})
        assert decided(result) == ("PERMIT", "PERMITTED", 1)
        assert result.structured_content["outcome"] == "ended", result.structured_content
        assert 0.0 < eyes.read().q_rad[0] - here < 0.2 * 1.0

        # the same again while it moves prolongs it; another agent, other speeds and another motion are busy
        here = eyes.read().q_rad
        other = cell.holder("vision")
        long = {**SPEEDS, "duration_s": 2.0}
        first = asyncio.create_task(cell.use(holder, "speed_joint", long))
        await moved(eyes, here, first)
        second = asyncio.create_task(cell.use(holder, "speed_joint", long))
        for who, arguments in ((other, long), (holder, {**long, "qd_rad_s": [0.3, 0, 0, 0, 0, 0]})):
            busy = await cell.use(who, "speed_joint", arguments)
            assert decided(busy)[:2] == ("DENY", "BUSY")
        assert decided(await cell.move(holder, RIGHT))[:2] == ("DENY", "BUSY")
        for result in await asyncio.gather(first, second):
            assert decided(result)[0] == "PERMIT", result
            assert result.structured_content["outcome"] == "ended"
        assert eyes.read().still

        # a stop ends it, and a move is possible after it
        assert decided(await cell.move(holder, LEFT))[:2] == ("PERMIT", "PERMITTED")
        moving = asyncio.create_task(cell.use(holder, "speed_joint", long))
        await moved(eyes, LEFT, moving)
        await cell.use(holder, "stop", {})
        assert (await moving).structured_content["outcome"] == "stopped"
        assert (await cell.move(holder, LEFT)).structured_content["outcome"] == "reached"

        # revoked: it stops
        moving = asyncio.create_task(cell.use(other, "speed_joint", long))
        await moved(eyes, LEFT, moving)
        cell.issuer.revoke("hop", other.hop_id)
        with contextlib.suppress(Exception):
            await moving
        assert "authority_lost" in [body.get("result", {}).get("outcome") for body in cell.records("outcome")]
        assert eyes.read().still

        # beyond the robot's limits, or not of its form
        for bad, reason in (
            ({"duration_s": 2.1}, "LIMIT_EXCEEDED_BY_REQUEST"),
            ({"duration_s": 0.049}, "ROBOT_LIMIT"),
            ({"qd_rad_s": [1.1, 0, 0, 0, 0, 0]}, "LIMIT_EXCEEDED_BY_REQUEST"),
            ({"qd_rad_s": [0.1] * 5}, "PARAMETERS_WRONG"),
            ({"duration_s": 0.0505}, "NOT_ON_GRID"),
        ):
            refused = await cell.use(holder, "speed_joint", {**SPEEDS, **bad})
            assert decided(refused)[:2] == ("DENY", reason), bad
        assert eyes.read().still

        # a person in the way: the whole envelope of the stream counts
        assert decided(await cell.move(holder, LEFT))[:2] == ("PERMIT", "PERMITTED")
        await cell.see(holder, people=[{"id": "bob", "x_m": 0.66, "y_m": 0.0}])
        assert decided(await cell.use(holder, "speed_joint", {**long, "qd_rad_s": [0.5, 0, 0, 0, 0, 0]}))[0] == "DEFER"
        assert eyes.read().q_rad == pytest.approx(LEFT, abs=2e-3)

    in_cell(tmp_path, scenario)
    eyes.close()


UP = (0.0, -1.62, 1.0, -1.2, -1.57, 0.0)
TOWARDS = (-1.1, -1.62, 1.25, -1.2, -1.57, 0.0)


def test_a_path_of_waypoints_through_the_tools(controller, tmp_path):
    eyes = received(HOST)

    def path(*waypoints, speed=1.0):
        return {"waypoints_rad": [list(q) for q in waypoints], "speed_rad_s": speed, "acceleration_rad_s2": 1.4}

    async def scenario(cell):
        holder, other = cell.holder(), cell.holder("vision")
        await cell.see(holder)
        assert decided(await cell.move(holder, LEFT))[:2] == ("PERMIT", "PERMITTED")

        # it passes every waypoint, at rest, and arrives at the last; nobody else moves anything meanwhile
        here = eyes.read().q_rad
        with StateRecorder(HOST) as recorder:
            task = asyncio.create_task(cell.use(holder, "move_path", path(UP, RIGHT, UP)))
            await moved(eyes, here, task)
            for who in (holder, other):
                assert decided(await cell.move(who, LEFT))[:2] == ("DENY", "BUSY")
            result = await task
            seen = recorder.since(0.0)
        assert decided(result) == ("PERMIT", "PERMITTED", 1)
        assert result.structured_content["outcome"] == "reached", result.structured_content
        # At the place itself it stands for one sample; near it, it is slow for 0.1 s.
        rests = [sample.q_rad for sample in seen if max(map(abs, sample.qd_rad_s)) < SLOW_RAD_S]
        passed = [
            name for q in rests for name, there in (("up", UP), ("right", RIGHT)) if q == pytest.approx(there, abs=2e-3)
        ]
        assert [name for at, name in enumerate(passed) if at == 0 or name != passed[at - 1]] == ["up", "right", "up"]
        assert eyes.read().q_rad == pytest.approx(UP, abs=2e-3)

        # a stop in the second leg ends all of it
        task = asyncio.create_task(cell.use(holder, "move_path", path(LEFT, RIGHT, speed=0.6)))
        async with asyncio.timeout(20):
            while not (eyes.read().q_rad[0] > -0.5 and eyes.read().qd_rad_s[0] > 0.05):
                await asyncio.sleep(0.004)
        await cell.use(other, "stop", {})
        assert (await task).structured_content["outcome"] == "stopped"
        assert -0.55 < eyes.read().q_rad[0] < 0.55

        # what one leg may not, the path may not: a person is near the end of the last one alone
        assert decided(await cell.move(holder, LEFT))[:2] == ("PERMIT", "PERMITTED")
        await cell.see(holder, people=[{"id": "bob", "x_m": 0.0, "y_m": 3.31}])
        near = (-0.7, -1.62, 1.25, -1.2, -1.57, 0.0)
        moved_short = await cell.use(holder, "move_path", path(near, LEFT, speed=0.25))
        short = decided(moved_short)
        while moved_short.structured_content["reason"] == "WATCH_BLIND":  # as on a busy machine, which stops the arm
            moved_short = await cell.move(holder, LEFT)
        long = decided(await cell.use(holder, "move_path", path(near, LEFT, TOWARDS, speed=0.25)))
        assert short[2] <= 2 < long[2], (short, long)
        assert long[:2] == ("DEFER", "TIER_NEEDS_APPROVAL"), long
        assert eyes.read().q_rad == pytest.approx(LEFT, abs=2e-3)

        # what is no path, and what the token does not allow at one waypoint
        far = (6.4, *LEFT[1:])
        for bad, reason in (
            (path(), "PARAMETERS_WRONG"),
            (path(*[LEFT] * 5), "PARAMETERS_WRONG"),
            (path(LEFT[:5]), "PARAMETERS_WRONG"),
            (path(LEFT, far, LEFT), "ROBOT_LIMIT"),
        ):
            refused = await cell.use(holder, "move_path", bad)
            assert decided(refused)[:2] == ("DENY", reason), bad

    in_cell(tmp_path, scenario)
    eyes.close()


def swing(*, start=LEFT, way=0.8, lasts_s=3.0, count=9):
    """Arguments of a smooth swing of the first joint, as a planner would time it."""
    s = np.linspace(0, 1, count)
    made = 10 * s**3 - 15 * s**4 + 6 * s**5
    points = [(start[0] + way * share, *start[1:]) for share in made.tolist()]
    return arguments_of(JointTrajectory(tuple((lasts_s * s).tolist()), tuple(points)))


@pytest.mark.clause("LSD-24", "LSD-25", "LSD-26")
@pytest.mark.campaign
def test_a_timed_trajectory_through_the_tools(controller, tmp_path):
    eyes = received(HOST)

    async def scenario(cell):
        holder, other = cell.holder(), cell.holder("vision")
        await cell.see(holder)
        assert decided(await cell.move(holder, LEFT))[:2] == ("PERMIT", "PERMITTED")

        # one call, one decision, one record: the arm passes all points without a rest, and nobody else moves it
        await cell.see(holder)
        here = eyes.read().q_rad
        with StateRecorder(HOST) as recorder:
            task = asyncio.create_task(cell.use(holder, "follow_trajectory", swing()))
            await moved(eyes, here, task)
            for who in (holder, other):
                assert decided(await cell.move(who, LEFT))[:2] == ("DENY", "BUSY")
            result = await task
            seen = recorder.since(0.0)
        assert decided(result) == ("PERMIT", "PERMITTED", 1)
        assert result.structured_content["outcome"] == "reached", result.structured_content
        there = (LEFT[0] + 0.8, *LEFT[1:])
        assert eyes.read().q_rad == pytest.approx(there, abs=2e-3)
        on_the_way = [each for each in seen if LEFT[0] + 0.1 < each.q_rad[0] < there[0] - 0.1]
        assert on_the_way and not any(each.still for each in on_the_way)
        records = [body for body in cell.records("decision") if body["request"]["operation"] == "follow_trajectory"]
        assert len(records) == 1
        assert "3000000" in json.dumps(records[0]["request"])

        # a stop on the way ends it, and it goes on no more
        await cell.see(holder)
        task = asyncio.create_task(cell.use(holder, "follow_trajectory", swing(start=there, way=-0.8)))
        await moved(eyes, there, task)
        await cell.use(other, "stop", {})
        assert (await task).structured_content["outcome"] == "stopped"
        stood = eyes.read().q_rad
        assert there[0] - 0.75 < stood[0] < there[0]

        # one that begins elsewhere, that is faster than it says, or that the token does not allow
        slow = swing(start=stood) | {"speed_rad_s": 0.1}
        far = swing(start=stood, way=0.2)
        far["positions_rad"][-1][5] = 6.4
        late = swing(start=stood, way=0.1, lasts_s=30.0)
        for bad, reason in (
            (swing(start=RIGHT), "OUT_OF_RANGE"),
            (slow, "OUT_OF_RANGE"),
            (far, "ROBOT_LIMIT"),
            (late, "LIMIT_EXCEEDED_BY_REQUEST"),
            (swing(start=stood) | {"times_s": [0.0, 1.0]}, "OUT_OF_RANGE"),
        ):
            refused = await cell.use(holder, "follow_trajectory", bad)
            assert decided(refused)[:2] == ("DENY", reason), (reason, decided(refused))
        assert eyes.read().q_rad == pytest.approx(stood, abs=2e-3)

        # a person who comes while it moves stops it
        assert decided(await cell.move(holder, LEFT))[:2] == ("PERMIT", "PERMITTED")
        await cell.see(holder)
        task = asyncio.create_task(cell.use(holder, "follow_trajectory", swing(way=1.0, lasts_s=9.0)))
        await moved(eyes, LEFT, task)
        await cell.see(other, people=[{"id": "bob", "x_m": 0.66, "y_m": 0.0}])
        assert (await task).structured_content["outcome"] == "world_changed"
        assert eyes.read().still

        # beside a person it is a person's to say, all 200 points of it
        here = eyes.read().q_rad
        beside = swing(start=here, way=0.3, count=200)
        beside["times_s"] = np.linspace(0, 19, 200).tolist()
        async with asyncio.timeout(40):
            said = decided(await cell.use(holder, "follow_trajectory", beside))
            while said[1] == "ROBOT_NOT_EXCLUSIVE":  # a busy machine has ended our script, which is back soon
                said = decided(await cell.use(holder, "follow_trajectory", beside))
        assert said[0] == "DEFER", said
        assert cell.records("decision")[-1]["ask"]["ask_id"]

    in_cell(tmp_path, scenario)
    eyes.close()


def test_digital_outputs_through_the_tools(controller, tmp_path):
    state = received(HOST)

    async def scenario(cell):
        holder = cell.holder()
        await cell.see(holder)
        declared = dataclasses.replace(cell.server.cell, outputs=(Output(2, 1, "lamp"),))
        cell.server.physics._cell = declared  # as a cell file would declare it

        for value in (True, False, True):
            result = await cell.use(holder, "set_digital_output", {"pin": 2, "value": value})
            assert decided(result) == ("PERMIT", "PERMITTED", 1)
            assert result.structured_content == {"pin": 2, "value": value}
            assert state.next().output_bits >> 2 & 1 == value

        # an output that nobody has declared asks a person
        assert decided(await cell.use(holder, "set_digital_output", {"pin": 3, "value": True})) == (
            "DEFER",
            "TIER_NEEDS_APPROVAL",
            3,
        )
        for bad in ({"pin": 2, "value": 1}, {"pin": 8, "value": True}, {"pin": -1, "value": True}, {"pin": 2}):
            assert decided(await cell.use(holder, "set_digital_output", bad))[0] == "DENY", bad
        assert state.next().output_bits == 1 << 2

        # not while the robot is not ready, which it is soon again by itself
        cell.server.own._able = lambda: False
        await asyncio.to_thread(stop_program, HOST)
        refused = await cell.use(holder, "set_digital_output", {"pin": 2, "value": False})
        assert decided(refused)[:2] == ("DENY", "ROBOT_NOT_EXCLUSIVE")
        assert state.next().output_bits == 1 << 2
        assert decided(await cell.use(holder, "gripper_activate", {}))[:2] == ("DENY", "ROBOT_NOT_EXCLUSIVE")
        assert decided(await cell.move(holder, LEFT))[:2] == ("DENY", "ROBOT_NOT_EXCLUSIVE")

    in_cell(tmp_path, scenario)
    state.close()


async def moved(eyes, start, moving):
    """The arm has begun; `moving` is the call that moves it, and what it says if it does not."""
    async with asyncio.timeout(10):
        while abs(eyes.read().q_rad[0] - start[0]) < 0.02:
            assert not moving.done(), moving.result().structured_content
            await asyncio.sleep(0.005)


def test_a_gateway_that_observes_enforces_no_policy(controller, tmp_path):
    """Two moves, past a person and over the token's speed, are refused on record, and made."""
    eyes = received(HOST)

    async def scenario(cell):
        holder = cell.holder()
        await cell.see(holder)
        assert decided(await cell.move(holder, LEFT))[:2] == ("PERMIT", "PERMITTED")
        await cell.see(holder, people=[{"id": "bob", "x_m": 0.66, "y_m": 0.0}])
        result = await cell.move(holder, RIGHT)
        assert decided(result)[0] == "DEFER"
        assert (result.meta[DECISION_META][OBSERVED], result.structured_content["outcome"]) == (True, "reached")
        assert eyes.read().q_rad == pytest.approx(RIGHT, abs=2e-3)
        result = await cell.move(holder, LEFT, speed=1.2)
        assert decided(result)[:2] == ("DENY", "LIMIT_EXCEEDED_BY_REQUEST")
        assert result.structured_content["outcome"] == "reached", result.structured_content
        assert eyes.read().q_rad == pytest.approx(LEFT, abs=2e-3)
        assert all(body[OBSERVED] for kind in ("decision", "outcome") for body in cell.records(kind))
        assert cell.issuer.asks == {}, "nobody is asked"

    in_cell(tmp_path, scenario, unsafe_observe=recognise(HOST))
    eyes.close()


def test_the_journal_reaches_the_ledger(controller, tmp_path):
    async def scenario(cell):
        await cell.see(cell.holder())
        async with asyncio.timeout(10):
            while cell.issuer.through < cell.server.journal.last_seq:
                await asyncio.sleep(0.05)
        return cell.issuer.shipped

    shipped = in_cell(tmp_path, scenario)
    assert [record["seq"] for record in shipped] == list(range(1, len(shipped) + 1))


class OwnSensor:
    """The program of docs/sensors.md in a thread; what its pose estimator sees is told here."""

    def __init__(self, key_file, folder):
        os.replace(key_file, folder / "camera-1.key")
        self.folder, self.skeletons, self.ended, self.failed = folder, [], threading.Event(), []
        self.thread = threading.Thread(target=self.run)
        self.thread.start()

    def estimator(self):
        while not self.ended.wait(1 / 30):
            yield self.skeletons

    def run(self):
        program = FIVE_LINES.replace("127.0.0.1:8801", f"{HOST}:{PORT + 1}").replace(
            '"camera-1.', f'"{self.folder}/camera-1.'
        )
        try:
            exec(compile(program, "docs/sensors.md", "exec"), {"pose_estimator": self.estimator()})  # noqa: S102 - the page itself
        except Exception as error:  # noqa: BLE001 - told where it is waited for
            self.failed.append(error)

    def tell(self, *, people, objects):
        assert not objects and not self.failed, self.failed
        self.skeletons = people

    def end(self):
        self.ended.set()
        self.thread.join()


def test_a_person_whom_the_five_lines_of_the_page_show_defers_a_motion(controller, tmp_path, monkeypatch):
    monkeypatch.setenv("ZTPM_PASSPHRASE", PASSPHRASE)
    document = tmp_path / "camera-1.pdf"
    document.write_bytes(b"measured on Monday")
    eyes = received(HOST)

    async def scenario(cell):
        holder = cell.holder()

        async def move(q):
            # A busy machine loses the control script now and then; the tools bring it again.
            async with asyncio.timeout(60):
                while (answer := decided(await cell.move(holder, q)))[1] == "ROBOT_NOT_EXCLUSIVE":
                    await asyncio.sleep(0.1)
            return answer

        await cell.see(holder)
        assert (await move(LEFT))[:2] == ("PERMIT", "PERMITTED")

        # somebody stands there, facing the arm: people are asked, and nothing moves
        skeleton = points(COCO_17)
        await cell.see(holder, people=[skeleton])
        assert (await move(RIGHT))[0] == "DEFER"
        assert eyes.read().q_rad == pytest.approx(LEFT, abs=2e-3)
        recorded = cell.records("decision")[-1]["evidence"]
        contributing = {each["object"] for each in recorded["impact"]["contributions"]}
        assert any("person-1" in each for each in contributing), contributing

        # nobody is there any more
        await cell.see(holder)
        assert (await move(RIGHT))[:2] == ("PERMIT", "PERMITTED")
        assert not cell.records("incident")

    in_cell(
        tmp_path, scenario, sensor=lambda file: OwnSensor(file, tmp_path),
        calibration=hashlib.sha256(document.read_bytes()).hexdigest(),
    )  # fmt: skip
    eyes.close()
