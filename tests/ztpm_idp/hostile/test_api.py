"""A short run of `make hostile-api`: right and wrong requests of the API's description, from some roles."""

from __future__ import annotations

import pytest
from tests.ztpm_idp.hostile import api
from tests.ztpm_idp.hostile.callers import SIGNING, STRANGERS, Callers, furnished

pytestmark = [pytest.mark.version, pytest.mark.long]


@pytest.fixture(scope="module")
def callers(tmp_path_factory):
    with furnished(tmp_path_factory.mktemp("hostile")) as world:
        yield Callers(world)


def test_whatever_the_description_allows_or_forbids_is_answered_in_its_own_terms(callers):
    """Each third operation once, right or wrong in turn, from a role that signs and from a stranger."""
    every, found = api.operations(api.near(api.document(callers.world), callers)), api.Found()
    assert len(every) > 90
    for number, operation in enumerate(every[::3]):
        roles = (STRANGERS[number % len(STRANGERS)], SIGNING[number % len(SIGNING)])
        mode = "wrong" if number % 2 and operation.body else "right"
        api.play(callers, operation, roles, found, mode=mode, cases=1, number=number, known=True)
    assert found.wrong == {}
    assert {200, 400, 401, 403, 404} <= set(found.statuses)


def test_the_description_says_of_every_query_what_it_takes(callers):
    described = api.document(callers.world)["paths"]
    stated = {
        f"{verb} {path}": [one["name"] for one in operation.get("parameters", ()) if one["in"] == "query"]
        for path, verbs in described.items()
        for verb, operation in verbs.items()
    }
    assert stated["get /ztpm/revocations"] == ["since", "nonce", "base"]
    assert stated["get /ztpm/registry"] == ["audience"]
    without = [
        f"{verb} {path}"
        for path, verbs in described.items()
        for verb, operation in verbs.items()
        if verb == "post" and not operation["requestBody"]["content"]
    ]
    assert without == []
    proven = {path for path, verbs in described.items() if "security" in verbs.get("post", {})}
    assert "/ztpm/tokens" in proven and "/ztpm/oauth/token" not in proven
