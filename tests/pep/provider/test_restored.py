"""A provider whose database was restored: nothing that was heard is forgotten, and no other history is taken for ours."""

import asyncio
import json
import os

import pytest
from capabilities.values.caps import DEFAULT as CAPS
from msgspec import structs
from pep.base.errors import FeedError, PepFault
from pep.provider.feed_mark import KeptRevocations
from capabilities.statements import revocation
from tests.pep.kit import ISSUER
from tests.pep.provider.test_feed import World, full


@pytest.fixture
def world(tmp_path):
    world = World(tmp_path)
    for name in ("first", "second"):
        world.issuer.revoke("agent", name)
    world.pull()
    world.backup = world.issuer.epoch, list(world.issuer.entries)
    for name in ("third", "fourth"):
        world.issuer.revoke("agent", name)
    world.pull()
    return world


def restore(world, *, line=None):
    """The old database is back; announced as a new line, or not."""
    world.issuer.epoch, world.issuer.entries = world.backup[0], list(world.backup[1])
    world.issuer.line = world.issuer.line if line is None else line


def agents(world):
    return {id_ for kind, id_ in world.follower.view().revoked if kind == "agent"}


ALL = {"first", "second", "third", "fourth"}


@pytest.mark.parametrize("restarted", [False, True])
@pytest.mark.parametrize("since", [0, 1, 2, 3])
def test_a_database_that_was_put_back_in_silence_is_refused(world, restarted, since):
    """At every number of revocations that follow, also where the epochs are level again, and beyond."""
    restore(world)
    for number in range(since):
        world.issuer.revoke("agent", f"new-{number}")
    if restarted:
        world.restart()
    world.refused(PepFault.FEED_ROLLED_BACK if since < 2 else PepFault.FEED_FORKED)
    assert agents(world) >= ALL or restarted
    world.refused(PepFault.FEED_ROLLED_BACK if since < 2 else PepFault.FEED_FORKED)
    assert {name for kind, name in world.follower._kept.revoked} == ALL | {f"new-{n}" for n in range(since)}


@pytest.mark.parametrize("restarted", [False, True])
@pytest.mark.parametrize("since", [0, 1, 2, 3])
def test_a_new_line_is_told_whole_and_nothing_is_forgotten(world, restarted, since):
    restore(world, line=7)
    world.issuer.registry_version = 0
    for number in range(since):
        world.issuer.revoke("agent", f"new-{number}")
    new = {f"new-{n}" for n in range(since)}
    if restarted:
        world.restart()
    world.pull()
    assert (world.follower.view().epoch, world.follower.view().age_ms, agents(world)) == (2 + since, 0, ALL | new)
    world.issuer.revoke("agent", "later")
    world.pull()
    world.restart()
    world.pull()
    assert agents(world) == ALL | new | {"later"}
    # the line before is over
    world.issuer.line = 0
    world.refused(PepFault.FEED_ROLLED_BACK)


def test_a_head_that_is_not_that_of_the_entries_is_refused(world):
    world.issuer.lie = {"head": "e" * 64}
    world.issuer.revoke("agent", "fifth")
    world.refused(PepFault.FEED_FORKED)
    assert "fifth" in agents(world), "revoked even so"


def test_a_mark_of_an_earlier_release_is_taken_as_far_as_it_goes(world):
    world.path.write_text(json.dumps({"issuer": ISSUER, "epoch": 4, "registry_version": 1}))
    world.restart()
    world.pull()
    assert json.loads(world.path.read_text())["head"] == world.follower._known.head
    world.path.write_text(json.dumps({"issuer": ISSUER, "epoch": 5, "registry_version": 1}))
    world.restart()
    world.refused(PepFault.FEED_ROLLED_BACK)


def kept(world, *, after_s=0, issuer=ISSUER):
    return KeptRevocations(
        world.path.with_suffix(".kept"), issuer=issuer, caps=CAPS, at=world.clock.wall_s() + after_s
    ).revoked


def test_a_token_and_a_hop_are_kept_until_they_would_have_ended_and_the_rest_for_ever(world):
    world.issuer.revoke("hop", "a" * 32)
    world.pull()
    world.issuer.revoke("token", "A" * 22)
    world.pull()
    passing = {("hop", "a" * 32), ("token", "A" * 22)}
    lasting = {("agent", name) for name in ALL}
    assert kept(world, after_s=CAPS.lifetime_s + CAPS.skew_s) == lasting | passing
    assert kept(world, after_s=CAPS.lifetime_s + CAPS.skew_s + 1) == lasting
    assert kept(world) == lasting, "what was dropped is gone"


