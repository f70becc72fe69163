"""Forms: a refusal names the place and the cause, and repeats nothing of the value."""

from __future__ import annotations

from typing import Annotated

import pytest
from capabilities.values.errors import CapabilityError, FaultCode
from capabilities.values.form import Form, FormError, converted, plain, read, upto, whole, within, words

pytestmark = pytest.mark.clause(reason="how forms are read; the statements that have them name the clauses")


def even(value: object) -> int:
    if not isinstance(value, str) or int(value) % 2:
        raise CapabilityError(FaultCode.OUT_OF_RANGE, "not even")
    return int(value)


class Leaf(Form, frozen=True, tag_field="form", tag="leaf"):
    size: Annotated[int, within(1, 9)]


class Bud(Form, frozen=True, tag_field="form", tag="bud"):
    size: Annotated[int, within(1, 9)]


class Tree(Form, frozen=True):
    name: Annotated[str, whole("[a-z]+"), upto(4)]
    kind: Annotated[str, words("oak", "ash")]
    leaves: Annotated[tuple[Leaf | Bud, ...], upto(2)]
    rings: converted(int, even)
    tall: bool = False


TREE = {"name": "elm", "kind": "oak", "leaves": [{"form": "bud", "size": 3}], "rings": "8"}
SECRET = "canary"
WRONG = {
    "no object": ([], "", "expected object, got array"),
    "a member missing": ({k: v for k, v in TREE.items() if k != "rings"}, "", "object missing required field rings"),
    "a member more": (TREE | {SECRET: 1}, "", "an unknown member"),
    "a member more that looks like a place": (TREE | {f"x` - at `$.{SECRET}": 1}, "", "an unknown member"),
    "a number for a text": (TREE | {"name": 1}, "name", "expected str, got int"),
    "a text of another form": (TREE | {"name": SECRET.upper()}, "name", "expected str of length <= 4"),
    "a line's end": (TREE | {"name": "elm\n"}, "name", "a wrong form"),
    "another word": (TREE | {"kind": SECRET}, "kind", "a wrong form"),
    "true for a number": (TREE | {"leaves": [{"form": "bud", "size": True}]}, "leaves[0].size", "expected int, got bool"),
    "a float": (TREE | {"leaves": [{"form": "bud", "size": 1.0}]}, "leaves[0].size", "expected int, got float"),
    "out of range": (TREE | {"leaves": [{"form": "bud", "size": 10}]}, "leaves[0].size", "expected int <= 9"),
    "an unknown tag": (TREE | {"leaves": [{"form": SECRET, "size": 1}]}, "leaves[0].form", "an unknown word"),
    "a member more inside": (TREE | {"leaves": [{"form": "bud", "size": 1, SECRET: 1}]}, "leaves[0]", "an unknown member"),
    "too many": (TREE | {"leaves": [{"form": "bud", "size": 1}] * 3}, "leaves", "expected array of length <= 2"),
    "a text for true": (TREE | {"tall": "true"}, "tall", "expected bool, got str"),
    "what a reader of its own refuses": (TREE | {"rings": "7"}, "rings", "not even"),
}  # fmt: skip


def test_what_is_read_is_written_again():
    assert plain(read(Tree, TREE)) == TREE | {"leaves": (TREE["leaves"][0],), "rings": 8}
    assert plain(read(Tree, TREE | {"tall": True}))["tall"] is True


@pytest.mark.parametrize("name", WRONG)
def test_a_refusal_names_place_and_cause_and_repeats_nothing(name):
    value, place, cause = WRONG[name]
    with pytest.raises(FormError) as caught:
        read(Tree, value)
    assert (caught.value.place, caught.value.cause) == (place, cause)
    assert SECRET not in str(caught.value).lower()
