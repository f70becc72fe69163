"""Every defective ask, vote, opening and closing: refused with its code, with no effect but its entry in the ledger."""

from __future__ import annotations

import json
import secrets
from dataclasses import dataclass
from typing import Callable

import pytest
from capabilities.values.scope import Tier
from tests.ztpm_idp.asks import AGENT, PEP, SENSOR, Cell
from tests.ztpm_idp.routes.test_endpoints import tables
from tests.ztpm_idp.world import AUDIENCE, World

from capabilities.keys import jws, keys
from capabilities.statements import statement_form
from capabilities.statements.people import ask, opening, vote
from capabilities.values import strict_json

pytestmark = pytest.mark.long

Attempt = tuple[str, str, object]
"""Caller, path and body."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """One world for all rows. It holds a second enforcement point and agent, a dead agent and a disabled approver."""
    with World(tmp_path_factory.mktemp("defects")) as world:
        made = Cell(world)
        alice = world.people["alice"]
        world.private["cell-2"] = keys.generate()
        alice.register_pep("cell-2", keys.public_raw(world.private["cell-2"]), ["http://127.0.0.1:8801/mcp"])
        world.agent("dead")
        alice.retire_agent("dead", "odd")
        world.agent("new", attested=False)
        world.agent("other")
        for name, roles in {"erin": ["approver"], "frank": ["sponsor"], "grace": ["approver"]}.items():
            world.person(name, *roles)
        world.end("erin")
        alice.disable_person("frank", "left")
        yield made


@dataclass(frozen=True)
class Row:
    """One defect: what sets it up and attempts it, the code, and whether the attempt is in the ledger."""

    name: str
    attempt: Callable[[Cell], Attempt]
    code: str
    kept: bool = True


ROWS: list[Row] = []


def row(name, code, *, kept=True):
    def add(attempt):
        ROWS.append(Row(name, attempt, code, kept))
        return attempt

    return add


# --- votes -------------------------------------------------------------------------------------------------------------


def cast(cell, text, vote_text, who="carol", ask_id=None):
    return (
        who,
        f"/approvals/{ask_id or json.loads(keys.unb64u(text.split('.')[1]))['ask_id']}/votes",
        {"vote": vote_text},
    )


def bad_vote(name, code, *, who="carol", approver=None, key=None, taken=None, kept=True, **changes):
    """A vote with these members changed, on a fresh ask. A change may be a function of now."""

    def attempt(cell):
        _, text = cell.taken(**(taken or {}))
        made = {k: v(cell.now) if callable(v) else v for k, v in changes.items()}
        return cast(cell, text, cell.vote(text, approver or who, key=key, **made), who)

    ROWS.append(Row(f"vote: {name}", attempt, code, kept))


bad_vote("other digest", "VOTE_NOT_FOR_THIS_ASK", ask_digest="0" * 64)
bad_vote("other nonce", "VOTE_NOT_FOR_THIS_ASK", nonce="0" * 32)
bad_vote("names another ask", "VOTE_NOT_FOR_THIS_ASK", ask_id="0" * 32)
bad_vote("signed in the future", "VOTE_OUT_OF_TIME", at=lambda now: now + 6, not_after=lambda now: now + 120)
bad_vote("signed before the ask", "VOTE_OUT_OF_TIME", at=lambda now: now - 1)
bad_vote("lapsed", "VOTE_OUT_OF_TIME", not_after=lambda now: now - 1)
bad_vote("too long", "VOTE_OUT_OF_TIME", not_after=lambda now: now + 3_601)
bad_vote("far beyond any time", "VOTE_OUT_OF_TIME", not_after=2**53 - 1)
bad_vote("by an agent", "NOT_PERMITTED", who=AGENT)
bad_vote("by an enforcement point", "NOT_PERMITTED", who=PEP)
bad_vote("by a sponsor without the role", "NOT_PERMITTED", who="bob")
bad_vote("by an administrator without the role", "NOT_PERMITTED", who="dan")
bad_vote("a right one, posted by an agent", "NOT_PERMITTED", who=AGENT, approver="carol", key="carol")
bad_vote("by a sensor", "CALLER_UNKNOWN", who=SENSOR, kept=False)
bad_vote("by a disabled person", "CALLER_INACTIVE", who="erin", kept=False)
bad_vote("signed by an agent", "STATEMENT_UNTRUSTED", key=AGENT)
bad_vote("signed by a sensor", "STATEMENT_UNTRUSTED", key=SENSOR)
bad_vote("signed by an enforcement point", "STATEMENT_UNTRUSTED", key=PEP)
bad_vote("signed by a sponsor without the role", "STATEMENT_UNTRUSTED", key="bob")
bad_vote("signed by a disabled person", "STATEMENT_UNTRUSTED", key="erin")
bad_vote("another approver's", "VOTE_NOT_YOURS", approver="alice")
bad_vote("signed by another approver in the caller's name", "VOTE_NOT_YOURS", key="alice")
bad_vote("in another approver's name", "VOTE_NOT_YOURS", approver="alice", key="carol")
bad_vote("withdraws nothing", "NOTHING_TO_WITHDRAW", answer="withdraw")
bad_vote("does not see the cell clear, view stale", "CLEAR_NOT_SEEN", taken={"perception": "stale"})
bad_vote("does not see the cell clear, view missing", "CLEAR_NOT_SEEN", taken={"perception": "missing"})
bad_vote("no uses", "STATEMENT_MALFORMED", uses=0)
bad_vote("101 uses", "STATEMENT_MALFORMED", uses=101)
bad_vote("uses as text", "STATEMENT_MALFORMED", uses="1")
bad_vote("uses as true", "STATEMENT_MALFORMED", uses=True)
bad_vote("negative uses", "STATEMENT_MALFORMED", uses=-1)
bad_vote("unknown answer", "STATEMENT_MALFORMED", answer="maybe")
bad_vote("answer in capitals", "STATEMENT_MALFORMED", answer="APPROVE")
bad_vote("sees_clear as a number", "STATEMENT_MALFORMED", sees_clear=1)
bad_vote("sees_clear as text", "STATEMENT_MALFORMED", sees_clear="true")
bad_vote("at nothing", "STATEMENT_MALFORMED", at=None)
bad_vote("digest in capitals", "STATEMENT_MALFORMED", ask_digest="A" * 64)
bad_vote("approver that turns the line", "STATEMENT_MALFORMED", approver="carol\u202e", key="carol")
bad_vote("approver in cyrillic", "STATEMENT_MALFORMED", approver="с" + "arol", key="carol")


@row("vote: unknown ask", "ASK_UNKNOWN")
def _(cell):
    return cast(cell, text := cell.text(), cell.vote(text))


@row("vote: an id that is none", "ASK_UNKNOWN", kept=False)
def _(cell):
    _, text = cell.taken()
    return cast(cell, text, cell.vote(text), ask_id="A" * 32)


@row("vote: the id of another ask in the path", "VOTE_NOT_FOR_THIS_ASK")
def _(cell):
    (_, text), (other, _) = cell.taken(), cell.taken()
    return cast(cell, text, cell.vote(text), ask_id=other)


@row("vote: on a changed ask", "VOTE_NOT_FOR_THIS_ASK")
def _(cell):
    stated = dict(ask_id="c" * 30 + secrets.token_hex(1), nonce="d" * 32)
    _, text = cell.taken(**stated)
    return cast(cell, text, cell.vote(cell.text(index_milli=2_641, **stated)))


@row("vote: on an expired ask", "ASK_OVER")
def _(cell):
    _, text = cell.taken()
    cell.world.clock.at_s += 600
    return cast(cell, text, cell.vote(text))


@row("vote: denies an expired ask", "ASK_OVER")
def _(cell):
    _, text = cell.taken()
    cell.world.clock.at_s += 600
    return cast(cell, text, cell.vote(text, answer="deny"))


@row("vote: when an approval lapsed", "ASK_OVER")
def _(cell):
    ask_id, text = cell.taken()
    cell.world.people["alice"].approve(ask_id, lifetime_s=5)
    cell.world.clock.at_s += 6
    return cast(cell, text, cell.vote(text))


@row("vote: on a denied ask", "ASK_ANSWERED")
def _(cell):
    ask_id, text = cell.taken()
    cell.world.people["alice"].deny(ask_id)
    return cast(cell, text, cell.vote(text))


@row("vote: on a granted ask", "ASK_ANSWERED")
def _(cell):
    ask_id, text = cell.taken()
    cell.world.people["alice"].approve(ask_id)
    return cast(cell, text, cell.vote(text))


@row("vote: on a withdrawn ask", "ASK_ANSWERED")
def _(cell):
    ask_id, text = cell.taken()
    cell.world.people["alice"].approve(ask_id)
    cell.world.people["alice"].withdraw(ask_id)
    return cast(cell, text, cell.vote(text))


@row("vote: the same person twice", "VOTED_BEFORE")
def _(cell):
    ask_id, text = cell.taken(approvers=2)
    cell.world.people["carol"].approve(ask_id)
    return cast(cell, text, cell.vote(text, uses=2))


@row("vote: the very same vote twice", "VOTED_BEFORE")
def _(cell):
    _, text = cell.taken(approvers=2)
    attempt = cast(cell, text, cell.vote(text))
    assert cell.post(*attempt).status_code == 201
    return attempt


@row("vote: denies after approving", "VOTED_BEFORE")
def _(cell):
    ask_id, text = cell.taken()
    cell.world.people["carol"].approve(ask_id)
    return cast(cell, text, cell.vote(text, answer="deny"))


@row("vote: approves after denying", "VOTED_BEFORE")
def _(cell):
    ask_id, text = cell.taken()
    cell.world.people["carol"].deny(ask_id)
    return cast(cell, text, cell.vote(text))


@row("vote: withdraws twice", "VOTED_BEFORE")
def _(cell):
    ask_id, text = cell.taken()
    cell.world.people["carol"].approve(ask_id)
    cell.world.people["carol"].withdraw(ask_id)
    return cast(cell, text, cell.vote(text, answer="withdraw"))


@row("vote: withdraws another's approval", "NOTHING_TO_WITHDRAW")
def _(cell):
    ask_id, text = cell.taken()
    cell.world.people["alice"].approve(ask_id)
    return cast(cell, text, cell.vote(text, answer="withdraw"))


@row("vote: an opening instead", "STATEMENT_WRONG_KIND")
def _(cell):
    _, text = cell.taken()
    return cast(cell, text, cell.opening())


@row("vote: the ask instead", "STATEMENT_WRONG_KIND")
def _(cell):
    _, text = cell.taken()
    return cast(cell, text, text)


def spelled(name, code, spell, *, kept=True):
    """Vote that is right but for its spelling: `spell` makes the text from its claims and the person's key."""

    @row(f"vote: {name}", code, kept=kept)
    def _(cell):
        _, text = cell.taken()
        right = cell.vote(text)
        claims = json.loads(keys.unb64u(right.split(".")[1]))
        return cast(cell, text, spell(claims, cell.world.private["carol"], right))


