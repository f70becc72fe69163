"""The console in a real browser: a token is killed and proven dead; an agent is suspended, and people change."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest
from capabilities.statements.people import picture as wire
from msgspec import structs
from pep.pit.files.scene_file import Situation
from pep.pit.picture.shown_form import shown_text
from tests import browsing
from tests.browsing import CHROMIUM
from tests.pep.pit.scenes import CELL, NOTHING, ROBOT, SEED, sweep, with_person
from tests.ztpm_idp.asks import PEP, Cell
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.world import SLOWER

from pep.pit import assess
from ztpm_idp.client import ClientError

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.clause("CON-2", "CON-4", "CON-6"),
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    with browsing.served(tmp_path_factory.mktemp("console")) as world:
        yield Cell(world)


@pytest.fixture(scope="module")
def point(cell, tmp_path_factory):
    """The enforcement point as a process of its own, which follows the feed and confirms."""
    folder = tmp_path_factory.mktemp("point")
    (folder / "key").write_bytes(cell.world.private[PEP].private_bytes_raw())
    command = [sys.executable, "-m", "tests.e2e.follow", cell.world.issuer, str(folder), "0.25"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as follower:
        assert "revoked" in follower.stdout.readline()
        yield follower
        follower.kill()


@pytest.fixture(scope="module")
def story(cell):
    """A token of alice for planner, lent on to mover, which acted and was refused; a mandate beside it."""
    world = cell.world
    planner, journal = world.agent("planner"), Journal(world, registered=True)
    first = world.people["alice"].issue(planner, world.scope(), purpose="bring parts from the tray")
    hop = planner.delegate(first.token, world.agents["mover"], SLOWER, purpose="move the arm")
    done = journal.acted(hop.token, tier=2)
    journal.acted(hop.token, tier=1)
    for reason in ("LIMIT_EXCEEDED_BY_REQUEST", "NOT_GRANTED"):
        journal.refused(hop.token, reason=reason, tier=3)
    journal.ship()
    cell.journal = journal
    return first, hop, done


@pytest.fixture(scope="module")
def page():
    with browsing.browser_page() as opened:
        yield browsing.authenticator(opened)


@pytest.fixture(scope="module")
def axe():
    return browsing.rules()


def looked_at(page, name, axe):
    browsing.looked_at(page, f"console-{name}", axe)


def with_passkey(world, page, name, another):
    """A passkey of this person in the page's authenticator."""
    browsing.enrolled(page, world.people[name], world.people[another])


def test_a_person_logs_in_cuts_a_tree_and_finds_it_on_record(cell, story, point, page, axe):
    world, (first, hop, done) = cell.world, story
    with_passkey(world, page, "alice", "dan")
    page.goto(f"{world.issuer}/console")
    page.get_by_role("button", name="Log in with a passkey").click()
    page.wait_for_url(f"{world.issuer}/console")
    looked_at(page, "front", axe)

    # the tree, by keyboard alone: to the token's Revoke, the reason, the passkey
    page.get_by_role("link", name="Tree", exact=True).first.click()
    looked_at(page, "tree", axe)
    page.get_by_role("link", name=f"Revoke Token {first.token_id}").focus()
    page.keyboard.press("Enter")
    page.get_by_label("Reason").wait_for()
    assert page.url.endswith("/console/tree"), "the question comes into the page"
    assert "This kills 2 hops" in page.inner_text("#act")
    looked_at(page, "question", axe)
    page.get_by_label("Reason").focus()
    page.keyboard.type("an odd act, größer")
    browsing.verified(page, person=False)
    page.keyboard.press("Enter")
    page.wait_for_function("() => document.querySelector('.told').textContent.includes('Nothing was revoked')")
    browsing.verified(page, person=True)
    began = time.monotonic()
    page.keyboard.press("Enter")
    page.wait_for_url("**/console/revocations/*")
    seen_s = time.monotonic() - began
    page.locator(".point.confirmed").wait_for(timeout=15_000)
    confirmed_s = time.monotonic() - began
    told = page.locator(".point").inner_text()
    assert f"{PEP} confirmed after" in told and page.locator("[hx-trigger]").count() == 0, "it asks no longer"
    assert hop.hop_id in page.inner_text("main")
    with pytest.raises(ClientError) as caught:
        world.agents["planner"].delegate(first.token, world.agents["mover"], SLOWER, purpose="again")
    assert caught.value.code == "REVOKED"
    looked_at(page, "revoked", axe)
    page.goto(f"{world.issuer}/console/tree")
    looked_at(page, "dead", axe)

    # the trail has it, and this browser proves it
    page.get_by_role("link", name="Trail", exact=True).first.click()
    looked_at(page, "trail", axe)
    page.get_by_label("Kind").fill("revoked")
    page.get_by_role("button", name="Find").click()
    row = page.locator("tbody tr").first
    assert "an odd act, größer" in row.inner_text() and first.token_id in row.inner_text()
    row.get_by_role("link").first.click()
    page.wait_for_function("() => document.querySelector('#proof').dataset.result")
    assert page.inner_text(".verdict") == "The proof holds: checked in this browser."
    looked_at(page, "entry", axe)
    page.goto(f"{world.issuer}/console/trail/requests/{done.request_id}")
    assert "PERMIT" in page.inner_text("main") and "planner" in page.inner_text("main")
    looked_at(page, "request", axe)
    page.goto(f"{world.issuer}/console/agents/mover")
    looked_at(page, "agent", axe)
    page.goto(f"{world.issuer}/console/agents")
    looked_at(page, "agents", axe)
    page.goto(f"{world.issuer}/console/people")
    looked_at(page, "people", axe)
    page.goto(f"{world.issuer}/console/tree/hops/{hop.hop_id}")
    looked_at(page, "hop", axe)
    assert page.faults == []
    print(
        f"seen {seen_s:.2f} s after the word, confirmed on the page {confirmed_s:.2f} s after it ({told}); accessibility {'tried' if axe else 'NOT tried'}"
    )


