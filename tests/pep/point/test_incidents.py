"""Incidents beside requests: told once a minute for each kind, with their place or their code."""

import asyncio

import pytest
from pep.base.errors import FeedError, PepFault
from tests.pep.kit import ManualClock
from pep.point.incidents import TOLD_EACH_MS, Incidents

SILENT = FeedError(PepFault.FEED_UNREACHABLE, "nobody answers")


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def incidents(clock):
    return Incidents(clock)


def test_what_goes_wrong_again_is_told_once_a_minute(incidents, clock, caplog):
    for _ in range(3):
        incidents.tell("feed", SILENT)
    clock.advance(TOLD_EACH_MS - 1)
    incidents.tell("feed", SILENT)
    assert len(caplog.messages) == 1
    clock.advance(1)
    incidents.tell("feed", SILENT)
    assert caplog.messages == [f"feed: {SILENT}"] * 2


def test_another_kind_is_told_at_once_and_so_is_the_same_of_another_part(incidents, caplog):
    for what, error in [("feed", SILENT), ("ledger", SILENT), ("feed", ValueError("x")), ("feed", KeyError("x"))]:
        incidents.tell(what, error)
    assert len(caplog.messages) == 4


def test_where_it_was_is_told_unless_it_has_a_code_of_ours(incidents, caplog):
    incidents.tell("feed", SILENT)
    incidents.tell("feed", ValueError("x"))
    assert [record.exc_info is not None for record in caplog.records] == [False, True]


def test_a_task_that_dies_is_told(incidents, caplog):
    async def dies():
        await asyncio.sleep(0)
        raise ValueError("it is broken")

    async def scenario():
        with pytest.raises(ValueError, match="it is broken"):
            await incidents.watched("leases", dies())

    asyncio.run(scenario())
    assert caplog.messages == ["leases: ValueError"]
    assert "in dies" in caplog.text


def test_a_task_that_ends_or_is_ended_is_not_told(incidents, caplog):
    async def scenario():
        await incidents.watched("leases", asyncio.sleep(0))
        task = incidents.watched("leases", asyncio.Event().wait())
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await asyncio.sleep(0)

    asyncio.run(scenario())
    assert caplog.messages == []
