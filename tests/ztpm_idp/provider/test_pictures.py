"""Pictures of motions at the provider: taken for a record that names them, given to auditors, forgotten in time."""

from __future__ import annotations

import secrets
import sqlite3
from contextlib import closing

import pytest
from capabilities.statements.people import picture
from msgspec import structs
from tests.capabilities.statements.people.test_pictures import SHOWN
from tests.ztpm_idp.asks import PEP, Cell
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.world import World
from ztpm_idp.provider import picture_keeping
from ztpm_idp.store.pictures import pictures as stored

DAY_S = 86_400


class Pictured:
    """A world in which an enforcement point acted, and its pictures."""

    def __init__(self, world: World) -> None:
        self.world, self.cell = world, Cell(world)
        self.journal = Journal(world, registered=True)
        self.request = self.journal.acted(
            world.people["alice"].issue(world.agents["mover"], world.scope(), purpose="p").token
        )

    def text(self) -> str:
        return picture.write(structs.replace(SHOWN, omitted=secrets.randbelow(1_000_000)))

    def named(self, text: str | None = None) -> str:
        """A picture that a record in the ledger names."""
        text = self.text() if text is None else text
        self.journal.pictured(self.request, text)
        self.journal.ship()
        return text

    def bring(self, text: str, who: str = PEP):
        answer = self.cell.post(who, "/ledger/pictures", {"picture": text})
        return answer.status_code if answer.is_success else answer.json()["code"]

    def given(self, text: str, who: str = "alice"):
        answer = self.cell.get(who, f"/ledger/pictures/{picture.digest_of(text)}")
        return answer.text if answer.is_success else answer.json()["code"]

    def kept(self, text: str) -> str:
        assert self.bring(self.named(text)) == 201
        return text

    def forget(self) -> int:
        return self.world.on_loop(picture_keeping.forget(self.world.provider))

    def numbers(self):
        return {row["digest"]: (row["since_ms"], row["bytes"]) for row in self.world.rows("pictures")}


class _EnoughError(Exception):
    """Ends what goes on for ever."""


@pytest.fixture
def pictured(world):
    return Pictured(world)


@pytest.mark.clause("CON-9")
def test_a_picture_is_taken_once_its_record_stands_in_the_ledger_and_given_byte_for_byte(pictured):
    text = pictured.text()
    assert (pictured.bring(text), pictured.given(text)) == ("PICTURE_UNKNOWN", "PICTURE_UNKNOWN")
    pictured.named(text)
    assert pictured.given(text) == "PICTURE_AWAITED"
    assert pictured.bring(pictured.text()) == "PICTURE_UNKNOWN", "another picture is not the one on record"
    assert [pictured.bring(text) for _ in range(2)] == [201, 200]
    assert pictured.given(text) == text
    before = pictured.numbers()
    pictured.named(text)  # another motion with the very same picture
    assert (pictured.bring(text), pictured.numbers()) == (200, before)
    assert before[picture.digest_of(text)][1] < len(text) / 2


@pytest.mark.clause("CON-9")
def test_enforcement_points_alone_bring_pictures_and_auditors_alone_are_given_them(pictured):
    text = pictured.named()
    assert {pictured.bring(text, who) for who in ("alice", "bob", "mover")} == {"NOT_PERMITTED"}
    pictured.bring(text)
    assert {who: pictured.given(text, who) for who in ("bob", "mover", PEP)} == dict.fromkeys(
        ("bob", "mover", PEP), "NOT_PERMITTED"
    )
    assert pictured.given(text, "carol") == text
    assert pictured.cell.get("alice", "/ledger/pictures/" + "F" * 64).json()["code"] == "PICTURE_UNKNOWN"


@pytest.mark.clause("CON-9")
def test_what_a_record_names_and_is_no_picture_is_not_taken(pictured):
    """The digest binds the record to any text; only a picture is kept."""
    for text in ("{}", pictured.text() + " ", picture.write(SHOWN).replace('"arm"', '"leg"', 1)):
        assert pictured.bring(pictured.named(text)) == "STATEMENT_MALFORMED"
        assert pictured.given(text) == "PICTURE_AWAITED"
    odd = pictured.request.request_id
    for body in ({"digest": "F" * 64}, {"digest": 1}, {"reason": "QUEUE_FULL"}, {}):
        pictured.journal.record("picture", {"request_id": odd} | body)
    pictured.journal.ship()
    assert len(pictured.world.rows("pictures")) == 3, "a record without a digest names none"


