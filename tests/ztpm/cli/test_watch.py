"""`ztpm approvals watch`: each ask is told once; an outage is told once, and looking goes on."""

from __future__ import annotations

import pytest
from tests.ztpm.cli.test_approvals import SHOWN
from ztpm.cli.provider.approvals import AskState

from ztpm.cli.provider import approvals
from ztpm_idp.client import ClientError
from ztpm_idp.domain.asking import asks

WORDS = ("approvals", "watch", "--as", "bob", "--every", "7")


def ask(number):
    return {**SHOWN, "ask_id": f"{number:032x}"}


@pytest.fixture
def looks(double, monkeypatch):
    """Findings of each look; after the last one a person presses Ctrl-C."""
    found, slept = [], []

    class Answers(dict):
        def __getitem__(self, name):
            assert name == "approvals"
            return found.pop(0)

    def pause(seconds):
        slept.append(seconds)
        if not found:
            raise KeyboardInterrupt

    double.answers, double.slept = Answers(), slept
    monkeypatch.setattr(approvals.time, "sleep", pause)
    return found


def test_each_open_ask_is_told_once_until_ctrl_c(run, cell, looks, double):
    looks += [[ask(1)], [ask(1), ask(2)], [ask(2)], []]
    told = run(*WORDS, "--data", cell.root)
    assert told.status == 130
    assert [line for line in told.out.splitlines() if "show" in line] == [
        f"  ztpm approvals show {ask(number)['ask_id']} --as bob" for number in (1, 2)
    ]
    assert "mover asks for ur3e.move_joint: tier 3, index 2.345" in told.out
    assert double.slept == [7] * 4 and double.asked == [("approvals", (), {"state": "open"})] * 4


def test_as_json_each_is_one_line(run, cell, looks):
    looks += [[ask(1), ask(2)], [ask(1)]]
    assert [line["ask_id"] for line in run(*WORDS, "--data", cell.root, "--json").lines] == [
        ask(number)["ask_id"] for number in (1, 2)
    ]


def test_an_outage_is_told_once_and_an_ask_after_it(run, cell, looks):
    gone = ClientError("UNREACHABLE", 0, "http://127.77.0.9:8700/ztpm: ConnectError")
    looks += [[], gone, gone, [ask(1)], gone]
    told = run(*WORDS, "--data", cell.root)
    assert told.status == 130 and told.err.count("UNREACHABLE") == 2 and "ztpm idp serve" in told.err
    assert ask(1)["ask_id"] in told.out


def test_a_refusal_ends_it(run, cell, looks):
    looks += [ClientError("NOT_PERMITTED", 403, "not an approver")]
    told = run(*WORDS, "--data", cell.root)
    assert (told.status, told.err.partition(":")[0]) == (3, "NOT_PERMITTED")


def test_the_states_are_those_of_the_identity_provider(run, cell, double):
    assert [*map(str, AskState)] == [*map(str, asks.AskState)]
    assert run("approvals", "list", "--as", "bob", "--data", cell.root, "--state", "odd").status == 2
    double.answers["approvals"] = []
    assert run("approvals", "list", "--as", "bob", "--data", cell.root, "--state", "denied").status == 0
    assert double.asked == [("approvals", (), {"state": "denied"})]
