"""Fixtures of the judge of a lease."""

import pytest
from tests.pep.rtde.leased import House


@pytest.fixture
def house(tmp_path):
    house = House(tmp_path)
    yield house
    house.gate.close()
    house.journal.close()
