"""Devices are told by a real push service, and no more once their session is over."""

from __future__ import annotations

import asyncio

import pytest
from tests.ztpm_idp.asks import AGENT, Cell
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.push.push_service import PushService
from tests.ztpm_idp.push.test_pushing import PEOPLE, failures, later, look, pushing
from tests.ztpm_idp.routes.test_latches import taken as fallen
from tests.ztpm_idp.world import ISSUER, World
from ztpm_idp.domain.asking.pushes import PAUSES_S, PushCode
from ztpm_idp.domain.asking.subscriptions import OF_A_PERSON
from ztpm_idp.outward import pinned
from ztpm_idp.provider.ask_page import time_of
from ztpm_idp.push.devices import LATCH_S
from ztpm_idp.push.sending import post
from ztpm_idp.web_push_settings import ServicePlace

pytestmark = pytest.mark.clause("PSH-7", "PSH-8")
PAGE, ADD, END = (f"/ztpm/approvals/page{each}" for each in ("", "/devices", "/devices/end"))


@pytest.fixture
def service(tmp_path):
    made = PushService(tmp_path)
    yield made
    made.close()


@pytest.fixture
def cell(tmp_path, service):
    with World(tmp_path, settings_changes={"web_push": service.stated}) as world:
        yield Cell(world)


def logged_in(cell, person="carol"):
    browser = Browser(cell.world)
    browser.log_in(cell.world.people[person])
    return browser


def added(browser, device, **changes):
    browser.get(PAGE)
    return browser.post(ADD, device.form | changes)


def works(cell, service, **more):
    return pushing(cell.world, web_push=service.web_push, **more)


def test_a_device_is_told_once_of_each_and_its_push_service_learns_no_word(cell, service):
    browser, device = logged_in(cell), service.device()
    assert added(browser, device).status_code == 201
    telling = works(cell, service)
    ask_id, _ = cell.taken()
    look(cell.world, telling)
    look(cell.world, telling)
    (post,) = service.all()
    now = cell.now
    assert device.told(post) == {
        "title": "Tier 3: a question waits",
        "body": f"A question waits: tier 3, high consequence. Nothing moves unless 1 person approves until {time_of(now + 600)}.",
        "url": f"{ISSUER}/approvals/{ask_id}/page",
        "tag": ask_id,
    }
    assert service.sender(post, at_s=now) in browser.get(PAGE).text
    assert post.path == "/push/one"
    headers = {name: post.headers[name] for name in ("content-encoding", "ttl", "urgency")}
    assert headers == {"content-encoding": "aes128gcm", "ttl": "600", "urgency": "high"}
    for word in (*PEOPLE, AGENT, ask_id, "move_joint", "ur3e", "question", "tier"):
        assert word not in str(post.headers)
        assert word.encode() not in post.raw
    latch_id, _ = fallen(cell)
    look(cell.world, telling)
    (second,) = service.all()
    told = device.told(second)
    assert (told["url"], told["tag"]) == (f"{ISSUER}/latches/{latch_id}/page", latch_id)
    assert told["body"] == "The robot ur3e at cell-1 has stopped and waits for a person."
    assert second.headers["ttl"] == str(LATCH_S)
    assert len(second.raw) == len(post.raw)
    assert service.sender(second, at_s=now) == service.sender(post, at_s=now)
    assert failures(cell) == []


@pytest.mark.parametrize(
    ("status", "stays", "tries"), [(404, 0, 1), (410, 0, 1), (400, 1, 1), (503, 1, 2), (429, 1, 2)]
)
def test_a_service_that_knows_it_no_more_ends_it_and_one_that_is_busy_is_asked_again(
    tmp_path, status, stays, tries, caplog
):
    caplog.set_level("DEBUG")
    service = PushService(tmp_path, (status, {}))
    try:
        with World(tmp_path, settings_changes={"web_push": service.stated}) as world:
            cell = Cell(world)
            assert added(logged_in(cell), service.device()).status_code == 201
            telling = works(cell, service)
            cell.taken()
            look(world, telling)
            later(world, PAUSES_S[0])
            look(world, telling)
            assert len(service.all()) == tries
            assert len(world.rows("push_subscriptions")) == stays
            assert [each["code"] for each in failures(cell)] == (["PUSH_REFUSED"] if tries == 1 else [])
            assert "push to @" in caplog.text
            for text in (caplog.text, str(cell.ledger()), str(world.rows("pushes"))):
                assert "/push/one" not in text  # its address is told nowhere
    finally:
        service.close()


@pytest.mark.parametrize("end", ["log out", "leave", "remove", "time"])
def test_a_device_is_told_no_more_once_its_person_or_session_is_gone(cell, service, end):
    browser, device = logged_in(cell), service.device()
    assert added(browser, device).status_code == 201
    telling = works(cell, service)
    match end:
        case "log out":
            browser.get("/ztpm/login/account")
            assert browser.post("/ztpm/login/end").status_code == 303
        case "leave":
            cell.world.end("carol")
        case "remove":
            name = cell.world.rows("push_subscriptions")[0]["subscription_id"]
            # Another person cannot.
            other = logged_in(cell, "alice")
            other.get(PAGE)
            other.post(END, {"device": name})
            assert len(cell.world.rows("push_subscriptions")) == 1
            assert name in browser.get(PAGE).text
            assert browser.post(END, {"device": name}).status_code == 303
            assert name not in browser.get(PAGE).text
        case "time":
            later(cell.world, 12 * 3_600)
            fallen(cell)
    if end != "time":
        cell.taken()
    look(cell.world, telling)
    assert service.all() == []


