"""Watch over a real motion: simulated controller, real ur_rtde client, real physics, real sensor.

The test measures with eyes of its own.

What is asserted is the stop model, not luck: from the first sample with commanded deceleration on, time and travel are the arm's alone.
When it begins depends on how busy this machine is, and has a generous limit.
"""

import asyncio
import contextlib
import time

import pytest
from tests.pep.kit import AUDIENCE, HOST
from tests.pep.test_cell import LEFT, PATIENT, RIGHT, controller, decided, in_cell  # noqa: F401 - a fixture
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stopping import read_stop

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(180)]
SPEED = 0.3
LOADED_S = 2.0
"""Longest reaction on a machine that does much else, beside the patient cell's own waiting.

The arm needs longer to the other side.
"""


@pytest.fixture
def eyes(controller):
    with StateRecorder(HOST) as eyes:
        yield eyes


async def seen(what, within_s=30.0):
    async with asyncio.timeout(within_s):
        while not what():
            await asyncio.sleep(0.002)


class Motion:
    """One motion from side to side, under way."""

    def __init__(self, cell, eyes):
        self.cell, self.eyes = cell, eyes

    async def begin(self, speed=SPEED):
        here = self.eyes.now().q_rad
        target = RIGHT if here[0] < 0 else LEFT
        async with asyncio.timeout(60):
            while True:
                self.holder, self.begun_s = self.cell.holder(), time.monotonic()
                self.call = asyncio.create_task(self.cell.move(self.holder, target, speed=speed))
                while not self.call.done() and abs(self.eyes.now().q_rad[0] - here[0]) < 0.05:
                    await asyncio.sleep(0.002)
                if not self.call.done():
                    return self
                # A verdict lives 50 ms, and a machine that does much else may need longer to record it.
                assert decided(self.call.result())[1] == "VERDICT_EXPIRED", self.call.result()

    async def stopped(self, at_s, within_s=LOADED_S):
        """The stop that the eyes saw, inside of the model; and what the record says of it."""
        with contextlib.suppress(Exception):
            # After a revocation the SDK looks at the tools once more, and is refused.
            await self.call
        await seen(lambda: self.eyes.now().still)
        stop = read_stop(self.eyes.since(self.begun_s), at_s=at_s, acceleration_rad_s2=1.4)
        assert stop is not None, "the motion was not cut short"
        assert stop.within_model, stop
        assert stop.reaction_s <= within_s, stop
        return stop, self.cell.records("outcome")[-1]


def test_a_person_who_walks_in_stops_it(eyes, tmp_path):
    async def scenario(cell):
        await cell.see(cell.holder())
        motion = await Motion(cell, eyes).begin()
        at_s = time.monotonic()
        cell.sensor.tell(people=[{"id": "bob", "x_m": -0.6, "y_m": -0.3}], objects=[])
        _, record = await motion.stopped(at_s)
        content = motion.call.result().structured_content
        assert (content["outcome"], content["reason"]) == ("world_changed", "IMPACT_ROSE")
        watch = record["watch"]
        assert (watch["outcome"], watch["reason"]) == ("world_changed", "IMPACT_ROSE")
        assert watch["index_milli"] > watch["authorised_milli"] == 1_000
        assert at_s * 1000 - 1 <= watch["t_seen_ms"] <= time.monotonic() * 1000
        assert "person" in watch["seen"]
        assert watch["q_at_standstill_rad"] == pytest.approx(eyes.now().q_rad, abs=2e-3)
        assert abs(watch["q_at_stop_rad"][0] - watch["q_at_standstill_rad"][0]) < 0.3

    in_cell(tmp_path, scenario)


def test_a_sensor_that_falls_silent_stops_it(eyes, tmp_path):
    async def scenario(cell):
        await cell.see(cell.holder())
        motion = await Motion(cell, eyes).begin()
        at_s = time.monotonic()
        cell.sensor.tell(pause=True)
        stop, record = await motion.stopped(at_s, within_s=PATIENT.watch_age_limit_s + LOADED_S)
        assert motion.call.result().structured_content["reason"] == record["watch"]["reason"] == "WATCH_BLIND", record
        # Not at once: the last frame may be so old, and was at most one period and its transit old when there were no more.
        assert stop.reaction_s > PATIENT.watch_age_limit_s - 0.5

    in_cell(tmp_path, scenario)


def test_a_motion_outlives_its_provider_until_the_lease_ends(eyes, tmp_path):
    async def scenario(cell):
        await cell.see(cell.holder())
        motion = await Motion(cell, eyes).begin(speed=0.15)
        cell.issuer.down = True
        at_s, age_s = time.monotonic(), cell.server.follower.view().age_ms / 1000
        lease_s = 2.0
        stop, record = await motion.stopped(at_s, within_s=lease_s + LOADED_S)
        assert stop.reaction_s > lease_s - age_s - 0.1, (stop, record)
        assert record["watch"]["reason"] == "REVOCATION_VIEW_STALE", record
        cell.issuer.down = False

    in_cell(tmp_path, scenario)


def test_lost_authority_stops_it_while_strangers_flood_the_server(eyes, tmp_path):
    async def scenario(cell):
        await cell.see(cell.holder())
        flood = await asyncio.create_subprocess_exec("python3", "-c", FLOOD, AUDIENCE, stdout=asyncio.subprocess.PIPE)
        try:
            await flood.stdout.readline()
            motion = await Motion(cell, eyes).begin()
            at_s = time.monotonic()
            cell.issuer.revoke("hop", motion.holder.hop_id)
            _, record = await motion.stopped(at_s)
            assert record["result"]["outcome"] == "authority_lost", record
        finally:
            flood.kill()
            await flood.wait()

    in_cell(tmp_path, scenario)


FLOOD = """
import http.client, sys, threading, urllib.parse
url = urllib.parse.urlsplit(sys.argv[1])
def pour():
    while True:
        try:
            link = http.client.HTTPConnection(url.hostname, url.port, timeout=5)
            while True:
                link.request("POST", url.path, body=b"{}" * 1000, headers={"content-type": "application/json"})
                link.getresponse().read()
                print("poured", flush=True)
        except Exception:
            pass
for _ in range(8):
    threading.Thread(target=pour).start()
"""
