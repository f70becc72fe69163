"""Campaigns on approvals: defects in pairs (D2), mutants of what was approved (D3), and a storm of asks (D4).

    python -m tests.pep.people.campaign defects|mutants|storm

Each prints its figure last, and fails where anything happened that must not.
"""

from __future__ import annotations

import copy
import itertools
import random
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import StatementError
from msgspec import structs
from policies.evidence.model import Effect
from tests.authenticators import Authenticator
from tests.capabilities.statements.people.test_passkey_votes import ASK, CHANGES, PARTY, VOTE
from tests.pep.kit import MOVE
from tests.pep.people.test_approvals import CRITICAL, DEFECTS, Critical, People, closing
from tests.progress import Progress
from tests.unread import unread
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.world import World

from capabilities.keys import keys
from capabilities.statements.people import ask as asks
from capabilities.statements.people import passkey_vote

SEED = 20_27
PAIRS = 300
MUTANTS = 500
STORM = 10_000
AGENTS = 20
SPOOFS = (
    "<script>alert(1)</script>", '"><img src=x onerror=1>', "{{7*7}}", "a\u202eb", "\u200bmover", "mоver", "ｍover",
    "a\nb", "a\x00b", "a" * 257, "a b/../c", "%0d%0aSet-Cookie:x", "&#x3c;b&#x3e;", "\ufeffmover", "a\tb",
    "mover ", " mover", "", "é", "e\u0301",
)  # fmt: skip
TEXTS = ("pep", "sponsor", "agent", "object", "operation")


# --- D2 ----------------------------------------------------------------------------------------------------------------


def defects() -> str:
    """Every defect of an approval alone, and pairs of them: what the gate still sent."""
    by_itself = {name for name, (_, why) in DEFECTS.items() if why is None}
    names = [name for name in DEFECTS if name not in by_itself]
    chosen = random.Random(SEED).sample(list(itertools.combinations(names, 2)), PAIRS)  # noqa: S311 - drawn cases
    cases = [(People, DEFECTS, (name,)) for name in names] + [(People, DEFECTS, pair) for pair in chosen]
    cases += [(Critical, CRITICAL, (name,)) for name in CRITICAL]
    tried = accepted = 0
    progress = Progress()
    for number, (kind, table, case) in enumerate(cases):
        progress.at(f"{number} of {len(cases)} defects")
        with TemporaryDirectory() as folder:
            rig = kind(Path(folder))
            try:
                rig.ask()
                rig.opening_id = rig.asks._deferrals[rig.ask_id].question.opening_id
                for name in case:
                    try:
                        table[name][0](rig)
                    except (Exception, pytest.fail.Exception):  # noqa: BLE001 - the second has nothing left to spoil
                        continue
                decision = rig.go().decision
                tried += 1
                if rig.sent or decision.effect is Effect.PERMIT:
                    accepted += 1
                    print(f"accepted: {case}")
            finally:
                closing(rig)
    return verdict("D2", accepted, f"{accepted} of {tried} defective approvals accepted", enough=tried >= PAIRS)


# --- D3 ----------------------------------------------------------------------------------------------------------------


