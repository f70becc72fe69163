"""Page of an ask: everything that an approval binds, from the very text that it binds.

It is readable without script, colour or trust in names. What its script checks and draws is tried in a browser.
"""

from __future__ import annotations

import base64
import hashlib
import re
from decimal import Decimal
from html.parser import HTMLParser

import pytest
from capabilities.values.arguments import argument
from capabilities.values.scope import Tier
from capabilities.values.units import INT_LIMIT, DeclaredUnit, ListOf, Quantity, Sort, Unit
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from policies.words.reason_table import REASONS, Reason
from tests.ztpm_idp.asks import AGENT, PEP, SENSOR, Cell
from tests.ztpm_idp.world import AUDIENCE, ISSUER
from ztpm_idp.domain.asking.asks import Answer, Asked, AskRecord, AskState, VoteRecord

from capabilities.statements.people import ask, vote
from ztpm_idp.provider import ask_page
from capabilities.statements.people.ask_words import sentence_of

VOID = {"meta", "br", "link", "input"}
TAGS = {"html", "head", "title", "style", "body", "main", "h1", "h2", "p", "strong", "code", "span", "table", "caption", "thead", "tbody", "tr", "th", "td", "pre", "noscript", "script", "details", "summary", "div", "button", "label", "output"} | VOID  # fmt: skip
ATTRIBUTES = {"lang", "charset", "name", "content", "http-equiv", "class", "scope", "colspan", "id", "role", "hidden", "rel", "href", "src", "defer", "tabindex", "type", "for", "min", "max", "step", "value"}  # fmt: skip


class Reader(HTMLParser):
    """Content of a page as a reader sees it.

    The page must be well formed and use nothing but the plain tags and attributes.
    """

    def __init__(self, text):
        super().__init__()
        self.open, self.seen, self.meta = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert tag in TAGS and {name for name, _ in attrs if not name.startswith(("data-", "aria-"))} <= ATTRIBUTES, (
            tag,
            attrs,
        )
        if tag == "meta":
            self.meta.append(dict(attrs))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in {"style", "script"}:
            self.seen.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.seen))


@pytest.fixture
def cell(world):
    return Cell(world)


def fetched(cell, ask_id):
    with cell.world.anonymous() as http:
        response = http.get(f"{ISSUER}/approvals/{ask_id}/page")
    assert response.status_code == 200
    return response


def test_everything_that_an_approval_binds_is_on_the_page(cell):
    stated = cell.ask(reasons=("TIER_NEEDS_APPROVAL", "NOBODY_KNOWS_THIS"), mandate_id="0d" * 16)
    text = ask.sign(stated, cell.world.private[PEP])
    assert cell.post(PEP, "/approvals", {"ask": text}).status_code == 201
    seen = Reader(fetched(cell, stated.ask_id).text).text
    for value in (
        stated.ask_id, stated.nonce, stated.pep, stated.audience, stated.issuer, stated.sponsor, stated.token_id, stated.mandate_id, stated.agent,
        stated.agent_key, stated.object, stated.operation, stated.request_digest, stated.model_digest, stated.policy_digest,
        stated.scene_digest, "2.640", "2640 thousandths", "at most 2.690", "3 (high consequence)", "person-ssm", "person-7", "forearm", SENSOR,
        "412.000 mm", "412000 um", "250.000 mm/s", "250000 um_s", "38 ms", "0.038 s", "TIER_NEEDS_APPROVAL",
        REASONS[Reason.TIER_NEEDS_APPROVAL].text, "NOBODY_KNOWS_THIS", vote.digest_of(text), "1 person must approve", "10 min 0 s left",
        "2027-01-15 08:00:00 UTC", "2027-01-15 08:10:00 UTC", "2 mrad", "nobody has answered", f"ztpm approvals approve {stated.ask_id}",
    ):  # fmt: skip
        assert value in seen, value
    for quantity in stated.values:
        assert f"{quantity.name}" in seen and f"{quantity.value} {quantity.unit}" in seen
    for angle in stated.start_urad:
        assert f"{angle} urad" in seen
    assert "≈ -90.00°" in seen and "≈ 30.00°/s" in seen and "≈ 80.21°/s²" in seen
    assert "-0.00" not in seen
    assert "--sees-clear" not in seen


