"""`ztpm approvals` against a real identity provider: what an enforcement point asks is shown, answered, opened, closed."""

import secrets
import time

import httpx2
import pytest
import rfc8785
from capabilities.values.scope import Tier
from capabilities.values.units import Quantity, Unit
from tests.ztpm.cli.conftest import PASSPHRASE
from tests.ztpm.cli.test_approvals import SHOWN
from tests.ztpm.cli.test_live import live  # noqa: F401 - a fixture
from ztpm.base.layout import read_key

from capabilities.keys import keys
from capabilities.statements.people import ask
from ztpm_idp.client import ProofAuth

pytest.importorskip("ztpm_idp.client.person_answers", reason="the identity provider does not take asks yet")
pytestmark = [pytest.mark.e2e, pytest.mark.timeout(300)]


def test_answers(run, live, tmp_path):
    secret, data = PASSPHRASE.encode(), ("--data", live.layout.root)
    software = tmp_path / "agent.py"
    software.write_text("x")

    def done(*arguments, status=0):
        told = run(*arguments, *data, "--json")
        assert told.status == status, (told.out, told.err)
        return told.json

    done("agent", "register", "asker", "--software", software, "--role", "mover", "--as", "alice")
    done("agent", "attest", "asker", "--software", software)
    agent, pep = (read_key(path, secret) for path in (live.layout.agent_key("asker"), live.layout.pep_key))

    def asked(**changes):
        now, ask_id = int(time.time()), secrets.token_hex(16)
        stated = {
            **SHOWN, "picture_digest": "", "ask_id": ask_id, "nonce": secrets.token_hex(16), "issuer": live.addresses.issuer,
            "audience": live.addresses.audience, "agent": "asker", "agent_key": keys.thumbprint(keys.public_raw(agent)),
            "tier": Tier(3), "values": (Quantity("q0", Unit.MICRORADIAN, -600_000),), "token_id": "A" * 22,
            "contributors": tuple(ask.Contributor(**c) for c in SHOWN["contributors"]),
            "start_urad": tuple(SHOWN["start_urad"]), "reasons": tuple(SHOWN["reasons"]), "asked_at": now,
            "facts": (), "expires_at": now + 60, **changes,
        }  # fmt: skip
        answer = httpx2.post(
            f"{live.addresses.issuer}/approvals",
            content=rfc8785.dumps({"ask": ask.sign(ask.Ask(**stated), pep)}),
            headers={"Content-Type": "application/json"},
            auth=ProofAuth(pep),
        )
        assert answer.status_code == 201, answer.text
        return ask_id

    bob, carol = ("--as", "bob"), ("--as", "carol")
    first = asked()
    assert [row["ask_id"] for row in done("approvals", "list", *bob)["approvals"]] == [first]
    assert first in run("approvals", "list", *bob, *data).out
    shown = done("approvals", "show", first, *bob)
    told = run("approvals", "show", first, *bob, *data)
    assert told.status == 0
    assert all(member in told.out for member in (*shown["shown"], shown["ask_digest"]))
    assert done("approvals", "approve", first, *bob, "--yes")["state"] == "granted"
    assert done("approvals", "approve", first, *bob, "--yes", status=3)["code"] == "VOTED_BEFORE"
    assert done("approvals", "withdraw", first, *bob)["state"] == "withdrawn"
    assert done("approvals", "deny", asked(index_milli=2_346), *bob)["state"] == "denied"
    assert done("approvals", "show", "0" * 32, *bob, status=3)["code"] == "ASK_UNKNOWN"

    # tier 4: opened beforehand, two people
    opening = done("approvals", "open", "--agent", "asker", "--operation", "move_joint", *bob)["opening_id"]
    assert [row["opening_id"] for row in done("approvals", "openings", *bob)["openings"]] == [opening]
    grave = asked(tier=Tier(4), index_milli=3_500, approvers=2, opening_id=opening)
    assert done("approvals", "approve", grave, *bob, "--yes", status=4)["state"] == "open"
    assert done("approvals", "approve", grave, *carol, "--yes")["state"] == "granted"
    done("approvals", "close", opening, "--reason", "done", *bob)
    assert done("approvals", "openings", *bob)["openings"] == []
