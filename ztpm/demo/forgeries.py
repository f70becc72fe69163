"""Forgeries in the story: a hop, a ballot and a frame, each made for real and wrong in one thing."""

from __future__ import annotations

import secrets
import socket
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.keys import keys
from capabilities.statements import observation
from capabilities.statements.people import ask, vote
from capabilities.statements.revocation import RevocationView
from capabilities.token.delegate import delegate
from capabilities.token.token_text import token_to_text
from capabilities.token.verify import verify
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, EvidenceKind, HopGrant
from capabilities.values.errors import Fault
from ztpm.base.layout import read_key
from ztpm.cell.setup import SENSOR_CALIBRATION, SENSOR_ID
from ztpm.stage.lending import SLOWER, arm_only, raw
from ztpm.stage.stage import StageError
from ztpm_idp.client import ProofAuth

if TYPE_CHECKING:
    from ztpm.stage.stage import Stage

PLAIN_CALL: Final = {
    "content-type": "application/json",
    "accept": "application/json, text/event-stream",
    "mcp-method": "tools/call",
    "mcp-name": "move_joint",
}
"""Headers of a tool call that is written by hand."""


@dataclass(frozen=True, slots=True)
class Refused:
    """Refusal over HTTP: status and reason code."""

    status: int
    code: str


def self_attested(stage: Stage, to: str) -> str:
    """The orchestrator's token with a hop that it appended itself: right in everything but the attester's key."""
    rogue, now = keys.generate(), int(time.time())
    token = raw(stage.tokens["orchestrator"])
    known = RevocationView(epoch=0, age_ms=0, revoked=frozenset())
    chain = verify(
        token, at=now, audience=stage.cell.addresses.audience, view=known, lease_ms=1, trust=stage.trust, caps=DEFAULT
    )
    if isinstance(chain, Fault):
        raise StageError(f"the orchestrator's token is {chain.code}")
    agent = stage.agents[to]
    hop = HopGrant(
        hop_id=secrets.token_hex(16),
        agent=to,
        key=keys.public_raw(read_key(stage.cell.layout.agent_key(to), stage.cell.passphrase)),
        delegator=chain.leaf.agent,
        purpose="nobody else needs to know",
        request_digest=secrets.token_bytes(32),
        attestation=Attestation(EvidenceKind.KEY, agent.measurement, now),
    )
    believed = replace(stage.trust, attesters=stage.trust.attesters | {keys.public_raw(rogue)})
    grafted = delegate(
        token,
        chain=chain,
        attester=rogue,
        trust=believed,
        hop=hop,
        restriction=arm_only(speed_high=SLOWER),
        caps=DEFAULT,
    )
    return token_to_text(grafted)


def ballot(stage: Stage, signer: str, ask_id: str, *, approver: str) -> str:
    """Approval of an open ask, signed with an agent's key in the name of `approver`.

    It is right in every member.
    """
    asked = stage.person("alice").approval(ask_id)
    stated = ask.open(
        asked["ask"], {keys.public_raw(read_key(stage.cell.layout.gateway_key, stage.cell.passphrase))}, DEFAULT
    )
    now = int(time.time())
    return vote.sign(
        vote.Vote(
            ask_id=ask_id, nonce=stated.nonce, ask_digest=vote.digest_of(asked["ask"]), answer="approve",
            approver=approver, sees_clear=True, uses=1, not_after=now + 60, at=now,
        ),
        read_key(stage.cell.layout.agent_key(signer), stage.cell.passphrase),
    )  # fmt: skip


def posted_vote(stage: Stage, caller: str, ask_id: str, ballot: str) -> Refused:
    """Identity provider's answer to a vote that an agent, or a stranger, posts with a proof of its own."""
    with httpx2.Client(auth=ProofAuth(stage.agents[caller].key), timeout=30.0) as http:
        answer = http.post(f"{stage.cell.addresses.issuer}/approvals/{ask_id}/votes", json={"vote": ballot})
    return Refused(answer.status_code, str(answer.json().get("code", "NONE")))


def forged_frame(stage: Stage) -> None:
    """Sends a frame of an empty cell in the sensor's name, signed with a foreign key.

    It is newer than all before.
    """
    frame = observation.sign(
        observation.Observation(
            sensor=SENSOR_ID, boot_id=secrets.token_hex(16), sequence=1, captured_ms=int(time.time() * 1000),
            calibration=SENSOR_CALIBRATION, complete=True, people=(), objects=(),
        ),
        keys.generate(),
    )  # fmt: skip
    addresses = stage.cell.addresses
    with socket.create_connection((addresses.gateway_host, addresses.perception_port), timeout=5.0) as line:
        line.sendall(frame.encode() + b"\n")
