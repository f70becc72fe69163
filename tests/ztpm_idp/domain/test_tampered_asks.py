"""Data tampered with on its way to an honest page: no vote that is then signed there counts.

The page signs what it was given with a real authenticator. Provider and enforcement point hold the ask as it was made.
"""

from __future__ import annotations

import html

import pytest
from capabilities.statements.people.assertion import Word, challenge, login_challenge, of_browser
from capabilities.statements.people.vote import Vote
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import CapabilityError
from capabilities.values.form import plain
from capabilities.values.scope import Tier
from capabilities.values.units import Quantity, Unit
from msgspec import structs
from pep.people.votes import Count, RejectedStatement, VerifiedVote, read_vote, tally
from tests.authenticators import ATTESTED, PRESENT, VERIFIED, Authenticator
from tests.capabilities.statements.people.test_pictures import SHOWN
from tests.ztpm_idp.asks import PEP, Cell
from tests.ztpm_idp.test_passkeys import NAMED, cast, passkey
from tests.ztpm_idp.world import World
from ztpm_idp.provider import ask_page

from capabilities.keys import keys
from capabilities.statements.people import ask, passkey_vote, picture, vote
from capabilities.values import strict_json

pytestmark = pytest.mark.clause("PSK-6", "STM-23")

PICTURE = picture.write(SHOWN)
OTHER_PICTURE = picture.write(structs.replace(SHOWN, bodies=SHOWN.bodies[1:]))

ASKS = {
    "ask_id": "0" * 32,
    "nonce": "0" * 32,
    "pep": "cell-2",
    "audience": "http://127.0.0.1:8801/mcp",
    "sponsor": "bob",
    "token_id": "h" * 22,
    "mandate_id": "0d" * 16,
    "agent": "other",
    "agent_key": "k" * 43,
    "object": "ur5e",
    "operation": "move_linear",
    "values": (Quantity("q0", Unit.MICRORADIAN, 0),),
    "request_digest": "9" * 64,
    "start_urad": (0, 0, 0, 0, 0, 0),
    "model_digest": "9" * 64,
    "policy_digest": "9" * 64,
    "scene_digest": "9" * 64,
    "tier": Tier(2),
    "index_milli": 100,
    "reasons": ("BEHAVIOUR_DEVIATES",),
    "contributors": (),
    "perception_age_ms": 1,
    "approvers": 2,
    "asked_at": lambda stated: stated.asked_at - 1,
    "expires_at": lambda stated: stated.expires_at + 1,
    "picture_digest": picture.digest_of(OTHER_PICTURE),
}
"""Members of the ask: what the page was given in place of each."""
CONTRIBUTORS = {
    "kind": "rigid",
    "link": "base",
    "object": "person-8",
    "index_milli": 1,
    "clearance_um": 900_000,
    "speed_um_s": 1,
    "source": "camera-9",
}
"""Members of which the sentence is made."""
VOTES = {
    "ask_id": "0" * 32,
    "nonce": "0" * 32,
    "ask_digest": "0" * 64,
    "answer": "deny",
    "approver": "alice",
    "sees_clear": True,
    "uses": 100,
    "not_after": lambda stated: stated.not_after + 600,
    "at": lambda stated: stated.at - 1,
}
"""Members of the vote: what was sent on in place of what was signed."""
ASSERTIONS = {
    "another origin": {"origin": "http://localhost:8701"},
    "an origin in https": {"origin": "https://localhost:8700"},
    "a look-alike origin": {"origin": "http://l\u043ecalhost:8700"},
    "a longer origin": {"origin": "http://localhost:8700.evil.example"},
    "another relying party": {"rp_id": "evil.example"},
    "an address as relying party": {"rp_id": "127.0.0.1"},
    "a registration": {"type": "webauthn.create"},
    "a payment": {"type": "payment.get"},
    "a frame of another": {"crossOrigin": True},
    "a top origin": {"topOrigin": "http://evil.example"},
    "nobody present": {"flags": VERIFIED},
    "nobody verified": {"flags": PRESENT},
    "neither": {"flags": 0},
    "a new credential": {"flags": PRESENT | VERIFIED | ATTESTED},
    "extensions": {"flags": PRESENT | VERIFIED | 0x80},
    "a reserved flag": {"flags": PRESENT | VERIFIED | 0x02},
    "a copy of what cannot be copied": {"flags": PRESENT | VERIFIED | 0x10},
}
CHALLENGES = {
    "a login": lambda stated, shown: login_challenge(NAMED, "n"),
    "a consent": lambda stated, shown: challenge(Word.AUTHORIZATION, _bound(stated, shown)),
    "a clearing": lambda stated, shown: challenge(Word.CLEARING, _bound(stated, shown)),
    "an enrolment": lambda stated, shown: challenge(Word.ENROLMENT, _bound(stated, shown)),
    "the vote alone": lambda stated, shown: challenge(Word.VOTE, {"vote": plain(stated)}),
    "the ask alone": lambda stated, shown: challenge(Word.VOTE, {"ask": ask.claims(shown)}),
    "the digest alone": lambda stated, shown: bytes.fromhex(stated.ask_digest),
    "nothing": lambda stated, shown: bytes(32),
}
RAW = {
    "another signature": lambda body: body | {"signature": _flipped(body["signature"])},
    "other authenticator data": lambda body: body | {"authenticator": _flipped(body["authenticator"])},
    "another counter": lambda body: body | {"authenticator": _flipped(body["authenticator"], at=-1)},
    "another client": lambda body: body | {"client": _flipped(body["client"], at=30)},
    "another credential": lambda body: body | {"credential": _flipped(body["credential"])},
    "less authenticator data": lambda body: (
        body | {"authenticator": keys.b64u(keys.unb64u(body["authenticator"])[:-1])}
    ),
}