def by_keyboard(page, form, reason):
    """Goes by keyboard alone from the reason of this form to the question that it asks."""
    page.locator(f"form[action$='{form}'] input[name=reason]").first.focus()
    page.keyboard.type(reason)
    page.keyboard.press("Enter")
    page.locator("[data-member=reason]").wait_for()
    assert page.inner_text("[data-member=reason]") == reason


def sign_by_keyboard(page):
    button = page.get_by_role("button", name="Sign with your passkey")
    for _ in range(40):
        if button.evaluate("each => each === document.activeElement"):
            break
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")


@pytest.mark.clause("CON-11", "CON-12", "CON-13")
def test_an_administrator_suspends_an_agent_and_changes_people_by_keyboard(cell, story, page, axe):
    world = cell.world
    if not any(row["id"] == "alice" and row["passkeys"] for row in world.people["alice"].persons()):
        with_passkey(world, page, "alice", "dan")
    page.goto(f"{world.issuer}/console")
    if page.get_by_role("button", name="Log in with a passkey").count():
        page.get_by_role("button", name="Log in with a passkey").click()
        page.wait_for_url(f"{world.issuer}/console")

    # what is signed is what is drawn: a changed word is seen, and the provider takes it not; a hidden one is not signed
    address, suspend = f"{world.issuer}/console/acts/suspend-agent?*", f"{world.issuer}/console/agents/planner"

    def altered(before, after):
        def other(route):
            answer = route.fetch()
            assert before in answer.text()
            route.fulfill(response=answer, body=answer.text().replace(before, after))

        page.route(address, other)
        page.goto(suspend)

    altered("&#34;planner&#34;", "&#34;mover&#34;")
    by_keyboard(page, "suspend-agent", "odd acts, größer")
    page.wait_for_function("() => document.querySelector('[data-member=agent]')?.textContent === 'mover'")
    sign_by_keyboard(page)
    page.get_by_text("STATEMENT_UNTRUSTED", exact=True).wait_for()
    page.unroute(address)
    altered('data-member="standing"', 'data-member="other"')
    by_keyboard(page, "suspend-agent", "odd acts, größer")
    sign_by_keyboard(page)
    page.wait_for_function("() => document.querySelector('.told').textContent.includes('does not show')")
    page.unroute(address)

    # an agent is suspended; a person without a finger does nothing
    page.goto(suspend)
    by_keyboard(page, "suspend-agent", "odd acts, größer")
    looked_at(page, "act", axe)
    browsing.verified(page, person=False)
    sign_by_keyboard(page)
    page.wait_for_function("() => document.querySelector('.told').textContent.includes('Nothing was done')")
    browsing.verified(page, person=True)
    began = time.monotonic()
    sign_by_keyboard(page)
    page.wait_for_url(suspend)
    took_s = time.monotonic() - began
    assert "suspended" in page.inner_text("main")
    by_keyboard(page, "restore-agent", "looked into")
    sign_by_keyboard(page)
    page.wait_for_url(suspend)
    assert "suspended" not in page.inner_text("table.pairs")

    # roles are proposed on the page, and confirmed with an operator key
    page.goto(f"{world.issuer}/console/people")
    page.locator("li", has_text="bob").locator("summary").focus()
    page.keyboard.press("Enter")
    auditor = page.locator("li", has_text="bob").get_by_label("auditor")
    auditor.focus()
    page.keyboard.press("Space")
    page.locator("li", has_text="bob").get_by_role("button", name="Propose roles").focus()
    page.keyboard.press("Enter")
    page.locator("[data-member=roles]").wait_for()
    assert page.inner_text("[data-member=roles]") == "auditor sponsor"
    sign_by_keyboard(page)
    page.wait_for_url("**/console/people?after=*")
    change = page.url.rpartition("=")[2]
    assert world.people["dan"].confirm_change(change) == "done"

    # another's change is confirmed on the page, where an operator key proposed it
    change = world.people["dan"].propose_roles("bob", ["sponsor"])
    page.goto(f"{world.issuer}/console/people")
    for part in page.locator("details").all():
        part.evaluate("each => { each.open = true; }")
    looked_at(page, "people-waiting", axe)
    page.get_by_role("button", name="Confirm").focus()
    page.keyboard.press("Enter")
    page.locator("[data-member=change_id]").wait_for()
    looked_at(page, "act-confirm", axe)
    sign_by_keyboard(page)
    page.wait_for_url(f"**/console/people?after={change}")
    assert f"{change} is done" in page.inner_text(".notice")
    assert [row["roles"] for row in world.people["dan"].persons() if row["id"] == "bob"] == [["sponsor"]]
    assert [fault for fault in page.faults if "403" not in fault] == []
    page.faults.clear()
    print(f"suspended {took_s:.2f} s after the word")