def test_the_file_holds_no_more_than_it_needs(world):
    before = world.path.with_suffix(".kept").read_bytes()
    assert before.count(b"\n") == 2, "one line for each pull that brought something"
    world.path.unlink()
    world.path.with_suffix(".kept").unlink()
    world.restart()
    world.pull()
    world.pull()
    whole = world.path.with_suffix(".kept").read_bytes()
    assert whole.count(b"\n") == 1
    world.path.with_suffix(".kept").write_bytes(before + whole)
    assert kept(world) == {("agent", name) for name in ALL}
    assert world.path.with_suffix(".kept").read_bytes() == whole
    assert kept(world, issuer="http://127.0.0.1:1/other") == set()


def test_what_is_heard_while_it_is_written_is_written_the_next_time(world, monkeypatch):
    held, hears = world.follower._kept, world.issuer
    late = revocation.RevocationIndex(
        issuer=ISSUER, epoch=9, since=8, as_of_ms=0, nonce="0" * 16, registry_version=1,
        entries=(revocation.RevocationEntry(9, "agent", "late"),),
    )  # fmt: skip
    text, fsync = revocation.sign(late, hears.made["feed"]), os.fsync

    def meanwhile(descriptor):
        fsync(descriptor)
        held.hear(late, text, at=world.clock.wall_s())

    monkeypatch.setattr("pep.provider.feed_mark.os.fsync", meanwhile)
    held.hear(structs.replace(late, entries=(revocation.RevocationEntry(9, "agent", "early"),)), text, at=0)
    held.sync()
    monkeypatch.undo()
    assert not held.synced
    held.sync()
    assert held.synced
    assert ("agent", "late") in kept(world)


def test_a_line_that_was_cut_by_a_power_failure_is_left_out(world):
    path = world.path.with_suffix(".kept")
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    assert kept(world) == {("agent", "first"), ("agent", "second")}
    assert path.read_bytes() == whole[: whole.index(b"\n") + 1]
    path.write_bytes(whole[20:])
    with pytest.raises(FeedError) as raised:
        kept(world)
    assert raised.value.code is PepFault.STATE_UNREADABLE


def test_what_could_not_be_kept_is_in_force_and_is_kept_later(world, monkeypatch):
    world.issuer.revoke("agent", "fifth")
    monkeypatch.setattr("os.fsync", full)
    world.clock.advance(300)
    for _ in range(2):
        world.refused(PepFault.STATE_UNREADABLE)
        assert "fifth" in agents(world)
        assert world.follower.view().age_ms == 300
    monkeypatch.undo()
    world.pull()
    assert world.follower.view().age_ms == 0
    assert ("agent", "fifth") in kept(world)


@pytest.mark.clause("STM-15")
@pytest.mark.parametrize("restarted", [False, True])
def test_a_provider_that_is_restored_is_told_what_this_point_knows(world, restarted):
    restore(world, line=1)
    world.issuer.restoring = True
    if restarted:
        world.restart()
    world.refused(PepFault.FEED_RESTORING)
    world.refused(PepFault.FEED_RESTORING)
    (told,) = world.issuer.marks
    assert (told.line, told.epoch, told.remaining) == (0, 4, 0)
    assert {entry.id for entry in told.entries} == ALL
    world.clock.advance(5_000)
    world.refused(PepFault.FEED_RESTORING)
    assert len(world.issuer.marks) == 2, "and again, should it be another restore"


@pytest.mark.clause("STM-15")
def test_a_new_line_is_accepted_once_its_provider_was_told(world):
    restore(world, line=1)
    world.issuer.mark_status = 503
    world.refused(PepFault.FEED_UNREACHABLE)
    assert json.loads(world.path.read_text())["line"] == 0
    world.issuer.mark_status = 200
    world.pull()
    world.pull()
    assert [(told.line, told.epoch) for told in world.issuer.marks] == [(0, 4), (0, 4)]
    assert json.loads(world.path.read_text())["line"] == 1


@pytest.mark.clause("STM-15")
def test_a_point_that_was_wiped_tells_nothing(world):
    world.path.unlink()
    world.path.with_suffix(".kept").unlink()
    world.restart()
    world.issuer.restoring = True
    world.refused(PepFault.FEED_RESTORING)
    world.issuer.restoring, world.issuer.line = False, 1
    world.pull()
    assert world.issuer.marks == []


