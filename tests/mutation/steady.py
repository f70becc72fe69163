"""A pytest plugin: every test makes the same attempts for every mutant, and no answer outlives its test."""

import pytest
from hypothesis import settings


def pytest_sessionstart(session):
    """Fixed examples, none remembered from another mutant. After the suite's own profile, before any test is collected."""
    settings.register_profile("mutants", settings(), derandomize=True, database=None, print_blob=False)
    settings.load_profile("mutants")


@pytest.fixture(autouse=True)
def nothing_remembered():
    """Forgets the shapes of classes, which a process computes once: each belongs to the test that asks."""
    from policies.evidence import shape

    shape._checker.cache_clear()
