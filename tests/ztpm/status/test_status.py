"""The status page: nothing on it can become markup, and it is served to its owner alone."""

import contextlib
import json
import os
import socket
import time
from dataclasses import replace

import httpx2
import pytest
from policies.evidence.model import ObligationKind
from ztpm.base.peer import owner_of
from ztpm.status.decisions import Decided, Decisions, OpenAsk
from ztpm.status.markup import Markup, tag, text
from pep.base.errors import PepFault, RobotError
from ztpm.cell.addresses import Addresses
from ztpm.status.live_feed import LiveFeed
from ztpm.status.page import SCRIPTS, STYLE, parts_of, render
from ztpm.status.picture import Known, Part, Snapshot, Told
from ztpm.status.server import StatusError, StatusServer
from ztpm.status.stopping import CellStop, StopAnswer

pytestmark = pytest.mark.xdist_group("status page")  # one port
HOST = "127.77.0.11"
EVIL = "<script>alert(1)</script>\"'&\x1b[2J"
PICTURE = Snapshot(
    at_ms=1_700_000_000_000,
    data="/cell",
    issuer="http://127.77.0.11:8700/ztpm",
    audience="http://127.77.0.11:8800/mcp",
    robot_host="127.77.0.12",
    parts=(Part("tool server", 12, answers=True, up_s=75.0, restarts=1), Part("sensor", None, answers=False, up_s=0, restarts=2)),
    robot={"q_rad": [0.0, 1.0, 2.0, 3.0, 4.0, 5.0], "moving": True, "robot_mode": 7, "safety_mode": 1},
    perception={
        "perception": "fresh", "age_ms": 30, "people": 1, "objects": 1, "sensors": ["camera-1", "camera-2"],
        "seen": [{"sensor": "camera-1", "age_ms": 30, "people": ["p1"], "objects": [{"id": "glass-1", "kind": "fragile"}]}],
    },
    view={"epoch": 3, "age_ms": 120},
    decisions=(Decided(1_700_000_000_000, "r1", "mover", "move_joint", "DEFER", "TIER_NEEDS_APPROVAL", 3, "", ("notify", "re-attest")),),
    asks=(OpenAsk("ab" * 16, "mover", "move_joint", "TIER_NEEDS_APPROVAL", 3, 1_700_000_030_000),),
    agents=(Known("mover", 900),),
    incomplete=(),
)  # fmt: skip
BLIND = replace(
    PICTURE,
    parts=(),
    robot=None,
    perception=None,
    view=None,
    decisions=(),
    asks=(),
    agents=None,
    incomplete=("No answer.",),
)


def test_everything_is_on_the_page():
    page = render(PICTURE)
    for shown in (
        "tool server", "1 min 15 s", "does not run", "57.3°", "moving", "running", "normal", "fresh", "camera-2", "p1",
        "glass-1 (fragile)", "120 ms old", "epoch 3", "90.0 %", "DEFER", "TIER_NEEDS_APPROVAL", "needs a person&#x27;s approval", ">30 s<",
        "a person has to see this, attest the agent again",
        f"http://127.77.0.11:8700/ztpm/approvals/{'ab' * 16}/page", f"ztpm approvals approve {'ab' * 16} --data /cell --as NAME",
    ):  # fmt: skip
        assert shown in page


@pytest.mark.parametrize(
    "picture",
    [BLIND, replace(PICTURE, robot={"fault": "ROBOT_STALLED"}), replace(PICTURE, view={"epoch": 3, "age_ms": 2_001})],
)
def test_what_is_not_known_or_not_well_is_said_and_not_left_out(picture):
    page = render(picture)
    assert 'class="bad"' in page
    assert page.count("<section") == 7
    assert page.count('id="part-') == 10


@pytest.mark.clause("LSD-21")
def test_a_latch_is_on_the_page_with_the_way_to_clear_it():
    latch = {
        "latched": True,
        "latch_id": "1a" * 16,
        "cause": "watch",
        "reason": "IMPACT_ROSE",
        "tier": 4,
        "approvers": 2,
    }
    for robot in (PICTURE.robot, {"fault": "ROBOT_STALLED"}):
        page = render(replace(PICTURE, robot=robot | {"latch": latch}))
        for shown in (
            "latched after watch IMPACT_ROSE",
            "two people have to clear it",
            f"ztpm latch clear {'1a' * 16}",
        ):
            assert shown in page
    named = render(replace(PICTURE, robot=PICTURE.robot | {"latch": latch | {"cause": "asked", "person": EVIL}}))
    assert "latched after asked IMPACT_ROSE; stopped by &lt;script&gt;" in named
    clear = render(replace(PICTURE, robot=PICTURE.robot | {"latch": {"latched": False}}))
    assert "latched after" not in clear and "ztpm latch clear" not in clear


