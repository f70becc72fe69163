"""Questions are pushed to real receivers: once each, in the form of each service, and never at an ask's cost."""

from __future__ import annotations

import asyncio
import json
import logging
import time

import pytest
from capabilities.values.arguments import Argument
from capabilities.values.scope import Tier
from capabilities.values.units import Quantity, Sort, Unit
from tests.ztpm_idp.asks import AGENT, PEP, Cell
from tests.ztpm_idp.push.receiver import HANG, Receiver
from tests.ztpm_idp.routes.test_latches import clear
from tests.ztpm_idp.routes.test_latches import taken as fallen
from tests.ztpm_idp.world import ISSUER, World
from ztpm_idp.domain.asking.pushes import LATCH_PAUSES_S, MINUTE_MS, PAUSES_S, TURN_MS
from ztpm_idp.provider.metrics import Metrics
from ztpm_idp.push import pushing as pushing_module
from ztpm_idp.push.pushing import Pushing
from ztpm_idp.store import Store
from ztpm_idp.store.push.pushes import MEMORY_MS
from ztpm_idp.webhook_settings import Webhook, WebhookSettings

from ztpm_idp.provider.provider import Provider

pytestmark = pytest.mark.clause("PSH-1", "PSH-2", "PSH-3", "PSH-4")
LINK = f"{ISSUER}/approvals/{{}}/page"
PEOPLE = ("alice", "carol", "person-7")
"""The sponsor, an approver, and a person in view."""
HOSTILE = "<!channel> [ok](https://evil.example) <https://evil.example|ok>"


@pytest.fixture
def cell(world):
    return Cell(world)


@pytest.fixture
def receivers():
    made = []

    def make(*answers, **how):
        made.append(Receiver(*answers, **how))
        return made[-1]

    yield make
    for each in made:
        each.close()


def hook(url, form="json", *, name="cell", authorities=None, **stated):
    return Webhook(WebhookSettings(name=name, form=form, url_variable="HOOK", **stated), url, authorities)


def pushing(world, *hooks, patience_s=5.0, **more):
    return Pushing(world.provider, hooks, patience_s=patience_s, **more)


def look(world, *all_pushing):
    """Each looks at the same time; all that they send has ended."""

    async def go():
        await asyncio.gather(*(each.look() for each in all_pushing))
        await asyncio.gather(*(each.settled() for each in all_pushing))

    world.on_loop(go())


def later(world, seconds):
    world.clock.at_s += seconds


def failures(cell):
    return [entry["body"] for entry in cell.ledger() if entry["kind"] == "push-failed"]


# --- what is sent ------------------------------------------------------------------------------------------------------


def test_each_service_is_told_once_in_its_own_form_and_of_nobody(cell, receivers):
    forms = ("slack", "teams", "ntfy", "json")
    at = {form: receivers() for form in forms}
    paths = {"ntfy": "/t0pic?auth=QmVhcmVy"}
    hooks = [hook(at[form].url(paths.get(form, "/hook/s3cret")), form, name=form) for form in forms]
    ask_id, _ = cell.taken(tier=Tier(3))
    works = pushing(cell.world, *hooks)
    look(cell.world, works)
    look(cell.world, works)
    posts = {form: receiver.all() for form, receiver in at.items()}
    assert {form: len(found) for form, found in posts.items()} == dict.fromkeys(forms, 1)
    sent = {form: found[0] for form, found in posts.items()}
    link = LINK.format(ask_id)

    slack = sent["slack"].body
    assert slack.keys() == {"text", "blocks", "unfurl_links", "unfurl_media"}
    assert (slack["unfurl_links"], slack["unfurl_media"]) == (False, False)
    assert slack["text"].endswith(f" <{link}|Read and answer>")
    assert [(b["type"], b["text"]["type"]) for b in slack["blocks"]] == [
        ("section", "plain_text"),
        ("section", "mrkdwn"),
    ]

    teams = sent["teams"].body
    (card,) = teams["attachments"]
    assert (teams["type"], card["contentType"]) == ("message", "application/vnd.microsoft.card.adaptive")
    assert (card["content"]["type"], card["content"]["version"]) == ("AdaptiveCard", "1.2")
    assert card["content"]["actions"] == [{"type": "Action.OpenUrl", "title": "Read and answer", "url": link}]

    ntfy = sent["ntfy"].body
    assert sent["ntfy"].path == "/?auth=QmVhcmVy"
    assert (ntfy["topic"], ntfy["priority"], ntfy["click"]) == ("t0pic", 4, link)
    assert ntfy["actions"] == [{"action": "view", "label": "Read and answer", "url": link, "clear": True}]
    assert len(ntfy["message"].encode()) <= 4_096

    plain = sent["json"].body
    assert (plain["kind"], plain["event"], plain["ask_id"], plain["url"]) == ("ztpm.question/1", "opened", ask_id, link)
    assert (plain["tier"], plain["approvers"], plain["state"], plain["details"]) == (3, 1, "open", [])

    for form, post in sent.items():
        assert post.headers["content-type"] == "application/json", form
        assert "tier 3, high consequence" in post.raw.decode(), form
        assert len(post.raw) < 4_096, form
        for word in (*PEOPLE, AGENT, "move_joint", "523599", "-1570796", "authorization"):
            assert word not in json.dumps([post.body, post.headers]), (form, word)