def header(key):
    return {"typ": "ztpm-vote+jwt", "kid": keys.thumbprint(keys.public_raw(key))}


for member in vote.NAMES:
    spelled(f"without {member}", "STATEMENT_MALFORMED", lambda c, k, _, member=member: statement_form.sign("vote", {n: v for n, v in c.items() if n != member}, k))  # fmt: skip
    spelled(f"{member} twice", "STATEMENT_MALFORMED", lambda c, k, _, member=member: jws.sign(header(k), strict_json.canonical(c)[:-1] + f',"{member}":{json.dumps(c[member])}'.encode() + b"}", k))  # fmt: skip
spelled("an extra member", "STATEMENT_MALFORMED", lambda c, k, _: statement_form.sign("vote", c | {"uses_left": 1}, k))
spelled(
    "spaces between the members", "STATEMENT_MALFORMED", lambda c, k, _: jws.sign(header(k), json.dumps(c).encode(), k)
)
spelled("members in another order", "STATEMENT_MALFORMED", lambda c, k, _: jws.sign(header(k), json.dumps(dict(reversed(c.items())), separators=(",", ":")).encode(), k))  # fmt: skip
spelled("a number with a point", "STATEMENT_MALFORMED", lambda c, k, _: jws.sign(header(k), strict_json.canonical(c).replace(b'"uses":1', b'"uses":1.0'), k))  # fmt: skip
spelled("uses beyond any integer", "STATEMENT_MALFORMED", lambda c, k, _: jws.sign(header(k), strict_json.canonical(c).replace(b'"uses":1', b'"uses":' + b"9" * 400), k))  # fmt: skip
spelled("not an object", "STATEMENT_MALFORMED", lambda c, k, _: jws.sign(header(k), b"[]", k))
spelled("another header", "STATEMENT_MALFORMED", lambda c, k, _: jws.sign(header(k) | {"crit": []}, strict_json.canonical(c), k))  # fmt: skip
spelled("another's kid", "STATEMENT_UNTRUSTED", lambda c, k, _: jws.sign(header(keys.generate()), strict_json.canonical(c), k))  # fmt: skip
spelled("a flipped signature", "STATEMENT_UNTRUSTED", lambda c, k, right: right[:-10] + ("A" if right[-10] != "A" else "B") + right[-9:])  # fmt: skip
spelled("a flipped payload", "STATEMENT_UNTRUSTED", lambda c, k, right: statement_form.sign("vote", c | {"uses": 100}, k).rsplit(".", 1)[0] + "." + right.rsplit(".", 1)[1])  # fmt: skip
spelled("huge", "BODY_MALFORMED", lambda c, k, right: right + "A" * 5_000, kept=False)
spelled("padded", "BODY_MALFORMED", lambda c, k, right: right + "==", kept=False)
spelled("empty", "BODY_MALFORMED", lambda c, k, right: "", kept=False)
spelled("no text", "BODY_MALFORMED", lambda c, k, right: {"vote": right}, kept=False)