@pytest.mark.clause("CON-10")
def test_pictures_are_forgotten_after_their_days_those_of_asks_too_and_their_digests_stay_on_record(pictured):
    world, cell, old, asked = pictured.world, pictured.cell, pictured.kept(pictured.text()), pictured.text()
    never = pictured.named()
    stated = cell.text(picture_digest=picture.digest_of(asked))
    ask_id = cell.post(PEP, "/approvals", {"ask": stated, "picture": asked}).json()["ask_id"]
    days = world.settings.pictures.days
    world.clock.at_s += days * DAY_S - 60
    new = pictured.kept(pictured.text())
    assert pictured.forget() == 0
    assert cell.get("carol", f"/approvals/{ask_id}/picture").text == asked
    world.clock.at_s += 120
    assert pictured.forget() == 3
    assert cell.get("carol", f"/approvals/{ask_id}/picture").json()["code"] == "ASK_UNKNOWN"
    assert [pictured.given(text) for text in (old, asked, never, new)] == [*["PICTURE_UNKNOWN"] * 3, new]
    assert pictured.bring(old) == "PICTURE_UNKNOWN", "what was forgotten does not come back"
    lines = world.people["alice"].export_ledger().decode()
    assert picture.digest_of(old) in lines and picture.digest_of(never) in lines


@pytest.mark.clause("CON-10")
def test_the_oldest_are_forgotten_where_there_is_no_room_and_none_of_the_last_hour(pictured, monkeypatch):
    world, texts = pictured.world, []
    for _ in range(6):
        texts.append(pictured.kept(pictured.text()))
        world.clock.at_s += 60
    awaited = pictured.named()
    one = max(size for _, size in pictured.numbers().values())
    monkeypatch.setattr(picture_keeping, "MEGABYTE", 1)
    monkeypatch.setattr(stored, "FORGOTTEN", 2)
    monkeypatch.setattr(picture_keeping, "FORGOTTEN", 2)
    monkeypatch.setattr(world.provider, "settings", world.settings.model_copy(
        update={"pictures": world.settings.pictures.model_copy(update={"megabytes": 3 * one})}
    ))  # fmt: skip
    assert pictured.forget() == 0, "people may still be asked about these"
    world.clock.at_s += picture_keeping.YOUNG_MS // 1_000 - 5 * 60
    assert pictured.forget() == 1, "the first alone is older than that"
    world.clock.at_s += DAY_S
    assert pictured.forget() == 2
    assert [pictured.given(text) for text in texts] == [*["PICTURE_UNKNOWN"] * 3, *texts[3:]]
    assert pictured.given(awaited) == "PICTURE_AWAITED", "it takes no room"
    assert pictured.forget() == 0


@pytest.mark.clause("CON-10")
def test_the_provider_looks_by_itself_and_goes_on_after_a_fault(pictured, monkeypatch):
    looked = []

    async def forget(provider):
        looked.append(provider)
        if len(looked) == 1:
            raise picture_keeping.StoreUnavailableError
        if len(looked) == 3:
            raise _EnoughError

    monkeypatch.setattr(picture_keeping, "forget", forget)
    with pytest.raises(_EnoughError):
        pictured.world.on_loop(picture_keeping.keep_pictures(pictured.world.provider, period_s=0))
    assert looked == [pictured.world.provider] * 3


@pytest.mark.clause("CON-10")
def test_pictures_of_earlier_asks_are_moved_into_the_table(tmp_path):
    """A store of the release before, with two asks of one picture, one of another, and one of none."""
    with World(tmp_path, database="sqlite") as world:
        cell, (one, other) = Cell(world), (picture.write(structs.replace(SHOWN, omitted=n)) for n in (1, 2))
        asked = [cell.taken()[0]]
        for text in (one, one, other):
            stated = cell.text(picture_digest=picture.digest_of(text))
            asked.append(cell.post(PEP, "/approvals", {"ask": stated, "picture": text}).json()["ask_id"])
            world.clock.at_s += 60
        taken = {row["ask_id"]: row["taken_ms"] for row in world.rows("asks")}
        world.stop()
        with closing(sqlite3.connect(tmp_path / "idp.sqlite")) as base, base:
            for later in ("pictures", "push_subscriptions"):
                base.execute(f"DROP TABLE {later}")
            base.execute("ALTER TABLE asks DROP COLUMN picture_digest")
            base.execute("ALTER TABLE asks ADD COLUMN picture TEXT NOT NULL DEFAULT ''")
            for ask_id, text in zip(asked[1:], (one, one, other), strict=True):
                base.execute("UPDATE asks SET picture = ? WHERE ask_id = ?", (text, ask_id))
            base.execute("UPDATE alembic_version SET version_num = 'v0029'")
        world.start()
        answers = [cell.get("carol", f"/approvals/{ask_id}/picture") for ask_id in asked]
        assert [answer.status_code for answer in answers] == [404, 200, 200, 200]
        assert [answer.text for answer in answers[1:]] == [one, one, other]
        since = {row["digest"]: row["since_ms"] for row in world.rows("pictures")}
        assert since == {picture.digest_of(one): taken[asked[2]], picture.digest_of(other): taken[asked[3]]}
