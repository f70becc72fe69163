import pytest
from tests.ztpm_idp import world as worlds
from tests.ztpm_idp.world import World


def pytest_configure(config):
    if config.getoption("postgres"):
        worlds.DATABASE[:] = ["postgres"]


@pytest.fixture
def world(tmp_path):
    with World(tmp_path) as made:
        yield made