# --- asks --------------------------------------------------------------------------------------------------------------


def bad_ask(name, code, *, who=PEP, key=None, kept=True, **changes):
    def attempt(cell):
        made = {k: v(cell) if callable(v) else v for k, v in changes.items()}
        return who, "/approvals", {"ask": cell.text(key=key or who, **made)}

    ROWS.append(Row(f"ask: {name}", attempt, code, kept))


bad_ask("by an agent", "NOT_PERMITTED", who=AGENT)
bad_ask("by a person", "NOT_PERMITTED", who="alice")
bad_ask("a right one, posted by an agent", "NOT_PERMITTED", who=AGENT, key=PEP)
bad_ask("by a sensor", "CALLER_UNKNOWN", who=SENSOR, kept=False)
bad_ask("signed by an agent", "STATEMENT_UNTRUSTED", key=AGENT)
bad_ask("another enforcement point's", "STATEMENT_UNTRUSTED", who="cell-2", key=PEP)
bad_ask("in another's name", "ASK_NOT_YOURS", who="cell-2")
bad_ask("for another's audience", "NOT_PERMITTED", audience="http://127.0.0.1:8801/mcp")
bad_ask("of another issuer", "ASK_CONTRADICTS_REGISTRY", issuer="http://127.0.0.1:9/ztpm")
bad_ask("of an unknown sponsor", "NOT_FOUND", sponsor="nobody")
bad_ask("of an agent as sponsor", "NOT_FOUND", sponsor="other")
bad_ask("of a person who sponsors nothing", "SPONSOR_INACTIVE", sponsor="carol")
bad_ask("of a disabled sponsor", "SPONSOR_INACTIVE", sponsor="frank")
bad_ask("of an unknown agent", "NOT_FOUND", agent="nobody")
bad_ask("of a person as agent", "NOT_FOUND", agent="bob")
bad_ask("of a revoked agent", "AGENT_INACTIVE", agent="dead")
bad_ask("of an agent never attested", "AGENT_INACTIVE", agent="new")
bad_ask("of another key", "ASK_CONTRADICTS_REGISTRY", agent_key="A" * 43)
bad_ask("over", "ASK_OVER", asked_at=lambda cell: cell.now - 600, expires_at=lambda cell: cell.now)
bad_ask("from the future", "ASK_OUT_OF_TIME", asked_at=lambda cell: cell.now + 6)
bad_ask("for too long", "ASK_OUT_OF_TIME", expires_at=lambda cell: cell.now + 3_601)
bad_ask("ends before it begins", "STATEMENT_MALFORMED", expires_at=lambda cell: cell.now)
bad_ask("without a reason", "STATEMENT_MALFORMED", reasons=())
bad_ask("a reason twice", "STATEMENT_MALFORMED", reasons=("BUSY", "BUSY"))
bad_ask("five angles", "STATEMENT_MALFORMED", start_urad=(1,) * 5)
bad_ask("tier 5", "STATEMENT_MALFORMED", tier=5)
bad_ask("index beyond 4", "STATEMENT_MALFORMED", index_milli=4_001)
bad_ask("three approvers", "STATEMENT_MALFORMED", approvers=3)
bad_ask("tier 4 with one approver", "STATEMENT_MALFORMED", tier=Tier(4), opening_id="a" * 32)
bad_ask("tier 4 without an opening", "STATEMENT_MALFORMED", tier=Tier(4), approvers=2)
bad_ask("tier 3 with an opening", "STATEMENT_MALFORMED", opening_id="a" * 32)
bad_ask("a name that turns the line", "STATEMENT_MALFORMED", operation="move\u202etniop")
bad_ask("a name with a tag", "STATEMENT_MALFORMED", object="<script>alert(1)</script>")
bad_ask("too many parameters", "STATEMENT_MALFORMED", values=tuple(ask.Quantity(f"q{n}", ask.Unit.COUNT, n) for n in range(33)))  # fmt: skip
bad_ask("an opening nobody made", "OPENING_NOT_IN_FORCE", tier=Tier(4), approvers=2, opening_id="a" * 32)


