"""Page of a running cell in a real browser, with hostile names everywhere: nothing runs, nothing is wider."""

import secrets
from dataclasses import replace

import pytest
from tests import browsing
from tests.browsing import CHROMIUM, SCREEN, TELEPHONE
from tests.e2e.live.test_live_page import DRAWS, says
from tests.ztpm.status.test_status import PICTURE, serving
from ztpm.base.loopback import free_host
from ztpm.status.decisions import Decided, OpenAsk
from ztpm.status.picture import Known, Part, Told

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.timeout(120),
    pytest.mark.clause("LIV-1", "LIV-3"),
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]
SCRIPT = "<img src=x onerror=\"window.ran=1\"><script>window.ran=1</script><svg onload='window.ran=1'>{{7*7}}${7*7}"
NAMES = {
    "script": SCRIPT,
    "breaks out": "'\"></p></div><script>window.ran=1</script>\u2028\n\x00\x1b[2J",
    "long": "x" * 10_000,
    "bidi": "mover\u202e\u2066\u202d\u200f" + "\u0627" * 40,
    "look-alike": "m\u043ever-\u0430gent",
    "wide": "\ufdfd" * 60 + "\U0001f9d1" * 60,
    "marks": "m" + "\u0301" * 500,
}


def hostile(name):
    """A picture in which every text that others choose is this one."""
    return replace(
        PICTURE,
        data=name,
        parts=(Part(name, 1, answers=None, up_s=1, restarts=0),),
        robot=PICTURE.robot
        | {"latch": {"latched": True, "latch_id": name, "cause": name, "reason": name, "approvers": 2, "person": name}},
        perception=PICTURE.perception
        | {
            "fault": name,
            "sensors": [name],
            "seen": [{"sensor": name, "age_ms": 30, "people": [name], "objects": [{"id": name, "kind": name}]}],
        },
        decisions=(Decided(10**12, name, name, name, "DENY", name, 3, name, (name,)),),
        asks=(OpenAsk(name, name, name, name, 3, 10**12),),
        agents=(Known(name, 1),),
        incomplete=(name,),
        story=(Told(name, name, name, name, 3, False),),
    )


@pytest.fixture(scope="module")
def served():
    with serving(8890, host=free_host(secrets.token_bytes(8), lambda _: True)) as served:
        at, longest = [0.5, 0, 0.5], "x" * 256  # of a sensor's words only ASCII names come as far
        served.gateway.bodies = [
            {"kind": kind, "name": longest, "tier": None, "told": longest, "a": at, "b": at, "r": 0.2}
            for kind in ("person", "fragile")
        ]
        yield served


@pytest.fixture(scope="module")
def page():
    with browsing.browser_page(args=DRAWS) as opened:
        opened.asked = []
        opened.on("dialog", lambda dialog: opened.asked.append(dialog.message))
        opened.on("request", lambda request: opened.asked.append(request.url))
        yield opened


@pytest.mark.parametrize("what", NAMES)
def test_nothing_of_it_runs_and_nothing_is_wider_than_the_screen(served, page, what):
    served.picture = hostile(NAMES[what])
    served.gateway.parts = [{"kind": "arm", "name": NAMES[what], "r": 0.05}]
    page.set_viewport_size(SCREEN)
    page.goto(served.url)
    says(page, "#told", "The arm stands still.")
    assert page.locator("head script").count() == page.evaluate("document.scripts.length")
    assert page.locator("body :is(img, script, iframe, style)").count() == 0
    page.locator("details").evaluate_all("all => all.forEach((each) => { each.open = true; })")
    for size in (SCREEN, TELEPHONE):
        page.set_viewport_size(size)
        browsing.narrow(page, what, size)
        browsing.picture(page, f"hostile-{what.replace(' ', '-')}-{size['width']}")
    assert (page.evaluate("window.ran"), page.faults) == (None, [])
    assert all(asked.startswith(served.url) for asked in page.asked)
    shown = page.inner_text("main")
    assert "\u202e" not in shown and "\u043e" not in shown
