"""Chapters on lent, refused and ended authority: each step uses the doors that anyone would use."""

from __future__ import annotations

import json
import re
import secrets
import time
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.token.token_text import token_to_text
from capabilities.values.scope import Tier
from policies.decision.load import load_shipped
from ztpm.demo.forgeries import PLAIN_CALL, self_attested
from ztpm.demo.run import Expect, StepObservation, Story
from ztpm.stage.calls import Answer, resend, send
from ztpm.stage.lending import LIFETIME_S, SLOWER, arm_only, hand_down, hop_id, lent, raw
from ztpm.stage.live import DEFER_TIMEOUT_S
from ztpm.stage.scene import PERSON_AXIS_M, front, person, under_the_path
from ztpm.stage.stage import ACCELERATION_RAD_S2, LEFT, SPEED_RAD_S, Stage, until
from ztpm_idp.client import ClientError
from ztpm_idp.ledger_file import Defect, Verified
from ztpm_idp.ledger_file import verify as verify_ledger

if TYPE_CHECKING:
    from collections.abc import Callable

LENDING: Final = Story("authority is lent")
REFUSING: Final = Story("more than was lent is refused")
SURROUNDINGS: Final = Story("the world matters")
ENDING: Final = Story("authority ends")
DELEGATED: Final = ("delegate",)
THETA: Final = load_shipped("paper-default").parameters.trust_theta_permille
"""Least trust, in permille, at which the cell's policies let a tier 2 act pass without a person."""
HEX_DIGEST: Final = re.compile(rb'"[0-9a-f]{64}"')


@LENDING.step("init", Expect("DONE", recorded=False))
def _init(stage: Stage) -> StepObservation:
    layout = stage.cell.layout
    started = time.perf_counter()
    ready = httpx2.get(stage.cell.addresses.issuer + "/readyz").status_code
    latency = (time.perf_counter() - started) * 1e3
    private = [path for path in layout.root.rglob("*.key") if path.stat().st_mode & 0o077 == 0]
    joints = len(stage.joints)
    told = f"three operators, {len(private)} encrypted keys (600); the provider answers {ready}, the arm too"
    all_keys = len(private) == 12 + len(stage.cell.sensors)
    return StepObservation(told, "DONE", "READY", None, latency, ok=ready == 200 and all_keys and joints == 6)


@LENDING.step("register", Expect("DONE", recorded=False, ledger="agent-registered"), needs=("init",))
def _register(stage: Stage) -> StepObservation:
    started = time.perf_counter()
    for name, role in (
        ("orchestrator", "planner"),
        ("robotic", "actuator"),
        ("vision", "observer"),
        ("config", "planner"),
        ("stray", "actuator"),
        ("greedy", "planner"),
    ):
        stage.new_agent(name, sponsor="alice", role=role)
    latency = (time.perf_counter() - started) * 1e3
    known = {row["id"]: row["status"] for row in stage.person("alice").agents()}
    told = f"alice registered {', '.join(sorted(known))}; none may act before it is attested"
    return StepObservation(
        told, "DONE", "REGISTERED", None, latency, ok=set(known.values()) == {"registered"} and len(known) == 6
    )


@LENDING.step("attest", Expect("DONE", recorded=False, ledger="agent-attested"), needs=("register",))
def _attest(stage: Stage) -> StepObservation:
    started = time.perf_counter()
    for agent in stage.agents.values():
        agent.attest()
    latency = (time.perf_counter() - started) * 1e3
    known = {row["id"]: row["status"] for row in stage.person("alice").agents()}
    told = f"each agent signed a fresh nonce and its measurement; {len(known)} active"
    return StepObservation(told, "DONE", "ATTESTED", None, latency, ok=set(known.values()) == {"active"})


@LENDING.step("issue", Expect("DONE", recorded=False, ledger="token-issued"), needs=("attest",))
def _issue(stage: Stage) -> StepObservation:
    scope = lent(stage, "robotic", "vision", "config", "stray")
    started = time.perf_counter()
    issued = stage.person("alice").issue(
        stage.agents["orchestrator"], scope, purpose="sweep the table and hand over parts"
    )
    latency = (time.perf_counter() - started) * 1e3
    stage.tokens["orchestrator"] = issued.token
    told = f"alice lent the orchestrator arm, gripper and state up to tier 3 for {LIFETIME_S} s"
    return StepObservation(told, "DONE", "ISSUED", None, latency)