def resting(name, *, opened=None, then=lambda cell, opening_id: None, **changes):
    """A tier 4 ask on an opening that does not carry it."""

    def attempt(cell):
        made = {k: v(cell) if callable(v) else v for k, v in (opened or {}).items()}
        opening_id = json.loads(keys.unb64u((text := cell.opening(**made)).split(".")[1]))["opening_id"]
        assert cell.post("carol", "/openings", {"opening": text}).status_code == 201
        then(cell, opening_id)
        return PEP, "/approvals", {"ask": cell.text(tier=Tier(4), approvers=2, opening_id=opening_id, **changes)}

    ROWS.append(Row(f"ask: {name}", attempt, "OPENING_NOT_IN_FORCE"))


def after(seconds):
    def then(cell, _):
        cell.world.clock.at_s += seconds

    return then


resting(
    "its opening is closed", then=lambda cell, opening_id: cell.world.people["alice"].close_opening(opening_id, "no")
)
resting("its opening is over", then=after(601))
resting("its opening has not begun", opened={"not_before": lambda cell: cell.now + 5})
resting("its opening is for another agent", opened={"agent": "other"})
resting("its opening is for another operation", operation="move_linear")
resting("its opening is for another object", opened={"object": "ur5e"})
resting("its opening is for another audience", opened={"audience": "http://127.0.0.1:8801/mcp"})


