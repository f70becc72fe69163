"""Caller of the cell that a test of its pages runs."""

import pytest
from tests.e2e.test_up import Caller


@pytest.fixture(scope="module")
def caller(cell):
    return Caller(cell)