@LENDING.step("delegate", Expect("DONE", recorded=False, ledger="token-delegated"), needs=("issue",))
def _delegate(stage: Stage) -> StepObservation:
    started = time.perf_counter()
    hand_down(stage, "robotic", arm_only(speed_high=SLOWER))
    latency = (time.perf_counter() - started) * 1e3
    hand_down(stage, "stray", arm_only(speed_high=SLOWER))
    told = "the orchestrator lent the robotic agent the arm alone, at most 0.6 rad/s, after it was attested anew"
    return StepObservation(told, "DONE", "DELEGATED", None, latency)


def outcome(answer: Answer) -> str:
    """End of a motion and its reason, as its tool says it."""
    said = answer.content
    return " ".join(str(said[name]) for name in ("outcome", "reason") if said.get(name))


@LENDING.step("move-empty", Expect("PERMIT", "PERMITTED", 1, moves=True), needs=DELEGATED)
def _move_empty(stage: Stage) -> StepObservation:
    stage.scene()
    answer = stage.move("robotic")
    told = f"empty workspace (C0): the arm swept {2 * abs(LEFT[0]):.1f} rad at {SPEED_RAD_S} rad/s ({outcome(answer)})"
    return StepObservation.answer(told, answer, ok=outcome(answer) == "reached")


def asked_of_idp(action: Callable[[], object]) -> tuple[str, str, int, float]:
    """Decision, code, status and latency of the identity provider's answer to an action."""
    started = time.perf_counter()
    try:
        action()
    except ClientError as error:
        return "DENY", str(error.code), error.status, (time.perf_counter() - started) * 1e3
    return "PERMIT", "DELEGATED", 201, (time.perf_counter() - started) * 1e3


@REFUSING.step(
    "widen-refused",
    Expect("DENY", "NOT_NARROWER", recorded=False, ledger="delegation-refused", attack=True),
    needs=DELEGATED,
)
def _widen(stage: Stage) -> StepObservation:
    greedy = stage.agents["greedy"]
    stage.tokens["greedy"] = stage.person("alice").issue(greedy, lent(stage, "vision"), purpose="plan a sweep").token
    decision, code, status, latency = asked_of_idp(
        lambda: greedy.delegate(
            stage.tokens["greedy"], stage.agents["vision"], arm_only(speed_high=2_000_000), purpose="faster"
        )
    )
    told = (
        f"the greedy agent asked for a delegate at 2 rad/s, above its own 1.05: the identity provider answered {status}"
    )
    return StepObservation(told, decision, code, None, latency, ok=status == 403)


@REFUSING.step("unattested-refused", Expect("DENY", "HOP_NOT_ATTESTED", attack=True), needs=DELEGATED)
def _unattested(stage: Stage) -> StepObservation:
    orchestrator, vision = stage.agents["orchestrator"], stage.agents["vision"]
    _, code, status, _ = asked_of_idp(
        lambda: orchestrator.delegate_with(
            stage.tokens["orchestrator"], "vision", arm_only(speed_high=SLOWER), purpose="look",
            evidence=vision.evidence("orchestrator", {"another": "request"}),
        )
    )  # fmt: skip
    answer = stage.move("vision", token=self_attested(stage, "vision"))
    told = (
        f"evidence for another request: the provider answered {status} {code}; "
        f"a perfect hop, but signed by an attester of the holder's own: {answer.status}"
    )
    return StepObservation.answer(
        told, answer, ok=status == 403 and code == "ATTESTATION_INVALID" and answer.status == 401
    )


@REFUSING.step("scope-refused", Expect("DENY", "NOT_GRANTED", attack=True), needs=DELEGATED)
def _scope(stage: Stage) -> StepObservation:
    answer = stage.ask("stray", "gripper_move", {"width_m": 0.04, "speed_m_s": 0.05, "force_n": 40})
    told = f"the stray agent called the gripper, which its hop dropped: {answer.content.get('primitive')}"
    return StepObservation.answer(told, answer, ok=answer.content.get("primitive") == "TEA-1")