def _bound(stated, shown):
    return {"ask": ask.claims(shown), "vote": plain(stated)}


def _flipped(text, at=0):
    raw = bytearray(keys.unb64u(text))
    raw[at] ^= 1
    return keys.b64u(bytes(raw))


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    with World(tmp_path_factory.mktemp("tampered"), settings_changes={"issuer": NAMED}) as world:
        made = Cell(world)
        made.phone = passkey(made, "carol")
        yield made


class Page:
    """An honest page with one ask, and what a person signs there."""

    def __init__(self, cell):
        self.cell = cell
        self.text = cell.text(picture_digest=picture.digest_of(PICTURE))
        answer = cell.post(PEP, "/approvals", {"ask": self.text, "picture": PICTURE})
        assert answer.status_code == 201, answer.text
        self.ask = ask.open(self.text, {keys.public_raw(cell.world.private[PEP])}, DEFAULT)

    def stated(self, shown, text):
        return Vote(shown.ask_id, shown.nonce, vote.digest_of(text), "approve", "carol", False, 1, self.cell.now + 120, self.cell.now)  # fmt: skip

    def counted(self, stated, body):
        """Votes that count after this one was sent: the provider's, and those of the point's own count."""
        cast(self.cell, self.ask.ask_id, {"vote": structs.asdict(stated), "assertion": body})
        key, people = self.cell.phone.key, Approvers({self.cell.phone.key: "carol"})
        try:
            parts = (keys.unb64u(body[name]) for name in ("authenticator", "client", "signature"))
            text = passkey_vote.compose(stated, of_browser(*parts, key=key), key=key)
            read = read_vote(text, self.ask, self.text, people, at=self.cell.now, caps=DEFAULT)
        except CapabilityError as error:  # of such parts no text can be made
            read = RejectedStatement(error.code)
        known = (
            body["credential"] == self.cell.phone.id
        )  # by which the provider finds the key, and names it to the point
        ballots = [read] if known and isinstance(read, VerifiedVote) else []
        counted = tally(ballots, self.ask, people.passkeys())
        return len(self.cell.told(self.ask.ask_id).votes), len(counted.approvers)


