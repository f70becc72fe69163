"""The status page: nothing on it can become markup, and it is served to its owner alone."""

import json
import os
import socket
from dataclasses import replace

import httpx2
import pytest
from policies.evidence.model import ObligationKind
from ztpm.base.peer import owner_of
from ztpm.status.decisions import Decided, Decisions, OpenAsk
from ztpm.status.markup import Markup, tag, text
from ztpm.status.page import render
from ztpm.status.picture import Known, Part, Snapshot
from ztpm.status.server import StatusError, StatusServer

HOST = "127.77.0.11"
EVIL = "<script>alert(1)</script>\"'&\x1b[2J"
PICTURE = Snapshot(
    at_ms=1_700_000_000_000,
    data="/cell",
    issuer="http://127.77.0.11:8700/ztpm",
    audience="http://127.77.0.11:8800/mcp",
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
        "glass-1 (fragile)", "120 ms old", "epoch 3", "90.0 %", "DEFER", "TIER_NEEDS_APPROVAL", "denies in 30 s",
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
    assert "latch" not in render(replace(PICTURE, robot=PICTURE.robot | {"latch": {"latched": False}}))


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
    )
    page = render(evil)
    assert "<script" not in page and "\x1b" not in page and "&lt;script&gt;" in page
    assert 'href="http://127.77.0.11:8700/ztpm/approvals/&lt;script&gt;' in page


def test_markup_escapes_by_itself():
    assert tag("p", "<b>", tag("b", "x"), title='"') == '<p title="&quot;">&lt;b&gt;<b>x</b></p>'
    assert isinstance(text("a"), Markup)


def test_a_name_that_looks_like_another_is_shown_apart():
    assert tag("p", "m\u043ever\u3164\nb", title="m\u043ever") == (
        '<p title="m⟨U+043E⟩ver">m⟨U+043E⟩ver⟨U+3164⟩\nb</p>'
    )


@pytest.fixture
def served():
    server = StatusServer(lambda: PICTURE, host=HOST, port=8890)
    server.start()
    yield server
    server.stop()


def test_served_read_only_with_strict_headers(served):
    page = httpx2.get(served.url)
    assert (page.status_code, page.text) == (200, render(PICTURE))
    assert page.headers["content-security-policy"] == (
        "default-src 'none'; style-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    assert page.headers["x-content-type-options"] == "nosniff"
    assert page.headers["cache-control"] == "no-store"
    assert httpx2.get(served.url + "status.json").json()["view"] == {"epoch": 3, "age_ms": 120}
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        assert httpx2.request(method, served.url).status_code == 405
    assert httpx2.get(served.url + "other").status_code == 404
    assert httpx2.get(served.url, headers={"Host": "localhost:8890"}).status_code == 421


def test_not_served_to_others(monkeypatch):
    monkeypatch.setattr("ztpm.status.server.owner_of", lambda near, far: 12_345)
    server = StatusServer(lambda: PICTURE, host=HOST, port=8891)
    server.start()
    try:
        answer = httpx2.get(server.url)
        assert (answer.status_code, answer.text) == (403, "NOT_YOURS\n")
        monkeypatch.setattr("ztpm.status.server.owner_of", lambda near, far: None)
        assert httpx2.get(server.url).status_code == 403
    finally:
        server.stop()


def test_a_port_that_is_taken_is_said():
    with socket.create_server((HOST, 8892)), pytest.raises(StatusError):
        StatusServer(lambda: PICTURE, host=HOST, port=8892)


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