@pytest.mark.clause("LIV-2", "LIV-7")
def test_the_page_says_how_a_known_person_stops_it_so_that_it_stays_stopped():
    assert "ztpm stop --data /cell --as NAME" in render(PICTURE)
    assert "ztpm stop --data &lt;script&gt;" in render(replace(PICTURE, data=EVIL))


def test_which_kinematics_count_is_on_the_page():
    nominal = replace(PICTURE, robot=PICTURE.robot | {"calibration": None, "uncertainty_mm": 7.5})
    assert "nominal kinematics; reckoned to 7.5 mm" in render(nominal)
    own = replace(PICTURE, robot=PICTURE.robot | {"calibration": "ab" * 32, "uncertainty_mm": 5.0})
    assert "kinematics of its own, calibration abababababab; reckoned to 5.0 mm" in render(own)


def test_nothing_becomes_markup():
    evil = replace(
        PICTURE,
        data=EVIL,
        parts=(Part(EVIL, 1, answers=None, up_s=1, restarts=0),),
        robot={"fault": EVIL},
        perception={**PICTURE.perception, "fault": EVIL, "perception": EVIL, "sensors": [EVIL]},
        decisions=(Decided(10**18, EVIL, EVIL, EVIL, EVIL, EVIL, None, EVIL, (EVIL,)),),
        asks=(OpenAsk(EVIL, EVIL, EVIL, EVIL, None, 0),),
        agents=(Known(EVIL, 1),),
        incomplete=(EVIL,),
        robot_host=EVIL,
        story=(Told(EVIL, EVIL, EVIL, EVIL, 3, False),),
    )
    page = render(evil)
    assert page.count("<script") == len(SCRIPTS) and "\x1b" not in page and "&lt;script&gt;" in page
    assert 'href="http://127.77.0.11:8700/ztpm/approvals/&lt;script&gt;' in page


def test_markup_escapes_by_itself():
    assert tag("p", "<b>", tag("b", "x"), title='"') == '<p title="&quot;">&lt;b&gt;<b>x</b></p>'
    assert isinstance(text("a"), Markup)


def test_a_name_that_looks_like_another_is_shown_apart():
    assert tag("p", "m\u043ever\u3164\nb", title="m\u043ever") == (
        '<p title="m⟨U+043E⟩ver">m⟨U+043E⟩ver⟨U+3164⟩\nb</p>'
    )


class Gateway:
    """A gateway that answers, or stands still."""

    def __init__(self):
        self.arm = {"ends": [[[0, 0, 0], [0, 0, 1]]], "tcp": [0, 0, 1], "moving": False}
        self.asked, self.silent, self.motion, self.parts, self.bodies = [], False, "", [], []

    def ask(self, question, *, timeout_s, lane="report"):
        self.asked.append(question)
        if self.silent:
            return None
        return {
            "live": {"arm": self.arm, "held": "h", "bodies": self.bodies, "motion": self.motion},
            "standing": {"held": "h", "parts": self.parts, "bodies": [], "workspace": None},
            "way": {"motion": self.motion, "postures": []},
        }[question["report"]]


class Served:
    """A page on a port of its own, before that gateway."""

    def __init__(self, port, picture=PICTURE, host=HOST):
        self.gateway, self.stops, self.picture = Gateway(), [], picture
        self.feed = LiveFeed(
            lambda: self.gateway,
            lambda: parts_of(self.picture),
            clock=time.monotonic,
            wall_ms=lambda: int(time.time() * 1000),
        )
        self.server = StatusServer(lambda: self.picture, feed=self.feed, stop=self.stop, host=host, port=port)
        self.url = self.server.url
        self.origin = self.url.rstrip("/")

    def stop(self):
        self.stops.append("stop")
        return StopAnswer("gateway", "The arm is being stopped.")


@contextlib.contextmanager
def serving(port, **changes):
    served = Served(port, **changes)
    served.server.start()
    yield served
    served.server.stop()


@pytest.fixture
def served():
    with serving(8890) as served:
        yield served