def test_the_page_follows_the_ask(cell):
    opening_id = cell.world.people["alice"].open_tier_4(
        audience=AUDIENCE, agent=AGENT, object="ur3e", operation="move_joint"
    )
    ask_id, _ = cell.taken(tier=Tier(4), approvers=2, opening_id=opening_id)
    look = lambda: Reader(fetched(cell, ask_id).text)
    first = look()
    assert "State: open" in first.text and "2 different people must approve" in first.text and opening_id in first.text
    assert "4 (safety critical)" in first.text
    assert {"http-equiv": "refresh", "content": "10"} in first.meta
    cell.world.people["alice"].approve(ask_id)
    cell.world.clock.at_s += 1
    second = look().text
    assert "alice approved" in second and "9 min 59 s left" in second and "State: open" in second
    cell.world.people["carol"].approve(ask_id)
    third = look()
    assert "State: granted" in third.text and "left" not in third.text
    assert not any("http-equiv" in meta for meta in third.meta), "what is answered is not loaded again and again"
    cell.world.people["carol"].withdraw(ask_id)
    assert "State: withdrawn" in look().text and "carol withdrew" in look().text
    ask_id, _ = cell.taken()
    cell.world.clock.at_s += 600
    assert "State: over" in look().text


@pytest.mark.parametrize("perception", ["stale", "missing"])
def test_what_was_not_seen_is_said_first(cell, perception):
    ask_id, _ = cell.taken(perception=perception, perception_age_ms=None)
    seen = Reader(fetched(cell, ask_id).text).text
    assert seen.index("Approve only if you yourself see the cell clear") < seen.index("What would happen")
    assert f"approve {ask_id} --sees-clear" in seen


def test_what_no_sensor_speaks_of_is_not_put_in_a_sensors_mouth(cell):
    own = ask.Contributor("joint", "wrist_3", "joint_speed", 1_200, 0, 90_000)
    ask_id, _ = cell.taken(contributors=(own,))
    seen = Reader(fetched(cell, ask_id).text).text
    assert "joint_speed no sensor wrist_3" in seen and SENSOR not in seen


def test_an_act_without_a_robot_is_told_in_words(cell):
    nothing = {"start_urad": (), "contributors": (), "index_milli": 0, "perception_age_ms": None}
    ask_id, _ = cell.taken(perception="none", object="valve-7", operation="open_valve", **nothing)
    text = Reader(fetched(cell, ask_id).text).text
    assert "open_valve" in text
    assert "valve-7" in text
    assert not any(word in text for word in ("Perception", "Clearance", "Robot", "Index", "Scene", "--sees-clear"))


def test_words_flags_lists_and_free_values_are_shown_so_that_none_passes_for_another(cell):
    values = (
        argument("query", Sort.TEXT, "pump <b>7</b>"),
        argument("look", Sort.TEXT, "p\u0430ypal"),
        argument("file", Sort.PATH, "/srv/é"),
        argument("bleed", Sort.FLAG, True),
        argument("tags", ListOf(Sort.TEXT), ["a", "b"]),
        argument("filter", Sort.FREE, {"a": 1}),
    )
    nothing = {"start_urad": (), "contributors": (), "index_milli": 0, "perception_age_ms": None}
    ask_id, _ = cell.taken(perception="none", object="docs", operation="search", values=values, **nothing)
    seen = Reader(fetched(cell, ask_id).text).text
    for shown in (
        'query pump <b>7</b> "pump <b>7</b>" text', 'look p\u27e8U+0430\u27e9ypal "p\\u0430ypal" text', 'file /srv/é "/srv/\\u00e9" path',
        "bleed yes true flag", 'tags 2: a, b ["a", "b"] [text]', "filter 7 bytes SHA-256 " + hashlib.sha256(b'{"a":1}').hexdigest(),
    ):  # fmt: skip
        assert shown in seen, shown


def test_what_sensors_say_is_told_beside_an_act_without_a_robot(cell):
    nothing = {"start_urad": (), "contributors": (), "index_milli": 0, "perception_age_ms": None}
    facts = (
        ask.AskedFact("zone-a/people", "fresh", Unit.COUNT, 3, 120, True),
        ask.AskedFact("tank/level", "missing", Unit.PERMILLE, None, None, False),
    )
    ask_id, _ = cell.taken(perception="none", object="press", operation="close_press", facts=facts, **nothing)
    seen = Reader(fetched(cell, ask_id).text).text
    assert "What sensors say" in seen
    assert "zone-a/people 3 3 count fresh 0.120 s yes" in " ".join(seen.split())
    assert "tank/level unknown missing unknown no" in " ".join(seen.split())
    plain, _ = cell.taken(perception="none", object="press", operation="close_press", **nothing)
    assert "What sensors say" not in Reader(fetched(cell, plain).text).text