@row("ask: another text with the same id", "ASK_DIFFERS")
def _(cell):
    ask_id, _ = cell.taken()
    return PEP, "/approvals", {"ask": cell.text(ask_id=ask_id, index_milli=1)}


@row("ask: the id of an ask that is over", "ASK_DIFFERS")
def _(cell):
    ask_id, _ = cell.taken()
    cell.world.clock.at_s += 5_000
    return PEP, "/approvals", {"ask": cell.text(ask_id=ask_id)}


@row("ask: huge", "BODY_MALFORMED", kept=False)
def _(cell):
    return PEP, "/approvals", {"ask": cell.text() + "A" * 131_072}


@row("ask: a vote instead", "STATEMENT_WRONG_KIND")
def _(cell):
    return PEP, "/approvals", {"ask": cell.vote(cell.text(), PEP)}


# --- openings ----------------------------------------------------------------------------------------------------------


def bad_opening(name, code, *, who="carol", opener=None, key=None, kept=True, **changes):
    def attempt(cell):
        made = {k: v(cell.now) if callable(v) else v for k, v in changes.items()}
        return who, "/openings", {"opening": cell.opening(opener or who, key=key, **made)}

    ROWS.append(Row(f"opening: {name}", attempt, code, kept))


bad_opening("by an agent", "NOT_PERMITTED", who=AGENT)
bad_opening("by an enforcement point", "NOT_PERMITTED", who=PEP)
bad_opening("by a sensor", "CALLER_UNKNOWN", who=SENSOR, kept=False)
bad_opening("by a sponsor without the role", "NOT_PERMITTED", who="bob")
bad_opening("by a disabled person", "CALLER_INACTIVE", who="erin", kept=False)
bad_opening("signed by an agent", "STATEMENT_UNTRUSTED", key=AGENT)
bad_opening("signed by a sensor", "STATEMENT_UNTRUSTED", key=SENSOR)
bad_opening("another approver's", "OPENING_NOT_YOURS", opener="alice")
bad_opening("in another approver's name", "OPENING_NOT_YOURS", opener="alice", key="carol")
bad_opening("over", "OPENING_OUT_OF_TIME", not_before=lambda now: now - 60, not_after=lambda now: now)
bad_opening("too far ahead", "OPENING_OUT_OF_TIME", not_before=lambda now: now + 60, not_after=lambda now: now + 3_601)
bad_opening("too long", "OPENING_OUT_OF_TIME", not_before=lambda now: now - 3_000, not_after=lambda now: now + 601)
bad_opening("ends before it begins", "STATEMENT_MALFORMED", not_after=lambda now: now)
bad_opening("for an unknown agent", "NOT_FOUND", agent="nobody")
bad_opening("for a person", "NOT_FOUND", agent="bob")
bad_opening("for a revoked agent", "AGENT_INACTIVE", agent="dead")
bad_opening("for an audience that nobody serves", "NOT_FOUND", audience="http://127.0.0.1:9/mcp")
bad_opening("no uses", "STATEMENT_MALFORMED", uses=0)
bad_opening("101 uses", "STATEMENT_MALFORMED", uses=101)
bad_opening("a vote instead", "STATEMENT_WRONG_KIND")
ROWS[-1] = Row(
    ROWS[-1].name, lambda cell: ("carol", "/openings", {"opening": cell.vote(cell.taken()[1])}), ROWS[-1].code
)