@REFUSING.step("limit-refused", Expect("DENY", "LIMIT_EXCEEDED_BY_REQUEST", attack=True), needs=DELEGATED)
def _limit(stage: Stage) -> StepObservation:
    answer = stage.move("stray", speed=0.8)
    said = answer.content
    by, limit = said.get("set_by") or {}, said.get("limit") or {}
    told = (
        f"{said.get('parameter')} {said.get('value')} {said.get('unit')} is outside {limit.get('low')} to "
        f"{limit.get('high')}, set at hop {by.get('hop')} ({by.get('agent')}, under {by.get('sponsor')}); "
        f"nearest permitted {said.get('nearest_permitted')}"
    )
    ok = (
        (said.get("parameter"), said.get("value"), said.get("unit"), said.get("nearest_permitted"))
        == ("speed", 800_000, "urad_s", SLOWER)
        and said.get("limit") == {"low": 0, "high": SLOWER}
        and (by.get("hop"), by.get("agent"), by.get("sponsor")) == (1, "stray", "alice")
    )
    return StepObservation.answer(told, answer, ok=ok)


@REFUSING.step("replay-refused", Expect("DENY", "REPLAYED", attack=True), needs=DELEGATED)
def _replay(stage: Stage) -> StepObservation:
    honest = stage.ask("stray", "read_state", {})
    assert honest.exchange is not None
    answer = resend(honest.exchange)
    told = f"the same bytes once more: first {honest.status}, then {answer.status}"
    return StepObservation.answer(told, answer, ok=honest.decision == "PERMIT" and answer.status == 401)


@REFUSING.step("stolen-refused", Expect("DENY", "PROOF_WRONG_KEY", attack=True), needs=DELEGATED)
def _stolen(stage: Stage) -> StepObservation:
    answer = stage.move("vision", token=stage.tokens["robotic"])
    return StepObservation.answer(
        f"the vision agent used the robotic agent's token with its own key: {answer.status}",
        answer,
        ok=answer.status == 401,
    )


@REFUSING.step("tampered-refused", Expect("DENY", "SIGNATURE_INVALID", attack=True), needs=DELEGATED)
def _tampered(stage: Stage) -> StepObservation:
    honest = stage.ask("robotic", "read_state", {})
    token = bytearray(raw(stage.tokens["robotic"]))
    stated = b'"purpose":"'  # of the first holder: a word that nothing but the signature protects
    place = token.index(stated) + len(stated)
    token[place] ^= 1
    answer = stage.move("robotic", token=token_to_text(bytes(token)))
    told = f"one bit of the token flipped, at byte {place}: first {honest.status}, then {answer.status}"
    return StepObservation.answer(told, answer, ok=honest.decision == "PERMIT" and answer.status == 401)


@REFUSING.step("not-finite-refused", Expect("DENY", "NOT_FINITE", attack=True), needs=DELEGATED)
def _not_finite(stage: Stage) -> StepObservation:
    stage.scene()
    arguments = {"q_rad": [0.1, *LEFT[1:]], "speed_rad_s": SPEED_RAD_S, "acceleration_rad_s2": ACCELERATION_RAD_S2}
    call = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "move_joint", "arguments": arguments}}
    body = json.dumps(call).replace("[0.1", "[NaN", 1).encode()
    answer = send(
        stage.agents["robotic"].auth(stage.tokens["robotic"]), stage.cell.addresses.audience, body, PLAIN_CALL
    )
    told = f"a target of NaN, properly signed: {answer.status}, a fault without a tier"
    return StepObservation.answer(told, answer, ok=answer.status == 400 and answer.tier is None)


@SURROUNDINGS.step("fragile-trusted", Expect("PERMIT", "PERMITTED", 2, moves=True), needs=DELEGATED)
def _fragile_trusted(stage: Stage) -> StepObservation:
    stage.scene(objects=[under_the_path()])
    answer = stage.move("robotic")
    told = f"a glass under the path (C1), trust 0.8 over theta 0.7: the arm moved ({outcome(answer)})"
    return StepObservation.answer(told, answer, ok=outcome(answer) == "reached")


@SURROUNDINGS.step("fragile-untrusted", Expect("DEFER", "TRUST_TOO_LOW", 2), needs=DELEGATED)
def _fragile_untrusted(stage: Stage) -> StepObservation:
    stage.scene(objects=[under_the_path()])
    stage.person("alice").set_trust("robotic", 500)
    until(lambda: trust(stage, "robotic") <= 500, "the lower trust in the PEP's evidence")
    answer = stage.move("robotic")
    stage.person("alice").set_trust("robotic", 800)
    until(lambda: trust(stage, "robotic") > THETA, "the trust of before in the PEP's evidence")
    return StepObservation.answer(
        "the same with trust 0.5, which alice signed: deferred, and the arm stood still", answer
    )