SENTENCES = {
    "The gripper passes person p1's upper arm at 133 mm, 0.38 m/s.": ("person", "gripper_low", "p1/upper_arm", 133_999, 371_000),
    "The forearm passes person-7 at 0 mm, 0.25 m/s.": ("person", "forearm_tube", "person-7", 999, 250_000),
    "The held object passes glass, which is fragile, at 20 mm, 0.01 m/s.": ("fragile", "payload", "glass", 20_000, 1),
    "The wrist passes the arm's own upper arm at 8 mm, 0.10 m/s.": ("self", "wrist_3", "upper_arm_tube", 8_000, 100_000),
    "The wrist meets the arm's own upper arm, 0.10 m/s.": ("self", "wrist_3", "upper_arm_tube", -12_000, 100_000),
    "The gripper meets person p1's hand, 0.10 m/s.": ("person", "gripper_low", "p1/hand", 0, 100_000),
    "The gripper leaves the workspace, 0.10 m/s.": ("workspace", "gripper_low", "", -1, 100_000),
    "The sensors' view of the cell is stale: nobody knows who is near.": ("perception", "", "stale", 0, 0),
    "Its own speed decides: the arm moves at up to 1.00 m/s.": ("tcp_speed", "", "", 0, 1_000_000),
    "The gripper comes within 9 mm of the closed zone press, 0.10 m/s.": ("zone", "gripper_low", "press", 9_000, 100_000),
    "The gripper enters the closed zone press, 0.10 m/s.": ("zone", "gripper_low", "press", 0, 100_000),
    "The output pin-4 is switched, which the cell file does not have.": ("undeclared_output", "", "pin-4", 0, 0),
    "strange decides: arm thing, 0.00 m/s.": ("strange", "", "thing", 0, 0),
}  # fmt: skip


@pytest.mark.clause("PSK-8")
@pytest.mark.parametrize("sentence", SENTENCES)
def test_a_sentence_says_first_what_would_happen(cell, sentence):
    kind, link, thing, clearance_um, speed_um_s = SENTENCES[sentence]
    first = ask.Contributor(kind, link, thing, 2_640, clearance_um, speed_um_s, SENSOR)
    assert sentence_of(cell.ask(contributors=(first, *cell.ask().contributors))) == sentence


def test_an_ask_without_parameters_start_or_contributors(cell):
    ask_id, _ = cell.taken(values=(), start_urad=(), contributors=(), perception_age_ms=None)
    seen = Reader(fetched(cell, ask_id).text).text
    assert "no parameters" in seen and "nothing is named" in seen and "mrad" not in seen


@pytest.mark.clause("PSK-8")
def test_nothing_foreign_and_no_other_script_can_be_on_the_page(cell):
    ask_id, _ = cell.taken()
    response = fetched(cell, ask_id)
    (style,) = re.findall(r"<style>(.*?)</style>", response.text, re.S)
    scripts = re.findall(r'<script src="(.*?)" defer></script>', response.text)
    assert response.text.count("<script") == len(scripts) == 6
    with cell.world.anonymous() as http:
        for script in scripts:
            given = http.get(script)
            assert (given.status_code, given.headers["content-type"]) == (200, "text/javascript; charset=utf-8")
            assert given.headers["x-content-type-options"] == "nosniff"
        assert http.get(f"{ISSUER}/approvals/assets/console.css").headers["content-type"].startswith("text/css")
        for unknown in ("..%2Fpasskey.js", "entry.js", "README.md", "__init__.py"):
            assert http.get(f"{ISSUER}/approvals/assets/{unknown}").status_code == 404
    policy = dict(part.split(" ", 1) for part in response.headers["content-security-policy"].split("; "))
    assert policy == {
        "default-src": "'none'",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": "'none'",
        "script-src": " ".join(scripts),
        "connect-src": "'self'",
        "style-src": f"'self' 'sha256-{base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()}'",
    }
    assert response.headers["content-type"] == "text/html; charset=utf-8"
    assert response.headers["cache-control"] == "no-store"
    assert response.headers["referrer-policy"] == "no-referrer"
    assert response.headers["x-content-type-options"] == "nosniff"
    assert "url(" not in style and "@import" not in style


