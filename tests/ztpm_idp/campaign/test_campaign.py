"""Slices of `make tampering` and `make horizon`: each claim holds, and fails where a defence is taken out."""

from __future__ import annotations

import random

import pytest
from tests.ztpm_idp.campaign import tampering
from ztpm_idp.domain.ledger import seal


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