class Approvers:
    """Carol with her phone, as a registry names them."""

    def __init__(self, held):
        self.held = held

    def approvers(self):
        return {}

    def passkeys(self):
        return self.held


def changed(members, name, stated):
    value = members[name]
    return structs.replace(stated, **{name: value(stated) if callable(value) else value})


def spelled(shown, text):
    """The text that was made of the ask on its way: its own header and signature, other claims."""
    header, _, signature = text.split(".")
    return ".".join((header, keys.b64u(strict_json.canonical(ask.claims(shown))), signature))


def tries(page):
    """By its name, each vote with its assertion as they arrive."""
    phone, shown = page.cell.phone, page.ask
    honest = page.stated(shown, page.text)
    bound = passkey_vote.challenge_of(honest, shown)
    others = {f"ask with another {name}": changed(ASKS, name, shown) for name in ASKS}
    for name, value in CONTRIBUTORS.items():
        first = structs.replace(shown.contributors[0], **{name: value})
        others[f"sentence of another {name}"] = structs.replace(shown, contributors=(first,))
    for what, other in others.items():
        stated = page.stated(other, spelled(other, page.text))
        yield what, stated, phone.body(passkey_vote.challenge_of(stated, other))
        # the page was given another text, and the vote was put right again behind it
        if what.endswith(("picture_digest", "clearance_um")):
            yield f"{what}, put right", honest, phone.body(passkey_vote.challenge_of(stated, other))
    for name in VOTES:
        yield f"vote with another {name}", changed(VOTES, name, honest), phone.body(bound)
    for what, changes in ASSERTIONS.items():
        yield what, honest, phone.body(bound, **changes)
    for what, made in CHALLENGES.items():
        yield what, honest, phone.body(made(honest, shown))
    for what, spoil in RAW.items():
        yield what, honest, spoil(phone.body(bound))
    stranger = Authenticator(phone.party, credential=phone.credential)
    yield "another's authenticator", honest, stranger.body(bound)


def test_no_vote_on_what_was_tampered_with_counts(cell):
    page = Page(cell)
    tried = list(tries(page))
    assert len({what for what, *_ in tried}) == len(tried) >= 60
    for what, stated, body in tried:
        assert page.counted(stated, body) == (0, 0), what
    # and the honest one counts, once at each
    honest = page.stated(page.ask, page.text)
    body = cell.phone.body(passkey_vote.challenge_of(honest, page.ask))
    assert page.counted(honest, body) == (1, 1)
    assert page.counted(honest, body) == (1, 1)
    # on another ask it is none
    other = Page(cell)
    assert other.counted(honest, body) == (0, 0)


@pytest.mark.clause("STM-23", "STM-24")
def test_a_picture_is_taken_and_given_byte_for_byte_or_not_at_all(cell):
    digest = picture.digest_of(PICTURE)
    send = lambda **body: cell.post(
        PEP, "/approvals", {"ask": cell.text(picture_digest=digest), "picture": PICTURE} | body
    )
    plain_ask = cell.text()
    for code, body in {
        "none": ("ASK_PICTURE_DIFFERS", {"picture": ""}),
        "another": ("ASK_PICTURE_DIFFERS", {"picture": OTHER_PICTURE}),
        "one that the ask does not name": ("ASK_PICTURE_DIFFERS", {"ask": plain_ask}),
        "not ASCII": ("BODY_MALFORMED", {"picture": PICTURE.replace("p1", "р1")}),
        "too long": ("BODY_MALFORMED", {"picture": PICTURE + " " * picture.PICTURE_BYTES}),
    }.values():
        answer = send(**body)
        assert (answer.json()["code"], answer.status_code < 500) == (code, True)
    spaced = f" {PICTURE}"
    answer = send(ask=cell.text(picture_digest=picture.digest_of(spaced)), picture=spaced)
    assert answer.json()["code"] == "STATEMENT_MALFORMED"
    text = cell.text(picture_digest=digest)
    assert [send(ask=text).status_code for _ in range(2)] == [201, 200]
    ask_id = ask.open(text, {keys.public_raw(cell.world.private[PEP])}, DEFAULT).ask_id
    with cell.world.anonymous() as http:
        given = http.get(f"{NAMED}/approvals/{ask_id}/picture")
        assert (given.status_code, given.text, given.headers["cache-control"]) == (200, PICTURE, "no-store")
        assert http.get(f"{NAMED}/approvals/{ask_id}/state").json() == {"state": "open", "votes": 0}
        bare, _ = cell.taken()
        for unknown in ("0" * 32, "x", bare):
            answer = http.get(f"{NAMED}/approvals/{unknown}/picture")
            assert (answer.status_code, answer.json()["code"]) == (404, "ASK_UNKNOWN")


