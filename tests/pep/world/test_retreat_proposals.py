"""Ways out of a stop, by the real physics: certified from where the arm stands, the mildest first."""

import itertools

import pytest
from capabilities.statements.people.latch import Retreat
from capabilities.values.scope import Tier
from pep.pit.assessment.readiness import compile_all
from pep.world.retreat import SPEED_URAD_S, proposed
from policies.evidence.evidence import ImpactFault
from tests.pep.kit import AUDIENCE, reading
from tests.pep.pit.scenes import HOME
from tests.pep.test_retreat import Cell, hand_at_the_fingers

pytestmark = pytest.mark.clause("LSD-23")
HERE = tuple(round(angle * 1e6) for angle in HOME)
compile_all()


@pytest.fixture
def cell(tmp_path):
    cell = Cell(tmp_path)
    yield cell
    cell.gate.close()
    cell.journal.close()


def ways(assess, *, back=None, late=lambda: False):
    ids = (f"{n:032x}" for n in itertools.count(1))
    return proposed(HERE, back, assess, audience=AUDIENCE, at=1.0, new_id=lambda: next(ids), late=late)


def by_physics(cell):
    return lambda request: cell.physics.assess(request, touch=frozenset()).impact


def test_out_of_a_person_the_way_is_certified_and_leads_away(cell):
    """The physics gives deeper into the hand to nobody: the proposal leads out, at tier 3."""
    cell.at(HOME, hand_at_the_fingers(0.01))
    way = ways(by_physics(cell))
    assert isinstance(way, Retreat)
    assert (way.tier, way.speed_urad_s) == (Tier.HIGH_CONSEQUENCE, SPEED_URAD_S)
    asked, kinds = cell.move([angle * 1e-6 for angle in way.target_urad], speed_rad_s=round(SPEED_URAD_S * 1e-6, 6))
    assert (asked.tier, "retreat" in kinds) == (Tier.HIGH_CONSEQUENCE, True), "the gate says the same of it"
    assert {turn.joint for turn in way.turns} <= {0, 1, 2, 3}
    for turn in way.turns:
        assert way.target_urad[turn.joint] - HERE[turn.joint] == turn.by_urad


def test_in_a_clear_cell_the_way_back_is_told_where_it_is_as_mild(cell):
    cell.at(HOME)
    back = (HERE[0] + 300_000, *HERE[1:])
    way = ways(by_physics(cell), back=back)
    alone = ways(by_physics(cell))
    assert way.tier <= alone.tier
    assert (way.tier, way.index_milli) <= (alone.tier, alone.index_milli)


def test_of_equal_ways_the_one_back_is_preferred_and_a_milder_one_before_it():
    back = (HERE[0] + 300_000, *HERE[1:])
    assert ways(lambda request: reading(), back=back).target_urad == back
    mild = HERE[1] - 200_000

    def assess(request):
        return reading(index_milli=500 if request.quantities[1].value == mild else 900)

    assert ways(assess, back=back).target_urad[1] == mild


def test_a_start_that_is_where_the_arm_stands_is_no_way():
    way = ways(lambda request: reading(), back=(HERE[0] + 1_000, *HERE[1:]))
    assert [turn.joint for turn in way.turns] == [1]


@pytest.mark.parametrize(
    ("impact", "code"),
    [
        (ImpactFault("PERCEPTION_INVALID", "camera-1"), "PERCEPTION_INVALID"),
        (ImpactFault("PHYSICS_FAULT", "slow"), "PHYSICS_FAULT"),
        (reading(violations=("person",)), "PHYSICS_VIOLATION"),
    ],
)
def test_where_nothing_is_certified_the_code_says_why(impact, code):
    assert ways(lambda request: impact) == code


def test_what_is_late_is_tried_no_more():
    asked = []

    def assess(request):
        asked.append(request)
        return reading()

    assert isinstance(ways(assess, late=lambda: len(asked) == 3), Retreat)
    assert len(asked) == 3
    assert ways(assess, late=lambda: True) == "UNPROVEN"
