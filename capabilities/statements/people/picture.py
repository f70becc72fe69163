"""Picture of an asked motion: the arm over time, and all that is around it.

It is no statement of its own: the ask names the SHA-256 of its text, and so does every vote on the ask. All numbers are
integers, so that every reader draws the very same. Clauses [STM-23] to [STM-25].
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Annotated, Final

from capabilities.statements.claims import NameOrEmpty, malformed
from capabilities.values import form, strict_json
from capabilities.values.form import Form, FormError, plain, upto, whole, within, words
from capabilities.values.strict_json import JsonError

if TYPE_CHECKING:
    from collections.abc import Iterable

FORM: Final = "ztpm-picture/1"
PICTURE_BYTES: Final = 262_144
"""Longest text; a phone reads it in a second on a slow line."""
DEPTH: Final = 6
PARTS: Final = 32
POSTURES: Final = 128
BODIES: Final = 2_560
PLACES: Final = 16
CORNERS: Final = 64
FACES: Final = 2 * CORNERS - 4
"""Most parts of the arm, postures, bodies, marked places, corners of a body, and triangles that these span."""
_FAR_UM: Final = 1_000_000_000
"""A kilometre: farther off is a wrong unit."""
_LONGEST_MS: Final = 3_600_000
_POINT: Final = 3
_ENDS: Final = 2 * _POINT
_TRIANGLE: Final = 3
UNKNOWN_UM: Final = -1
"""Margin of a picture that encloses no motion: a cut corner, or an arm that is led."""

PART_KINDS: Final = frozenset({"base", "arm", "tool", "payload"})
BODY_KINDS: Final = frozenset({"person", "fragile", "rigid", "zone"})
_Um = Annotated[int, within(-_FAR_UM, _FAR_UM)]
_Size = Annotated[int, within(0, _FAR_UM)]
_Ms = Annotated[int, within(0, _LONGEST_MS)]
_Text = Annotated[str, whole(r"[ -~]*"), upto(256)]


class ShownPart(Form, frozen=True):
    """Capsule of the arm: its name, its kind, and its radius, um."""

    kind: Annotated[str, words(*PART_KINDS)]
    name: NameOrEmpty
    radius_um: _Size


class ShownPosture(Form, frozen=True):
    """The arm at one time: both ends of each part, one after the other, and the tool centre point, um."""

    at_ms: _Ms
    ends_um: Annotated[tuple[_Um, ...], upto(_ENDS * PARTS)]
    tcp_um: Annotated[tuple[_Um, ...], upto(_POINT)]


class ShownBody(Form, frozen=True):
    """Body around the arm: the hull of its corners, with a rounding.

    Attributes:
        kind, name: of it; a person's has its region behind a slash.
        corners_um: three numbers for each; one of a ball, two of a capsule.
        faces: three numbers of corners for each triangle, seen from outside to the left; none of a round body.
        radius_um: of the rounding.
        tier: of a zone that has one.
        source: the sensor that says so, or "" for the signed cell file.
        age_ms: of the sighting.
    """

    kind: Annotated[str, words(*BODY_KINDS)]
    name: _Text
    corners_um: Annotated[tuple[_Um, ...], upto(_POINT * CORNERS)]
    faces: Annotated[tuple[Annotated[int, within(0, CORNERS - 1)], ...], upto(_TRIANGLE * FACES)] = ()
    radius_um: _Size = 0
    tier: Annotated[int, within(0, 4)] | None = None
    source: NameOrEmpty = ""
    age_ms: _Ms = 0


class ShownPlace(Form, frozen=True):
    """Place that raises the index: nearest points of a part and a thing, um.

    Attributes:
        kind, link, object: as in the ask's contributor.
        posture: number of the posture at which it is.
        on_link_um, on_object_um: the points.
        clearance_um, speed_um_s, index_milli: as in the ask's contributor.
    """

    kind: NameOrEmpty
    link: NameOrEmpty
    object: NameOrEmpty
    posture: Annotated[int, within(0, POSTURES - 1)]
    on_link_um: Annotated[tuple[_Um, ...], upto(_POINT)]
    on_object_um: Annotated[tuple[_Um, ...], upto(_POINT)]
    clearance_um: _Um
    speed_um_s: _Size
    index_milli: Annotated[int, within(0, 4_000)]


class ShownPicture(Form, frozen=True):
    """Picture of one motion.

    Attributes:
        form: the name of this form.
        margin_um: the drawn capsules, widened by it, hold the arm at every time; -1 where nobody knows that.
        parts: of the arm.
        postures: in order of time, start and end among them.
        bodies: people, objects and zones.
        workspace_um: low and high corner, or none.
        places: highest index first.
        omitted: number of bodies for which there was no room.
    """

    form: Annotated[str, words(FORM)]
    margin_um: Annotated[int, within(UNKNOWN_UM, _FAR_UM)]
    parts: Annotated[tuple[ShownPart, ...], upto(PARTS)]
    postures: Annotated[tuple[ShownPosture, ...], upto(POSTURES)]
    bodies: Annotated[tuple[ShownBody, ...], upto(BODIES)]
    workspace_um: Annotated[tuple[_Um, ...], upto(_ENDS)] = ()
    places: Annotated[tuple[ShownPlace, ...], upto(PLACES)] = ()
    omitted: Annotated[int, within(0, 1_000_000)] = 0


def write(shown: ShownPicture) -> str:
    """The text of a picture, read back before it is given.

    Raises:
        StatementError: as `read`.
    """
    text = strict_json.canonical(plain(shown)).decode("utf-8")
    read(text)
    return text


def read(text: str) -> ShownPicture:
    """The picture that the text says, strictly.

    Raises:
        StatementError: `STATEMENT_MALFORMED`: too long, not canonical, not of the form, or at odds with itself.
    """
    try:
        raw = text.encode("ascii")
        value, canonical = strict_json.read_canonical(raw, limit_bytes=PICTURE_BYTES, limit_depth=DEPTH)
        if not canonical:
            raise malformed("picture: not canonical")
        shown: ShownPicture = form.read(ShownPicture, value)
    except UnicodeEncodeError:
        raise malformed("picture: not ASCII") from None
    except JsonError as error:
        raise malformed(f"picture: {error.detail}") from None
    except FormError as error:
        raise malformed(f"picture: {error}") from None
    _check(shown)
    return shown


def digest_of(text: str) -> str:
    """SHA-256 (hex) of a picture's text, which the ask names."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _check(shown: ShownPicture) -> None:
    """Raises where two members of it say otherwise ([STM-24])."""
    if not shown.postures or len(shown.workspace_um) not in {0, _ENDS}:
        raise malformed("picture: no posture, or no workspace of two corners")
    if any(len(each.ends_um) != _ENDS * len(shown.parts) or len(each.tcp_um) != _POINT for each in shown.postures):
        raise malformed("picture: a posture with other parts")
    if not _rising([each.at_ms for each in shown.postures]):
        raise malformed("picture: postures out of order")
    for body in shown.bodies:
        corners = len(body.corners_um) // _POINT
        if corners == 0 or len(body.corners_um) % _POINT or len(body.faces) % _TRIANGLE:
            raise malformed("picture: a body without corners")
        if any(corner >= corners for corner in body.faces) or bool(body.faces) is (corners <= 2):
            raise malformed("picture: a body's faces without its corners")
    for place in shown.places:
        if len(place.on_link_um) != _POINT or len(place.on_object_um) != _POINT or place.posture >= len(shown.postures):
            raise malformed("picture: a place that is nowhere")


def _rising(times: Iterable[int]) -> bool:
    last = 0
    for at in times:
        if at < last:
            return False
        last = at
    return True
