"""Picture that an ask names: read strictly, in one spelling, and never at odds with itself."""

from __future__ import annotations

import json

import pytest
from capabilities.statements.people import picture
from capabilities.statements.people.picture import ShownBody, ShownPart, ShownPicture, ShownPlace, ShownPosture
from capabilities.values.errors import FaultCode, StatementError
from msgspec import structs

from capabilities.values import strict_json

POSTURE = ShownPosture(0, (0, 0, 0, 0, 0, 100_000), (0, 0, 200_000))
BALL = ShownBody("person", "p1/torso", (500_000, 0, 300_000), radius_um=150_000, source="camera-1", age_ms=40)
TENT = ShownBody("zone", "aisle", (0, 0, 0, 9, 0, 0, 0, 9, 0, 0, 0, 9), (0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3), tier=3)
PLACE = ShownPlace("person", "arm", "p1/torso", 1, (0, 0, 100_000), (350_000, 0, 300_000), 133_000, 380_000, 2_640)
SHOWN = ShownPicture(
    form=picture.FORM,
    margin_um=4_000,
    parts=(ShownPart("arm", "arm", 50_000),),
    postures=(POSTURE, structs.replace(POSTURE, at_ms=40)),
    bodies=(BALL, TENT),
    workspace_um=(-1, -1, -1, 1, 1, 1),
    places=(PLACE,),
)


@pytest.mark.clause("STM-23")
def test_what_is_written_is_read_back_and_has_one_digest():
    text = picture.write(SHOWN)
    assert picture.read(text) == SHOWN
    assert picture.write(picture.read(text)) == text
    assert picture.digest_of(text) != picture.digest_of(picture.write(structs.replace(SHOWN, margin_um=4_001)))


def body(**changes):
    return structs.replace(SHOWN, bodies=(structs.replace(BALL, **changes),))


DEFECTS = {
    "no posture": structs.replace(SHOWN, postures=(), places=()),
    "a posture of other parts": structs.replace(SHOWN, parts=()),
    "half a point": structs.replace(SHOWN, postures=(structs.replace(POSTURE, tcp_um=(0, 0)),), places=()),
    "postures out of order": structs.replace(SHOWN, postures=(structs.replace(POSTURE, at_ms=9), POSTURE)),
    "half a workspace": structs.replace(SHOWN, workspace_um=(0, 0, 0)),
    "a place at no posture": structs.replace(SHOWN, places=(structs.replace(PLACE, posture=2),)),
    "a place that is no point": structs.replace(SHOWN, places=(structs.replace(PLACE, on_link_um=(0,)),)),
    "a body nowhere": body(corners_um=()),
    "half a corner": body(corners_um=(1, 2)),
    "faces of a ball": body(faces=(0, 0, 0)),
    "no faces": structs.replace(SHOWN, bodies=(structs.replace(TENT, faces=()),)),
    "a face of no corner": structs.replace(SHOWN, bodies=(structs.replace(TENT, faces=(0, 1, 4)),)),
    "half a face": structs.replace(SHOWN, bodies=(structs.replace(TENT, faces=(0, 1)),)),
    "an unknown kind": body(kind="ghost"),
    "a name from right to left": body(name="p1‮osrot"),
    "a name of ten thousand letters": body(name="p" * 10_000),
    "a look-alike": body(name="р1"),
    "a kilometre off": body(corners_um=(10**10, 0, 0)),
    "another form": structs.replace(SHOWN, form="ztpm-picture/2"),
    "a margin below none": structs.replace(SHOWN, margin_um=-2),
    "too many bodies": structs.replace(SHOWN, bodies=(BALL,) * (picture.BODIES + 1)),
}


@pytest.mark.clause("STM-23", "STM-24")
@pytest.mark.parametrize("what", DEFECTS)
def test_a_picture_that_nobody_could_draw_alike(what):
    text = strict_json.canonical(picture.plain(DEFECTS[what])).decode()
    with pytest.raises(StatementError) as raised:
        picture.read(text)
    assert raised.value.code is FaultCode.STATEMENT_MALFORMED
    with pytest.raises(StatementError):
        picture.write(DEFECTS[what])


@pytest.mark.clause("STM-23")
@pytest.mark.parametrize(
    "spoil",
    [
        lambda text: " " + text,
        lambda text: text.replace('"margin_um":4000', '"margin_um":4000.0'),
        lambda text: text.replace('"margin_um":4000', '"margin_um":4000,"margin_um":1'),
        lambda text: text.replace('"margin_um":4000', '"margin_um":NaN'),
        lambda text: text.replace('"margin_um":4000', '"margin_um":4000,"more":1'),
        lambda text: json.dumps(json.loads(text)),
        lambda text: text + " " * picture.PICTURE_BYTES,
        lambda _: "[" * 100_000,
        lambda _: "",
        lambda _: "{}",
    ],
)
def test_another_spelling_is_none(spoil):
    with pytest.raises(StatementError) as raised:
        picture.read(spoil(picture.write(SHOWN)))
    assert raised.value.code is FaultCode.STATEMENT_MALFORMED
