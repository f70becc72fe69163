"""What the story is played with: scenes, tokens and a forgery, each made for real."""

from __future__ import annotations

import secrets
import socket
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import httpx2

from capabilities.keys import keys
from capabilities.statements import ask, observation, vote
from capabilities.statements.revocation import RevocationView
from capabilities.token.delegate import delegate
from capabilities.token.token_text import token_from_text, token_to_text
from capabilities.token.verify import inspect_token, verify
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, EvidenceKind, HopGrant
from capabilities.values.errors import Fault
from capabilities.values.scope import Tier
from ztpm.base.layout import read_key
from ztpm.cell.setup import SENSOR_CALIBRATION, SENSOR_ID
from ztpm.demo.stage import StageError, arm_only, sweep_scope
from ztpm_idp.client import ProofAuth

if TYPE_CHECKING:
    from capabilities.values.scope import Restriction, Scope
    from ztpm.demo.stage import Stage

LIFETIME_S: Final = 900
SLOWER: Final = 600_000
"""The orchestrator leaves the robotic agent this joint speed, urad/s."""

GLASS: Final = {"id": "glass-1", "kind": "fragile"}
PERSON_AXIS_M: Final = 0.69
"""Body axis of a standing adult whose nearest surface (torso, radius 0.19 m) is 0.5 m from the base axis: C2."""

PLAIN_CALL: Final = {
    "content-type": "application/json",
    "accept": "application/json, text/event-stream",
    "mcp-method": "tools/call",
    "mcp-name": "move_joint",
}
"""Headers of a tool call that is written by hand."""


@dataclass(frozen=True, slots=True)
class Refused:
    """What came back over HTTP: status and reason code."""

    status: int
    code: str


def person(identity: str, x_m: float, y_m: float) -> dict[str, object]:
    """A standing adult for the sensor, by the position of the body axis in the base frame."""
    return {"id": identity, "x_m": x_m, "y_m": y_m}


MIDDLE_M: Final = (-0.272, -0.131)
"""Where the tool passes the middle of the sweep: x, y in the base frame, by forward kinematics."""


def front(radius_m: float) -> tuple[float, float]:
    """The point at that distance from the base axis in the direction of the middle of the sweep, base frame."""
    x, y = MIDDLE_M
    norm = (x * x + y * y) ** 0.5
    return radius_m * x / norm, radius_m * y / norm


def under_the_path() -> dict[str, object]:
    """A fragile glass standing on the table under the middle of the sweep (condition C1)."""
    x, y = MIDDLE_M
    return {**GLASS, "shape": {"type": "capsule", "a_m": [x, y, 0.03], "b_m": [x, y, 0.10], "radius_m": 0.035}}


def lent(stage: Stage, *delegates: str, ceiling: Tier = Tier.HIGH_CONSEQUENCE) -> Scope:
    """What an operator lends now, to be handed down to these agents."""
    scope = sweep_scope(
        stage.cell.addresses.audience, delegates=frozenset(delegates), now=int(time.time()), lifetime_s=LIFETIME_S
    )
    return replace(scope, ceiling=ceiling)


def hand_down(stage: Stage, to: str, restriction: Restriction, *, keep_as: str | None = None) -> str:
    """The orchestrator delegates to an agent; the token is kept under `keep_as` or the agent's name."""
    token = (
        stage.agents["orchestrator"]
        .delegate(stage.tokens["orchestrator"], stage.agents[to], restriction, purpose="move the arm along the sweep")
        .token
    )
    stage.tokens[keep_as or to] = token
    return token


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


def raw(text: str) -> bytes:
    """The bytes of a token text that is known to be well formed."""
    token = token_from_text(text, DEFAULT)
    if not isinstance(token, bytes):
        raise StageError("a token that was just issued does not parse")
    return token


def hop_id(stage: Stage, token: str) -> str:
    """The id of a token's last hop, as `ztpm token inspect` shows it."""
    described: Any = inspect_token(raw(token), stage.trust, DEFAULT)
    return str(described["hops"][-1]["hop_id"])


def ballot(stage: Stage, signer: str, ask_id: str, *, approver: str) -> str:
    """An approval of an open ask, right in every member, but signed with an agent's key in the name of `approver`."""
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
    """What the identity provider makes of a vote that an agent posts with a proof of its own."""
    key = read_key(stage.cell.layout.agent_key(caller), stage.cell.passphrase)
    with httpx2.Client(auth=ProofAuth(key), timeout=30.0) as http:
        answer = http.post(f"{stage.cell.addresses.issuer}/approvals/{ask_id}/votes", json={"vote": ballot})
    return Refused(answer.status_code, str(answer.json().get("code", "NONE")))


def forged_frame(stage: Stage) -> None:
    """A frame of an empty cell in the sensor's name, newer than all before, signed with a key of somebody else."""
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