@row("opening: another text with the same id", "OPENING_DIFFERS")
def _(cell):
    opening_id = "b" * 30 + secrets.token_hex(1)
    assert cell.post("carol", "/openings", {"opening": cell.opening(opening_id=opening_id)}).status_code == 201
    return "carol", "/openings", {"opening": cell.opening(opening_id=opening_id, uses=2)}


@row("opening: an extra member", "STATEMENT_MALFORMED")
def _(cell):
    claims = json.loads(keys.unb64u(cell.opening().split(".")[1]))
    return (
        "carol",
        "/openings",
        {"opening": statement_form.sign(opening.KIND, claims | {"more": 1}, cell.world.private["carol"])},
    )


for name, who, code in (("an agent", AGENT, "NOT_PERMITTED"), ("an enforcement point", PEP, "NOT_PERMITTED"), ("a sponsor", "bob", "NOT_PERMITTED")):  # fmt: skip

    @row(f"closing: by {name}", code)
    def _(cell, who=who):
        opened = cell.world.people["carol"].open_tier_4(
            audience=AUDIENCE, agent=AGENT, object="ur3e", operation="move_joint"
        )  # fmt: skip
        return who, f"/openings/{opened}/withdraw", {"reason": "no"}


@row("closing: unknown", "OPENING_UNKNOWN")
def _(cell):
    return "carol", f"/openings/{'e' * 32}/withdraw", {"reason": "no"}


@row("closing: an id that is none", "OPENING_UNKNOWN", kept=False)
def _(cell):
    return "carol", "/openings/E/withdraw", {"reason": "no"}


@pytest.mark.parametrize("defect", ROWS, ids=lambda defect: defect.name)
def test_a_defect_is_refused_and_has_no_effect(cell, defect):
    cell.world.clock.at_s += 5_000  # whatever the rows before left is over
    attempt = defect.attempt(cell)
    before = tables(cell.world)
    response = cell.post(*attempt)
    assert response.json()["code"] == defect.code, response.text
    assert 400 <= response.status_code < 500
    after = tables(cell.world)
    kept = [json.loads(line) for _, _, line in after.pop("ledger")[len(before.pop("ledger")) :]]
    del after["counters"], before["counters"]
    del after["refusals"], before["refusals"]  # how many an agent has had, which the ledger tells too
    for name in ("ledger_index", "ledger_tiles", "ledger_followed"):  # made of the ledger's lines, a moment later
        del after[name], before[name]
    assert after == before
    assert [(entry["actor"], entry["body"]["code"]) for entry in kept] == [(attempt[0], defect.code)] * defect.kept


def test_there_are_enough_of_them():
    assert len({defect.name for defect in ROWS}) == len(ROWS) >= 100
