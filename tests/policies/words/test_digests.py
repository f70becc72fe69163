"""Digest of a request as of RFC 8785, from any writer; canonical texts know no order but their own."""

import hashlib
import random

import pytest
import rfc8785
from capabilities.values.units import Quantity, Unit
from hypothesis import given
from hypothesis import strategies as st

from policies import Point, Request
from policies.words import canonical

texts = st.text(st.characters(blacklist_categories=["Cs"]), max_size=8)
exact = st.integers(-canonical.EXACT, canonical.EXACT)


def request(audience="a", object="b", operation="c", values=()):
    return Request("r", frozenset({Point.TOOL}), audience, object, operation, tuple(values), 0.0)


@given(texts, texts, texts, st.lists(st.builds(Quantity, texts, st.sampled_from(Unit), exact), max_size=4))
def test_the_digest_of_a_request_is_over_its_rfc_8785_form(audience, thing, operation, values):
    form = {
        "audience": audience,
        "object": thing,
        "operation": operation,
        "values": [[v.name, str(v.unit), v.value] for v in values],
    }
    expected = hashlib.sha256(rfc8785.dumps(form)).hexdigest()
    assert request(audience, thing, operation, values).digest == expected


def test_every_character_is_written_as_rfc_8785_writes_it():
    """Both would be wrong together only if this list were."""
    for start in range(0, 0x110000, 0x1000):
        name = "".join(chr(c) for c in range(start, start + 0x1000) if not 0xD800 <= c < 0xE000)
        form = {"audience": name, "object": "b", "operation": "c", "values": []}
        assert request(audience=name).digest == hashlib.sha256(rfc8785.dumps(form)).hexdigest(), hex(start)


@pytest.mark.parametrize("value", [canonical.EXACT + 1, -canonical.EXACT - 1, 10**30, float("nan"), object()])
def test_what_has_no_rfc_8785_form_has_no_digest(value):
    with pytest.raises((ValueError, TypeError)):
        request(values=[Quantity("q0", Unit.MICRORADIAN, value)]).digest  # noqa: B018


@given(
    st.dictionaries(st.text(max_size=4), st.integers(), max_size=6),
    st.sets(st.text(max_size=4), max_size=6),
    st.integers(0, 99),
)
def test_the_order_in_which_a_map_or_a_set_was_filled_does_not_matter(map_, set_, seed):
    pairs, members = list(map_.items()), list(set_)
    random.Random(seed).shuffle(pairs)
    random.Random(seed).shuffle(members)
    assert canonical.text(dict(pairs)) == canonical.text(map_)
    assert canonical.text(frozenset(members)) == canonical.text(frozenset(set_))


def test_half_a_surrogate_pair_is_neither_lost_nor_taken_for_what_spells_it():
    odd = ["\ud800", "\\ud800", "\ufffd", "\udfff", "?"]
    assert len({canonical.text(value) for value in odd}) == len(odd)
    assert len({canonical.digest("k", (value, "é")) for value in odd}) == len(odd)
