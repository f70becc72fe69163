"""Provider with an enforcement point, and a browser with an authenticator, for each module of this folder."""

import pytest
from tests import browsing
from tests.ztpm_idp.asks import Cell


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    with browsing.served(tmp_path_factory.mktemp("browser")) as world:
        yield Cell(world)


@pytest.fixture(scope="module")
def page():
    with browsing.browser_page(viewport=browsing.TELEPHONE, reduced_motion="reduce") as opened:
        yield browsing.authenticator(opened)


@pytest.fixture(scope="module")
def axe():
    return browsing.rules()