def test_no_secret_is_on_the_page(cell):
    """Neither a token nor a vote: only the ask, as it was signed."""
    lent = cell.world.people["alice"].issue(cell.world.agents[AGENT], cell.world.scope(), purpose="p")
    ask_id, _ = cell.taken(token_id=lent.token_id)
    cell.world.people["carol"].approve(ask_id)
    shown = fetched(cell, ask_id).text
    (cast,) = cell.told(ask_id).votes
    for secret in (lent.token[:30], lent.token[-30:], cast, cast.split(".")[1], cast.split(".")[2]):
        assert secret not in shown


HOSTILE = "<script>alert(1)</script>\"'&{{7*7}}{% raw %}\u202e"


def hostile():
    """An ask that no statement can hold: every text in it is an attack."""
    stated = ask.Ask(**{name: HOSTILE for name in ask.NAMES if name not in NUMBERS} | NUMBERS)
    record = AskRecord(HOSTILE, HOSTILE, HOSTILE, HOSTILE, HOSTILE, HOSTILE, HOSTILE, 1, True, 0, 1)
    return stated, Asked(record, (VoteRecord(HOSTILE, Answer.APPROVE, 1, False, HOSTILE),))


NUMBERS = dict(
    values=(Quantity(HOSTILE, Unit.GRAM, -INT_LIMIT),),
    start_urad=(INT_LIMIT,) * 6,
    tier=Tier(4),
    index_milli=4_000,
    reasons=(HOSTILE,),
    contributors=(ask.Contributor(HOSTILE, HOSTILE, HOSTILE, 0, -INT_LIMIT, INT_LIMIT, HOSTILE),),
    facts=(ask.AskedFact(HOSTILE, HOSTILE, Unit.COUNT, -INT_LIMIT, INT_LIMIT, True),),
    perception="missing",
    perception_age_ms=INT_LIMIT,
    approvers=2,
    asked_at=0,
    expires_at=INT_LIMIT,
)


def test_whatever_a_text_holds_it_stays_a_text():
    stated, asked = hostile()
    shown = ask_page.render(HOSTILE, stated, asked, AskState.OPEN, at_ms=0)
    assert "<script>" not in shown and "{{7*7}}" in shown and "49" not in Reader(shown).text
    assert HOSTILE.replace("\u202e", "⟨U+202E⟩") in "".join(Reader(shown).seen)
    for state in AskState:
        Reader(ask_page.render(HOSTILE, replace(stated, expires_at=-INT_LIMIT), asked, state, at_ms=INT_LIMIT))


def test_a_declared_unit_is_shown_in_what_it_names_where_the_point_alone_moves():
    for value, unit, shown in (
        (901, DeclaredUnit("x-bar", 1_000), "0.901 x-bar"), (1_234, DeclaredUnit("cur-EUR", 100), "12.34 cur-EUR"),
        (-3, DeclaredUnit("x-box", 1), "-3 x-box"), (9, DeclaredUnit("x-dozen", 12), "9 x-dozen/12"),
    ):  # fmt: skip
        assert ask_page.readable(value, unit) == shown


def test_a_name_that_looks_like_another_is_shown_apart():
    stated, asked = hostile()
    seen = Reader(ask_page.render("", replace(stated, agent="m\u043ever"), asked, AskState.OPEN, at_ms=0)).text
    assert "m⟨U+043E⟩ver" in seen and "m\u043ever" not in seen


@given(st.sampled_from(list(Unit)), st.integers(-INT_LIMIT, INT_LIMIT))
def test_the_readable_figure_is_the_integer(unit, value):
    shown = ask_page.readable(value, unit)
    assert re.fullmatch(r"(≈ )?-?[0-9]+(\.[0-9]+)?[ °].*|-?[0-9]+", shown), shown
    if not shown.startswith("≈"):
        figure = Decimal(shown.split(" ")[0])
        factor = {"mm": 1_000, "N": 1_000, "k": 1_000, "s": 1_000, "%": 10, "": 1, "Pa": 1, "Hz": 1}
        factor |= dict.fromkeys(("°C", "K", "V", "A", "W", "L"), 1_000)
        word = shown.partition(" ")[2]
        per = factor["mm"] if word.startswith("mm") else factor["k"] if word == "kg" else factor["N"] if word.startswith("N") else factor[word]  # fmt: skip
        assert figure * per == value
    else:
        degrees = Decimal(shown.split(" ")[1].split("°")[0])
        exact = Decimal(value) * 180 / (Decimal("3.14159265358979323846264338") * 1_000_000)
        assert abs(degrees - exact) <= Decimal("0.0051") + abs(exact) * Decimal("1e-14")