@pytest.mark.clause("PSK-8")
def test_the_link_alone_reads_page_picture_and_state_also_afterwards_and_opens_nothing(cell):
    text = cell.text(picture_digest=picture.digest_of(PICTURE))
    assert cell.post(PEP, "/approvals", {"ask": text, "picture": PICTURE}).status_code == 201
    ask_id = ask.open(text, {keys.public_raw(cell.world.private[PEP])}, DEFAULT).ask_id
    for over_s, state in ((0, "open"), (601, "expired")):
        cell.world.clock.at_s += over_s
        with cell.world.anonymous() as http:
            page, drawn, told, whole = (
                http.get(f"{NAMED}/approvals/{ask_id}{part}") for part in ("/page", "/picture", "/state", "")
            )
        assert (page.status_code, drawn.text, told.json()["state"]) == (200, PICTURE, state)
        assert ask_page.TEXTS["ask"]["read_by"] in html.unescape(page.text)
        assert "set-cookie" not in page.headers | drawn.headers | told.headers
        assert whole.status_code == 401, "the ask as it was signed, and its votes, are for people who prove a key"


@pytest.mark.clause("PSK-9")
def test_of_two_people_one_votes_with_an_operator_key(cell):
    alices = passkey(cell, "alice")
    opened = cell.post("carol", "/openings", {"opening": cell.opening()})
    assert opened.status_code == 201
    ask_id, text = cell.taken(tier=Tier(4), approvers=2, opening_id=opened.json()["opening_id"])
    shown = ask.open(text, {keys.public_raw(cell.world.private[PEP])}, DEFAULT)
    first, second = (
        Vote(ask_id, shown.nonce, vote.digest_of(text), "approve", who, False, 1, cell.now + 120, cell.now)
        for who in ("carol", "alice")
    )
    by = lambda held, stated: {"vote": structs.asdict(stated), "assertion": held.body(passkey_vote.challenge_of(stated, shown))}  # fmt: skip
    assert cast(cell, ask_id, by(cell.phone, first)).json()["state"] == "open"
    answer = cast(cell, ask_id, by(alices, second))
    assert (answer.status_code, answer.json()["code"]) == (409, "OPERATOR_KEY_NEEDED")
    # the enforcement point counts so by itself, whatever a provider lets through
    people = Approvers({cell.phone.key: "carol", alices.key: "alice"})
    ballots = [
        read_vote(held.vote(stated, shown), shown, text, people, at=cell.now, caps=DEFAULT)
        for held, stated in ((cell.phone, first), (alices, second))
    ]
    assert all(isinstance(each, VerifiedVote) for each in ballots)
    assert tally(ballots, shown, people.passkeys()).count is Count.OPEN
    # alice has her answer still, and gives it at a terminal
    answer = cell.post("alice", f"/approvals/{ask_id}/votes", {"vote": cell.vote(text, "alice")})
    assert (answer.status_code, answer.json()["state"]) == (201, "granted")