@pytest.mark.clause("LIV-1")
def test_served_with_strict_headers_and_nothing_but_its_own_files(served):
    page = httpx2.get(served.url)
    assert (page.status_code, page.text) == (200, render(PICTURE))
    assert page.headers["content-security-policy"] == (
        "default-src 'none'; style-src 'self'; script-src 'self'; connect-src 'self'; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    )
    assert page.headers["x-content-type-options"] == "nosniff"
    assert page.headers["cache-control"] == "no-store"
    assert httpx2.get(served.url + "status.json").json()["view"] == {"epoch": 3, "age_ms": 120}
    for name in (*SCRIPTS, STYLE):
        assert f'"{name}"' in page.text
        assert httpx2.get(served.url + name).status_code == 200
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        assert httpx2.request(method, served.url).status_code == 405
    for other in ("other", "__init__.py", "README.md", "..%2fpage.py"):
        assert httpx2.get(served.url + other).status_code == 404
    assert httpx2.get(served.url, headers={"Host": "localhost:8890"}).status_code == 421


def events(lines, wanted):
    """Events of an answer's lines by kind, until `wanted` of them came."""
    found = []
    for line in lines:
        if line.startswith("event: "):
            kind = line.removeprefix("event: ")
        elif line.startswith("data: "):
            found.append((kind, json.loads(line.removeprefix("data: "))))
            if len(found) >= wanted:
                return found
    return found


@pytest.mark.clause("LIV-3")
def test_the_feed_tells_all_at_first_then_what_changed_and_is_made_once(served):
    assert served.gateway.asked == [], "nothing is made while nobody looks"
    with httpx2.stream("GET", served.url + "events", timeout=20) as first:
        assert first.headers["content-type"].startswith("text/event-stream")
        looking = first.iter_lines()
        begun = events(looking, 15)
        assert {kind for kind, _ in begun} == {"standing", "seen", "way", "frame", "part"}
        assert [kind for kind, _ in begun].index("standing") < [kind for kind, _ in begun].index("frame")
        assert {told["name"] for kind, told in begun if kind == "part"} == set(parts_of(PICTURE))
        with httpx2.stream("GET", served.url + "events", timeout=20) as second:
            assert {kind for kind, _ in events(second.iter_lines(), 15)} == {kind for kind, _ in begun}, (
                "a later one is told all too"
            )
    assert [question["report"] for question in served.gateway.asked].count("standing") == 1


@pytest.mark.clause("LIV-3")
def test_another_gateway_is_asked_anew_for_what_stands_there(served):
    with httpx2.stream("GET", served.url + "events", timeout=20) as answer:
        looking = answer.iter_lines()
        events(looking, 15)
        before, served.gateway = served.gateway, Gateway()
        events(looking, 1)
        while not served.gateway.asked:
            events(looking, 1)
    reports = [question["report"] for question in served.gateway.asked]
    assert "standing" in reports[:2] and before is not served.gateway


@pytest.mark.clause("LIV-4")
def test_a_gateway_or_robot_that_is_silent_is_told_in_the_next_frame(served):
    served.gateway.arm = None
    with httpx2.stream("GET", served.url + "events", timeout=20) as answer:
        faults = [told["fault"] for kind, told in events(answer.iter_lines(), 15) if kind == "frame"]
    assert faults[0] == "robot"
    served.gateway.silent = True
    with httpx2.stream("GET", served.url + "events", timeout=20) as answer:
        faults = [told["fault"] for kind, told in events(answer.iter_lines(), 12) if kind == "frame"]
    assert faults == ["gateway"]


HTTP = httpx2.Client(timeout=20, limits=httpx2.Limits(max_keepalive_connections=0))


def stop_at(served, *, content='{"stop":true}', **headers):
    headers = {"Content-Type": "application/json", "Origin": served.origin} | {
        name.replace("_", "-"): value for name, value in headers.items()
    }
    kept = {name: value for name, value in headers.items() if value is not None}
    return HTTP.post(served.url + "stop", content=content, headers=kept)


@pytest.mark.clause("LIV-2")
def test_whoever_opens_the_page_stops_the_arm_as_often_as_it_wants(served):
    for _ in range(200):
        answer = stop_at(served)
        assert (answer.status_code, answer.json()["by"]) == (200, "gateway")
    assert len(served.stops) == 200


@pytest.mark.clause("LIV-2")
@pytest.mark.parametrize(
    ("headers", "content", "status", "code"),
    [
        ({"Origin": None}, '{"stop":true}', 403, "WRONG_ORIGIN"),
        ({"Origin": "null"}, '{"stop":true}', 403, "WRONG_ORIGIN"),
        ({"Origin": f"http://{HOST}:8891"}, '{"stop":true}', 403, "WRONG_ORIGIN"),
        ({"Origin": f"https://{HOST}:8890"}, '{"stop":true}', 403, "WRONG_ORIGIN"),
        ({"Origin": "http://evil.example"}, '{"stop":true}', 403, "WRONG_ORIGIN"),
        ({"Content-Type": "text/plain"}, '{"stop":true}', 400, "BODY_MALFORMED"),
        ({"Content-Type": "application/x-www-form-urlencoded"}, "stop=true", 400, "BODY_MALFORMED"),
        ({}, "", 400, "BODY_MALFORMED"),
        ({}, '{"stop":1}', 400, "BODY_MALFORMED"),
        ({}, '{"stop":true,"x":1}', 400, "BODY_MALFORMED"),
        ({}, '{"stop":true' + " " * 300 + "}", 400, "BODY_MALFORMED"),
    ],
)
def test_no_other_page_stops_it_and_nothing_else_is_taken(served, headers, content, status, code):
    answer = stop_at(served, content=content, **{name.replace("-", "_"): value for name, value in headers.items()})
    assert (answer.status_code, answer.json()["code"]) == (status, code)
    assert served.stops == []
    wrong = stop_at(served, Host=f"localhost:{httpx2.URL(served.url).port}")
    assert (wrong.status_code, wrong.text) == (421, "WRONG_HOST\n")
    assert served.stops == []


class Place:
    """A cell whose gateway is that one, or none."""

    def __init__(self, gateway):
        self.children = {} if gateway is None else {"gateway": gateway}
        self.addresses = Addresses(HOST)


class Stopping:
    def __init__(self, answer):
        self.answer = answer

    def ask(self, question, *, timeout_s, lane):
        assert (question, lane) == ({"stop": True}, "stop")
        return self.answer


@pytest.mark.clause("LIV-2")
def test_a_silent_gateway_is_passed_by_at_the_dashboard_and_silence_of_both_is_told():
    def fails(_):
        raise RobotError(PepFault.ROBOT_UNREACHABLE, "")

    for gateway, dashboard, expected in (
        (Stopping({"begun": True, "lease": "mover"}), fails, (True, "gateway", [])),
        (Stopping(None), lambda _: None, (True, "dashboard", ["arm-stopped"])),
        (Stopping({"fault": "KeyError"}), lambda _: None, (True, "dashboard", ["arm-stopped"])),
        (None, fails, (False, "", ["stop-failed"])),
    ):
        noted = []
        stop = CellStop(Place(gateway), note=lambda event, _, noted=noted: noted.append(event), dashboard=dashboard)
        answer = stop()
        assert (answer.stopped, answer.by, noted) == expected


def test_not_served_to_others(monkeypatch):
    monkeypatch.setattr("ztpm.status.server.owner_of", lambda near, far: 12_345)
    with serving(8891) as served:
        answer = httpx2.get(served.url)
        assert (answer.status_code, answer.text) == (403, "NOT_YOURS\n")
        assert stop_at(served).status_code == 403 and served.stops == []
        monkeypatch.setattr("ztpm.status.server.owner_of", lambda near, far: None)
        assert httpx2.get(served.url).status_code == 403


def test_a_port_that_is_taken_is_said():
    with socket.create_server((HOST, 8892)), pytest.raises(StatusError):
        Served(8892)


def test_the_kernel_says_whose_connection_it_is(tmp_path):
    with socket.create_server((HOST, 0)) as server, socket.create_connection(server.getsockname()) as client:
        assert owner_of(server.getsockname(), client.getsockname()) == os.getuid()
        assert owner_of(server.getsockname(), ("127.0.0.1", 1)) is None
        ends = server.getsockname(), client.getsockname()
        client.close()
        assert owner_of(*ends) is None, "a socket that is being closed is nobody's"
    assert owner_of(("::1", 1), ("::1", 2)) is None
    assert owner_of((HOST, 1), (HOST, 2), table=tmp_path / "none") is None


def test_what_a_decision_obliges_people_to_is_read_from_its_record(tmp_path):
    journal = tmp_path / "journal"
    decision = {
        "effect": "DENY",
        "reason": "TOOL_DEFINITION_CHANGED",
        "obligations": [str(kind) for kind in ObligationKind],
    }
    body = {"decision": decision, "request": {"id": "r1", "operation": "move_joint"}}
    journal.write_text(json.dumps({"kind": "decision", "at_ms": 1, "body": body}) + "\n", encoding="utf-8")
    decisions = Decisions(journal)
    decisions.follow()
    assert [decided.owed for decided in decisions.newest()] == [("notify", "re-attest", "lower trust")]
