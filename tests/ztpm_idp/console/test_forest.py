"""Trees as people see them: what kills a hop, what dies with it, and whose trust stands beside it."""

from __future__ import annotations

import pytest
from ztpm_idp.console import forest
from ztpm_idp.store.lending import LentHop

pytestmark = pytest.mark.clause("CON-2")
ROWS = (
    LentHop("h0", "t1", None, "planner", "alice", 1_000, 9, None),
    LentHop("h1", "t1", "h0", "mover", "alice", 2_000, 9, None),
    LentHop("h2", "t1", "h1", "gripper", "alice", 3_000, 9, None),
    LentHop("h3", "t1", "h0", "camera", "alice", 3_000, 9, None),
    LentHop("m0", "t2", None, "mover", "bob", 5_000, 9, "m1"),
    LentHop("x9", "t3", "gone", "mover", "bob", 5_000, 9, None),
)
EVERY = {"h0", "h1", "h2", "h3", "m0"}


def grown(*dead, former=None, **scores):
    keys = {agent: f"k-{agent}" for agent in ("planner", "mover", "gripper", "camera")}
    standings = forest.Standings(frozenset(dead), keys, former or {}, scores, 800)
    roots = forest.grown(ROWS, standings)
    return roots, {b.hop.hop_id: b for trees in roots.values() for root in trees for b in root.each()}


@pytest.mark.parametrize(
    ("name", "dies"),
    [
        (("token", "t1"), {"h0", "h1", "h2", "h3"}),
        (("hop", "h1"), {"h1", "h2"}),
        (("agent", "planner"), {"h0", "h1", "h2", "h3"}),
        (("agent", "mover"), {"h1", "h2", "m0"}),
        (("key", "k-camera"), {"h3"}),
        (("sponsor", "bob"), {"m0"}),
        (("mandate", "m1"), {"m0"}),
        (("hop", "t1"), set()),
    ],
)
def test_a_hop_dies_by_its_own_names_and_with_the_hop_above(name, dies):
    roots, found = grown(name)
    assert found.keys() == EVERY, "one whose hop above is missing is left out"
    assert {id_ for id_, branch in found.items() if branch.dead_by is not None} == dies
    assert {branch.dead_by for branch in found.values()} - {None} == ({name} if dies else set())
    assert {b.hop.hop_id for trees in roots.values() for b in forest.hit(trees, name)} == dies
    assert sum(root.living for trees in roots.values() for root in trees) == len(EVERY - dies)


def test_what_came_from_above_is_told_from_what_is_its_own():
    _, found = grown(("agent", "mover"), ("hop", "h2"))
    assert [found[id_].above for id_ in ("h0", "h1", "h2", "m0")] == [False, False, False, False]
    _, found = grown(("agent", "mover"))
    assert (found["h2"].above, found["h2"].dead_by) == (True, ("agent", "mover"))


def test_a_hop_that_was_made_for_a_key_before_dies_with_that_key():
    _, found = grown(("key", "old"), former={"mover": [(2_500, "old"), (6_000, "newer")]})
    assert {id_ for id_, branch in found.items() if branch.dead_by} == {"h1", "h2"}
    _, found = grown(("key", "newer"), former={"mover": [(2_500, "old"), (6_000, "newer")]})
    assert {id_ for id_, branch in found.items() if branch.dead_by} == {"m0"}


def test_trust_is_that_of_the_edge_and_the_newest_tree_comes_first():
    roots, found = grown(mover={"planner": 512, "bob": 100})
    told = {id_: (b.delegator, b.trust) for id_, b in found.items()}
    assert told == {
        "h0": ("alice", "0.80"), "h1": ("planner", "0.51"), "h2": ("mover", "0.80"), "h3": ("planner", "0.80"),
        "m0": ("bob", "0.10"),
    }  # fmt: skip
    assert [root.hop.hop_id for root in roots["alice"]] == ["h0"]
