"""Defences of each refusing step: without the one that it rests on, the step is no longer as told.

Each case plays the step in a cell of which a process runs with one check undone (tests/e2e/sabotage.py), and what the step needs;
sees that everything before it is as told, and that the attack then does exactly what the check had kept from happening.

One case of each kind is always played. They share a cell, and only the process whose defect changes is begun anew, as a copy
(evaluation/harness/copies.py). The other cases are for `make campaign`, each in a cell of its own that has its defect from the beginning.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from evaluation.coverage.theatre import START
from evaluation.harness import copies
from tests.e2e import sabotage
from ztpm.base.processes import Child
from ztpm.demo.run import StepReport, play
from ztpm.demo.story import STORY
from ztpm.stage.live import stage
from ztpm.stage.stage import LEFT, WAIT_S, Stage, until

IDP, GATEWAY, TOOLS = ("identity provider",), ("gateway",), ("tool server",)
BOTH = (*TOOLS, *GATEWAY)
"""Processes that verify by themselves: one alone would be found out by the other."""

IN_VAIN_S = 5.0
"""Seconds for which a step waits for a refusal that its defect keeps from coming."""
FOREVER = ("NONE", "STEP_FAILED", False)
"""The refusal that the step waits for never comes: the wait itself is the observation."""
MOVED = ("PERMIT", "PERMITTED", True)

# step, processes, defect, what is then seen: decision, reason, whether the arm moved
CASES = [
    ("widen-refused", IDP, "idp_lends_more", ("PERMIT", "DELEGATED", False)),
    ("unattested-refused", IDP, "idp_takes_any_evidence", ("DENY", "HOP_NOT_ATTESTED", False)),
    ("unattested-refused", BOTH, "pep_takes_unattested_blocks", MOVED),
    ("scope-refused", GATEWAY, "pep_grants_everything", ("PERMIT", "PERMITTED", False)),
    ("limit-refused", GATEWAY, "pep_grants_everything", MOVED),
    ("replay-refused", BOTH, "pep_forgets_proofs", ("PERMIT", "PERMITTED", False)),
    ("stolen-refused", BOTH, "pep_takes_any_key", MOVED),
    ("tampered-refused", BOTH, "pep_trusts_a_token_it_knows", MOVED),
    ("fragile-untrusted", GATEWAY, "pep_ignores_trust", MOVED),
    ("trust-fell", IDP, "idp_charges_nobody", FOREVER),
    ("trust-fell", GATEWAY, "pep_ignores_trust", MOVED),
    ("human-deferred", GATEWAY, "pep_is_blind_to_people", MOVED),
    ("human-deferred", GATEWAY, "pep_moves_without_asking", MOVED),
    ("deferral-expires", GATEWAY, "pep_never_ends_an_ask", FOREVER),
    # TEA-6 asks for the ceiling, too, of the act with what it follows; and what is known of behaviour has an age of its own
    ("ceiling-refused", GATEWAY, "pep_ignores_the_ceiling", ("DENY", "SEQUENCE_TOO_HIGH", False)),
    ("through-person-denied", GATEWAY, "pep_is_blind_to_people", MOVED),
    ("not-finite-refused", BOTH, "pep_reads_nan", ("DENY", "NOT_FINITE", False)),
    ("revoked-refused", BOTH, "pep_ignores_revocations", FOREVER),
    ("sponsor-disabled", BOTH, "pep_ignores_sponsors", FOREVER),
    ("stale-feed-refused", BOTH, "pep_ignores_the_age_of_its_view", ("DENY", "BEHAVIOUR_OLD", False)),
    ("approval-used-up", GATEWAY, "pep_never_uses_an_approval_up", MOVED),
    ("approval-changed-world", GATEWAY, "pep_ignores_what_was_shown", MOVED),
    ("agent-approval-refused", IDP, "idp_lets_anybody_vote", ("PERMIT", "NONE", False)),
    ("zone-denied", GATEWAY, "pep_sees_no_zones", MOVED),
    ("one-of-two-refused", GATEWAY, "pep_takes_one_for_two", MOVED),
    ("stale-world-deferred", GATEWAY, "pep_sees_no_age", FOREVER),
    ("forged-frame-refused", GATEWAY, "pep_believes_any_frame", FOREVER),
    ("place-on-table", GATEWAY, "pep_touches_anything", MOVED),
    ("human-enters-stops", GATEWAY, "pep_does_not_watch_the_world", FOREVER),
    ("revoke-in-motion", GATEWAY, "pep_does_not_watch_authority", FOREVER),
    ("idp-killed-in-motion", BOTH, "pep_ignores_the_age_of_its_view", FOREVER),
    ("rtde-raw-denied", GATEWAY, "gateway_is_open", ("DENY", "IN_USE", True)),
    ("rtde-hijack-refused", GATEWAY, "gateway_lends_twice", ("DENY", "LEASE_HELD", False)),
]
ALWAYS = frozenset(
    {
        "idp_lends_more", "pep_takes_any_key", "pep_is_blind_to_people", "pep_does_not_watch_authority", "gateway_is_open",
    }
)  # fmt: skip
"""Of the provider; of authority, physics, policy and watch at the tools; of the gateway."""
SHORT_RAD = {"rtde-raw-denied": 1e-3}
"""Least way of the arm where another defence comes: the tools take it back from a stranger's program."""
STOPS = frozenset({"place-on-table", "human-enters-stops", "revoke-in-motion", "idp-killed-in-motion"})
"""Steps that permit and refuse: what is not granted, and what goes on when it should not."""


def test_every_refusing_step_has_a_case() -> None:
    refusing = {step.id for step in STORY.steps if step.expect.decision in ("DENY", "DEFER")}
    assert refusing | STOPS == {step for step, *_ in CASES}
    assert {defect for _, _, defect, _ in CASES} >= ALWAYS


