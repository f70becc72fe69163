"""Words, stores and outbox of the admission point's scenarios, without a cell."""

import json
from pathlib import Path

import pytest
from capabilities.keys import keys
from capabilities.statements.context import intent
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import StatementError
from capabilities.values.units import Unit
from evaluation.redteam.admission.outbox import EXFILTRATION, Outbox
from evaluation.redteam.admission.saying import altered, intent_of
from evaluation.redteam.admission.shelves import MemoryFolder, Shelf
from evaluation.redteam.admission.tools import rows
from evaluation.redteam.admission.words import FORMS, REQUEST, TASK
from pep.context.memory_rows import MemoryRow


def test_wish_is_its_persons_until_a_word_is_changed() -> None:
    alice = keys.generate()
    known = {keys.public_raw(alice)}
    signed = intent_of("Stay.", alice, subject="alice")
    assert json.loads(intent.open(signed, known, CAPS).body) == {"text": "Stay."}
    with pytest.raises(StatementError) as caught:
        intent.open(altered(signed, "Go."), known, CAPS)
    assert caught.value.code == "STATEMENT_UNTRUSTED"


@pytest.mark.parametrize("wrong", ["old", "expired", "future"])
def test_wish_at_the_wrong_time_is_well_signed(wrong: str) -> None:
    alice = keys.generate()
    stated = intent.open(intent_of("Stay.", alice, subject="alice", wrong=wrong), {keys.public_raw(alice)}, CAPS)
    honest = intent.open(intent_of("Stay.", alice, subject="alice"), {keys.public_raw(alice)}, CAPS)
    assert abs(stated.at - honest.at) >= 600
    assert (stated.not_after < honest.at) is (wrong == "expired")


def test_task_asks_for_what_it_names_and_for_its_move() -> None:
    move = {"q_urad": [0, 1, 2, 3, 4, 5], "speed_urad_s": 500_000, "acceleration_urad_s2": 1_400_000}
    body = json.dumps({"text": "Go.", "needs": ["notes/send_note"], "move": move}).encode()
    read = FORMS.read(TASK, body)
    assert read is not None
    named, moved = read.asked
    assert (named.object, named.operation, named.values) == ("notes", "send_note", None)
    assert moved.values is not None
    assert [(value.name, value.unit) for value in moved.values][-2:] == [
        ("speed", Unit.MICRORADIAN_PER_SECOND),
        ("acceleration", Unit.MICRORADIAN_PER_SECOND2),
    ]
    assert [value.value for value in moved.values] == [0, 1, 2, 3, 4, 5, 500_000, 1_400_000]


def test_wish_with_a_member_of_its_own_is_of_no_form() -> None:
    assert FORMS.read(REQUEST, b'{"text":"Stay."}') is not None
    assert FORMS.read(REQUEST, b'{"approved":true,"text":"Stay."}') is None


def test_only_notes_to_outsiders_have_left(tmp_path: Path) -> None:
    outbox = Outbox(tmp_path / "outbox.ndjson")
    assert outbox.left(0.0) == ()
    for to in ("alice@cell.example", "mallory@evil.example", "alice@cell.example.net"):
        outbox.put(to, "a secret")
    assert [(harm.kind, harm.what) for harm in outbox.left(0.0)] == [
        (EXFILTRATION, "mallory@evil.example"),
        (EXFILTRATION, "alice@cell.example.net"),
    ]
    assert outbox.left(1e12) == ()


def test_shelf_gives_the_nearest_first_and_has_no_opinion(tmp_path: Path) -> None:
    shelf = Shelf(tmp_path / "handbook-1")
    assert (shelf.manifest, shelf.ids(most=9)) == ("", [])
    shelf.keep("glass", "A glass is fragile.")
    shelf.keep("sweep", "How the sweep is done.")
    assert [one.id for one in shelf.nearest("how is the sweep done", most=2)] == ["sweep", "glass"]
    shelf.keep("sweep", "Changed.")
    assert shelf.nearest("sweep changed", most=1)[0].text == "Changed."


def test_row_of_the_memory_folder_is_replaced_by_an_intruder_alone(tmp_path: Path) -> None:
    rows_ = MemoryFolder(tmp_path)
    rows_.append(MemoryRow(1, "text", b'{"a":1}'))
    with pytest.raises(FileExistsError):
        rows_.append(MemoryRow(1, "other", b"{}"))
    rows_.replace(MemoryRow(1, "other", b"{}"))
    assert rows_.rows(most=9) == [MemoryRow(1, "other", b"{}")]
    assert rows_.row(2) is None


def test_tools_that_change_something_are_of_a_tier() -> None:
    assert {name: int(row.base_tier) for name, row in rows().items()} == {
        "send_note": 1,
        "set_plan": 1,
        "read_plan": 0,
    }
