"""Slowing of a real motion: simulated controller, real ur_rtde client, real physics, real sensor.

The test measures with eyes of its own.
"""

import asyncio
import contextlib
import math
import time
from dataclasses import replace

import pytest
from tests.pep.rtde.packages import received
from pep.watch.governor import Governor
from tests.pep.kit import HOST
from tests.pep.test_cell import PATIENT, Child, in_cell
from tests.pep.watch.test_watch_cell import eyes, seen  # noqa: F401 - a fixture, over this module's controller

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(240)]
NEAR = (1.6, -1.62, 1.25, -1.2, -1.57, 0.0)
FAR = (-0.8, *NEAR[1:])
SPEED = 0.6
SHARED = replace(
    PATIENT,
    watch_age_limit_s=0.5,
    watch_time_limit_s=0.5,
    reaction_s=0.2,
    pacing_time_limit_s=0.2,
    slider_delay_s=0.6,
)
"""A cell that has more time, for the watch and for the slider: this machine does much else."""
TOWARDS = math.radians(-62.7)
"""Direction in which the tool ends a move to `NEAR`, as seen from the base."""


def at(distance_m):
    """Person at this distance from the base, towards the end of the move."""
    return [{"id": "bob", "x_m": distance_m * math.cos(TOWARDS), "y_m": distance_m * math.sin(TOWARDS)}]


ASIDE, CLOSE, AWAY = at(2.5), at(1.9), at(4.5)


@pytest.fixture(scope="module")
def controller():
    child = Child("ursim", "--host", HOST, "--joints=" + ",".join(map(str, FAR)), "--commands")
    yield child
    child.end()


class Motion:
    """One motion under way to a place where a person may be."""

    def __init__(self, cell, eyes):
        self.cell, self.eyes = cell, eyes

    async def begin(self):
        holder = self.cell.holder()
        before = []  # On a machine that is held up, a verdict or a sample is too old, and the cell does not begin or ends it.
        for _ in range(10):
            await self.cell.see(holder)
            if abs(self.eyes.now().q_rad[0] - FAR[0]) > 0.01:
                before.append(await self.cell.move(holder, FAR, speed=0.9))
                continue
            self.begun_s = time.monotonic()
            self.call = asyncio.create_task(self.cell.move(holder, NEAR, speed=SPEED))
            while not self.call.done() and self.eyes.now().commanded_rad_s < SPEED - 1e-6:
                await asyncio.sleep(0.002)
            if not self.call.done():
                return self
            before.append(self.call.result())
        raise AssertionError([(each.meta, each.structured_content) for each in before])

    async def ended(self):
        """Answer to the caller, the record, and the commanded speeds of all samples with their times."""
        with contextlib.suppress(Exception):
            await self.call
        await seen(lambda: self.eyes.now().still)
        speeds = [(sample.arrived_s, sample.commanded_rad_s) for sample in self.eyes.since(self.begun_s)]
        return self.call.result().structured_content, self.cell.records("outcome")[-1], speeds


def slider_now():
    state = received(HOST)
    try:
        return state.read().slider
    finally:
        state.close()