@SURROUNDINGS.step("trust-fell", Expect("DEFER", "TRUST_TOO_LOW", 2), needs=("widen-refused",))
def _trust_fell(stage: Stage) -> StepObservation:
    stage.scene(objects=[under_the_path()])
    until(lambda: trust(stage, "greedy") < THETA, "what the attempt cost in the PEP's evidence")
    answer = stage.move("greedy")
    known = trust(stage, "greedy")
    told = f"the same by the greedy agent, whose attempt to lend more than it holds left it a trust of {known / 1000}"
    return StepObservation.answer(told, answer, ok=answer.content.get("trust_permille") == known)


def trust(stage: Stage, agent: str) -> int:
    """The agent's trust in permille as the PEP reads it now."""
    stage.ask(agent, "read_state", {})
    (*_, newest) = (row["body"]["evidence"]["trust"] for row in stage.journal() if row["kind"] == "decision")
    return int(newest.get("score_permille", -1))


@SURROUNDINGS.step("human-deferred", Expect("DEFER", "TIER_NEEDS_APPROVAL", 3), needs=DELEGATED)
def _human(stage: Stage) -> StepObservation:
    stage.scene(people=[person("person-1", *front(PERSON_AXIS_M))])
    answer = stage.move("robotic")
    stage.open_ask = answer.content.get("ask_id")
    lower = answer.content.get("highest_speed_of_lower_tier", "absent")
    words = "no speed lowers the tier" if lower is None else f"up to {lower} urad/s the tier is lower"
    return StepObservation.answer(
        f"a person 0.5 m from the base (C2): tier 3, people must decide; {words}", answer, ok=lower != "absent"
    )


@SURROUNDINGS.step("deferral-expires", Expect("DENY", "APPROVAL_TIMEOUT"), needs=("human-deferred",))
def _expires(stage: Stage) -> StepObservation:
    until(lambda: stage.open_ask in stage.ended_asks(), "the deferral's end in the journal")
    answer = stage.move("robotic")
    return StepObservation.answer(f"nobody answered for {DEFER_TIMEOUT_S} s: silence denies", answer)


@SURROUNDINGS.step("ceiling-refused", Expect("DENY", "ABOVE_CEILING", 3, attack=True), needs=DELEGATED)
def _ceiling(stage: Stage) -> StepObservation:
    stage.scene(people=[person("person-1", *front(PERSON_AXIS_M))])
    token = hand_down(stage, "config", arm_only(speed_high=SLOWER, ceiling=Tier.CONSEQUENTIAL))
    answer = stage.move("config", token=token)
    by = answer.content.get("set_by") or {}
    told = f"a ceiling of 2, set at hop {by.get('hop')} ({by.get('agent')}), near the person; nobody was asked"
    return StepObservation.answer(
        told, answer, ok=(by.get("hop"), by.get("agent")) == (1, "config") and "ask_id" not in answer.content
    )


@SURROUNDINGS.step("through-person-denied", Expect("DENY", "PHYSICS_VIOLATION"), needs=DELEGATED)
def _through(stage: Stage) -> StepObservation:
    stage.scene(people=[person("person-1", *front(0.45))])
    answer = stage.move("robotic")
    told = f"violated: {', '.join(answer.content.get('violations') or [])} in the path; nothing can authorise it"
    return StepObservation.answer(told, answer, ok="person" in (answer.content.get("violations") or []))


@ENDING.step("revoked-refused", Expect("DENY", "REVOKED", attack=True), needs=DELEGATED)
def _revoked(stage: Stage) -> StepObservation:
    stage.scene()
    token = hand_down(stage, "vision", arm_only(speed_high=SLOWER - 1))
    before = stage.ask("vision", "read_state", {}, token=token)
    started = time.perf_counter()
    stage.person("alice").revoke("hop", hop_id(stage, token), reason="demonstration")
    answer = poll_refusal(stage, "vision", token)
    horizon = (time.perf_counter() - started) * 1e3
    answer = stage.move("vision", token=token)
    told = f"alice revoked vision's hop: {before.status}, then {answer.status} {horizon:.0f} ms later; its parent lives"
    parent = stage.ask("orchestrator", "read_state", {})
    return StepObservation.answer(
        told, answer, ok=before.decision == "PERMIT" and parent.decision == "PERMIT" and answer.status == 401
    )