def test_details_are_sent_where_they_are_switched_on_and_call_nobody(cell, receivers):
    forms = ("slack", "teams", "ntfy", "json")
    at = {form: receivers() for form in forms}
    values = (
        Argument("label", Sort.TEXT, HOSTILE),
        *(Quantity(f"q{n}", Unit.MICRORADIAN, 1_570_796) for n in range(20)),
    )
    cell.taken(values=values)
    look(cell.world, pushing(cell.world, *(hook(at[f].url("/t"), f, name=f, details=True) for f in forms)))
    posts = {form: receiver.all()[0] for form, receiver in at.items()}
    for form, post in posts.items():
        text = json.dumps(post.body, ensure_ascii=False)
        assert f"agent {AGENT}" in text, form
        assert "q10 = ≈ 90.00°" in text, form
        assert "q11" not in text, form
        assert "and 9 more" in text, form
        assert not any(name in text for name in PEOPLE), form
    slack = posts["slack"].body
    said = [b["text"] for b in slack["blocks"] if "evil" in b["text"]["text"]]
    assert [each["type"] for each in said] == ["plain_text"]
    assert "evil" not in slack["text"]
    card = posts["teams"].body["attachments"][0]["content"]
    assert {b["type"] for b in card["body"] if "evil" in json.dumps(b)} == {"RichTextBlock"}
    assert "markdown" not in posts["ntfy"].body


def test_an_end_is_told_to_those_who_want_it_and_were_told_of_the_beginning(cell, receivers):
    wants, does_not = receivers(), receivers()
    works = pushing(cell.world, hook(wants.url(), name="a", ends=True), hook(does_not.url(), name="b"))
    ask_id, text = cell.taken()
    look(cell.world, works)
    cell.world.people["carol"].deny(ask_id)
    unseen, _ = cell.taken()
    cell.world.people["carol"].deny(unseen)
    look(cell.world, works)
    look(cell.world, works)
    assert [(p.body["event"], p.body["state"], p.body["ask_id"]) for p in wants.all()] == [
        ("opened", "open", ask_id),
        ("ended", "denied", ask_id),
    ]
    assert [p.body["event"] for p in does_not.all()] == ["opened"]


