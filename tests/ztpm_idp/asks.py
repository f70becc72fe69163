"""Asks, votes and openings for tests: each whole and right, and any member changed."""

from __future__ import annotations

import json
import secrets
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import httpx2
from tests.unread import unread
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Tier
from capabilities.values.units import Quantity, Unit
from msgspec import structs
from tests.ztpm_idp.world import AUDIENCE, World

from capabilities.keys import keys
from capabilities.statements.people import answers, ask, opening, vote
from ztpm_idp.client import ProofAuth

PEP, AGENT, SENSOR = "cell-1", "mover", "camera"
AT_ONCE = {
    (1, "approve", "approve"): {("granted", "ASK_ANSWERED"), ("ASK_ANSWERED", "granted")},
    (1, "approve", "deny"): {("granted", "denied"), ("ASK_ANSWERED", "denied")},
    (1, "deny", "deny"): {("denied", "ASK_ANSWERED"), ("ASK_ANSWERED", "denied")},
    (2, "approve", "approve"): {("open", "granted"), ("granted", "open")},
    (2, "approve", "deny"): {("open", "denied"), ("ASK_ANSWERED", "denied")},
}
"""Words that two people may be given who answer at one instant, by people needed and answers."""


class Cell:
    """A world with an enforcement point, an attested agent and a sensor, unless it is furnished already."""

    def __init__(self, world: World, *, furnished: bool = False) -> None:
        self.world = world
        if furnished:
            return
        world.pep(PEP)
        world.agent(AGENT)
        world.private[SENSOR] = keys.generate()
        world.people["alice"].register_sensor(
            SENSOR, keys.public_raw(world.private[SENSOR]), calibration="1" * 64, transit_ms=20, audience=AUDIENCE
        )  # fmt: skip

    @property
    def now(self) -> int:
        return int(self.world.clock())

    def ask(self, **changes) -> ask.Ask:
        agent = changes.get("agent", AGENT)
        key = self.world.private[agent if agent in self.world.private else AGENT]
        stated = dict(
            ask_id=secrets.token_hex(16),
            nonce=secrets.token_hex(16),
            pep=PEP,
            audience=AUDIENCE,
            issuer=changes.get("issuer") or self.world.issuer,
            sponsor="alice",
            token_id="g" * 22,
            agent=agent,
            agent_key=keys.thumbprint(keys.public_raw(key)),
            object="ur3e",
            operation="move_joint",
            values=(
                Quantity("q0", Unit.MICRORADIAN, -1_570_796),
                Quantity("speed", Unit.MICRORADIAN_PER_SECOND, 523_599),
                Quantity("acceleration", Unit.MICRORADIAN_PER_SECOND2, 1_400_000),
            ),
            request_digest="1" * 64,
            start_urad=(0, -1_570_796, 1_570_796, 0, 785_398, -1),
            model_digest="2" * 64,
            policy_digest="3" * 64,
            scene_digest="4" * 64,
            tier=Tier(3),
            index_milli=2_640,
            reasons=("TIER_NEEDS_APPROVAL",),
            contributors=(ask.Contributor("person-ssm", "forearm", "person-7", 2_640, 412_000, 250_000, SENSOR),),
            perception="fresh",
            perception_age_ms=38,
            approvers=1,
            opening_id="",
            asked_at=self.now,
            expires_at=self.now + 600,
        )
        return ask.Ask(**(stated | changes))

    def text(self, *, key: str = PEP, **changes) -> str:
        return unread(ask, self.ask(**changes), self.world.private[key])

    def post(self, who: str, path: str, body: object) -> httpx2.Response:
        content = body if isinstance(body, bytes) else json.dumps(body).encode()
        with self.world.anonymous() as http:
            return http.post(
                self.world.issuer + path, content=content, auth=ProofAuth(self.world.private[who], now=self.world.clock)
            )  # fmt: skip

    def get(self, who: str, path: str) -> httpx2.Response:
        with self.world.anonymous() as http:
            return http.get(self.world.issuer + path, auth=ProofAuth(self.world.private[who], now=self.world.clock))

    def taken(self, **changes) -> tuple[str, str]:
        """The id and text of an ask that the provider took."""
        text = self.text(**changes)
        response = self.post(PEP, "/approvals", {"ask": text})
        assert response.status_code == 201, response.text
        return response.json()["ask_id"], text

    def vote(self, text: str, approver: str = "carol", *, key: str | None = None, **changes) -> str:
        asked = ask.open(text, {keys.public_raw(self.world.private[PEP])}, DEFAULT)
        stated = vote.Vote(
            ask_id=asked.ask_id,
            nonce=asked.nonce,
            ask_digest=vote.digest_of(text),
            answer="approve",
            approver=approver,
            sees_clear=False,
            uses=1,
            not_after=self.now + 120,
            at=self.now,
        )
        return unread(vote, structs.replace(stated, **changes), self.world.private[key or approver])

    def together(self, ask_id: str, text: str, answers: dict[str, str]) -> tuple[str, ...]:
        """State or code that each of these people is given, whose signed answers come at one instant."""
        signed = {who: self.vote(text, who, answer=answer) for who, answer in answers.items()}
        start = Barrier(len(signed))

        def cast(who: str) -> str:
            start.wait(10)
            said = self.post(who, f"/approvals/{ask_id}/votes", {"vote": signed[who]}).json()
            return said.get("state") or said["code"]

        with ThreadPoolExecutor(len(signed)) as pool:
            return tuple(pool.map(cast, signed))

    def opening(self, opener: str = "carol", *, key: str | None = None, **changes) -> str:
        stated = opening.Opening(
            opening_id=secrets.token_hex(16),
            opener=opener,
            audience=AUDIENCE,
            agent=AGENT,
            object="ur3e",
            operation="move_joint",
            reason="",
            uses=1,
            not_before=self.now,
            not_after=self.now + 600,
        )
        return unread(opening, structs.replace(stated, **changes), self.world.private[key or opener])

    def answers(self, audience: str = AUDIENCE, nonce: str = "n" * 32) -> answers.Answers:
        response = self.get(PEP, f"/approvals/answers?audience={audience}&nonce={nonce}")
        assert response.status_code == 200, response.text
        return answers.open(response.text, self.world.trust.registry, DEFAULT)

    def told(self, ask_id: str) -> answers.AnsweredAsk | None:
        return next((a for a in self.answers().asks if a.ask_id == ask_id), None)

    def ledger(self) -> list[dict]:
        return [json.loads(line) for line in self.world.people["carol"].export_ledger().splitlines()[:-1]]
