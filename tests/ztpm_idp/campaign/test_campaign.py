"""Slices of `make tampering` and `make horizon`: each claim holds, and fails where a defence is taken out."""

from __future__ import annotations

import asyncio
import dataclasses
import random
import time
from contextlib import closing
from types import SimpleNamespace

import pytest
from capabilities.statements.revocation import RevocationView
from capabilities.token.verify import Verifier
from capabilities.values.caps import DEFAULT
from tests.progress import Progress
from tests.ztpm_idp.campaign import horizon, tampering
from ztpm_idp.domain.ledger import seal
from ztpm_idp.keys.key_files import IdpKeys

from capabilities.keys import keys


@pytest.fixture(scope="module")
def scene():
    return tampering.Scene(200)


def test_every_changed_copy_is_found_by_who_holds_the_checkpoint():
    counted, effects = tampering.run(entries=150, trials=96, seed=7)
    assert not [key for key in counted if key[2] == "ESCAPED"]
    assert {way for way, _, _ in counted} == set(tampering.WAYS)
    thiefs = {code for _, who, code in counted if who == "thief"}
    assert thiefs == {"LEDGER_FORKED", "CUT"}, "nothing in their copies is wrong but that another ledger is held"
    assert effects == sum(entry["kind"] == "pep-record" for entry in tampering.ledger(150))


def test_without_a_held_checkpoint_the_thief_of_the_key_escapes():
    scene = tampering.Scene(200)
    scene.head = None
    scene.walks = scene.honest_walks()
    codes = {tampering.trial(scene, way, thief=True, drawn=random.Random(1)) for way in tampering.WAYS}
    assert codes == {"ESCAPED"}


def test_the_campaigns_own_chain_is_the_ledgers(scene):
    """The copies are made quicker than entries are sealed, and are the same."""
    prev = "0" * 64
    for number, line in enumerate(scene.lines[:20], start=1):
        entry = scene.entries[number - 1]
        if entry["kind"] != "pep-record":
            sealed = seal(
                seq=number, prev=prev, at_ms=entry["at_ms"], actor="alice", kind="revoked", body=entry["body"]
            )
            assert sealed.line == line
        prev = tampering.hashlib.sha256(line).hexdigest()
    drawn = random.Random(3)
    for way in tampering.WAYS:
        entries = tampering.changed(scene.entries, scene.other, way, drawn, tampering.flipped_entry)
        assert tampering.chained(entries, scene.states, honest=scene.entries) == tampering.chained(entries)


# --- the horizon of revocations --------------------------------------------------------------------------------------


def test_permits_after_a_denial_and_points_that_never_deny_break_the_claim():
    good = horizon.Horizon([10.0] * 99 + [900.0], [20.0], 0, 0, 0)
    assert good.holds
    assert good.told["revocation_ms.p99"] == 900.0
    for change in (
        {"after": 1},
        {"unseen": 1},
        {"last_ms": [], "cascade_ms": []},
        {"last_ms": [10.0] * 80 + [1_001.0] * 20},
        {"cascade_ms": [2_000.0]},
    ):
        assert not dataclasses.replace(good, **change).holds


def test_the_board_keeps_what_each_point_saw(tmp_path):
    with (
        closing(horizon.Board(tmp_path / "board", 3, 2, new=True)) as board,
        closing(horizon.Board(tmp_path / "board", 3, 2)) as other,
    ):
        check_board(board, other)


def check_board(board, other):
    board.current = 1
    assert other.current == 1
    other.permitted(2, 1)
    other.denied(2, 1)
    other.permitted(2, 1)
    other.otherwise(2, 1)
    other.failed(2)
    last, denied, after, stale, failed = board.seen(2, 1)
    assert (after, stale, failed, 0 < denied <= last) == (1, 1, 1, True)
    assert board.seen(1, 1) == (0, 0, 0, 0, 0)
    assert not board.every(1, 0)


def test_a_points_look_tells_permit_revoked_and_old_apart(tmp_path):
    """A descendant is dead with its root; an old view permits nothing, and is no revocation."""
    made = IdpKeys(*(keys.generate() for _ in range(5)))
    trust = made.trust(issuer="https://idp.example/ztpm", root_key_id=1)
    issuer = horizon.Issuer({"root": made.root, "attester": made.attester}, trust, int(time.time()))
    root_hop, tree = issuer.tree(12, random.Random(1), Progress())
    view = None
    with closing(horizon.Board(tmp_path / "board", 1, 1, new=True)) as board:
        point = horizon.Point.__new__(horizon.Point)
        point.number, point.board, point.verifier = 0, board, Verifier(trust, DEFAULT)
        point.follower = SimpleNamespace(view=lambda: view)
        seen = []
        for view in (
            RevocationView(0, 0, frozenset()),
            RevocationView(1, 0, frozenset({("hop", root_hop)})),
            RevocationView(1, horizon.LEASE_MS + 1, frozenset()),
        ):
            asyncio.run(point.look(1, tree))
            last, denied, _, stale, _ = board.seen(0, 1)
            seen.append((bool(last), bool(denied), stale))
        assert seen == [(True, False, 0), (True, True, 0), (True, True, len(tree))]


@pytest.mark.campaign
@pytest.mark.e2e
def test_a_slice_of_the_horizon(tmp_path):
    found = horizon.run(tmp_path, fleet=2, points=1, tokens=20, revocations=3, descendants=10, burners=0)
    assert (found.after, found.unseen, len(found.last_ms), len(found.cascade_ms)) == (0, 0, 9, 3)