@pytest.mark.clause("PSH-6")
def test_a_latched_robot_is_told_once_with_its_name_and_its_end_to_those_who_want_it(cell, receivers):
    forms = ("slack", "teams", "ntfy", "json")
    at = {form: receivers() for form in forms}
    works = pushing(cell.world, *(hook(at[f].url("/t"), f, name=f, ends=f == "json") for f in forms))
    latch_id, text = fallen(cell, robot="ur3e")
    link, waits = f"{ISSUER}/latches/{latch_id}/page", "The robot ur3e at cell-1 has stopped and waits for a person."
    look(cell.world, works)
    look(cell.world, works)
    posts = {form: receiver.all() for form, receiver in at.items()}
    assert {form: len(found) for form, found in posts.items()} == dict.fromkeys(forms, 1)
    sent = {form: found[0] for form, found in posts.items()}
    for form, post in sent.items():
        assert waits in post.raw.decode(), form
        assert link in post.raw.decode(), form
        for word in (*PEOPLE, AGENT, "IMPACT_ROSE", "watch"):
            assert word not in post.raw.decode(), (form, word)
    assert [b["text"]["type"] for b in sent["slack"].body["blocks"]] == ["plain_text", "mrkdwn"]
    assert sent["ntfy"].body["title"] == "A robot waits"
    told = sent["json"].body
    assert (told["kind"], told["event"], told["latch_id"], told["url"]) == ("ztpm.latch/1", "opened", latch_id, link)
    assert (told["state"], told["approvers"], told["robot"], told["details"]) == ("waits", 1, "ur3e", [])
    assert clear(cell, latch_id, text).json()["state"] == "released"
    look(cell.world, works)
    look(cell.world, works)
    assert {form: len(receiver.all()) for form, receiver in at.items() if form != "json"} == {
        "slack": 0, "teams": 0, "ntfy": 0,
    }  # fmt: skip
    assert [(p.body["event"], p.body["state"], p.body["text"]) for p in at["json"].all()] == [
        ("ended", "released", "The robot ur3e at cell-1 was cleared.")
    ]


@pytest.mark.clause("PSH-6")
def test_a_latch_is_told_once_however_long_it_waits_and_again_where_a_cleared_one_is_told_of_again(cell, receivers):
    at = receivers((200, {}), (200, {}), (500, {}))
    works = pushing(cell.world, hook(at.url(), ends=True, details=True))
    latch_id, text = fallen(cell)
    look(cell.world, works)
    assert at.all()[0].body["details"][:2] == ["cause watch", "reason IMPACT_ROSE"]
    later(cell.world, 2 * MEMORY_MS / 1_000)
    cell.taken()  # the next look keeps something, and forgets what is old
    look(cell.world, works)
    look(cell.world, works)
    assert [post.body["kind"] for post in at.all()] == ["ztpm.question/1"]
    assert clear(cell, latch_id, text).json()["state"] == "released"
    look(cell.world, works)  # it is not taken now
    later(cell.world, PAUSES_S[0])
    look(cell.world, works)
    # The robot did not take the clearing while it counted, and says so.
    later(cell.world, 301)
    assert cell.post(PEP, "/latches", {"latch": text}).status_code == 201
    look(cell.world, works)
    look(cell.world, works)
    assert [post.body["event"] for post in at.all()] == ["ended", "ended", "opened"]


@pytest.mark.clause("PSH-6")
def test_questions_in_any_number_delay_no_latch(tmp_path, receivers):
    at = receivers()
    with World(tmp_path, settings_changes={"asks_a_minute": 1}) as world:
        cell = Cell(world)
        works = pushing(world, hook(at.url()))
        for _ in range(2):
            cell.taken()
        fallen(cell)
        for _ in range(3):
            look(world, works)
        assert {post.body["kind"] for post in at.all()} == {"ztpm.latch/1", "ztpm.question/1"}


@pytest.mark.clause("PSH-6")
def test_a_latch_is_tried_for_an_hour_and_then_given_up_on_record(cell, receivers):
    at = receivers(*[(500, {})] * (len(LATCH_PAUSES_S) + 3))
    works = pushing(cell.world, hook(at.url()))
    latch_id, _ = fallen(cell)
    for pause_s in (*LATCH_PAUSES_S, 600):
        look(cell.world, works)
        later(cell.world, pause_s)
    tries = len(LATCH_PAUSES_S) + 1
    assert len(at.all()) == tries
    assert failures(cell) == [
        {"latch_id": latch_id, "webhook": "cell", "event": "opened", "code": "PUSH_NOT_TAKEN", "tries": tries}
    ]


# --- once ---------------------------------------------------------------------------------------------------------------