def test_a_long_mark_is_told_in_parts(world, monkeypatch):
    monkeypatch.setattr("pep.provider.feed_mark.PART_BYTES", 100)
    world.issuer.restoring = True
    world.refused(PepFault.FEED_RESTORING)
    assert [(told.remaining, [entry.id for entry in told.entries]) for told in world.issuer.marks] == [
        (1, ["first", "fourth"]),
        (0, ["second", "third"]),
    ]


def test_the_refusal_of_a_copy_that_was_put_back_by_hand_names_the_command(world):
    restore(world)
    with pytest.raises(FeedError) as raised:
        world.pull()
    assert "ztpm idp restore" in raised.value.detail


def test_a_new_line_asks_for_the_whole_word_on_conduct(world):
    world.issuer.conduct_version = 5
    asyncio.run(world.follower.standings.pull())
    restore(world, line=1)
    world.pull()
    world.issuer.conduct_version = 0
    asyncio.run(world.follower.standings.pull())
    assert world.follower.conduct().age_ms == 0


# --- bases -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def fresh(tmp_path):
    return World(tmp_path)


def based(world, revocations=8, base=6):
    """A feed whose first hops have ended: its base leaves them out."""
    for number in range(revocations):
        world.issuer.revoke("hop", f"{number:032x}")
    world.issuer.base_epoch = base
    world.issuer.ended = frozenset({("hop", f"{number:032x}") for number in range(4)})


@pytest.mark.clause("STM-18")
@pytest.mark.parametrize("page", [2, 3, 4_096])
def test_a_new_point_begins_with_the_base_and_goes_on_from_its_head(fresh, monkeypatch, page):
    monkeypatch.setattr(revocation, "ENTRIES", page)
    based(fresh)
    fresh.pull()
    view = fresh.follower.view()
    assert (view.epoch, len(view.revoked)) == (8, 4)
    fresh.issuer.revoke("agent", "mover")
    fresh.pull()
    assert fresh.follower.view().epoch == 9
    assert fresh.follower._mark.head == fresh.issuer.heads[9]


@pytest.mark.clause("STM-18")
def test_a_point_that_was_away_is_shown_what_lies_between_its_mark_and_the_base(fresh):
    fresh.issuer.revoke("hop", "e" * 32)
    fresh.issuer.revoke("agent", "early")
    fresh.pull()
    based(fresh)
    fresh.restart()
    fresh.issuer.asked.clear()
    fresh.pull()
    assert fresh.issuer.asked.count("/revocations") == 2
    assert fresh.follower.view().epoch == 10
    assert {("agent", "early"), ("hop", f"{0:032x}")} <= fresh.follower.view().revoked, "also what has ended since"


@pytest.mark.clause("STM-18")
def test_a_base_hides_no_other_history_from_a_point_that_was_away(fresh):
    """The entries below the base, where the mark lies, are others than this point was told."""
    fresh.issuer.revoke("hop", "e" * 32)
    fresh.issuer.revoke("agent", "early")
    fresh.pull()
    fresh.issuer.entries.clear()
    fresh.issuer.epoch = 0
    fresh.issuer.revoke("hop", "f" * 32)
    fresh.issuer.revoke("agent", "other")
    based(fresh)
    fresh.restart()
    fresh.refused(PepFault.FEED_FORKED)


@pytest.mark.clause("STM-18")
@pytest.mark.parametrize("at", [6, 8])
def test_a_base_with_another_head_than_the_mark_or_the_chain_is_refused(fresh, at):
    """At the mark itself, or below it: the chain from the base does not meet the index."""
    based(fresh, revocations=at)
    fresh.pull()
    fresh.restart()
    fresh.issuer.lie = {"base": revocation.RevocationBase(6, "0" * 63 + "1", at)}
    fresh.refused(PepFault.FEED_FORKED)


@pytest.mark.clause("STM-18")
def test_another_base_in_the_middle_is_refused(fresh, monkeypatch):
    monkeypatch.setattr(revocation, "ENTRIES", 2)
    based(fresh)
    inner = fresh.issuer.index

    def moving(**query):
        text = inner(**query)
        fresh.issuer.base_epoch = 7
        return text

    monkeypatch.setattr(fresh.issuer, "index", moving)
    fresh.refused(PepFault.FEED_WRONG_RANGE)
