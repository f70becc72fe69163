"""Asks about a real motion, with its picture, and their page until it answers."""

from __future__ import annotations

from pep.pit.files.scene_file import Situation
from pep.pit.picture.shown_form import shown_text
from tests.pep.pit.scenes import CELL, NOTHING, ROBOT, SEED, sweep, with_person
from tests.ztpm_idp.asks import PEP

from capabilities.statements.people import ask
from capabilities.statements.people import picture as wire
from pep.pit import assess

MOTION = sweep()
SEEN = Situation(CELL, with_person(0.55), 0.05, None, NOTHING)
FOUND = assess(ROBOT, SEEN.scene, MOTION, CELL, perception_age_s=0.05, touch=NOTHING, seed=SEED)
SHOWN = shown_text(ROBOT, SEEN, MOTION, FOUND)
"""The picture of a real motion near a person, as physics assessed it."""


def asked(cell, *, shown=SHOWN, **changes):
    """The id and text of an ask about that motion, which the provider took with its picture."""
    reading = FOUND.reading()
    stated = {
        "contributors": tuple(
            ask.Contributor(c.kind, c.link, c.object, c.index_milli, c.clearance_um, c.speed_um_s, c.source)
            for c in reading.contributions
        ),
        "index_milli": reading.index_milli,
        "start_urad": reading.start_urad,
        "picture_digest": wire.digest_of(SHOWN),
    }
    text = cell.text(**(stated | changes))
    answer = cell.post(PEP, "/approvals", {"ask": text, "picture": shown})
    assert answer.status_code == 201, answer.text
    return answer.json()["ask_id"], text


def checked(page):
    """Waits until the script has found the page to show what was signed, and has drawn the picture."""
    page.wait_for_function("() => !document.querySelector('#approve').disabled", timeout=20_000)


def answered(page, told):
    page.wait_for_function(
        "text => document.querySelector('#told').textContent.includes(text)", arg=told, timeout=15_000
    )