def test_it_is_slowed_where_that_suffices_and_arrives(eyes, tmp_path):
    async def scenario(cell):
        motion = await Motion(cell, eyes).begin()
        at_s = time.monotonic()
        cell.sensor.tell(people=ASIDE, objects=[])
        told, record, speeds = await motion.ended()
        assert told["outcome"] == "reached", (told, record)
        slowed, ended = told["speed"][0], told["speed"][-1]
        assert (slowed["cause"], slowed["seen"]) == ("person", True)
        assert 10 <= slowed["percent"] <= 95
        assert (ended["cause"], ended["percent"], ended["seen"]) == ("ended", 100, True)
        # The record says the same, with times of this machine's clock.
        watch = record["watch"]
        assert watch["outcome"] == "reached"
        assert [c["percent"] for c in watch["speed"]] == [c["percent"] for c in told["speed"]]
        confirmed_s = watch["speed"][0]["t_confirmed_ms"] / 1000
        assert at_s - 0.1 < watch["speed"][0]["t_ms"] / 1000 < confirmed_s
        # What the eyes saw: full speed before, from the confirmation on no more than what was told, to the end.
        lowest = min(c["percent"] for c in told["speed"]) / 100
        assert max(v for t, v in speeds if t < at_s) == pytest.approx(SPEED, abs=1e-6)
        after = [v for t, v in speeds if t > confirmed_s + 0.05]
        assert max(after) <= slowed["percent"] / 100 * SPEED
        assert min(max(after[: len(after) // 2]), SPEED * lowest) > 0.09 * SPEED, "it goes on"
        assert eyes.now().q_rad == pytest.approx(NEAR, abs=2e-3)
        assert slider_now() == 1.0

    in_cell(tmp_path, scenario, SHARED)


def test_nearer_still_it_stops(eyes, tmp_path):
    async def scenario(cell):
        motion = await Motion(cell, eyes).begin()
        cell.sensor.tell(people=ASIDE, objects=[])
        await seen(lambda: eyes.now().commanded_rad_s < 0.99 * SPEED)
        cell.sensor.tell(people=CLOSE, objects=[])
        told, record, _ = await motion.ended()
        assert (told["outcome"], told["reason"]) == ("world_changed", "IMPACT_ROSE"), record
        assert [change["cause"] for change in told["speed"]][0] == "person"
        assert told["speed"][-1]["cause"] == "ended"
        assert record["watch"]["index_milli"] > record["watch"]["authorised_milli"] == 1_000
        assert abs(eyes.now().q_rad[0] - NEAR[0]) > 0.05, "it arrived"
        assert slider_now() == 1.0

    in_cell(tmp_path, scenario, SHARED)


def test_when_they_go_away_it_goes_on_at_its_speed(eyes, tmp_path):
    async def scenario(cell):
        motion = await Motion(cell, eyes).begin()
        cell.sensor.tell(people=ASIDE, objects=[])
        await seen(lambda: eyes.now().commanded_rad_s < 0.99 * SPEED)
        cell.sensor.tell(people=AWAY, objects=[])
        left_s = time.monotonic()
        told, record, speeds = await motion.ended()
        assert told["outcome"] == "reached", record
        assert [change["cause"] for change in told["speed"]] == ["person", "clear", "ended"]
        assert told["speed"][1]["percent"] == 100
        risen_s = record["watch"]["speed"][1]["t_ms"] / 1000
        assert risen_s - left_s > SHARED.restore_dwell_s - 0.05
        between = [v for t, v in speeds if left_s + 0.3 < t < risen_s]
        assert not between or max(between) < SPEED
        assert max(v for t, v in speeds if t > risen_s) == pytest.approx(SPEED, abs=1e-6)
        assert max(v for _, v in speeds) <= SPEED + 1e-9
        assert slider_now() == 1.0

    in_cell(tmp_path, scenario, SHARED)


@pytest.mark.parametrize("believing", [False, True])
def test_a_slider_that_does_nothing_stops_it_and_without_that_it_would_not_be_slower(
    controller, eyes, tmp_path, monkeypatch, believing
):
    """The defence, and the harm without it: believing the order passes people at full speed."""
    if believing:

        def hear(self, speeds, *, now_ms):
            self._due_ms = None
            return ""

        monkeypatch.setattr(Governor, "hear", hear)

    async def scenario(cell):
        motion = await Motion(cell, eyes).begin()
        controller.tell(fault="slider_stuck")
        try:
            at_s = time.monotonic()
            cell.sensor.tell(people=ASIDE, objects=[])
            told, record, speeds = await motion.ended()
        finally:
            controller.tell(fault="slider_free")  # the controller is also the next test's
        assert told["speed"][0]["cause"] == "person"
        fastest = max(v for t, v in speeds if t > at_s + 2.0) if speeds[-1][0] > at_s + 2.0 else 0.0
        if believing:
            assert told["outcome"] == "reached"
            assert fastest == pytest.approx(SPEED, abs=1e-6)
        else:
            assert (told["outcome"], told["reason"]) == ("world_changed", "IMPACT_ROSE")
            assert "not slowed" in record["watch"]["seen"]
            assert told["speed"][0]["seen"] is False
            assert fastest == 0.0

    in_cell(tmp_path, scenario, SHARED)