def mutants() -> str:
    """One member of an approved request or ask changed: what was sent, and what was shown of names that deceive."""
    drawn, effects, progress = random.Random(SEED), 0, Progress()  # noqa: S311 - drawn cases
    with TemporaryDirectory() as folder:
        rig = People(Path(folder))
        rig.ask()
        rig.cast(rig.vote(uses=100))
        for number in range(MUTANTS // 2):
            progress.at(f"{number} of {MUTANTS} changes")
            try:
                effects += rig.go(arguments=mutated(drawn)).decision.effect is Effect.PERMIT
            except AttributeError:  # no request at all: the arguments are out of the robot's own limits
                continue
        effects += len(rig.sent)
        alive = rig.go().decision.effect is Effect.PERMIT and len(rig.sent) == 1
        closing(rig)
    held, counted = Authenticator(PARTY), 0
    text = held.vote(VOTE, ASK)
    alive = alive and passkey_vote.open(text, [held.key], ask=ASK, party=PARTY)[0] == VOTE
    for number in range(MUTANTS // 2):
        name = sorted(CHANGES)[number % len(CHANGES)]
        value: Any = CHANGES[name]
        if isinstance(value, str) and len(value) in (32, 64):
            value = f"{drawn.getrandbits(4 * len(value)):0{len(value)}x}"
        elif isinstance(value, int):
            value += drawn.randrange(1_000)
        counted += opened(text, held, structs.replace(ASK, **{name: value}))
    pep, shown, tried = keys.generate(), 0, 0
    for spoof, name in itertools.product(SPOOFS, TEXTS):
        tried += 1
        try:
            asks.open(unread(asks, structs.replace(ASK, **{name: spoof}), pep), [keys.public_raw(pep)], CAPS)
            shown += 1
        except StatementError:
            continue
    figure = (
        f"{effects + counted} of {MUTANTS} changed requests and asks took effect; "
        f"{shown} of {tried} names that deceive could be shown"
    )
    return verdict("D3", effects + counted + shown, figure, enough=alive)


def mutated(drawn: random.Random) -> dict[str, Any]:
    """The approved arguments with one number changed by at least one unit of its grid."""
    arguments = copy.deepcopy(MOVE)
    name = drawn.choice(sorted(arguments))
    by = drawn.choice((-1, 1)) * drawn.randrange(1, 50_000) / 1e6
    if name == "q_rad":
        arguments[name][drawn.randrange(6)] += by
    else:
        arguments[name] += by
    return arguments


def opened(text: str, held: Authenticator, ask: asks.Ask) -> bool:
    try:
        passkey_vote.open(text, [held.key], ask=ask, party=PARTY)
    except StatementError:
        return False
    return True


# --- D4 ----------------------------------------------------------------------------------------------------------------


def storm() -> str:
    """Ten thousand asks by twenty agents in an hour: how many people are shown, and that nobody is answered for."""
    with (
        TemporaryDirectory() as folder,
        World(Path(folder), settings_changes={"asks_a_minute": 6, "asks_an_hour": 30}) as world,
    ):
        cell, taken, refused = Cell(world), [], 0
        for number in range(AGENTS):
            world.agent(f"agent-{number}")
        approvers = sum("approver" in roles for roles in World.ROLES.values())
        began, progress = world.clock.at_s, Progress()
        for number in range(STORM):
            progress.at(f"{number} of {STORM} asks, {len(taken)} of them taken")
            world.clock.at_s = began + 3_600 * number / STORM
            text = cell.text(agent=f"agent-{number % AGENTS}", expires_at=cell.now + 120)
            answer = cell.post("cell-1", "/approvals", {"ask": text})
            if answer.status_code == 201:
                taken.append((world.clock.at_s, answer.json()["ask_id"]))
                again = cell.post("cell-1", "/approvals", {"ask": text})
                refused += again.status_code != 200
            elif answer.json()["code"] != "ASK_BUDGET_SPENT":
                refused += STORM
        minute = max(sum(at <= other < at + 60 for other, _ in taken) for at, _ in taken)
        world.clock.at_s += 3_600
        granted = sum(world.people["carol"].approval(ask_id)["state"] != "expired" for _, ask_id in taken[-50:])
        figure = (
            f"{STORM} asks by {AGENTS} agents in an hour: {len(taken)} shown, at most {minute / approvers:g} a minute and "
            f"{len(taken) / approvers:g} an hour for each of {approvers} approvers; {granted} answered by silence"
        )
        wrong = granted + refused + (minute > 6 * approvers) + (len(taken) > 30 * approvers)
        return verdict("D4", wrong, figure, enough=bool(taken))


# --- all ---------------------------------------------------------------------------------------------------------------


def verdict(mark: str, wrong: int, figure: str, *, enough: bool) -> str:
    """The figure, or the end of the program where it is not what it has to be."""
    if wrong or not enough:
        sys.exit(f"{mark}: {figure}: NOT AS CLAIMED")
    return f"{mark}: {figure}"


if __name__ == "__main__":
    print({"defects": defects, "mutants": mutants, "storm": storm}[sys.argv[1]]())
