"""A maker makes the same value as its class."""

from __future__ import annotations

import copy
import pickle
from dataclasses import FrozenInstanceError, dataclass, field, fields, replace

import pytest
from capabilities.proof import proof
from capabilities.token import checks
from capabilities.values import chain, scope
from capabilities.values.fast_dataclass import maker
from capabilities.values.scope import Tier
from tests.capabilities.world import SCOPE, SLOWER, SPONSOR, chain_of, chain_of_four, grant_to

pytestmark = pytest.mark.clause(reason="how values are made fast; no clause says how they are made")

CHAIN = chain_of(chain_of_four())
MADE = [
    (scope.make_scope, SCOPE),
    (scope.make_restriction, SLOWER),
    (chain.make_sponsor, SPONSOR),
    (chain.make_grant, grant_to("robotic", "alice")),
    (chain.make_attestation, grant_to("robotic", "alice").attestation),
    (chain.make_hop, CHAIN.leaf),
    (chain.make_chain, CHAIN),
    (checks.make_checks, checks.Checks((), 1, None, 3)),
    (proof._make_proof, proof.Proof("j" * 22, 5, b"k" * 32, b"d" * 32)),
]


def stated(instance):
    return {f.name: getattr(instance, f.name) for f in fields(instance) if f.init}


@pytest.mark.parametrize(("make", "instance"), MADE, ids=lambda each: type(each).__name__)
def test_a_maker_makes_what_the_class_makes(make, instance):
    given = stated(instance)
    for made in (make(**given), make(*given.values())):
        assert type(made) is type(instance)
        assert made == type(instance)(**given)
        assert hash(made) == hash(type(instance)(**given))
        assert repr(made) == repr(type(instance)(**given))
        assert copy.deepcopy(made) == made == pickle.loads(pickle.dumps(made))  # noqa: S301 - our own
        assert replace(made) == made
        assert not hasattr(made, "__dict__")


@pytest.mark.parametrize(("make", "instance"), MADE, ids=lambda each: type(each).__name__)
def test_what_was_made_is_frozen(make, instance):
    made = make(**stated(instance))
    for name in stated(made):
        with pytest.raises(FrozenInstanceError):
            setattr(made, name, None)
        with pytest.raises(FrozenInstanceError):
            delattr(made, name)
    with pytest.raises((FrozenInstanceError, TypeError, AttributeError)):
        made.other = 1


def test_each_field_gets_its_own_value_and_the_rest_their_defaults():
    assert scope.make_restriction(ceiling=Tier.REVERSIBLE) == scope.Restriction(ceiling=Tier.REVERSIBLE)
    given = {name: number for number, name in enumerate(stated(CHAIN.leaf))}
    assert stated(chain.make_hop(**given)) == given
    made = scope.make_scope(*[getattr(SCOPE, name) for name in stated(SCOPE)])
    assert made.find("ur3e", "move_joint") is SCOPE.find("ur3e", "move_joint") is not None


@pytest.mark.parametrize("wrong", [{}, {"index": 0}, {**stated(CHAIN.leaf), "further": 1}])
def test_a_maker_takes_what_the_class_takes(wrong):
    with pytest.raises(TypeError):
        chain.make_hop(**wrong)


def test_a_class_that_does_more_than_store_has_no_maker():
    @dataclass(frozen=True, slots=True)
    class Checked:
        a: int

        def __post_init__(self) -> None:
            raise ValueError

    @dataclass(frozen=True, slots=True)
    class Filled:
        a: list[int] = field(default_factory=list)

    @dataclass(frozen=True, slots=True)
    class Hidden:
        a: int = field(init=False)

    for kind in (Checked, Filled, Hidden):
        with pytest.raises(TypeError):
            maker(kind)