def test_several_workers_on_one_database_push_each_question_once(cell, receivers):
    world, at = cell.world, receivers()
    stores = [world.on_loop(Store.open(world.settings.database_url)) for _ in range(3)]
    try:
        workers = [
            Pushing(
                Provider(
                    world.settings, world.idp_keys, store, world.clock,
                    platform=None, policies=world.provider.rules.policies,
                ),
                [hook(at.url())],
            )
            for store in stores
        ]  # fmt: skip
        asked = {cell.taken()[0] for _ in range(6)}
        for _ in range(3):
            look(world, *workers)
        posts = [post.body["ask_id"] for post in at.all()]
    finally:
        for store in stores:
            world.on_loop(store.close())
    assert sorted(posts) == sorted(asked)


def test_what_a_worker_that_died_had_in_hand_is_sent_by_another_after_its_turn(cell, receivers):
    first, at = receivers(HANG), receivers()
    dies = pushing(cell.world, hook(first.url()), patience_s=30)

    async def die():
        await dies.look()
        for task in dies._under_way:
            task.cancel()
        await dies.settled()

    ask_id, _ = cell.taken()
    cell.world.on_loop(die())
    other = pushing(cell.world, hook(at.url()))
    look(cell.world, other)
    assert at.all() == []
    later(cell.world, TURN_MS / 1_000)
    look(cell.world, other)
    assert [post.body["ask_id"] for post in at.all()] == [ask_id]


def test_a_restart_forgets_no_question(tmp_path, receivers):
    at = receivers((500, {}))
    with World(tmp_path) as world:
        cell = Cell(world)
        ask_id, _ = cell.taken()
        look(world, pushing(world, hook(at.url())))
        world.stop()
        world.start()
        later(world, PAUSES_S[0])
        look(world, pushing(world, hook(at.url())))
        assert [post.body["ask_id"] for post in at.all()] == [ask_id, ask_id]
        look(world, pushing(world, hook(at.url())))
        assert at.all() == []


# --- what goes wrong -----------------------------------------------------------------------------------------------------


def test_a_receiver_that_hangs_delays_no_ask_and_is_tried_again(cell, receivers):
    at = receivers(HANG)
    works = pushing(cell.world, hook(at.url()), patience_s=0.2)
    first, _ = cell.taken()

    async def begin():
        await works.look()

    cell.world.on_loop(begin())
    began = time.perf_counter()
    cell.taken()
    assert time.perf_counter() - began < 2.0  # the request under way holds nothing that an ask needs
    cell.world.on_loop(works.settled())
    assert {row["code"] for row in cell.world.rows("pushes")} == {"PUSH_UNREACHABLE"}
    later(cell.world, PAUSES_S[0])
    look(cell.world, works)
    assert [post.body["ask_id"] for post in at.all()].count(first) == 2
    assert {(row["code"], bool(row["done"])) for row in cell.world.rows("pushes")} == {("", True)}
    assert failures(cell) == []


def test_no_redirect_is_followed(cell, receivers):
    elsewhere = receivers()
    for status in (301, 302, 303, 307, 308):
        at = receivers((status, {"location": elsewhere.url()}))
        look(cell.world, pushing(cell.world, hook(at.url(), name=f"to-{status}")))
        cell.taken()
        look(cell.world, pushing(cell.world, hook(at.url(), name=f"to-{status}")))
        assert len(at.all()) >= 1, status
    assert elsewhere.all() == []
    assert {entry["code"] for entry in failures(cell)} == {"PUSH_REFUSED"}


@pytest.mark.parametrize(("answer", "pause_s"), [((500, {}), PAUSES_S[0]), ((503, {}), PAUSES_S[0]),
                                                 ((429, {"retry-after": "30"}), 30), ((429, {"retry-after": "9999"}), 60),
                                                 ((408, {"retry-after": "soon"}), PAUSES_S[0])])  # fmt: skip
def test_what_is_not_taken_now_is_sent_once_more_after_the_pause(cell, receivers, answer, pause_s):
    at = receivers(answer)
    works = pushing(cell.world, hook(at.url()))
    cell.taken()
    look(cell.world, works)
    later(cell.world, pause_s - 0.1)
    look(cell.world, works)
    assert len(at.all()) == 1
    later(cell.world, 0.1)
    look(cell.world, works)
    look(cell.world, works)
    assert len(at.all()) == 1
    assert failures(cell) == []


