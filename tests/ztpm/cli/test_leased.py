"""`ztpm rtde run` and `connect`, where there is nobody to talk to; with a gateway: tests/e2e/test_gateway.py."""

import pytest
from ztpm.base.layout import new_key

from .conftest import PASSPHRASE


@pytest.fixture
def code(run, cell, tmp_path):
    """The status and the reason of `ztpm rtde connect` for an agent of the cell."""
    agent = cell.agent_key("lessee")
    if not agent.exists():
        new_key(agent, PASSPHRASE.encode())
    token = tmp_path / "token"
    token.write_text("a token")

    def connected(*more, agent="lessee", data=cell.root):
        told = run("rtde", "connect", agent, "--token", token, "--data", data, "--json", *more)
        return told.status, told.json["code"]

    return connected


def test_an_agent_without_a_key_here(code):
    assert code(agent="stranger") == (2, "AGENT_UNKNOWN")
    assert code(agent="no/name") == (2, "NAME_MALFORMED")


def test_a_directory_that_is_no_cell(code, tmp_path):
    assert code(data=tmp_path) == (2, "NOT_A_CELL")


def test_nobody_says_who_the_gateway_is(code):
    """Nothing is told to the party at the door's address, as long as nobody has vouched for its key."""
    assert code() == (1, "REGISTRY_UNAVAILABLE")


def test_the_same_of_a_program(run, cell, code, tmp_path):
    assert code() == (1, "REGISTRY_UNAVAILABLE")
    began = tmp_path / "began"
    told = run("rtde", "run", "lessee", "--token", tmp_path / "token", "--data", cell.root, "--", "touch", began)
    assert told.status == 1
    assert told.err.startswith("REGISTRY_UNAVAILABLE")
    assert not began.exists()


def test_a_token_or_a_mandate_and_not_both(run, cell, code, tmp_path):
    token, software = ("--token", tmp_path / "token"), ("--software", __file__)
    for given in ((), (*token, "--mandate", "ab" * 16, *software), ("--mandate", "ab" * 16)):
        told = run("rtde", "connect", "lessee", *given, "--data", cell.root, "--json")
        assert (told.status, told.json["code"]) == (2, "USAGE")
