"""Scopes of the cast: the widest one that a sponsor lends is read again by its own form."""

from types import SimpleNamespace

from capabilities.values.caps import DEFAULT
from capabilities.values.well_formed import well_formed
from evaluation.redteam.cast import Cast


class Sponsor:
    def __init__(self):
        self.lent = []

    def issue(self, agent, scope, *, purpose):  # noqa: ARG002 - as an operator's
        self.lent.append(scope)
        return SimpleNamespace(token="text")


def test_a_free_hand_is_a_scope_of_these_operations():
    sponsor = Sponsor()
    cell = SimpleNamespace(addresses=SimpleNamespace(audience="http://127.0.0.1:1/mcp"))
    stage = SimpleNamespace(agents={"robotic-1": None}, cell=cell, person=lambda _: sponsor)
    assert Cast(stage, 1).free_hand("robotic", {"servo_joint", "move_path", ""}) == "text"
    (scope,) = sponsor.lent
    assert well_formed(scope, DEFAULT) == scope
    assert [(grant.object, grant.operation) for grant in scope.grants] == [
        ("table", "touch"),
        ("ur3e", "move_path"),
        ("ur3e", "read_state"),
        ("ur3e", "servo_joint"),
        ("ur3e", "stop"),
    ]
