"""`ztpm latch list`, `show` and `clear`: each done, each refused, and the way out in words."""

from __future__ import annotations

import pytest
from capabilities.statements.people.latch import Latch, LatchCause, Retreat, Turn
from capabilities.values.scope import Tier
from msgspec import structs
from ztpm.cli.provider.latch import way_out
from ztpm_idp.client.latches import ShownLatch

from ztpm_idp.client import ClientError

pytestmark = pytest.mark.clause("LSD-22", "LSD-23")

ID = "0123456789abcdef" * 2
WAY = Retreat((Turn(1, -100_000), Turn(2, 50_000)), (0, -1_670_000, 1_620_000, 0, 0, 0), 100_000, Tier.REVERSIBLE, 812)
LATCH = Latch(
    latch_id=ID,
    issuer="https://idp.example/ztpm",
    pep="cell-pep",
    audience="http://127.0.0.1:8800/mcp",
    robot="ur3e",
    cause=LatchCause.WATCH,
    reason="IMPACT_ROSE",
    tier=Tier.HIGH_CONSEQUENCE,
    approvers=1,
    request_id="ab" * 16,
    at=1_800_000_000,
    retreat=(WAY,),
)
SHOWN = ShownLatch(LATCH, "5d" * 32, "waits", ())
ROW = {
    "latch_id": ID, "state": "waits", "pep": "cell-pep", "audience": LATCH.audience, "robot": "ur3e", "cause": "watch",
    "approvers": 1, "at": LATCH.at,
}  # fmt: skip
COMMANDS = {
    "list": (["latch", "list"], {"latches": [ROW, {**ROW, "state": "released"}]}, 0),
    "show": (["latch", "show", ID], {"latch": SHOWN}, 0),
    "clear": (["latch", "clear", ID, "--yes"], {"latch": SHOWN, "clear_latch": "released"}, 0),
    "clear of two": (["latch", "clear", ID, "--yes"], {"latch": SHOWN, "clear_latch": "waits"}, 4),
}


@pytest.fixture
def who(cell):
    return ("--data", cell.root, "--as", "bob")


@pytest.mark.parametrize("command", COMMANDS)
def test_done(run, who, double, command):
    arguments, double.answers, status = COMMANDS[command]
    told = run(*arguments, *who, "--json")
    assert told.status == status, told.err
    assert double.asked[-1][0] == list(double.answers)[-1]
    assert run(*arguments, *who).status == status


@pytest.mark.parametrize("command", COMMANDS)
def test_refused(run, who, double, command):
    arguments, double.answers, _ = COMMANDS[command]
    double.answers = {**double.answers, list(double.answers)[0]: ClientError("NOT_PERMITTED", 403)}
    assert run(*arguments, *who, "--json").status == 3


def test_only_what_waits_is_listed_and_what_is_cleared_is_the_latch_that_was_shown(run, who, double):
    double.answers = COMMANDS["list"][1]
    assert [row["state"] for row in run("latch", "list", *who, "--json").json["latches"]] == ["waits"]
    assert len(run("latch", "list", "--all", *who, "--json").json["latches"]) == 2
    double.answers = COMMANDS["clear"][1]
    told = run("latch", "clear", ID, "--yes", *who, "--json").json
    assert (told["state"], told["latch_digest"]) == ("released", SHOWN.digest)
    assert double.asked[-1][1] == (SHOWN,)


def test_nothing_is_signed_without_a_yes(run, who, double):
    double.answers = COMMANDS["clear"][1]
    assert run("latch", "clear", ID, *who, "--json").status == 2
    assert run("latch", "clear", "x", "--yes", *who).status == 2
    assert "clear_latch" not in [name for name, *_ in double.asked]


def test_the_way_out_is_told_with_joints_angles_and_tier():
    told = way_out(LATCH)
    for part in ("joint 1 by -5.73°", "joint 2 by +2.86°", "tier 1", "index 0.812", "-1.670000"):
        assert part in told
    assert "UNPROVEN" in way_out(structs.replace(LATCH, retreat=(), no_retreat="UNPROVEN"))
