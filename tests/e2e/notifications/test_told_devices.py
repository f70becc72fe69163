"""A device in headless Chromium is added, told by a push service with no page open, and opens the question."""

from __future__ import annotations

import json

import pytest
from tests.browsing import CHROMIUM, TELEPHONE, browser_page, looked_at, rules, served
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.push.push_service import PushService, opened
from ztpm_idp.push.pushing import Pushing

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.clause("PSH-7"),
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]
WAIT_MS = 20_000
SUBSCRIBED = """form => {
  const made = { endpoint: form.endpoint, toJSON: () => ({ endpoint: form.endpoint, keys: form }) };
  let there = sessionStorage.getItem("subscribed") === "yes";
  PushManager.prototype.subscribe = async (asked) => {
    sessionStorage.setItem("asked", JSON.stringify(asked));
    sessionStorage.setItem("subscribed", "yes");
    there = true;
    return made;
  };
  PushManager.prototype.getSubscription = async () => (there ? made : null);
}"""
"""In place of a browser maker's push service, which no test can reach; all the rest is the browser's own."""


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    made = PushService(tmp_path_factory.mktemp("service"))
    yield made
    made.close()


@pytest.fixture(scope="module")
def cell(tmp_path_factory, service):
    with served(tmp_path_factory.mktemp("browser"), web_push=service.stated) as world:
        yield Cell(world)


def test_a_device_is_added_and_told_with_no_page_open_and_its_notification_opens_the_question(cell, service):
    device = service.device()
    origin = cell.world.issuer.removesuffix("/ztpm")
    with browser_page(viewport=TELEPHONE) as page:
        page.context.grant_permissions(["notifications"], origin=origin)
        page.context.add_init_script(f"({SUBSCRIBED})({json.dumps(device.form)})")
        page.goto(f"{cell.world.issuer}/approvals/page")
        page.goto(cell.world.people["carol"].login_link())
        page.get_by_role("button").first.click()
        page.wait_for_url("**/approvals/page")
        page.get_by_role("button", name="Notify this device").click()
        page.wait_for_selector("[data-device]", timeout=WAIT_MS)
        page.wait_for_selector("#device", state="hidden", timeout=WAIT_MS)
        assert "127.0.0.1" in page.locator("[data-device]").inner_text()
        assert "(this device)" in page.locator("[data-device]").inner_text()
        assert json.loads(page.evaluate("sessionStorage.getItem('asked')"))["userVisibleOnly"] is True
        looked_at(page, "told-devices", rules())
        assert page.faults == []

        # The worker runs without its page.
        (worker,) = page.context.service_workers
        control = page.context.new_cdp_session(page)
        page.goto("about:blank")
        ask_id, _ = cell.taken()
        cell.world.on_loop(told(cell, service))
        (post,) = service.all()
        text = opened(post.raw, device.key, device.secret).decode()
        deliver(control, worker, origin, text)
        worker.evaluate("clients.openWindow = (url) => { self.opened = url; }")
        shown = worker.evaluate(
            """async () => {
              for (let n = 0; n < 200; n += 1) {
                const [note] = await registration.getNotifications();
                if (note) return { title: note.title, body: note.body, tag: note.tag };
                await new Promise((later) => setTimeout(later, 50));
              }
            }"""
        )
        assert (shown["title"], shown["tag"]) == ("Tier 3: a question waits", ask_id)
        pressed = """async () => {
          const [notification] = await registration.getNotifications();
          dispatchEvent(new NotificationEvent("notificationclick", { notification }));
          return [self.opened, (await registration.getNotifications()).length];
        }"""
        assert worker.evaluate(pressed) == [f"{cell.world.issuer}/approvals/{ask_id}/page", 0]

        # Nothing but a page of the provider is opened.
        deliver(
            control, worker, origin, json.dumps({"title": "t", "body": "b", "tag": "x", "url": "https://evil.example/"})
        )
        worker.evaluate("async () => { while (!(await registration.getNotifications()).length); self.opened = null; }")
        assert worker.evaluate(pressed) == [None, 0]

        page.goto(f"{cell.world.issuer}/approvals/page")
        page.get_by_role("button", name="Remove").click()
        page.wait_for_selector("#device", timeout=WAIT_MS)
        assert page.locator("[data-device]").count() == 0
        assert cell.world.rows("push_subscriptions") == []


async def told(cell, service):
    works = Pushing(cell.world.provider, (), web_push=service.web_push)
    await works.look()
    await works.settled()


def deliver(control, worker, origin, text):
    """Hands a message to the worker, as the browser does when its push service has one."""
    registrations = []
    control.on("ServiceWorker.workerRegistrationUpdated", lambda event: registrations.extend(event["registrations"]))
    control.send("ServiceWorker.enable")
    for _ in range(200):
        found = [each for each in registrations if worker.url.startswith(each["scopeURL"])]
        if found:
            break
        worker.evaluate("new Promise((later) => setTimeout(later, 20))")
    control.send(
        "ServiceWorker.deliverPushMessage",
        {"origin": f"{origin}/", "registrationId": found[0]["registrationId"], "data": text},
    )
    control.send("ServiceWorker.disable")