def logged_out_elsewhere(page, issuer):
    """Ends the session in another tab of this browser."""
    other = page.context.new_page()
    other.goto(f"{issuer}/login/account")
    other.get_by_role("button", name="Log out").click()
    other.wait_for_url(f"{issuer}/login")
    other.close()


def logged_in_again(page):
    page.get_by_text("your session was over, and nothing was done").wait_for()
    page.get_by_role("link", name="Log in, and see again what you were asked").click()
    page.get_by_role("button", name="Log in with a passkey").click()


@pytest.mark.clause("CON-2", "CON-12")
def test_a_session_that_ends_before_the_word_does_nothing_and_loses_nothing(cell, story, page, axe):
    world, agent = cell.world, f"{cell.world.issuer}/console/agents/planner"
    if not any(row["id"] == "alice" and row["passkeys"] for row in world.people["alice"].persons()):
        with_passkey(world, page, "alice", "dan")
    page.goto(f"{world.issuer}/login?back_to=/ztpm/console")
    if page.get_by_role("button", name="Log in with a passkey").count():
        page.get_by_role("button", name="Log in with a passkey").click()
    page.goto(agent)
    by_keyboard(page, "suspend-agent", "odd acts, größer & <b>")
    logged_out_elsewhere(page, world.issuer)
    sign_by_keyboard(page)
    page.get_by_text("NOT_LOGGED_IN", exact=True).first.wait_for()
    looked_at(page, "session-over", axe)
    logged_in_again(page)
    page.locator("[data-member=reason]").wait_for()
    assert page.inner_text("[data-member=reason]") == "odd acts, größer & <b>"
    page.goto(agent)
    assert "suspended" not in page.inner_text("table.pairs")

    # what is taken back on the tree: the reason that was written stands there again, and counts once it is signed
    lent = world.people["alice"].issue(world.agent("carrier"), world.scope(), purpose="bring parts")
    page.goto(f"{world.issuer}/console/tree")
    page.get_by_role("link", name=f"Revoke Token {lent.token_id}").click()
    page.get_by_label("Reason").fill("größer & <b>")
    logged_out_elsewhere(page, world.issuer)
    revoked = len(world.sql("SELECT epoch FROM revocations"))
    page.get_by_label("Reason").press("Enter")
    logged_in_again(page)
    page.get_by_label("Reason").wait_for()
    assert page.get_by_label("Reason").input_value() == "größer & <b>"
    assert len(world.sql("SELECT epoch FROM revocations")) == revoked
    page.get_by_label("Reason").press("Enter")
    page.wait_for_url("**/console/revocations/*")
    assert len(world.sql("SELECT epoch FROM revocations")) == revoked + 1
    page.faults.clear()