class Theatre:
    """A stage, the defects of its processes by name, and the steps that were played on it."""

    def __init__(self, on_stage: Stage, defects: dict[str, str]) -> None:
        self.stage, self.defects = on_stage, defects
        self.delegated: list[StepReport] = []

    def change(self, broken: tuple[str, ...], defect: str) -> None:
        """Runs these processes with that defect and all others with none.

        The arm stands at the left of an empty scene.
        """
        wanted = dict.fromkeys(broken, defect)
        changed = {child for child in START if self.defects.get(child) != wanted.get(child)}
        self.defects.clear()
        self.defects.update(wanted)
        if changed:
            self.stage.close()
            self.stage.eyes, self.stage.side = None, LEFT
            self.stage.cell.start_robot()  # wherever the last case has left its arm, and whatever it went on doing
            with self.stage.cell.beside():
                for child in START:
                    if child in {*changed, *GATEWAY}:
                        START[child](self.stage.cell)
            until(lambda: self.stage.perception() == "fresh", "a fresh view")
        self.stage.scene()

    def play(self, name: str, *, wait_s: float = WAIT_S) -> StepReport:
        """The step, played with this longest wait; what it needs is as told."""
        steps = STORY.only(frozenset({name}))
        assert steps[-1].id == name
        known = {told.id for told in self.delegated}
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("ztpm.stage.stage.WAIT_S", wait_s)
            told = [play(self.stage, step) for step in steps if step.id not in known]
        assert [step.id for step in told[:-1] if not step.ok] == []
        return told[-1]

    def delegate(self) -> None:
        """Plays the steps that every other step needs, once."""
        self.delegated = [play(self.stage, step) for step in STORY.only(frozenset({"delegate"}))]
        assert [step.id for step in self.delegated if not step.ok] == []


@contextmanager
def theatre(
    broken: tuple[str, ...] = (), defect: str = "", *, by: Callable[..., Child] = Child.begin
) -> Iterator[Theatre]:
    """A theatre on a fresh cell of which these processes have that defect from the beginning."""
    defects = dict.fromkeys(broken, defect)

    def begin(child: str, module: str, *arguments: str, environment: dict[str, str]) -> Child:
        if child not in defects:
            return by(child, module, *arguments, environment=environment)
        return sabotage.begin(by, defects[child], child, module, *arguments, environment=environment)

    with stage(begin=begin) as on_stage:
        yield Theatre(on_stage, defects)


@pytest.fixture(scope="module")
def shared() -> Iterator[Theatre]:
    with theatre(by=copies.begin) as opened:
        opened.delegate()
        yield opened


def played(
    request: pytest.FixtureRequest, name: str, broken: tuple[str, ...], defect: str, *, wait_s: float = WAIT_S
) -> StepReport:
    """The step, in a cell in which these processes run with that defect; what it needs was as told."""
    if request.node.get_closest_marker("campaign") is None:
        opened = request.getfixturevalue("shared")
        opened.change(broken, defect)
        return opened.play(name, wait_s=wait_s)
    with theatre(broken, defect) as own:
        return own.play(name, wait_s=wait_s)


@pytest.mark.e2e
@pytest.mark.timeout(180)
@pytest.mark.parametrize(
    ("name", "broken", "defect", "seen"),
    [
        pytest.param(*case, id=f"{case[0]}-{case[2]}", marks=() if case[2] in ALWAYS else pytest.mark.campaign)
        for case in CASES
    ],
)
def test_step_fails_without_its_defence(
    request: pytest.FixtureRequest, name: str, broken: tuple[str, ...], defect: str, seen: tuple[str, str, bool]
) -> None:
    last = played(request, name, broken, defect, wait_s=IN_VAIN_S)
    assert not last.ok, last
    assert (last.decision, last.reason, last.moved_rad > SHORT_RAD.get(name, 0.1)) == seen, last


@pytest.mark.e2e
@pytest.mark.timeout(180)
@pytest.mark.parametrize(
    ("name", "defect"),
    [
        ("stolen-refused", "pep_takes_any_key"),
        pytest.param("replay-refused", "pep_forgets_proofs", marks=pytest.mark.campaign),
        pytest.param("unattested-refused", "pep_takes_unattested_blocks", marks=pytest.mark.campaign),
        pytest.param("not-finite-refused", "pep_reads_nan", marks=pytest.mark.campaign),
        pytest.param("revoked-refused", "pep_ignores_revocations", marks=pytest.mark.campaign),
    ],
)
def test_a_tool_server_without_a_defence_opens_nothing(request: pytest.FixtureRequest, name: str, defect: str) -> None:
    """The gateway verifies for itself what the tool server has verified."""
    told = played(request, name, TOOLS, defect)
    assert told.ok, told


@pytest.mark.e2e
@pytest.mark.timeout(180)
def test_audit_step_fails_without_the_chain(shared: Theatre, monkeypatch: pytest.MonkeyPatch) -> None:
    """The offline check runs in this process: without its comparison of hashes the flipped bit goes unseen."""
    from ztpm_idp import ledger_file

    walk = ledger_file._Walk
    entry, end = walk._entry, walk.end

    def unlinked(self, value, seq, line):
        entry(self, {**value, "prev": self._head}, seq, line)

    def unsigned(self):
        self._head = self._checkpoint.head
        return end(self)

    monkeypatch.setattr(walk, "_entry", unlinked)
    monkeypatch.setattr(walk, "_record", lambda self, actor, body, seq, line: None)
    monkeypatch.setattr(walk, "end", unsigned)
    shared.change((), "")
    told = shared.play("audit-verifies")
    assert not told.ok, told
    assert (told.decision, told.reason) == ("DONE", "VERIFIED")
