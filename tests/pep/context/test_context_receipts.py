"""Receipts: what one admission point admitted, another believes of exactly that value, for exactly that holder."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from capabilities.values.arguments import argument
from capabilities.values.units import Quantity, Unit, kind_of
from hypothesis import given
from hypothesis import strategies as st
from pep.context.arguments import PRESENTED, ArgumentContext, PresentedReceipt, arguments, named_arguments
from pep.context.flow import Holder, own
from pep.context.json_value import Plain
from policies.evidence.content_readings import ArgumentReading
from policies.evidence.model import Point, Request
from policies.words.labels import Integrity, Source, joined
from tests.capabilities.world import CELL, NOW, OTHER_CELL, key_of, raw_of
from tests.pep.context.context_kit import (
    ADMITTERS,
    CAPS,
    CURATED,
    PEP_KEY,
    SENSED,
    UNVOUCHED,
    chain_to,
    move,
    replaced,
    said,
)
from tests.pep.context.test_context_flow import labels, no_better

from capabilities.statements.context import admission as statement
from pep.context import json_value as values
from pep.context import receipts

pytestmark = pytest.mark.clause("STM-10")

HOLDER = Holder("0a" * 16, "robotic")
OWN = own(HOLDER)
VALUE = {"pick": {"x_um": -5, "speed_urad_s": 500_000}, "q_rad": [0, 0.25], "speed_rad_s": 0.5, "note": "red"}
REQUEST = Request("r", frozenset({Point.TOOL}), CELL, "ur3e", "move_joint", move(500_000), NOW)
SPEED = "/pick/speed_urad_s"


def receipt(value=VALUE, label=SENSED, holder=HOLDER, *, audience=CELL, key=PEP_KEY, at=NOW, **other):
    return receipts.issue(values.plain(value), label, holder, audience=audience, key=key, at=at, **other)


def shown(pointers=None, value=VALUE, *, text=None, **other):
    raw = value if isinstance(value, bytes) else json.dumps(value).encode()
    pointers = {"speed": SPEED} if pointers is None else pointers
    return PresentedReceipt(receipt(**other) if text is None else text, raw, pointers)


def known(**other):
    return ArgumentContext(
        **{**{"holder": HOLDER, "context": OWN, "admitters": ADMITTERS, "at": NOW + 1, "caps": CAPS}, **other}
    )


def read(*presented, request=REQUEST, **other) -> dict[str, ArgumentReading]:
    found = arguments(request, presented, known(**other))
    assert [reading.name for reading in found] == [quantity.name for quantity in request.values]
    return {reading.name: reading for reading in found}


# --- what is believed ------------------------------------------------------------------------------------------------


def test_an_argument_that_is_the_admitted_value_has_its_label():
    found = read(shown())
    assert found["speed"] == ArgumentReading("speed", replaced(SENSED, age_ms=1_040))
    assert found["q0"].label == joined((OWN, replaced(SENSED, age_ms=1_040))) and found["q0"].fault == ""


def test_without_receipts_every_argument_is_the_holders_choice():
    assert all(reading == ArgumentReading(name, OWN) for name, reading in read().items())


def test_the_words_of_a_receipt_are_those_of_a_label():
    assert list(statement.SOURCES) == sorted(map(str, Source))
    assert list(statement.INTEGRITIES) == [each.name.lower() for each in Integrity]
    assert [Integrity(n).name.lower() for n, _ in enumerate(statement.INTEGRITIES)] == list(statement.INTEGRITIES)


@given(labels, st.integers(0, 3_000))
def test_a_label_comes_back_as_old_as_it_is(label, later_s):
    opened = receipts.verify(receipt(label=label), admitters=ADMITTERS, caps=CAPS)
    assert receipts.label_of(opened, at=NOW + later_s) == replaced(label, age_ms=label.age_ms + later_s * 1_000)
    assert receipts.label_of(opened, at=NOW - 9) == label


def test_what_is_known_of_the_context_is_in_every_choice():
    context = joined((OWN, replaced(UNVOUCHED, tainted=True)))
    found = read(shown(), context=context)
    assert found["q0"].label.tainted and found["q0"].label.integrity is Integrity.NONE
    assert not found["speed"].label.tainted and found["speed"].label.integrity is Integrity.SENSED


def test_the_taint_of_a_receipt_is_in_every_choice():
    found = read(shown(label=replaced(CURATED, tainted=True)), shown({}, {"other": 1}, text=receipt({"other": 1})))
    assert found["speed"].label.tainted and found["q0"].label.tainted


def test_two_receipts_for_one_argument_give_the_least():
    found = read(shown(), shown(label=CURATED))
    assert found["speed"].label == joined((replaced(SENSED, age_ms=1_040), replaced(CURATED, age_ms=1_000)))


WORDS = {
    "query": "pump 7",
    "bleed": True,
    "tags": ["a", "b"],
    "filter": {"b": 1.0, "a": None},
    "pins": [1, 2],
    "lengths_um": [1, 2],
}
KINDS = {
    "query": "text",
    "bleed": "flag",
    "tags": "[text]",
    "filter": "free",
    "pins": "[count]",
    "lengths_um": "[um]",
    "lengths": "[um]",
}


def searching(**changes):
    values_ = tuple(argument(name, kind_of(KINDS[name]), value) for name, value in {**WORDS, **changes}.items())
    return replace(REQUEST, object="docs", operation="search", values=values_)


def test_a_value_of_another_kind_is_vouched_for_where_it_is_the_same():
    everything = shown({name: f"/{name}" for name in WORDS}, WORDS, text=receipt(WORDS))
    found = read(everything, request=searching())
    assert {reading.label.integrity for reading in found.values()} == {Integrity.SENSED}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("lengths", [1, 2]),
        ("query", "pump 8"),
        ("bleed", False),
        ("tags", ["b", "a"]),
        ("filter", {"a": None}),
        ("pins", [1]),
    ],
)
def test_another_value_or_unit_is_not_the_admitted_one(name, value):
    place = "/pins" if name == "lengths" else f"/{name}"
    found = read(shown({name: place}, WORDS, text=receipt(WORDS)), request=searching(**{name: value}))
    assert (found[name].fault, found[name].label.integrity) == ("NOT_AT_THAT_PLACE", Integrity.NONE)


# --- what is not -----------------------------------------------------------------------------------------------------

THERE = {CELL: raw_of("pep"), OTHER_CELL: raw_of("pep-2")}
FORGED = receipt(key=key_of("mallory"))
BROKEN = {
    "of a stranger": ({"text": FORGED}, {}, "STATEMENT_UNTRUSTED"),
    "of the agent itself": ({"key": key_of("robotic")}, {}, "STATEMENT_UNTRUSTED"),
    "of a PEP that is no longer registered": ({}, {"admitters": {}}, "STATEMENT_UNTRUSTED"),
    "of one PEP in the name of another": ({"key": key_of("pep-2")}, {"admitters": THERE}, "STATEMENT_UNTRUSTED"),
    "of a PEP in the name of nobody": ({"audience": OTHER_CELL}, {}, "STATEMENT_UNTRUSTED"),
    "another holder's": ({"holder": Holder("0b" * 16, "robotic")}, {}, "OTHER_HOLDER"),
    "another agent's": ({"holder": Holder("0a" * 16, "vision")}, {}, "OTHER_HOLDER"),
    "shown by another holder": ({}, {"holder": Holder("0b" * 16, "robotic")}, "OTHER_HOLDER"),
    "over": ({}, {"at": NOW + receipts.LIFETIME_S}, "EXPIRED"),
    "of the future": ({"at": NOW + 7}, {}, "NOT_YET_VALID"),
    "another kind": ({"text": said(chain_to("robotic"), key=PEP_KEY)}, {}, "STATEMENT_WRONG_KIND"),
    "no statement": ({"text": "believe me"}, {}, "STATEMENT_MALFORMED"),
    "nothing": ({"text": ""}, {}, "STATEMENT_MALFORMED"),
    "for another value": ({"value": {**VALUE, "note": "blue"}, "text": receipt()}, {}, "VALUE_CHANGED"),
    "for a value with one more member": ({"value": {**VALUE, "more": 1}, "text": receipt()}, {}, "VALUE_CHANGED"),
    "for a part of the value": ({"value": VALUE["pick"], "text": receipt()}, {}, "VALUE_CHANGED"),
    "with a member twice": ({"value": b'{"a":1,"a":1}', "text": receipt()}, {}, "VALUE_MALFORMED"),
    "with NaN": ({"value": b'{"a":NaN}', "text": receipt()}, {}, "VALUE_MALFORMED"),
    "with an endless number": ({"value": b'{"a":1e999}', "text": receipt()}, {}, "VALUE_MALFORMED"),
    "that is no JSON": ({"value": b"\xff", "text": receipt()}, {}, "VALUE_MALFORMED"),
    "that is too deep": ({"value": b"[" * 99 + b"]" * 99, "text": receipt()}, {}, "VALUE_MALFORMED"),
    "that is too large": ({"value": b'"%s"' % (b"x" * values.VALUE_BYTES), "text": receipt()}, {}, "VALUE_TOO_LARGE"),
    "at a place that is none": ({"pointers": {"speed": "/pick/nowhere"}}, {}, "NOT_AT_THAT_PLACE"),
    "at another place": ({"pointers": {"speed": "/pick/x_um"}}, {}, "NOT_AT_THAT_PLACE"),
    "at what is no pointer": ({"pointers": {"speed": "pick/speed_urad_s"}}, {}, "NOT_AT_THAT_PLACE"),
    "at the whole value": ({"pointers": {"speed": ""}}, {}, "NOT_AT_THAT_PLACE"),
    "for an argument that there is not": ({"pointers": {"speed": SPEED, "slowness": SPEED}}, {}, "UNKNOWN_ARGUMENT"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_receipt_that_is_not_believed_vouches_for_nothing(name):
    change, where, fault = BROKEN[name]
    reading = read(shown(**change), **where)["speed"]
    assert reading.fault == fault and type(reading.fault) is str
    assert reading.label.integrity is Integrity.NONE


def test_a_receipt_that_is_believed_until_the_last_second():
    assert read(shown(), at=NOW + receipts.LIFETIME_S - 1)["speed"].fault == ""
    assert read(shown(at=NOW + 6))["speed"].fault == ""


def test_a_receipt_for_no_argument_speaks_for_all_when_it_is_broken():
    assert {reading.fault for reading in read(shown({}, text=FORGED)).values()} == {"STATEMENT_UNTRUSTED"}
    assert {reading.fault for reading in read(shown({})).values()} == {""}


def test_a_broken_receipt_beside_a_good_one_breaks_the_argument():
    assert read(shown(), shown(text=FORGED))["speed"].fault == "STATEMENT_UNTRUSTED"
    assert read(shown(), shown(text=FORGED))["q0"].fault == ""


def test_what_is_over_still_says_what_was_read():
    """An expired receipt vouches for nothing, and its taint stays with the holder that shows it."""
    stale = shown(label=replaced(CURATED, tainted=True))
    found = read(stale, at=NOW + 700)
    assert (found["speed"].fault, found["q0"].fault) == ("EXPIRED", "")
    assert found["q0"].label.tainted


def test_too_many_receipts_are_none():
    found = read(*[shown()] * (PRESENTED + 1))
    assert {reading.fault for reading in found.values()} == {"TOO_MANY"}
    assert all(reading.label.tainted and reading.label.integrity is Integrity.NONE for reading in found.values())
    large = shown(value={"x": "x" * (values.VALUE_BYTES // 2)})
    assert {reading.fault for reading in read(large, large).values()} == {"VALUE_TOO_LARGE"}


# --- units -----------------------------------------------------------------------------------------------------------

URAD_S = Quantity("speed", Unit.MICRORADIAN_PER_SECOND, 500_000)
EQUAL = [
    ({"speed_urad_s": 500_000}, "/speed_urad_s", URAD_S, True),
    ({"speed_urad_s": 500_001}, "/speed_urad_s", URAD_S, False),
    ({"speed_rad_s": 0.5}, "/speed_rad_s", URAD_S, True),
    ({"rad_s": 0.5}, "/rad_s", URAD_S, True),
    ({"speed_rad_s": 500_000}, "/speed_rad_s", URAD_S, False),
    ({"speed_um_s": 500_000}, "/speed_um_s", URAD_S, False),
    ({"speed_rad": 0.5}, "/speed_rad", URAD_S, False),
    ({"speed": 500_000}, "/speed", URAD_S, False),
    ({"confidence": 0.5}, "/confidence", URAD_S, False),
    ({"speed_urad_s": "500000"}, "/speed_urad_s", URAD_S, False),
    ({"speed_urad_s": 500_000.5}, "/speed_urad_s", URAD_S, False),
    ({"q_rad": [0, 0.25]}, "/q_rad/1", Quantity("q1", Unit.MICRORADIAN, 250_000), True),
    ({"q_rad": [0, 0.25]}, "/q_rad/0", Quantity("q0", Unit.MICRORADIAN, 0), True),
    ({"q_rad": [0, 0.25]}, "/q_rad/01", Quantity("q1", Unit.MICRORADIAN, 250_000), False),
    ({"q_rad": [0, 0.25]}, "/q_rad/-", Quantity("q1", Unit.MICRORADIAN, 250_000), False),
    ({"q_rad": [0, 0.25]}, "/q_rad/2", Quantity("q1", Unit.MICRORADIAN, 250_000), False),
    ([0, 0.25], "/1", Quantity("q1", Unit.MICRORADIAN, 250_000), False),
    ({"hold_s": 2}, "/hold_s", Quantity("hold", Unit.MILLISECOND, 2_000), True),
    ({"speed_rad_s": 2}, "/speed_rad_s", Quantity("hold", Unit.MILLISECOND, 2_000), False),
    ({"hold_ms": 2_000}, "/hold_ms", Quantity("hold", Unit.MILLISECOND, 2_000), True),
    ({"part_kg": 0.25}, "/part_kg", Quantity("payload", Unit.GRAM, 250), True),
    ({"pin": 3}, "/pin", Quantity("pin", Unit.COUNT, 3), True),
    ({"pin": True}, "/pin", Quantity("pin", Unit.COUNT, 1), False),
    ({"pin_count": True}, "/pin_count", Quantity("pin", Unit.COUNT, 1), False),
    ({"pin_count": 1}, "/pin_count", Quantity("pin", Unit.COUNT, 1), True),
    ({"hold_s": 3}, "/hold_s", Quantity("pin", Unit.COUNT, 3), False),
    ({"a/b": {"~": {"x_m": 0.001}}}, "/a~1b/~0/x_m", Quantity("x", Unit.MICROMETRE, 1_000), True),
]  # fmt: skip


@pytest.mark.parametrize(("value", "pointer", "quantity", "equal"), EQUAL)
def test_a_number_is_vouched_for_in_its_unit(value, pointer, quantity, equal):
    request = replaced(REQUEST, values=(quantity,))
    found = read(shown({quantity.name: pointer}, value, text=receipt(value)), request=request)
    assert found[quantity.name].fault == ("" if equal else "NOT_AT_THAT_PLACE")


@pytest.mark.parametrize(
    ("call", "pointer", "equal"),
    [
        ({"note": "red"}, "/note", True),
        ({"note": "re\u200bd"}, "/note", False),
        ({"note": {"x_um": -5, "speed_urad_s": 500_000}}, "/pick", True),
        ({"note": 1}, "/pick/x_um", False),
        ({"note": VALUE}, "", True),
        ({"note": [0, 0.25]}, "/q_rad", True),
        ({"note": [False, 0.25]}, "/q_rad", False),
        ({"note": [0.0, 0.25]}, "/q_rad", True),
        ({"note": float("nan")}, "/q_rad", False),
        ({"note": object()}, "/q_rad", False),
    ],
)
def test_named_arguments_are_equal_to_the_letter(call, pointer, equal):
    (found,) = named_arguments(call, [shown({"note": pointer})], known())
    assert found.fault == ("" if equal else "NOT_AT_THAT_PLACE")


# --- never raises, never better --------------------------------------------------------------------------------------

texts = st.one_of(st.just(receipt()), st.just(FORGED), st.just(receipt(label=CURATED)), st.text(max_size=40))
raws = st.one_of(st.just(json.dumps(VALUE).encode()), st.binary(max_size=40))
pointers = st.dictionaries(
    st.sampled_from(["speed", "q0", "q1", "nobody"]),
    st.one_of(st.just(SPEED), st.just("/q_rad/0"), st.just("/pick/x_um"), st.text(max_size=12)),
    max_size=3,
)


@given(
    st.lists(st.builds(PresentedReceipt, texts, raws, pointers), max_size=4), labels, st.integers(NOW - 9, NOW + 900)
)
def test_no_argument_is_better_than_its_receipts_and_its_holder(presented, context, at):
    """A vouched argument has its receipt's label, and any other no better one than the context."""
    for reading in arguments(REQUEST, presented, known(context=context, at=at)):
        stated = [one for one in presented if reading.name in one.pointers]
        if reading.fault:
            assert reading.label.integrity is Integrity.NONE
        elif stated:
            opened = [receipts.verify(one.receipt, admitters=ADMITTERS, caps=CAPS) for one in stated]
            assert reading.label == joined(receipts.label_of(one, at=at) for one in opened)
        else:
            assert no_better(reading.label, context) and no_better(reading.label, OWN)


@given(st.recursive(st.none() | st.booleans() | st.floats() | st.integers() | st.text(), st.lists, max_leaves=8))
def test_any_value_is_plain_or_none(value):
    found = values.plain(value)
    if isinstance(found, Plain):
        assert values.read(found.raw) == found


@given(st.text(max_size=30))
def test_any_pointer_finds_something_or_nothing(pointer):
    values.found(VALUE, pointer)


def test_a_value_is_a_copy():
    value = {"parts": ["red"]}
    plain = values.plain(value)
    value["parts"].append("blue")
    assert plain.value == {"parts": ["red"]}