@pytest.mark.parametrize("changed", ["line", "path", "root", "signature", "number"])
def test_a_proof_that_was_tampered_with_does_not_hold(cell, story, page, changed):
    """On the way to an honest page: the browser says so."""
    issuer = cell.world.issuer

    changes = []

    def other(route):
        answer = route.fetch()
        text = answer.text()
        if changed == "line":
            text = text.replace("bootstrap", "bootstraq", 1)
        elif changed == "number":
            text = text.replace("index 2\n", "index 3\n")
        else:
            lines = text.split("\n")
            place = {"path": 2, "root": lines.index("") + 3, "signature": len(lines) - 2}[changed]
            head, cut, body = lines[place].rpartition(" ")
            spot = len(body) // 2
            body = body[:spot] + ("A" if body[spot] != "A" else "B") + body[spot + 1 :]
            text = "\n".join([*lines[:place], head + cut + body, *lines[place + 1 :]])
        changes.append(text != answer.text())

        route.fulfill(response=answer, body=text)

    address = f"{issuer}/console/trail/entries/3/{'line' if changed == 'line' else 'proof'}"
    page.route(address, other)
    page.goto(f"{issuer}/console/trail/entries/3")
    page.wait_for_function("() => document.querySelector('#proof').dataset.result")
    page.unroute(address)
    assert changes == [True]
    assert page.inner_text(".verdict").startswith("The proof does not hold"), changed
    assert page.locator("#proof li.fails").count() > 0


HOSTILE = "<img src=x onerror=document.title='taken'>"


@pytest.fixture(scope="module")
def shown():
    """A real picture of a motion near a person, among 500 more bodies, one with a hostile name."""
    seen = Situation(CELL, with_person(0.55), 0.05, None, NOTHING)
    found = assess(ROBOT, seen.scene, sweep(), CELL, perception_age_s=0.05, touch=NOTHING, seed=SEED)
    drawn = wire.read(shown_text(ROBOT, seen, sweep(), found))
    place = [(400_000 + 9_000 * k, 700_000 - 2_500 * k, 40_000 * (k % 20)) for k in range(500)]
    more = (wire.ShownBody("rigid", HOSTILE if k == 0 else f"ball-{k}", place[k], radius_um=15_000) for k in range(500))
    return wire.write(structs.replace(drawn, bodies=(*drawn.bodies, *more)))


def asked(cell, text, **changes):
    """The id of an ask about a motion, which the provider took with this picture."""
    stated = {"picture_digest": wire.digest_of(text)} | changes
    answer = cell.post(PEP, "/approvals", {"ask": cell.text(**stated), "picture": text})
    assert answer.status_code == 201, answer.text
    return answer.json()["ask_id"]


def replayed(page, issuer, ask_id):
    """Words of the page of that request about its picture."""
    page.goto(f"{issuer}/console/trail/requests/{ask_id}")
    page.wait_for_function("() => document.querySelector('.pictured').dataset.result", timeout=20_000)
    return page.inner_text(".pictured .verdict")


@pytest.mark.clause("CON-8")
def test_a_motion_is_replayed_from_its_record(cell, story, shown, page, axe):
    issuer, ask_id = cell.world.issuer, asked(cell, shown)
    page.faults.clear()
    told = replayed(page, issuer, ask_id)
    assert told.startswith("Checked in this browser before it was drawn"), told
    number = page.locator(".pictured").get_attribute("data-number")
    assert told.endswith(f"entry {number}.") and wire.digest_of(shown) in page.inner_text(".pictured")
    assert "person-7, 0.25 m/s" in page.inner_text(".sentence")
    slider = page.locator("[data-time]")
    last = int(slider.get_attribute("max"))
    assert last == len(wire.read(shown).postures) - 1 > 8
    slider.focus()
    page.keyboard.press("End")
    assert slider.input_value() == str(last)
    at_end = page.inner_text("[data-told]")
    page.get_by_role("button", name="Play").focus()
    page.keyboard.press("Enter")
    page.wait_for_function("told => document.querySelector('[data-told]').textContent !== told", arg=at_end)
    page.get_by_role("button", name="Pause").click()
    assert page.title() != "taken" and page.locator(".pictured img").count() == 0
    looked_at(page, "replay", axe)
    assert page.faults == []