def test_an_answer_that_refuses_it_ends_it_and_the_ledger_says_so(cell, receivers):
    at = receivers((404, {}))
    works = pushing(cell.world, hook(at.url()))
    ask_id, _ = cell.taken()
    for _ in range(3):
        look(cell.world, works)
        later(cell.world, 60)
    assert len(at.all()) == 1
    assert failures(cell) == [
        {"ask_id": ask_id, "webhook": "cell", "event": "opened", "code": "PUSH_REFUSED", "tries": 1}
    ]


def test_it_is_given_up_after_the_last_pause(cell, receivers):
    answers = [(500, {})] * (len(PAUSES_S) + 3)
    at = receivers(*answers)
    works = pushing(cell.world, hook(at.url()))
    cell.taken()
    for pause_s in (*PAUSES_S, 120, 120):
        look(cell.world, works)
        later(cell.world, pause_s)
    assert len(at.all()) == len(PAUSES_S) + 1
    assert [(e["code"], e["tries"]) for e in failures(cell)] == [("PUSH_NOT_TAKEN", len(PAUSES_S) + 1)]


def test_it_is_given_up_with_its_question(cell, receivers):
    at = receivers((500, {}))
    works = pushing(cell.world, hook(at.url()))
    ask_id, _ = cell.taken()
    look(cell.world, works)
    cell.world.people["carol"].deny(ask_id)
    later(cell.world, PAUSES_S[0])
    look(cell.world, works)
    look(cell.world, works)
    assert len(at.all()) == 1
    assert [(e["ask_id"], e["code"]) for e in failures(cell)] == [(ask_id, "PUSH_NOT_TAKEN")]


def test_nobody_is_told_of_more_questions_in_a_minute_than_one_person_reads(tmp_path, receivers, caplog):
    at = receivers()
    with World(tmp_path, settings_changes={"asks_a_minute": 2}) as world:
        cell, metrics = Cell(world), Metrics(time.perf_counter)
        world.person("erin", "approver")
        world.person("frank", "approver")
        works = pushing(world, hook(at.url()), metrics=metrics)
        asked = list[str]()
        for _ in range(5):
            asked.append(cell.taken()[0])
            later(world, 1)
        for _ in range(3):
            look(world, works)
        assert {post.body["ask_id"] for post in at.all()} == set(asked[:2])
        assert caplog.text.count("PUSH_OVER_BUDGET") == 3
        later(world, MINUTE_MS / 1_000)
        look(world, works)
        assert {post.body["ask_id"] for post in at.all()} == set(asked[2:4])
        world.people["carol"].deny(asked[4])
        later(world, MINUTE_MS / 1_000)
        look(world, works)
        assert at.all() == []
        assert [(e["ask_id"], e["code"], e["tries"]) for e in failures(cell)] == [(asked[4], "PUSH_OVER_BUDGET", 0)]
        counted = {s.labels["outcome"]: s.value for m in metrics.registry.collect() for s in m.samples
                   if s.name == "ztpm_pushes_total"}  # fmt: skip
        assert counted == {"taken": 4, "PUSH_OVER_BUDGET": 3}


def test_an_address_is_told_nowhere(cell, receivers, caplog):
    caplog.set_level(logging.DEBUG)
    taken, refuses = receivers(), receivers((404, {}), (500, {}))
    hooks = hook(taken.url(), name="a"), hook(refuses.url(), name="b"), hook("http://127.0.0.1:9/hook/s3cret", name="c")

    cell.taken()
    look(cell.world, pushing(cell.world, *hooks))
    assert len(taken.all()) == 1
    assert "PUSH_UNREACHABLE" in caplog.text
    assert "PUSH_REFUSED" in caplog.text
    for text in (caplog.text, repr(hooks), str(cell.ledger()), str(cell.world.rows("pushes"))):
        assert "s3cret" not in text


def test_a_provider_pushes_by_itself_what_it_takes_and_at_once(tmp_path, receivers, monkeypatch):
    monkeypatch.setattr(pushing_module, "PERIOD_S", 60.0)
    at = receivers()
    with World(tmp_path, webhooks=(hook(at.url()),)) as world:
        ask_id, _ = Cell(world).taken()
        assert at.posts.get(timeout=20).body["ask_id"] == ask_id
