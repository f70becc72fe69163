"""Characters as people are shown them: nothing hides, and no name looks like another."""

from __future__ import annotations

import sys
import unicodedata

import pytest
from capabilities.values import invisible
from hypothesis import given
from hypothesis import strategies as st

from capabilities.values.characters import LOOK_ALIKES, shown

pytestmark = pytest.mark.clause(reason="how texts are shown to people; VAL-4 says which ones a token holds")


@pytest.mark.parametrize(
    ("text", "as_shown"),
    [
        ("m\u043ever", "m⟨U+043E⟩ver"),
        ("m\u03bf\u03bder", "m⟨U+03BF⟩⟨U+03BD⟩er"),
        ("\u0441\u043e\u0441\u043e", "⟨U+0441⟩⟨U+043E⟩⟨U+0441⟩⟨U+043E⟩"),
        ("agent \u0430", "agent ⟨U+0430⟩"),
        ("\uff4dover", "⟨U+FF4D⟩over"),
        ("\ufb01le", "⟨U+FB01⟩le"),
        ("mover\U0001d7cf", "mover⟨U+1D7CF⟩"),
        ("mover\u3164", "mover⟨U+3164⟩"),
        ("mover\ufe0f", "mover⟨U+FE0F⟩"),
        ("mover\u00a0", "mover⟨U+00A0⟩"),
        ("mover\x1b[2J", "mover⟨U+001B⟩[2J"),
        ("m⟨U+043E⟩ver", "m⟨U+27E8⟩U+043E⟨U+27E9⟩ver"),
    ],
)
def test_what_deceives_is_spelled(text, as_shown):
    assert shown(text) == as_shown


@pytest.mark.parametrize(
    "text",
    ["mover", "Анна", "Возьми деталь робота", "USB-кабель", "αβγδ και λόγος", "部品を取る", "Größe 3 m/s² ½ µm", "👍"],
)
def test_what_deceives_nobody_is_shown_as_it_is(text):
    assert shown(text) == text


@pytest.mark.parametrize("letter", sorted(set(LOOK_ALIKES) - set("ɑɡ")))
def test_no_look_alike_passes_in_a_latin_name(letter):
    assert shown(f"ab{letter}cd") == f"ab⟨U+{ord(letter):04X}⟩cd"


@given(st.text(st.sampled_from("ao\u0430\u043e\u03bf⟨⟩U+043E\u3164\ufe0f 1"), max_size=12), st.data())
def test_two_texts_are_never_shown_alike(one, draw):
    other = draw.draw(st.permutations([*one, "\u043e", "o"]).map("".join))
    for text in (other, one.replace("o", "\u043e"), one.replace("\u043e", "o"), one.replace("\u3164", "")):
        assert (shown(text) == shown(one)) is (text == one)


def test_the_table_agrees_with_the_interpreters_own_data():
    """The properties themselves are not in `unicodedata`: what follows from their definitions is (UAX #44)."""
    excepted = {*map(chr, range(0xFFF9, 0xFFFC)), *map(chr, range(0x13430, 0x13440))}
    prepended = {chr(code) for code in (*range(0x600, 0x606), 0x6DD, 0x70F, 0x890, 0x891, 0x8E2, 0x110BD, 0x110CD)}
    every = [chr(code) for code in range(sys.maxunicode + 1)]
    formats = {each for each in every if unicodedata.category(each) == "Cf"} - excepted - prepended
    assert formats <= invisible.IGNORABLE
    assert {each for each in every if "VARIATION SELECTOR" in unicodedata.name(each, "")} <= invisible.IGNORABLE
    assert {each for each in every if "HANGUL" in (name := unicodedata.name(each, "")) and "FILLER" in name} <= (
        invisible.IGNORABLE
    )
    spaces = {each for each in every if each.isspace()} - set("\x1c\x1d\x1e\x1f ")
    assert spaces == invisible.SPACES
    kinds = {unicodedata.category(each) for each in invisible.IGNORABLE}
    assert kinds <= {"Cf", "Cn", "Mn", "Lo"}