def poll_refusal(stage: Stage, agent: str, token: str) -> Answer:
    """First refusal of a read with that token.

    Raises:
        StageError: when reads go on being permitted.
    """
    found: list[Answer] = []

    def is_refused() -> bool:
        answer = stage.ask(agent, "read_state", {}, token=token)
        if answer.decision != "PERMIT":
            found.append(answer)
        return bool(found)

    until(is_refused, "the refusal")
    return found[0]


@ENDING.step("sponsor-disabled", Expect("DENY", "REVOKED", attack=True), needs=DELEGATED)
def _sponsor(stage: Stage) -> StepObservation:
    for name in ("scout", "carrier"):
        stage.new_agent(name, sponsor="bob", role="actuator").attest()
    root = stage.person("bob").issue(stage.agents["scout"], lent(stage, "carrier"), purpose="a tree of bob's").token
    child = (
        stage.agents["scout"]
        .delegate(root, stage.agents["carrier"], arm_only(speed_high=SLOWER), purpose="below bob")
        .token
    )
    before = [
        stage.ask(name, "read_state", {}, token=token).decision for name, token in (("scout", root), ("carrier", child))
    ]
    stage.person("alice").confirm_change(stage.person("carol").propose_end("bob", reason="left the company"))
    poll_refusal(stage, "carrier", child)
    answer = stage.move("carrier", token=child)
    parent = stage.ask("scout", "read_state", {}, token=root)
    told = f"carol and alice ended bob: his tree died ({parent.status} for the parent, {answer.status} for the child)"
    return StepObservation.answer(told, answer, ok=before == ["PERMIT", "PERMIT"] and parent.reason == "REVOKED")


@ENDING.step("stale-feed-refused", Expect("DENY", "REVOCATION_VIEW_STALE"), needs=DELEGATED)
def _stale(stage: Stage) -> StepObservation:
    stage.scene()
    stage.cell.idp.pause()
    started = time.perf_counter()
    try:
        answer = poll_motion_refusal(stage)
        lease = time.perf_counter() - started
    finally:
        stage.cell.idp.resume()
    reading = stage.ask("robotic", "read_state", {})
    told = f"the identity provider fell silent: motion was denied after {lease:.1f} s, reading state was not"
    return StepObservation.answer(told, answer, ok=reading.decision == "PERMIT" and lease < 5.0)


def poll_motion_refusal(stage: Stage) -> Answer:
    """First refusal of a motion to the arm's present place.

    Raises:
        StageError: when motions go on being permitted.
    """
    found: list[Answer] = []

    def is_refused() -> bool:
        answer = stage.ask(
            "robotic", "move_joint",
            {
                "q_rad": [round(q, 6) for q in stage.joints],
                "speed_rad_s": SPEED_RAD_S,
                "acceleration_rad_s2": ACCELERATION_RAD_S2,
            },
        )  # fmt: skip
        if answer.decision != "PERMIT":
            found.append(answer)
        return bool(found)

    until(is_refused, "the refusal of motion")
    return found[0]


@ENDING.step("audit-verifies", Expect("DONE", recorded=False), needs=DELEGATED)
def _audit(stage: Stage) -> StepObservation:
    shipped = stage.journal_records()

    def complete() -> bool:
        return stage.exported_pep_records() >= shipped

    until(complete, "every record of the PEP in the ledger")
    lines = stage.person("carol").export_ledger().splitlines()
    started = time.perf_counter()
    whole = verify_ledger(lines, stage.trust)
    latency = (time.perf_counter() - started) * 1e3
    # A digest inside an entry's body: the line stays well-formed JSON, only untrue.
    bodies = [row for row, line in enumerate(lines[:-1]) if len(HEX_DIGEST.findall(line)) > 1]
    row = secrets.choice(bodies)
    place = next(HEX_DIGEST.finditer(lines[row])).start() + 1
    flipped = [*lines]
    flipped[row] = lines[row][:place] + bytes([lines[row][place] ^ 1]) + lines[row][place + 1 :]
    defect = verify_ledger(flipped, stage.trust)
    named = isinstance(defect, Defect) and defect.seq == row + 1  # entries count from 1
    found = f"{defect.code} at {defect.seq}" if isinstance(defect, Defect) else "nothing"
    size = whole.size if isinstance(whole, Verified) else 0
    told = f"{size} ledger entries verified offline; with one bit of entry {row + 1} flipped the check finds {found}"
    return StepObservation(told, "DONE", "VERIFIED", None, latency, ok=isinstance(whole, Verified) and named)