def test_a_silent_session_does_not_end_it(cell, service):
    """A person with a telephone in the pocket makes no requests."""
    assert added(logged_in(cell), service.device()).status_code == 201
    later(cell.world, 3_600)
    fallen(cell)
    look(cell.world, works(cell, service))
    assert len(service.all()) == 1


def test_a_person_has_few_devices_and_the_same_one_once(cell, service):
    browser = logged_in(cell)
    for number in range(OF_A_PERSON):
        assert added(browser, service.device(str(number))).status_code == 201
    assert added(browser, service.device("0")).status_code == 201
    refused = added(browser, service.device("more"))
    assert (refused.status_code, refused.json()["code"]) == (429, "DEVICES_SPENT")
    assert added(logged_in(cell, "alice"), service.device("more")).status_code == 201
    assert len(cell.world.rows("push_subscriptions")) == OF_A_PERSON + 1


def test_what_is_no_subscription_at_an_allowed_service_is_refused(cell, service):
    browser, device = logged_in(cell), service.device()
    for changes in (
        {"endpoint": "https://evil.example/push/one"},
        {"endpoint": "http://fcm.googleapis.com/one"},
        {"p256dh": "AAAA"},
        {"p256dh": device.form["p256dh"][:-1]},
        {"auth": "AAAA"},
    ):
        refused = added(browser, device, **changes)
        assert (refused.status_code, refused.json()["code"]) == (400, "DEVICE_REFUSED"), changes
    browser.get(PAGE)
    assert browser.post(ADD, device.form, **{"sec-fetch-site": "cross-site"}).status_code == 403
    assert cell.world.rows("push_subscriptions") == []


def test_without_the_setting_there_is_no_such_thing(world, service):
    browser = logged_in(Cell(world))
    page = browser.get(PAGE)
    assert "worker.js" not in page.text
    browser.get("/ztpm/login/account")
    refused = browser.post(ADD, service.device().form)
    assert (refused.status_code, refused.json()["code"]) == (404, "PATH_UNKNOWN")


def test_a_service_at_an_address_that_is_not_public_is_never_asked(cell, service):
    """A name of the allow-list that leads into one's own network."""
    device = service.device()
    device.endpoint = "https://fcm.googleapis.com/fcm/send/one"
    assert added(logged_in(cell), device).status_code == 201

    async def inwards(_):
        return ["142.250.1.1", "127.0.0.1"]

    cell.taken()
    look(cell.world, works(cell, service, resolver=inwards))
    assert [each["code"] for each in failures(cell)] == ["PUSH_REFUSED"]
    assert service.all() == []


def test_the_address_that_was_looked_at_is_the_one_that_is_asked():
    async def resolver(host):
        assert host == "fcm.googleapis.com"
        return ["142.250.1.1", "142.250.1.2"]

    target = asyncio.run(pinned("https://fcm.googleapis.com/fcm/send/one?a=b", resolver))
    assert str(target.url) == "https://142.250.1.1/fcm/send/one?a=b"
    assert target.headers == {"Host": "fcm.googleapis.com"}
    assert target.extensions == {"sni_hostname": "fcm.googleapis.com"}


def test_the_certificate_is_that_of_the_name_and_not_of_the_address(tmp_path, monkeypatch):
    monkeypatch.setattr("ztpm_idp.outward.is_public", lambda _: True)
    service = PushService(tmp_path, name="push.example")

    async def here(_):
        return ["127.0.0.1"]

    async def asked(name):
        target = await pinned(f"https://{name}:{service.port}/one", here)
        verify = service.web_push.authorities[ServicePlace.OWN]
        return await post(
            target.url, b"{}", headers=target.headers, verify=verify, extensions=target.extensions, patience_s=5.0
        )

    try:
        assert asyncio.run(asked("push.example")).code is None
        assert asyncio.run(asked("other.example")).code is PushCode.PUSH_UNREACHABLE
        assert [each.headers["host"] for each in service.all()] == [f"push.example:{service.port}"]
    finally:
        service.close()


def test_the_worker_may_stand_before_the_pages_of_questions_and_fetches_nothing(cell):
    browser = logged_in(cell)
    policy = browser.get(PAGE).headers["content-security-policy"]
    assert f"worker-src {ISSUER}/approvals/assets/worker.js;" in policy
    worker = browser.get("/ztpm/approvals/assets/worker.js")
    assert worker.headers["service-worker-allowed"] == "/ztpm/approvals/"
    assert worker.headers["content-security-policy"] == "default-src 'none'"
    assert worker.headers["content-type"].startswith("text/javascript")