@pytest.mark.clause("CON-8")
@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ("picture", "not the one whose digest stands in the record"),
        ("large", "larger than any picture"),
        ("gone", "no longer kept"),
        ("line", "the record stands in the ledger does not hold"),
        ("entry", "not the one whose digest stands in the record"),
    ],
)
def test_nothing_unbound_is_drawn(cell, story, shown, page, changed, says):
    """On the way to an honest page, at the provider, or by the page itself."""
    issuer, ask_id = cell.world.issuer, asked(cell, shown)
    changes = {
        "picture": lambda text: text.replace('"name":"ball-1"', '"name":"ball-x"'),
        "large": lambda text: text + " " * wire.PICTURE_BYTES,
        "line": lambda text: text.replace('"agent":"mover"', '"agent":"mouer"', 1),
    }
    done = []

    def other(route):
        answer = route.fetch()
        text = changes[changed](answer.text())
        done.append(text != answer.text())
        route.fulfill(response=answer, body=text)

    def misled(route):
        """The page names the entry of another ask, whose proof holds."""
        answer = route.fetch()
        own = page_number(cell, ask_id)
        text = answer.text().replace(f"entries/{own}/", f"entries/{own - 1}/")
        text = text.replace(f'data-number="{own}"', f'data-number="{own - 1}"')
        done.append(text != answer.text())
        route.fulfill(response=answer, body=text)

    if changed == "gone":
        cell.world.sql(f"DELETE FROM pictures WHERE digest = '{wire.digest_of(shown)}'")
    elif changed == "entry":
        page.route("**/console/trail/requests/*", misled)
    else:
        page.route("**/console/trail/entries/*/line" if changed == "line" else "**/console/trail/pictures/*", other)
    told = replayed(page, issuer, ask_id)
    page.unroute_all()
    assert done == ([] if changed == "gone" else [True])
    assert told.startswith("Nothing is drawn") and says in told, told
    assert page.locator(".pictured canvas").count() == 0
    assert not page.locator(".pictured .controls").is_visible()


@pytest.mark.clause("CON-9")
@pytest.mark.parametrize("changed", ["nothing", "picture", "request", "awaited"])
def test_a_motion_that_nobody_was_asked_about_is_drawn_from_its_own_record(cell, story, shown, page, changed):
    """Or not at all: where its picture is another one, the record is about another request, or nothing came yet."""
    world, (_, hop, _), journal = cell.world, story, cell.journal
    text = wire.write(structs.replace(wire.read(shown), omitted=1 + len(journal.made)))
    request, other = journal.acted(hop.token), journal.acted(hop.token)
    journal.pictured(request, text)
    journal.ship()
    if changed != "awaited":
        assert cell.post(PEP, "/ledger/pictures", {"picture": text}).status_code == 201

    def misled(route):
        """The page of another request names this one's record, whose proof holds."""
        answer = route.fetch()
        route.fulfill(response=answer, body=answer.text().replace(request.request_id, other.request_id))

    if changed == "picture":
        page.route("**/console/trail/pictures/*", lambda route: route.fulfill(body=shown))
    elif changed == "request":
        page.route("**/console/trail/requests/*", misled)
    told = replayed(page, world.issuer, request.request_id)
    page.unroute_all()
    says = {"nothing": "Checked in this browser", "awaited": "Nothing is drawn yet"}.get(
        changed, "not the one whose digest"
    )
    assert says in told, told
    assert page.locator(".pictured canvas").count() == (changed == "nothing")


def page_number(cell, ask_id):
    return cell.world.sql(f"SELECT seq FROM ledger_index WHERE request = '{ask_id}'")[0][0]


@pytest.mark.clause("CON-8")
def test_a_record_without_a_picture_says_so(cell, story, page):
    issuer, (_, _, done) = cell.world.issuer, story
    page.goto(f"{issuer}/console/trail/requests/{done.request_id}")
    assert "No picture stands in the record." in page.inner_text("main")
    assert page.locator("script[src*=viewer]").count() == 0, "what draws is loaded only where there is a picture"
    unpictured, _ = cell.taken()
    page.goto(f"{issuer}/console/trail/requests/{unpictured}")
    assert "The ask names no picture" in page.inner_text(".pictured")
